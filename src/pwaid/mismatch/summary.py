"""One screen of text: verdict, how sure, where, what, proof, what else, what next."""

from __future__ import annotations

import math
import textwrap

__all__ = ["number", "summary_text", "with_interval"]


def number(x: float | None, digits: int = 3) -> str:
    """A short decimal."""
    return "n/a" if x is None else f"{x:.{digits}g}"


def with_interval(value: float | None, low: float | None, high: float | None) -> str:
    """A value and its interval, with as many digits as the interval's width supports (at least three)."""
    width = 0.0 if low is None or high is None else high - low
    digits = 3
    if width > 0 and value:
        digits = min(8, max(3, 2 + math.ceil(math.log10(abs(value) / width))))
    return f"{number(value, digits)} ({number(low, digits)} to {number(high, digits)})"


def _effect_line(e: dict) -> str:
    values = ", ".join(f"{name} = {with_interval(v['value'], v['low'], v['high'])} {v['unit']}".rstrip()
                       for name, v in e["parameters"].items())
    where = e["where"]["signal"] + (f", {e['where']['note']}" if e["where"].get("note") else "")
    return f"{e['id'].replace('_', ' ')} at {e['where']['kind']} {where}: {e['law']}" + (f"; {values}"
                                                                                         if values else "")


_VERDICTS = {
    "agreement": "AGREEMENT: nothing above the noise.",
    "parameters_only": "PARAMETERS ONLY: the structure is not rejected once the parameters are refitted.",
    "named": "MISSING PHYSICS, named.",
    "one_of": "ONE OF SEVERAL: these recordings cannot tell them apart.",
    "unexplained": "UNEXPLAINED: the mismatch is real, and nothing in the catalogue explains it.",
}


def _unknown_lines(c: dict) -> list[str]:
    """What the unknown input and the hinges say, and the correction."""
    seen, lines = c["location"].get("unknown_input"), []
    if seen:
        where = " or ".join([seen["channel"], *seen["alike"]])
        if seen["variable"]:
            bends = ", ".join(f"{'jump' if b['jump'] else 'bend'} at {number(b['position'])} "
                              f"({number(b['low'])} to {number(b['high'])})" for b in seen["breakpoints"])
            memory = "; with memory" if c["location"]["memory"] else ""
            lines.append(f"Unknown input at {where} goes with {seen['variable']} (held-out gain over linear "
                         f"{100 * seen['heldout_gain']:.0f} %): {bends or 'no sharp bend'}{memory}")
        else:
            lines.append(f"Unknown input at {where} is no law of one variable")
    if c["correction"]:
        lines.append(f"Correction without a name, c({c['correction']['variable']}) at {c['correction']['channel']}: "
                     f"removes {100 * c['correction']['heldout_gain']:.0f} % of the explainable held-out error"
                     + ("; it is in the repaired simulator" if c["correction"]["in_repaired_simulator"] else ""))
    return lines


def summary_text(c: dict) -> str:
    """The text summary of a report's content."""
    lines = [_VERDICTS[c["verdict"]]]
    for e in c["effects"]:
        lines.append(f"  {_effect_line(e)}")
    if c["effects"]:
        lines.append(f"  It explains {100 * c['share_explained']:.1f} % of the explainable held-out error "
                     f"(floor: {c['noise_floor_source']}).")
    lines.append("Error on held-out recordings (RMSE: nominal -> parameters refitted -> repaired; floor)")
    for recording, outputs in c["fit"].items():
        for output, stages in outputs.items():
            r = [number(stages[s]["rmse"]) for s in ("nominal", "refitted", "repaired")]
            floor = number(c["noise_floor"][output])
            lines.append(f"  {recording} {output}: {r[0]} -> {r[1]} -> {r[2]}; floor {floor}")
    moved = [f"{n} {number(v['nominal'])} -> {with_interval(v['refitted'], v['low'], v['high'])}"
             for n, v in c["parameters"].items()]
    if moved:
        lines.append("Parameters: " + "; ".join(moved))
    named = " + ".join(e["id"] for e in c["effects"][:2]) if c["verdict"] == "named" else ""
    others = [r for r in c["candidates"] if r["id"] != named][:3]
    if others:
        lines.append("Runners-up (share of explainable held-out error): " + "; ".join(
            f"{r['where']} {100 * r['share_explained']:.0f} %" for r in others))
    where = c["location"]
    spots = ", ".join(f"{a:.3g}-{b:.3g} s" for a, b in where["intervals_s"][:4])
    bands = ", ".join(f"{a:.3g}-{b:.3g} Hz" for a, b in where["bands_hz"])
    if spots or bands:
        lines.append(f"Most of the mismatch: {spots}; {bands}")
    lines += _unknown_lines(c)
    lines.append(f"Next: {c['next_experiment']}")
    lines += [f"Note: {w}" for w in c["warnings"][:5]]
    lines.append(f"{c['hypotheses_tried']} hypotheses tried in {c['seconds']:.1f} s.")
    return "\n".join(line if len(line) < 112 else textwrap.fill(line, 112, subsequent_indent="    ")
                     for line in lines) + "\n"
