"""Two laws at once: their order at one reading, and a fine ripple on top of friction."""

from __future__ import annotations

import numpy as np
import pytest
from tests_support import gathered, record

from pwaid.mismatch.decide import decide


def clipped_then_drifting(seed: int):
    r = record(seed, samples=700)
    return r.replace(outputs=np.clip(r.outputs, -0.6, 0.6) + 0.03 * r.time[:, None])


def test_the_order_of_two_laws_of_a_reading_is_found():
    evidence = gathered([clipped_then_drifting(s) for s in (1, 2, 3)], "sensor_saturation", "sensor_drift")
    both = [h for h in evidence.pairs if sorted(h.ids) == ["sensor_drift", "sensor_saturation"]]
    errors = {order: min(h.train_error for h in both if h.ids == order) for order in {h.ids for h in both}}
    assert len(errors) == 2
    assert min(errors.values()) < 0.2 * max(errors.values())
    decision = decide(evidence.problem, evidence.null, evidence.singles, evidence.pairs)
    assert decision.chosen.ids == min(errors, key=errors.get)
    assert decision.chosen.share > 0.99


@pytest.mark.parametrize(("size", "wavenumber"), [(0.2, 25.0), (0.1, 60.0)])
def test_a_ripple_is_found_on_top_of_friction(size, wavenumber):
    """Over whole recordings every wrong wavenumber is a valley of its own."""
    runs = [record(s, level=0.2, samples=700, force=lambda x: size * np.sin(wavenumber * x + 0.7)) for s in (1, 2, 3)]
    evidence = gathered(runs, "coulomb_friction", "asymmetric_coulomb_friction", "position_ripple")
    decision = decide(evidence.problem, evidence.null, evidence.singles, evidence.pairs)
    assert decision.verdict == "named" and sorted(decision.chosen.ids) == ["coulomb_friction", "position_ripple"]
    values = dict(zip(decision.chosen.ids, decision.chosen.values(), strict=True))
    assert values["coulomb_friction"][0] == pytest.approx(0.2, rel=0.05)
    assert values["position_ripple"][:2] == pytest.approx([size, wavenumber], rel=0.05)
