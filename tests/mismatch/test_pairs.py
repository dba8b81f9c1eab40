"""Two laws of one reading act one after the other, and the order matters."""

from __future__ import annotations

import numpy as np
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
