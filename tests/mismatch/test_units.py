"""Units as powers."""

from __future__ import annotations

import pytest

from pwaid.errors import InputError
from pwaid.mismatch.units import check_unit, combine, parse_unit, unit_kind


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
