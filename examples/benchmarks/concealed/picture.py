"""The confusion matrix as a picture: concealed effect against the first name given."""

from __future__ import annotations

import numpy as np

from concealed.catalogue import IDS

SILENT = ("agreement", "parameters_only", "unexplained", "failed")


def _said(verdict):
    if verdict.facts["exact_first"]:
        return verdict.entry["effects"][0]["id"]
    return verdict.ids[0] if verdict.ids else verdict.verdict


def confusion(verdicts, path):
    """Save the picture of single-effect cases; a double that the key accepts counts as the truth."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    columns = [*IDS, *SILENT]
    counts = np.zeros((len(IDS), len(columns)))
    for v in verdicts:
        if v.entry["class"] == "single":
            counts[IDS.index(v.entry["effects"][0]["id"]), columns.index(_said(v))] += 1
    fig, ax = plt.subplots(figsize=(11, 10))
    share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    ax.imshow(share, cmap="Blues", vmin=0, vmax=1)
    for i, j in zip(*np.nonzero(counts), strict=True):
        ax.text(j, i, int(counts[i, j]), ha="center", va="center", fontsize=7,
                color="white" if share[i, j] > 0.6 else "black")
    ax.set_xticks(range(len(columns)), columns, rotation=90, fontsize=7)
    ax.set_yticks(range(len(IDS)), IDS, fontsize=7)
    ax.axvline(len(IDS) - 0.5, color="grey", lw=0.8)
    for i in range(len(IDS)):
        ax.add_patch(plt.Rectangle((i - 0.5, i - 0.5), 1.0, 1.0, fill=False, ec="silver", lw=0.5))
    ax.set_xlabel("first name, or verdict without a name")
    ax.set_ylabel("concealed effect")
    fig.tight_layout()
    fig.savefig(path, dpi=100)
    plt.close(fig)
