"""A self-contained HTML page of the report."""

from __future__ import annotations

import base64
from html import escape

from pwaid.mismatch.summary import interval, number, verdict_sentence

__all__ = ["html_page"]

_STYLE = """body{font:15px/1.5 system-ui,sans-serif;max-width:66rem;margin:0 auto;padding:0 1rem 3rem;color:#1a1a1a}
header{border-bottom:2px solid #1a1a1a;margin:1.5rem 0 1rem;padding-bottom:.6rem}
header p.kind{margin:0;letter-spacing:.06em;text-transform:uppercase;font-size:.8rem;color:#555}
h1{font-size:1.5rem;line-height:1.3;margin:.2rem 0}h2{font-size:1.1rem;margin:2rem 0 .3rem}
img{max-width:100%;height:auto}p.caption{margin:.1rem 0 .5rem;color:#444}
pre{background:#f4f4f2;padding:.8rem 1rem;white-space:pre-wrap;font-size:.83rem;line-height:1.4}
table{border-collapse:collapse;font-size:.87rem}td,th{padding:.2rem .7rem .2rem 0;border-bottom:1px solid #ccc;
text-align:left;vertical-align:top}td.n,th.n{text-align:right;font-variant-numeric:tabular-nums}"""


def html_page(report) -> str:
    """The whole page as text, pictures inlined."""
    from pwaid.mismatch.pictures import pictures

    c = report.content
    sentence = verdict_sentence(c)
    parts = [f"<header><p class='kind'>pwaid: explain the mismatch &middot; {escape(c['verdict'].replace('_', ' '))}"
             f"</p><h1>{escape(sentence)}</h1></header>", f"<pre>{escape(report.summary)}</pre>"]
    for title, caption, png in pictures(report):
        data = base64.b64encode(png).decode("ascii")
        parts.append(f"<h2>{escape(title)}</h2><p class='caption'>{escape(caption)}</p>"
                     f'<img alt="{escape(title)}" src="data:image/png;base64,{data}">')
    parts += ["<h2>Fit per held-out recording and output</h2>" + _fit_table(c), "<h2>Parameters</h2>" + _parameters(c),
              "<h2>Every candidate that was fitted</h2>" + _candidates(c), _notes(c)]
    return ("<!doctype html><html lang='en'><head><meta charset='utf-8'>"
            "<meta name='viewport' content='width=device-width'>"
            f"<title>{escape(sentence)}</title><style>{_STYLE}</style></head><body>" + "\n".join(parts)
            + "</body></html>")


def _table(head, rows, numeric=()) -> str:
    """A table; columns in `numeric` are right-aligned."""
    def line(cells, tag):
        return "<tr>" + "".join(f"<{tag}{' class=n' if k in numeric else ''}>{escape(str(cell))}</{tag}>"
                                for k, cell in enumerate(cells)) + "</tr>"

    return "<table>" + line(head, "th") + "".join(line(r, "td") for r in rows) + "</table>"


def _share(x) -> str:
    return "n/a" if x is None else f"{100 * x:.1f} %"


def _fit_table(c) -> str:
    rows = []
    for recording, outputs in c["fit"].items():
        for output, stages in outputs.items():
            for stage, m in stages.items():
                rows.append([recording, output, stage, number(m["rmse"], 4), number(c["noise_floor"][output], 3),
                             number(m["bft"], 4), number(m["vaf"], 4), number(m["lag_one"], 2),
                             number(m["whiteness_p"], 2), _share(m.get("share_explained"))])
    head = ["recording", "output", "simulator", "RMSE", "noise floor", "best fit [%]", "VAF [%]", "lag-one corr.",
            "Ljung-Box p", "share of explainable"]
    return _table(head, rows, range(3, 10))


def _parameters(c) -> str:
    rows = []
    for e in c["effects"]:
        for name, v in e["parameters"].items():
            rows.append([f"{e['id']}: {name}", "", number(v["value"], 5), interval(v["value"], v["low"], v["high"]),
                         v["unit"]])
    for name, v in c["parameters"].items():
        rows.append([name, number(v["nominal"], 5), number(v["refitted"], 5),
                     interval(v["refitted"], v["low"], v["high"]), ""])
    return _table(["parameter", "nominal", "fitted", "90 % interval", "unit"], rows, (1, 2, 3))


def _candidates(c) -> str:
    rows = []
    for r in c["candidates"]:
        rmse = ", ".join(f"{k} {v:.4g}" for k, v in r["heldout_rmse"].items() if v is not None)
        rows.append([r["where"], r["family"], _share(r["share_explained"]), rmse, r["parameters"],
                     "yes" if r["passed"] else "no"])
    return _table(["candidate", "family", "share explained", "held-out RMSE", "parameters", "passed"], rows, (2, 4))


def _notes(c) -> str:
    items = "".join(f"<li>{escape(text)}</li>" for text in [*c["reasons"], *c["warnings"]])
    return f"<h2>Reasons and warnings</h2><ul>{items}</ul>" if items else ""
