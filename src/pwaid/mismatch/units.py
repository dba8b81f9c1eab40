"""Units as products of powers, so that a coefficient's unit follows from its law."""

from __future__ import annotations

import math
import re

from pwaid.errors import InputError

__all__ = ["KNOWN", "check_unit", "combine", "factor_of", "parse_unit", "scaled_unit", "unit_kind"]

_KINDS = {
    "angle": ("rad", "deg", "°", "rev", "turn", "arcmin", "arcsec", "gon"),
    "length": ("m", "in", "ft", "yd", "mi", "nmi", "mil", "thou"),
    "force": ("N", "lbf", "kgf", "gf", "dyn"), "voltage": ("V",), "current": ("A",),
    "temperature": ("K", "degC", "°C", "C", "degF", "°F"),
    "pressure": ("Pa", "bar", "psi", "ksi", "mmHg", "torr", "inHg", "atm", "mmWC", "cmWC", "mWC", "inWC"),
    "mass": ("g", "t", "lb", "oz", "slug"), "time": ("s", "min", "h", "d"), "power": ("W", "hp", "VA", "var"),
    "volume": ("l", "L", "gal"), "charge": ("Ah", "As", "Coulomb"),
    "energy": ("J", "Wh", "cal", "BTU"), "frequency": ("Hz",), "resistance": ("Ohm", "ohm", "Ω"), "inductance": ("H",),
    "field": ("T",), "capacitance": ("F",), "conductance": ("S",), "flux": ("Wb",), "amount": ("mol",),
    "light": ("lx", "lm", "cd"),
    "plain": ("1", "-", "%", "", "counts", "count", "pu", "rpm", "krpm", "ticks", "lsb", "inc", "steps", "px", "bit",
              "bits", "ppm", "ppb", "pH", "dB"),
}
# what else engineers write for products of these
_ALIASES = {"mmH2O": "mmWC", "cmH2O": "cmWC", "mH2O": "mWC", "inH2O": "inWC", "Torr": "torr", "mph": "mi/h",
            "kph": "km/h", "kmh": "km/h", "knot": "nmi/h", "kn": "nmi/h", "gpm": "gal/min", "lpm": "L/min",
            "LPM": "L/min", "slpm": "L/min", "sccm": "ml/min", "cfm": "ft^3/min", "rps": "rev/s", "cc": "ml",
            "ccm": "ml", "sec": "s", "msec": "ms", "hr": "h", "day": "d", "inch": "in", "mile": "mi", "RPM": "rpm",
            "PSI": "psi", "Vrms": "V", "Vpp": "V", "Vdc": "V", "Vac": "V", "Arms": "A", "Adc": "A",
            "degK": "K", "Celsius": "degC", "celsius": "degC", "Kelvin": "K", "kelvin": "K", "degree": "deg",
            "degrees": "deg", "radian": "rad", "radians": "rad", "volt": "V", "volts": "V", "amp": "A", "amps": "A",
            "percent": "%", "liter": "L", "litre": "L", "meter": "m", "metre": "m", "second": "s", "seconds": "s",
            "minute": "min", "hour": "h", "LSB": "lsb", "cnt": "counts", "step": "steps", "tick": "ticks",
            "permille": "%", "‰": "%", "pct": "%", "%RH": "%", "%rh": "%", "rH": "%", "RH": "%", "turns": "turn",
            "revs": "rev", "r": "rev", "pulse": "counts", "pulses": "counts", "digit": "counts", "digits": "counts",
            "raw": "counts", "code": "counts", "codes": "counts", "duty": "1", "PWM": "1", "pwm": "1",
            "knots": "nmi/h", "slm": "L/min", "SLM": "L/min", "scfm": "ft^3/min",
            "barg": "bar", "bara": "bar", "psig": "psi", "psia": "psi", "tesla": "T", "lux": "lx", "℃": "degC",
            "℉": "degF",
            "degc": "degC", "DegC": "degC", "degf": "degF", "DegF": "degF", "fps": "ft/s", "lb-ft": "lbf ft",
            "ft-lb": "lbf ft", "lb-in": "lbf in", "in-lb": "lbf in", "lbft": "lbf ft", "ftlb": "lbf ft",
            "pixel": "px", "pixels": "px", "micron": "um", "hz": "Hz", "kts": "nmi/h"}
_PLAIN = ("n/a", "none", "p.u.", "per-unit", "norm", "normalized", "normalised", "dimensionless", "unitless")
_PREFIXES = {"p": 1e-12, "n": 1e-9, "u": 1e-6, "µ": 1e-6, "m": 1e-3, "c": 1e-2, "h": 1e2, "k": 1e3, "M": 1e6, "G": 1e9}
_PREFIXED = ("rad", "m", "N", "V", "A", "K", "Pa", "bar", "g", "s", "W", "l", "L", "Ah", "J", "Wh", "Hz", "Ohm", "ohm",
             "Ω", "H", "T", "F", "S", "Wb", "mol", "VA", "var", "cal")
KNOWN = {symbol: kind for kind, symbols in _KINDS.items() for symbol in symbols}
KNOWN = {prefix + symbol: KNOWN[symbol] for symbol in _PREFIXED for prefix in _PREFIXES} | KNOWN
# what one of them is in the SI unit of its kind, where that is not 1
_SIZES = {"deg": math.pi / 180, "°": math.pi / 180, "rev": 2 * math.pi, "turn": 2 * math.pi,
          "arcmin": math.pi / 10800, "arcsec": math.pi / 648000, "in": 0.0254, "ft": 0.3048, "lbf": 4.4482216,
          "kgf": 9.80665, "degF": 5 / 9, "bar": 1e5, "psi": 6894.757, "g": 1e-3, "t": 1e3, "lb": 0.45359237,
          "min": 60.0, "h": 3600.0, "d": 86400.0, "hp": 745.7, "l": 1e-3, "L": 1e-3, "Ah": 3600.0, "Wh": 3600.0,
          "gon": math.pi / 200, "yd": 0.9144, "mi": 1609.344, "nmi": 1852.0, "mil": 2.54e-5, "thou": 2.54e-5,
          "gf": 9.80665e-3, "dyn": 1e-5, "°F": 5 / 9, "ksi": 6894757.0, "mmHg": 133.322, "torr": 133.322,
          "inHg": 3386.39, "atm": 101325.0, "mmWC": 9.80665, "cmWC": 98.0665, "mWC": 9806.65, "inWC": 249.089,
          "oz": 0.0283495, "slug": 14.5939, "gal": 3.785412e-3, "cal": 4.184, "BTU": 1055.06}
_SI = {"angle": ("rad", 1), "length": ("m", 1), "force": ("N", 1), "voltage": ("V", 1), "current": ("A", 1),
       "temperature": ("K", 1), "pressure": ("Pa", 1), "mass": ("kg", 1), "time": ("s", 1), "power": ("W", 1),
       "volume": ("m", 3), "charge": ("As", 1), "energy": ("J", 1), "frequency": ("Hz", 1), "resistance": ("Ohm", 1),
       "inductance": ("H", 1), "field": ("T", 1), "capacitance": ("F", 1), "conductance": ("S", 1), "flux": ("Wb", 1),
       "amount": ("mol", 1), "light": ("cd", 1)}
_TOGETHER = {prefix + text: (prefix + "N", *text[1:]) for text in ("Nm", "Nms", "Ns") for prefix in ("", *_PREFIXES)}
_TOKEN = re.compile(r"([A-Za-zµ°Ω%]+|[cmin]*H2O|1|-)(?:\^|\*\*)?(-?\d+)?")


def parse_unit(text: str) -> dict[str, int]:
    """Exponent of every symbol: ``"N m s/rad"`` gives ``{"N": 1, "m": 1, "s": 1, "rad": -1}``.

    Raises
    ------
    InputError
        For a symbol that is not known.
    """
    powers: dict[str, int] = {}
    if text.strip().lower() in _PLAIN:
        return {}
    text = re.sub(r"(?<=[A-Za-z])\.(?=[A-Za-z])", " ", text)  # N.m
    plain = text.strip().replace("**", "^").replace("*", " ").replace("·", " ").replace("²", "^2").replace("³", "^3")
    for part, sign in _parts(plain.replace("μ", "µ")):  # the Greek letter as the prefix sign
        for token in part.split():
            match = _TOKEN.fullmatch(token)
            if token in ("1", "-"):
                continue
            alias = _ALIASES.get(token) or (_ALIASES.get(match.group(1)) if match else None)
            if alias:
                exponent = 1 if token in _ALIASES else int(match.group(2) or 1)
                for symbol, power in parse_unit(alias).items():
                    powers[symbol] = powers.get(symbol, 0) + sign * power * exponent
                continue
            symbols = _TOGETHER.get(match.group(1), match.groups()[:1]) if match else ()
            if not symbols or symbols[0] not in KNOWN:
                raise InputError(f"unknown unit {text!r} (at {token!r}); expected products of SI symbols such as "
                                 "'N m', 'rad/s', 'm/s^2', 'V', 'degC', 'bar', or '1'")
            for symbol in symbols:
                powers[symbol] = powers.get(symbol, 0) + sign * int(match.group(2) or 1)
    return {symbol: power for symbol, power in powers.items() if power and KNOWN[symbol] != "plain"}


def _parts(text: str):
    """Products of symbols, each with 1 where they stand above the line and -1 below it; in "a/(b/c)" c is above."""
    brackets, sign, part = [1], 1, ""  # the signs that open brackets have
    for letter in text:
        if letter not in "/()":
            part += letter
            continue
        yield part, sign
        part = ""
        if letter == "/":
            sign = -brackets[-1]
        elif letter == "(":
            brackets.append(sign)
        elif len(brackets) > 1:
            sign = brackets.pop()
    yield part, sign


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
        return "speed" if "rpm" in text.lower() else "plain"
    if len(key) == 1 and key[0][1] == 1:
        return table.get(key, key[0][0])
    return table.get(key, "other")


def factor_of(symbol: str) -> float:
    """What one of it is in the SI unit of its kind: 1e-3 for mm, π/180 for deg."""
    explicit = any(symbol in symbols for symbols in _KINDS.values())
    prefix, rest = ("", symbol) if explicit else (symbol[0], symbol[1:])
    return _PREFIXES.get(prefix, 1.0) * _SIZES.get(rest, 1.0)


def scaled_unit(text: str, gain: float, offset: float = 0.0) -> dict[str, int]:
    """The unit of x where y = gain x + offset has the unit `text`: SI where the gain converts, {} where it does not."""
    powers = parse_unit(text)
    turning = not powers and "rpm" in text.lower()
    if turning and text.lower() == "rpm":
        powers = {"rev": 1, "min": -1}
    kelvin = offset and unit_kind(text) == "temperature"  # an absolute temperature, read in another scale
    if abs(gain - 1) < 1e-6 and not kelvin:
        return powers
    size = math.prod(factor_of(s) ** n for s, n in powers.items())
    if turning and not powers:
        powers, size = {"rad": 1, "s": -1}, 2e3 * math.pi / 60
    if abs(size * abs(gain) - 1) > 1e-3:
        return {}
    found: dict[str, int] = {}
    for symbol, n in powers.items():
        base, exponent = _SI[KNOWN[symbol]]
        found[base] = found.get(base, 0) + n * exponent
    return found


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
