"""Two laws at once: their order at one reading, a fine ripple on top of friction, one law at two places."""

from __future__ import annotations

import control
import numpy as np
import pytest
from tests_support import gathered, multisine, oscillator, pushed, record

from pwaid.mismatch import Thresholds
from pwaid.mismatch.decide import decide
from pwaid.mismatch.effects.registry import effect_by_id
from pwaid.mismatch.explain import collect, explain
from pwaid.recording import Recording


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


def test_a_pair_that_leaves_a_disturbance_may_leave_more():
    """As under a disturbance: the share that a pair needs is out of reach, and maps find nothing in what it leaves."""
    evidence = gathered([clipped_then_drifting(s) for s in (1, 2, 3)], "sensor_saturation", "sensor_drift")

    def decided(**changes):
        asked = Thresholds(share=0.97, share_tentative=0.97, pair_share=1.1, **changes)
        return decide(evidence.problem, evidence.null, evidence.singles, evidence.pairs, asked)

    assert sorted(decided().chosen.ids) == ["sensor_drift", "sensor_saturation"]
    assert decided(unfound=-1.0).verdict == "unexplained"  # as if maps found something
    assert decided(pair_share_quiet=1.1).verdict == "unexplained"


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


@pytest.mark.parametrize(("damping", "id"), [((0.30, 0.42), "asymmetric_viscous_friction"),
                                             ((0.36, 0.361), "viscous_friction")])
def test_the_wider_of_two_laws_counts_beside_what_its_partner_leaves(damping, id):
    """The drift is a hundred times as large as either damping: beside it no asymmetry would."""
    def drifting(seed):
        r = pushed(seed, lambda x, v: -damping[int(v < 0)] * v)
        return r.replace(outputs=r.outputs + 0.05 * r.time[:, None])

    effects = [e for i in ("viscous_friction", "asymmetric_viscous_friction", "sensor_drift") for e in effect_by_id(i)]
    runs = [drifting(s) for s in (1, 2, 3)]
    evidence = collect(oscillator(b=0.46), runs[:2], runs[2:], ["m", "k"], effects=effects)
    decision = decide(evidence.problem, evidence.null, evidence.singles, evidence.pairs)
    assert decision.verdict == "named" and sorted(decision.chosen.ids) == sorted(["sensor_drift", id])


def two_joints(t, x, u, params):
    torque = params["k"] * (x[0] - x[2])
    return np.array([x[1], u[0] - torque - params["d"] * x[1], x[3], u[1] + torque - 4.0 * x[2] - params["d"] * x[3]])


def joints_with_friction(seed: int, levels=(0.6, 0.5), samples: int = 600, dt: float = 0.02) -> Recording:
    rng, h = np.random.default_rng(seed), dt / 20
    t, x, y = np.arange(samples) * dt, np.zeros(4), []
    u = np.column_stack([1.5 * multisine(rng, t, 1.5) for _ in levels])
    for now in u:
        y.append(x[[0, 2]])
        for _ in range(20):
            rates = two_joints(0.0, x, now, {"k": 8.0, "d": 0.2})
            for v, level in zip((1, 3), levels, strict=True):
                free = x[v] + h * rates[v]
                x[v] = np.sign(free) * max(abs(free) - h * level, 0.0)
            x[[0, 2]] += h * x[[1, 3]]
    y = np.array(y) + 1e-3 * rng.normal(size=(samples, 2))
    return Recording(t, u, y, ("T1", "T2"), ("q1", "q2"), {"T1": "N m", "T2": "N m", "q1": "rad", "q2": "rad"},
                     name=f"r{seed}.csv")


def test_friction_in_both_joints_is_a_pair():
    simulator = control.nlsys(two_joints, lambda t, x, u, params: x[[0, 2]], inputs=["T1", "T2"], outputs=["q1", "q2"],
                              states=["q1", "w1", "q2", "w2"], params={"k": 8.0, "d": 0.2})
    recordings = [joints_with_friction(seed) for seed in (1, 2, 3)]
    report = explain(simulator, recordings[:2], recordings[2:], ["k", "d"], effects=effect_by_id("coulomb_friction"))
    assert report.verdict == "named"
    found = {e["where"]["signal"]: e["parameters"]["level"]["value"] for e in report.effects}
    assert found == pytest.approx({"w1": 0.6, "w2": 0.5}, rel=0.02)
    assert any("coulomb_friction(state:w2).level" in c["values"] for c in report.content["candidates"])
