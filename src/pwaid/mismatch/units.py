"""Units as products of powers, so that a coefficient's unit follows from its law."""

from __future__ import annotations

import re

from pwaid.errors import InputError

__all__ = ["KNOWN", "check_unit", "combine", "parse_unit", "unit_kind"]

_KINDS = {
    "angle": ("rad", "deg", "°", "rev", "turn", "arcmin", "arcsec"), "length": ("m", "in", "ft"),
    "force": ("N", "lbf", "kgf"), "voltage": ("V",), "current": ("A",),
    "temperature": ("K", "degC", "°C", "C", "degF"), "pressure": ("Pa", "bar", "psi"), "mass": ("g", "t", "lb"),
    "time": ("s", "min", "h", "d"), "power": ("W", "hp"), "volume": ("l", "L"), "charge": ("Ah", "As", "Coulomb"),
    "energy": ("J", "Wh"), "frequency": ("Hz",), "resistance": ("Ohm", "ohm", "Ω"), "inductance": ("H",),
    "field": ("T",), "capacitance": ("F",),
    "plain": ("1", "-", "%", "", "counts", "count", "pu", "rpm", "ticks", "lsb"),
}
_PREFIXES = ("p", "n", "u", "µ", "m", "c", "h", "k", "M", "G")
_PREFIXED = ("rad", "m", "N", "V", "A", "K", "Pa", "bar", "g", "s", "W", "l", "L", "Ah", "J", "Wh", "Hz", "Ohm", "ohm",
             "Ω", "H", "T", "F")
KNOWN = {symbol: kind for kind, symbols in _KINDS.items() for symbol in symbols}
KNOWN = {prefix + symbol: KNOWN[symbol] for symbol in _PREFIXED for prefix in _PREFIXES} | KNOWN
_TOGETHER = {prefix + text: (prefix + "N", *text[1:]) for text in ("Nm", "Nms", "Ns") for prefix in ("", *_PREFIXES)}
_TOKEN = re.compile(r"([A-Za-zµ°Ω%]+|1|-)(?:\^|\*\*)?(-?\d+)?")


def parse_unit(text: str) -> dict[str, int]:
    """Exponent of every symbol: ``"N m s/rad"`` gives ``{"N": 1, "m": 1, "s": 1, "rad": -1}``.

    Raises
    ------
    InputError
        For a symbol that is not known.
    """
    powers: dict[str, int] = {}
    plain = text.strip().replace("·", " ").replace("*", " ").replace("²", "^2").replace("³", "^3")
    plain = plain.replace("(", " ").replace(")", " ")
    for part, sign in _parts(plain):
        for token in part.split():
            match = _TOKEN.fullmatch(token)
            if token in ("1", "-"):
                continue
            symbols = _TOGETHER.get(match.group(1), match.groups()[:1]) if match else ()
            if not symbols or symbols[0] not in KNOWN:
                raise InputError(f"unknown unit {text!r} (at {token!r}); expected products of SI symbols such as "
                                 "'N m', 'rad/s', 'm/s^2', 'V', 'degC', 'bar', or '1'")
            for symbol in symbols:
                powers[symbol] = powers.get(symbol, 0) + sign * int(match.group(2) or 1)
    return {symbol: power for symbol, power in powers.items() if power and KNOWN[symbol] != "plain"}


def _parts(text: str):
    pieces = text.split("/")
    yield pieces[0], 1
    for piece in pieces[1:]:
        yield piece, -1


def check_unit(text: str) -> str:
    """The text itself when it parses; raises InputError otherwise."""
    parse_unit(text)
    return text


def unit_kind(text: str) -> str:
    """A coarse kind: angle, angular_speed, length, speed, force, torque, voltage, current, temperature, ..."""
    powers = parse_unit(text)
    kinds: dict[str, int] = {}
    for symbol, power in powers.items():
        kinds[KNOWN[symbol]] = kinds.get(KNOWN[symbol], 0) + power
    table = {
        (("angle", 1),): "angle", (("angle", 1), ("time", -1)): "angular_speed", (("length", 1),): "length",
        (("length", 1), ("time", -1)): "speed", (("force", 1),): "force",
        (("force", 1), ("length", 1)): "torque",
        (("length", 3), ("time", -1)): "flow", (("time", -1), ("volume", 1)): "flow",
        (("length", 1), ("time", -2)): "acceleration", (("angle", 1), ("time", -2)): "acceleration",
    }
    key = tuple(sorted(kinds.items()))
    if not key:
        return "speed" if "rpm" in text else "plain"
    if len(key) == 1 and key[0][1] == 1:
        return table.get(key, key[0][0])
    return table.get(key, "other")


def combine(base: dict[str, int], *others: tuple[dict[str, int], int]) -> str:
    """Unit text of base · Π otherᵏ, numerator first."""
    powers = dict(base)
    for other, k in others:
        for symbol, power in other.items():
            powers[symbol] = powers.get(symbol, 0) + k * power
    up = [s if n == 1 else f"{s}^{n}" for s, n in powers.items() if n > 0]
    down = [s if n == -1 else f"{s}^{-n}" for s, n in powers.items() if n < 0]
    if not up and not down:
        return "1"
    return (" ".join(up) or "1") + ("/" + (down[0] if len(down) == 1
                                           else f"({' '.join(down)})") if down else "")
