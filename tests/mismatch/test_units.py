"""Units as powers."""

from __future__ import annotations

import math

import pytest

from pwaid.errors import InputError
from pwaid.mismatch.units import KNOWN, check_unit, combine, parse_unit, scaled_unit, unit_kind


def test_parse_and_kind():
    assert parse_unit("N m s/rad") == {"N": 1, "m": 1, "s": 1, "rad": -1}
    assert unit_kind("rad/s") == "angular_speed"
    assert unit_kind("N m") == "torque"
    assert unit_kind("m^3/s") == "flow"


def test_combine_cancels():
    assert combine({}, (parse_unit("N"), 1), (parse_unit("m/s"), -1)) == "N s/m"


def test_unknown_unit_names_the_symbol():
    with pytest.raises(InputError, match="unknown unit 'furlong'"):
        check_unit("furlong")


def test_prefixes_and_what_is_written_together():
    assert unit_kind("MN m") == unit_kind("kNm") == unit_kind("Nm") == "torque"
    assert parse_unit("mNms/rad") == {"mN": 1, "m": 1, "s": 1, "rad": -1}
    assert unit_kind("µm/s") == "speed" and unit_kind("MPa") == "pressure" and unit_kind("mA") == "current"
    assert unit_kind("min") == "time" and unit_kind("ft") == "length"  # no prefix on an inch


def test_a_symbol_of_its_own_is_no_prefix():
    assert (KNOWN["h"], KNOWN["T"], KNOWN["cm"], KNOWN["kg"], KNOWN["°C"]) == (
        "time", "field", "length", "mass", "temperature")


def test_an_output_that_converts_tells_the_unit_of_its_state():
    assert scaled_unit("mm", 1e3) == {"m": 1} and scaled_unit("mm", 1.0) == {"mm": 1} and scaled_unit("mm", 7.0) == {}
    assert scaled_unit("rpm", 30 / math.pi) == {"rad": 1, "s": -1}
    assert scaled_unit("deg/s", -180 / math.pi) == {"rad": 1, "s": -1}
    assert scaled_unit("bar", 1e-5) == {"Pa": 1} and scaled_unit("L/min", 6e4) == {"m": 3, "s": -1}
    assert scaled_unit("degC", 1.0, -273.15) == {"K": 1} and scaled_unit("degC", 1.0) == {"degC": 1}


def test_brackets_powers_and_both_letters_mu():
    assert parse_unit("N/(m/s)") == parse_unit("N s/m") == {"N": 1, "s": 1, "m": -1}
    assert parse_unit("V/(rad/s)") == {"V": 1, "rad": -1, "s": 1}
    assert parse_unit("W/(m^2 K)") == {"W": 1, "m": -2, "K": -1}
    assert parse_unit("kg/(m*s**2)") == {"kg": 1, "m": -1, "s": -2}
    assert parse_unit("m**2") == {"m": 2} and parse_unit("\u03bcm") == parse_unit("\u00b5m")


def test_units_of_the_clinic_the_road_and_the_workshop():
    kinds = {"mmHg": "pressure", "cmH2O": "pressure", "mmH2O": "pressure", "gpm": "flow", "slpm": "flow",
             "mph": "speed", "km/h": "speed", "kph": "speed", "rps": "angular_speed", "RPM": "speed", "Vrms": "voltage",
             "degrees/s": "angular_speed", "inch": "length", "°F": "temperature", "ft lbf": "torque", "kcal": "energy"}
    assert {unit: unit_kind(unit) for unit in kinds} == kinds
    assert parse_unit("mmHg s/mL") == {"mmHg": 1, "s": 1, "mL": -1}
    assert scaled_unit("mmHg", 1 / 133.322) == {"Pa": 1}
    assert scaled_unit("mph", 1 / 0.44704) == {"m": 1, "s": -1}


@pytest.mark.parametrize(("text", "powers"), [
    ("permille", {}), ("‰", {}), ("p.u.", {}), ("n/a", {}), ("nA", {"nA": 1}), ("%RH", {}),
    ("N.m.s/rad", {"N": 1, "m": 1, "s": 1, "rad": -1}),
    ("Pa.s", {"Pa": 1, "s": 1}), ("lb-ft", {"lbf": 1, "ft": 1}), ("r/min", {"rev": 1, "min": -1}),
    ("barg", {"bar": 1}), ("slm", {"L": 1, "min": -1})])
def test_what_engineers_write_for_no_unit_products_and_flows(text, powers):
    assert parse_unit(text) == powers
