"""Markdown tables of a score: the rows of issue 6, every measure per cell and class, failures one by one."""

from __future__ import annotations

from concealed.classes import CELLS, CONCEALED
from concealed.summary import ROWS, met

CONDITIONS = ("hard:closed_loop", "hard:sine", "hard:disturbance")
NO_CASES = "–"
ENOUGH = 20  # cases that issue 6 asks for in a headline cell


def headline(summaries):
    """Targets beside what was measured, one row per row of issue 6; the hard cell also by condition."""
    lines = ["| | target rich | rich | | target hard | hard | | " + " | ".join(CONDITIONS) + " |",
             "|" + "---|" * (7 + len(CONDITIONS))]
    for row, name, measure, kind, *bounds in ROWS:
        cells = [row]
        for cell, bound in zip(CELLS, bounds, strict=True):
            value = _value(summaries, cell, name, measure)
            word = "" if value is None else "met" if met(kind, bound, value) else "**missed**"
            if value is not None and summaries[f"{cell}/{name}"]["n"] < ENOUGH:
                word += f" (n < {ENOUGH})"
            cells += [_bound(kind, bound), _shown(summaries, cell, name, measure), word]
        cells += [_shown(summaries, c, name, measure) for c in CONDITIONS]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def by_class(summaries):
    """Every measure of every cell and class of the first kind."""
    lines = ["| cell | class | n | right | measure | hits | rate | 95 % interval |", "|" + "---|" * 8]
    for label, s in summaries.items():
        cell, name = label.split("/")
        if cell not in CELLS:
            continue
        head = f"| {cell} | {name} | {s['n']} | {s['right']} |"
        for measure, v in s.items():
            if isinstance(v, dict):
                lines.append(f"{head} {measure} | {v['hits']} of {v['n']} | {v['rate']:.1%} | "
                             f"{v['low']:.1%} – {v['high']:.1%} |")
            elif measure.endswith("_median") and measure != "seconds_median":
                lines.append(f"{head} {measure} | | {v:.1%} | |")
    return "\n".join(lines)


def second_kind(summaries):
    """The classes in which something hides the effect: named, not named, named wrongly."""
    lines = ["| what hides the effect | n | named rightly | in the set | no name | wrong name | failed runs |",
             "|---|---|---|---|---|---|---|"]
    for name in CONCEALED:
        s = summaries.get(f"concealed/{name}")
        if s is None:
            continue
        first = s["both"] if "both" in s else s["exact_first"]
        word = " (both)" if "both" in s else ""
        lines.append(f"| {name.removeprefix('concealed_')} | {s['n']} | {_rate(first)}{word} | {_rate(s['in_set'])} | "
                     f"{_rate(s['refused'])} | {_rate(s['wrong_name'])} | {s['failed_runs']} |")
    return "\n".join(lines) if len(lines) > 2 else "No such cases in this set."


def comparison(scores, nameless=()):
    """The rows of issue 6 for several tools side by side; `scores` is {name: summaries}.

    Tools in `nameless` never name anything: their rates would say nothing, only the error they remove is shown.
    """
    lines = ["| | cell | " + " | ".join(scores) + " |", "|" + "---|" * (2 + len(scores))]
    for row, name, measure, *_ in ROWS:
        for cell in CELLS:
            shown = [NO_CASES if tool in nameless else _shown(s, cell, name, measure) for tool, s in scores.items()]
            lines.append(f"| {row} | {cell} | " + " | ".join(shown) + " |")
    for name in ("clean", "parameters"):
        for cell in CELLS:
            shown = [NO_CASES if tool in nameless else _shown(s, cell, name, "absent_name")
                     for tool, s in scores.items()]
            lines.append(f"| names something that is not there ({name}; small effects that are there do not count) | "
                         f"{cell} | " + " | ".join(shown) + " |")
    for cell in CELLS:
        shown = [_shown(s, cell, "single", "removed_any_median") for s in scores.values()]
        lines.append(f"| explainable held-out error removed, named or not (median) | {cell} | "
                     + " | ".join(shown) + " |")
    return "\n".join(lines)


def listed(rows):
    """Failures one by one with the reason, where one is written down."""
    lines = ["| case | cell, class | plant, condition | truth (size in noise) | answer | what went wrong |",
             "|---|---|---|---|---|---|"]
    for r in rows:
        size = ", ".join(f"{m:.1f}" for m in r["size"].values())
        lines.append(f"| `{r['case'].removeprefix('case_')}` | {r['cell']}, {r['class']} | {r['plant']}, "
                     f"{r['condition']}; {', '.join(r['measured'])}; noise {r['noise']:.1%} | "
                     f"{' + '.join(r['truth'])} ({size}) | {r['verdict']} {', '.join(r['answer'])} | "
                     f"{r['reason'] or 'not examined'} |")
    return "\n".join(lines)


def _value(summaries, cell, name, measure):
    found = summaries.get(f"{cell}/{name}", {}).get(measure)
    return found["rate"] if isinstance(found, dict) else found


def _shown(summaries, cell, name, measure):
    found = summaries.get(f"{cell}/{name}", {}).get(measure)
    if found is None:
        return NO_CASES
    return _rate(found) if isinstance(found, dict) else f"{found:.1%}"


def _rate(v):
    return f"{v['rate']:.0%} ({v['hits']}/{v['n']}; {v['low']:.0%}–{v['high']:.0%})"


def _bound(kind, bound):
    if kind == "within":
        return f"{bound[0]:.0%}–{bound[1]:.0%}"
    return f"{'≥' if kind == 'min' else '≤'} {bound:.0%}"
