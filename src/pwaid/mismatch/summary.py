"""One screen of text: verdict, how sure, where, what, proof, what else, what next."""

from __future__ import annotations

import math
import textwrap

from pwaid.mismatch.decide import TOGETHER
from pwaid.mismatch.thresholds import Thresholds

__all__ = ["interval", "number", "plus_minus", "summary_text", "verdict_sentence", "with_interval"]

WIDTH = 112
ROWS = 6
UNKNOWN = 1e3  # an interval this many times as wide as the value tells nothing


def number(x: float | None, digits: int = 3) -> str:
    """A short decimal, without an exponent up to a million."""
    text = "n/a" if x is None else f"{x:.{digits}g}"
    return f"{x:.0f}" if "e+" in text and abs(x) < 1e6 else text


def _digits(value: float | None, low: float | None, high: float | None) -> int:
    """Digits that an interval of this width supports, at least three."""
    width = 0.0 if low is None or high is None else high - low
    return min(8, max(3, 2 + math.ceil(math.log10(abs(value) / width)))) if width > 0 and value else 3


def interval(value: float | None, low: float | None, high: float | None) -> str:
    """``0.1199 to 0.12003``, with as many digits as its width beside the value supports (at least three)."""
    if None not in (value, low, high) and high - low > UNKNOWN * abs(value) > 0.0:
        return "not determined"
    digits = _digits(value, low, high)
    return f"{number(low, digits)} to {number(high, digits)}"


def with_interval(value: float | None, low: float | None, high: float | None) -> str:
    """A value and its interval, with as many digits as the interval's width supports (at least three)."""
    return f"{number(value, _digits(value, low, high))} ({interval(value, low, high)})"


def _plain(unit: str) -> str:
    """The unit, nothing for a pure number."""
    return "" if unit == "1" else unit


def plus_minus(value: float | None, low: float | None, high: float | None, unit: str = "") -> str:
    """``0.450 ± 0.010 N m`` where the interval is about symmetric, else value and interval."""
    unit = _plain(unit)
    if value is None or low is None or high is None:
        return f"{number(value)} {unit}".rstrip()
    half = 0.5 * (high - low)
    if half <= 0 or abs(0.5 * (high + low) - value) > 0.3 * half:
        return f"{with_interval(value, low, high)} {unit}".rstrip()
    places = max(0, 1 - math.floor(math.log10(half)))
    if places > 8 or abs(value) >= 1e5 or half >= 100:
        return f"{with_interval(value, low, high)} {unit}".rstrip()
    return f"{value:.{places}f} ± {half:.{places}f} {unit}".rstrip()


def _percent(share: float | None) -> str:
    return "n/a" if share is None else f"{100 * share:.{1 if abs(share) < 0.9995 and share > 0.95 else 0}f} %"


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:]


def _listed(items, last: str = "and") -> str:
    items = list(items)
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} {last} {items[-1]}" if items else ""


# ------------------------------------------------------------------ verdict
_SPOTS = {"state": "acting on {}", "input": "in the input {}", "output": "in the sensor {}",
          "parameter": "in the parameter {}"}


def _effect_phrase(e: dict) -> str:
    """``coulomb friction of 0.45 ± 0.01 N m acting on omega``."""
    values = [(n.replace("_", " "), plus_minus(v["value"], v["low"], v["high"], v["unit"]))
              for n, v in e["parameters"].items()]
    size = f" of {values[0][1]}" if len(values) == 1 else f" ({', '.join(f'{n} {v}' for n, v in values)})"
    note = f" ({e['where']['note']})" if e["where"].get("note") else ""
    where = _SPOTS[e["where"]["kind"]].format(e["where"]["signal"])
    return f"{e['id'].replace('_', ' ')}{size if values else ''} {where}{note}"


def _members(c: dict) -> list[str]:
    """Each member of the answer in words, a pair joined by `and`."""
    return [_listed(_effect_phrase(c["effects"][i]) for i in group) for group in c["alternatives"]]


def _worst(c: dict, stage: str) -> tuple[float, str]:
    """Largest ratio of held-out RMSE to the floor, and its output."""
    found = (0.0, "")
    for outputs in c["fit"].values():
        for output, stages in outputs.items():
            floor, rmse = c["noise_floor"][output], stages[stage]["rmse"]
            if floor and rmse is not None:
                found = max(found, (rmse / floor, output))
    return found


def _moved(c: dict) -> str:
    """The parameters that moved by more than 2 %, in words."""
    moves = {n: v["refitted"] / v["nominal"] - 1 for n, v in c["parameters"].items() if v["nominal"]}
    big = sorted((n for n in moves if abs(moves[n]) > 0.02), key=lambda n: -abs(moves[n]))
    return _listed(f"{n} {100 * abs(moves[n]):.0f} % {'higher' if moves[n] > 0 else 'lower'}" for n in big[:4])


def verdict_sentence(c: dict) -> str:
    """The verdict in one or two sentences."""
    verdict = c["verdict"]
    if verdict == "named":
        plural = "are" if len(c["effects"]) > 1 else "is"
        return _sentence(f"{_members(c)[0]} {plural} missing from the simulator.")
    if verdict == "one_of":
        return ("One of these is missing from the simulator, and these recordings cannot say which: "
                f"{_listed(_members(c), 'or')}.")
    ratio, output = _worst(c, "refitted")
    size = f"the held-out error of {output} is {ratio:.{1 if ratio < 10 else 0}f} times the noise" if output else ""
    if verdict == "unexplained":
        left = f" ({size} after refitting the parameters)" if size else ""
        return _sentence(f"the mismatch is real{left} and nothing in the catalogue explains it.")
    if any(r.startswith(TOGETHER) for r in c.get("reasons", ())):
        return (f"No missing physics is seen: {TOGETHER}, the simulator matches to the noise; the training recordings "
                "alone do not determine its parameters.")
    if verdict == "parameters_only":
        moved = _moved(c)
        with_them = f"with {moved}" if moved else "with refitted parameters"
        return _sentence(f"no missing physics is seen: {with_them} the simulator matches{_remains(ratio, size)}")
    return _sentence(f"nothing is missing above the noise{_remains(ratio, size)}")


def _remains(ratio: float, size: str) -> str:
    """What is left when nothing was named; past the noise it is a disturbance, by the rule of the decision."""
    if not size:
        return "."
    if ratio > Thresholds().material ** 0.5:
        return f" up to a disturbance that past inputs do not predict: {size}."
    return f" ({size})."


# ------------------------------------------------------------------ the other paragraphs
def _sure(c: dict) -> list[str]:
    """Share explained against the runner-up, and what cannot be told apart."""
    lines = []
    trust = f"noise floor: {c['noise_floor_source']}"
    if c["effects"]:
        other = [r for r in _runners(c) if not r["wider"]][:1] if c["verdict"] == "named" else []
        rival = "".join(f"; the runner-up, {r['where']}, explains {_percent(r['share_explained'])}{_refused(r, c)}"
                        for r in other)
        share = _percent(c["share_explained"])
        lines.append(f"It explains {share} of the explainable held-out error{rival} ({trust}).")
    else:
        lines.append(f"Yardstick: {trust}.")
    answers = set(c["answer"])
    alike = [pair for pair in c["isolability"]["alike"] if answers & set(pair)]
    if alike:
        lines.append(f"These recordings cannot tell apart: {'; '.join(' from '.join(pair) for pair in alike[:3])}.")
    return lines


def _runners(c: dict) -> list[dict]:
    """Fitted candidates that are not the answer, best first, one per set of laws."""
    seen, found = {r["id"] for r in c["candidates"] if r["where"] in c["answer"]}, []
    for r in c["candidates"]:
        if r["id"] not in seen and r["share_explained"] is not None:
            seen.add(r["id"])
            found.append(r)
    return found


def _where(c: dict) -> list[str]:
    where = c["location"]
    spots = ", ".join(f"{number(a)}-{number(b)} s" for a, b in where["intervals_s"][:4])
    bands = ", ".join(f"{number(a)}-{number(b)} Hz" for a, b in where["bands_hz"])
    lines = [f"Where: most of the mismatch lies in {spots} of the first training recording, at {bands}."
             if spots or bands else ""]
    seen = where.get("unknown_input")
    if seen:
        lines.append(_unknown(seen, where["memory"]))
    if c["correction"]:
        k = c["correction"]
        lines.append(f"Correction without a name, c({k['variable']}) at {k['channel']}: removes "
                     f"{_percent(k['heldout_gain'])} of the explainable held-out error"
                     + ("; it is in the repaired simulator." if k["in_repaired_simulator"] else "."))
    return [line for line in lines if line]


def _unknown(seen: dict, memory: bool) -> str:
    """What the unknown input and the hinges say."""
    place = " or ".join([seen["channel"], *seen["alike"]])
    pair = seen.get("pair")
    second = (f" With two variables, {pair['variables'][0]} and {pair['variables'][1]}, a map gains "
              f"{_percent(pair['heldout_gain'])} held out.") if pair else ""
    if not seen["variable"]:
        return f"An unknown input at {place} is no law of one variable." + second
    bends = ", ".join(f"a {'jump' if b['jump'] else 'bend'} at {number(b['position'])} "
                      f"({number(b['low'])} to {number(b['high'])})" for b in seen["breakpoints"])
    gain, past = _percent(seen["heldout_gain"]), ", with memory" if memory else ""
    return (f"An unknown input at {place} goes with {seen['variable']} (held-out gain over linear {gain}): "
            f"{bends or 'no sharp bend'}{past}.{second}")


def _what(c: dict) -> list[str]:
    """Laws with parameters and intervals, then the nominal parameters."""
    lines = []
    for e in c["effects"]:
        values = ", ".join(f"{name} = {with_interval(v['value'], v['low'], v['high'])} {_plain(v['unit'])}".rstrip()
                           for name, v in e["parameters"].items())
        note = f", {e['where']['note']}" if e["where"].get("note") else ""
        lines.append(f"Law: {e['id'].replace('_', ' ')} at {e['where']['kind']} {e['where']['signal']}{note}: "
                     f"{e['law']}{'; ' + values if values else ''}")
    moved = [f"{n} {number(v['nominal'])} -> {with_interval(v['refitted'], v['low'], v['high'])}"
             for n, v in c["parameters"].items()]
    return lines + ([f"Parameters, nominal -> refitted (90 %): {'; '.join(moved)}"] if moved else [])


def _proof(c: dict) -> list[str]:
    """RMSE per held-out recording and output, with floor and whiteness."""
    units = c["units"]["outputs"]
    lines, rows = ["Error on held-out recordings, RMSE: nominal -> parameters refitted -> repaired; floor"], []
    for recording, outputs in c["fit"].items():
        for output, stages in outputs.items():
            r = [number(stages[s]["rmse"]) for s in ("nominal", "refitted", "repaired")]
            p = stages["repaired"].get("whiteness_p")
            white = "" if p is None else "; residual white" if p > 0.01 else "; residual not white"
            rows.append(f"  {recording} {output}: {r[0]} -> {r[1]} -> {r[2]} {_plain(units.get(output, ''))}".rstrip()
                        + f"; floor {number(c['noise_floor'][output])}{white}")
    more = [f"  and {len(rows) - ROWS} more in report.json"] if len(rows) > ROWS else []
    return lines + rows[:ROWS] + more


def _else(c: dict) -> list[str]:
    """The best of the other laws, then those that contain the answer."""
    lines = []
    for wider, title in ((False, "Runners-up (share of explainable held-out error): "),
                         (True, "Laws that contain the answer and need not: ")):
        rows = [r for r in _runners(c) if r["wider"] == wider][:3]
        if rows:
            lines.append(title + "; ".join(
                f"{r['where']} {_percent(r['share_explained'])}{_refused(r, c)}" for r in rows))
    return lines


def _refused(row: dict, c: dict) -> str:
    """That a law which explains more than the answer is not it: physics or what it leaves speaks against it."""
    more = c["effects"] and row["share_explained"] > c["share_explained"] and not row["passed"] and not row["wider"]
    return ", refused" if more else ""


def summary_text(c: dict) -> str:
    """The text summary of a report's content, in the order an engineer asks."""
    lines = [f"{c['verdict'].upper().replace('_', ' ')}. {verdict_sentence(c)}", *_sure(c), *_where(c), *_what(c),
             *_proof(c), *_else(c), f"Next: {c['next_experiment']}"]
    lines += [f"Note: {w}" for w in c["warnings"][:5]]
    lines.append(f"{c['hypotheses_tried']} hypotheses tried in {c['seconds']:.1f} s.")
    return "\n".join(line if len(line) <= WIDTH else textwrap.fill(line, WIDTH, subsequent_indent="    ")
                     for line in lines) + "\n"
