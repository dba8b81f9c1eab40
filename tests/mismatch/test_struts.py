"""Laws between two bodies: where they are found, what they do, and that one is named."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest
from tests_support import multisine, record

from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.decide import decide
from pwaid.mismatch.effects.registry import effect_by_id
from pwaid.mismatch.explain import collect
from pwaid.mismatch.model import Model, Settings
from pwaid.mismatch.plant import as_plant
from pwaid.mismatch.probing import find_structure
from pwaid.mismatch.screen import locate_effects
from pwaid.recording import Recording

DATA = Dataset.from_recordings([record(1, samples=300)])


def stop(s, v):
    depth = s - np.clip(s, -0.2, 0.2)
    force = 60.0 * depth + 0.5 * v
    return force if depth * force > 0.0 else 0.0


LAWS = {  # parameters, force of relative position s and speed v
    "viscous_friction": ([0.8], lambda s, v: 0.8 * v),
    "asymmetric_viscous_friction": ([0.8, 0.2], lambda s, v: (0.8 if v > 0 else 0.2) * v),
    "quadratic_drag": ([0.7], lambda s, v: 0.7 * v * abs(v)),
    "cubic_stiffness": ([5.0], lambda s, v: 5.0 * s**3),
    "end_stop": ([60.0, 0.2, 0.5], stop),
}


def quarter_car(law=None):
    def update(t, x, u, params):
        mb, mw = params["mb"], params["mw"]
        s, v = x[0] - x[1], x[2] - x[3]
        force = 20.0 * s + 1.0 * v + (law(s, v) if law else 0.0)
        return np.array([x[2], x[3], -force / mb, (force + 60.0 * (u[0] - x[1])) / mw])
    return _system(update, ["zb", "zw", "vb", "vw"], {"mb": 1.3, "mw": 0.4})


def geared_drive(law=None):
    """A motor that turns three times per turn of its load, measured in degrees."""
    def update(t, x, u, params):
        s, v = x[0] / 3.0 - x[1], x[2] / 3.0 - x[3]
        force = 0.4 * s + (law(s, v) if law else 0.0)
        return np.array([x[2], x[3], (u[0] - force / 3.0) / params["jm"], force / params["jl"]])
    return _system(update, ["qm", "ql", "wm", "wl"], {"jm": 0.02, "jl": 0.3})


def chain(law=None):
    """Three bodies between two walls; the law is between the second and the third."""
    def update(t, x, u, params):
        q, w, m = x[:3], x[3:], params["m"]
        a = 5.0 * (q[0] - q[1])
        b = 9.0 * (q[1] - q[2]) + (law(q[1] - q[2], w[1] - w[2]) if law else 0.0)
        return np.array([w[0], w[1], w[2], (u[0] - a - q[0]) / m, (a - b) / 0.7, (b - 2.0 * q[2] - 0.1 * w[2]) / 0.5])
    return _system(update, ["q1", "q2", "q3", "w1", "w2", "w3"], {"m": 0.8})


def twisted(law=None):
    def update(t, x, u, params):
        force = 8.0 * x[2] + (law(x[2], x[0] - x[1]) if law else 0.0)
        return np.array([(u[0] - force - 0.1 * x[0]) / params["jm"], (force - 0.2 * x[1]) / params["jl"], x[0] - x[1]])
    return _system(update, ["wm", "wl", "twist"], {"jm": 0.2, "jl": 0.5})


def half_car(law=None):
    """Heave and pitch, shown as the heights of both ends; the law is below the front end, which the input pushes."""
    def update(t, x, u, params):
        front, rear, v, w = x[0] - 0.8 * x[1], x[0] + 1.1 * x[1], x[2] - 0.8 * x[3], x[2] + 1.1 * x[3]
        pushes = u[0] - 12.0 * front - 0.6 * v - (law(front, v) if law else 0.0), -9.0 * rear - 0.5 * w
        return np.array([x[2], x[3], (pushes[0] + pushes[1]) / params["m"],
                         (-0.8 * pushes[0] + 1.1 * pushes[1]) / params["i"]])
    return _system(update, ["z", "th", "vz", "vth"], {"m": 1.2, "i": 0.7},
                   lambda t, x, u, params: np.array([x[0] - 0.8 * x[1], x[0] + 1.1 * x[1]]))


def _system(update, states, params, output=lambda t, x, u, params: x[:2]):
    return control.nlsys(update, output, inputs=["u"], outputs=["y1", "y2"], states=states, params=params)


SIMULATORS = {quarter_car: ("m", "m", "zb-zw"), chain: ("N", "m", "q2-q3"), twisted: ("N m", "rad/s", "twist"),
              half_car: ("N", "m", "y1")}


def _placed(simulator, units, name):
    plant = as_plant(simulator)
    data = replace(DATA, Y=np.repeat(DATA.Y, 2, axis=1))
    states = np.random.default_rng(0).normal(size=(64, plant.sizes[0]))
    s = find_structure(plant, states, data.U, data.Y, units[:1], [units[1]] * 2, data.sample_time, 6.0, ())
    between = [e for e in locate_effects(effect_by_id(name), s) if e.effect.between]
    return between, Settings(plant, s.partner, s.ratio, (), np.zeros(0), substeps=20), data


@pytest.mark.parametrize("build", [quarter_car, twisted])
def test_friction_between_two_bodies_resists_their_relative_motion(build):
    between, settings, data = _placed(build(), SIMULATORS[build], "presliding_friction")
    located = next(e for e in between if e.place.signal == SIMULATORS[build][2])
    start = np.resize([0.5, -0.4], (1, settings.plant.sizes[0]))
    got = Model(settings, (located,)).simulate_with(settings.plant.vector(), [np.array([0.3, 40.0])], start, data)[0]
    exact = replace(settings, plant=as_plant(build(lambda s, v: 0.3 * np.tanh(v / 0.01))))
    want = Model(exact, (), 8).simulate_with(exact.plant.vector(), [], start, data)[0]
    plain = Model(settings, ()).simulate_with(settings.plant.vector(), [], start, data)[0]
    assert np.sqrt(np.mean((got - want) ** 2)) < 0.12 * np.sqrt(np.mean((plain - want) ** 2))


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("build", SIMULATORS)
def test_a_law_between_two_bodies_is_that_law_in_the_equations(build, name):
    values, law = LAWS[name]
    between, settings, data = _placed(build(), SIMULATORS[build], name)
    located = next(e for e in between if e.place.signal in (SIMULATORS[build][2], _turned(SIMULATORS[build][2]))
                   and e.place.note in ("", "both sides"))
    values = list(values)
    if build is chain:  # the masses of these two are no parameters: force per mass of the first
        values = [v / 0.7 if q.size.startswith("force") else v
                  for v, q in zip(values, located.effect.quantities, strict=True)]
    sign = -1.0 if located.place.signal != SIMULATORS[build][2] and name == "asymmetric_viscous_friction" else 1.0
    values = values[::-1] if sign < 0 else values  # the relative position counts the other way
    start = np.resize([0.5, -0.4], (1, settings.plant.sizes[0]))
    got = Model(settings, (located,)).simulate_with(settings.plant.vector(), [np.array(values)], start, data)[0]
    exact = replace(settings, plant=as_plant(build(law)))
    want = Model(exact, ()).simulate_with(exact.plant.vector(), [], start, data)[0]
    plain = Model(settings, ()).simulate_with(settings.plant.vector(), [], start, data)[0]
    assert np.max(np.abs(plain - want)) > 1e-3 * np.max(np.abs(want))
    np.testing.assert_allclose(got, want, atol=2e-3 * np.max(np.abs(plain - want)))


def _turned(signal: str) -> str:
    return "-".join(reversed(signal.split("-")))


def test_a_gear_scales_a_law_between_motor_and_load():
    between, settings, data = _placed(geared_drive(), ("N m", "deg"), "quadratic_drag")
    assert len(between) == 1
    start = np.full((1, 4), 0.1)
    vector = settings.plant.vector()
    got = Model(settings, tuple(between)).simulate_with(vector, [np.array([0.03])], start, data)[0]
    exact = replace(settings, plant=as_plant(geared_drive(lambda s, v: 0.03 * v * abs(v))))
    want = Model(exact, ()).simulate_with(vector, [], start, data)[0]
    np.testing.assert_allclose(got, want, rtol=1e-4, atol=1e-6)


def ball_screw():
    """A motor that moves a table by a screw of 2 mm per radian."""
    def update(t, x, u, params):
        force = 4e3 * (0.002 * x[0] - x[2])
        return np.array([x[1], (u[0] - 0.002 * force) / params["j"], x[3], (force - 2.0 * x[3]) / params["m"]])
    return control.nlsys(update, lambda t, x, u, params: x[[0, 2]], inputs=["T"], outputs=["y1", "y2"],
                         states=["theta", "omega", "x", "v"], params={"j": 1e-3, "m": 10.0})


def test_what_acts_behind_a_screw_has_the_units_of_the_table():
    plant, rng = as_plant(ball_screw()), np.random.default_rng(0)
    states = rng.normal(size=(64, 4)) * [1.0, 1.0, 2e-3, 2e-3]
    s = find_structure(plant, states, DATA.U, np.repeat(DATA.Y, 2, axis=1), ["N m"], ["rad", "m"], DATA.sample_time,
                       6.0, ())
    (gap,) = (e for e in locate_effects(effect_by_id("backlash"), s) if e.place.signal == "theta-x")
    assert gap.units() == ["m"]
    (spring,) = (e for e in locate_effects(effect_by_id("cubic_stiffness"), s) if e.effect.between)
    assert spring.units() == ["N/m^3"]
    assert spring.place.scales["force"] == pytest.approx(500.0 * s.force_scale[1])


def test_what_acts_behind_a_gear_has_the_unit_of_a_load_whose_position_is_in_degrees_and_its_speed_in_radians():
    turn = 180.0 / np.pi

    def update(t, x, u, params):
        torque = 0.4 * (turn * x[0] / 3.0 - x[1])
        return np.array([x[2], turn * x[3], (u[0] - torque / 3.0) / params["jm"], torque / params["jl"]])

    states = np.random.default_rng(0).normal(size=(64, 4))
    s = find_structure(as_plant(_system(update, ["qm", "ql", "wm", "wl"], {"jm": 0.02, "jl": 0.3})), states, DATA.U,
                       np.repeat(DATA.Y, 2, axis=1), ["N m"], ["rad", "deg"], DATA.sample_time, 6.0, ())
    (gap,) = (e for e in locate_effects(effect_by_id("backlash"), s) if e.place.signal == "qm-ql")
    (spring,) = (e for e in locate_effects(effect_by_id("cubic_stiffness"), s) if e.effect.between)
    assert gap.units() == ["deg"] and spring.place.units["position"] == {"deg": 1}


def _ride(seed: int, law) -> Recording:
    """A quarter car over a road, with a law between body and wheel."""
    rng, samples, dt, fine = np.random.default_rng(seed), 1200, 0.02, 20
    t = np.arange(samples) * dt
    u = 0.1 * multisine(rng, t, 2.0)
    update = quarter_car(law).updfcn
    x, y, h = np.zeros(4), np.empty((samples, 2)), dt / fine
    for k in range(samples):
        y[k] = x[:2]
        for _ in range(fine):
            mid = x + h / 2 * update(0.0, x, u[k:k + 1], {"mb": 1.3, "mw": 0.4})
            x = x + h * update(0.0, mid, u[k:k + 1], {"mb": 1.3, "mw": 0.4})
    y += 2e-3 * rng.normal(size=y.shape)
    return Recording(t, u[:, None], y, ("u",), ("y1", "y2"), {"u": "m", "y1": "m", "y2": "m"}, name=f"r{seed}.csv")


def test_a_damper_that_is_harder_in_rebound_is_named_between_body_and_wheel():
    recordings = [_ride(s, lambda s, v: 2.0 * v if v > 0 else 0.0) for s in (1, 2, 3)]
    ids = ("asymmetric_viscous_friction", "viscous_friction", "quadratic_drag", "coulomb_friction", "cubic_stiffness")
    evidence = collect(quarter_car(), recordings[:2], recordings[2:], ["mb"],
                       effects=[e for i in ids for e in effect_by_id(i)])
    decision = decide(evidence.problem, evidence.null, evidence.singles, evidence.pairs)
    assert (decision.verdict, decision.chosen.ids) == ("named", ("asymmetric_viscous_friction",))
    assert decision.chosen.located[0].place.signal in ("zb-zw", "zw-zb")
    soft, hard = sorted(decision.chosen.values()[0])
    assert hard == pytest.approx(2.0, rel=0.05) and soft < 0.1


def test_what_an_output_shows_of_heave_and_pitch_has_the_units_of_heave():
    def output(t, x, u, params):
        return np.array([1e3 * (x[0] - 0.8 * x[1]), x[1]])

    car = half_car()
    both = control.nlsys(car.updfcn, output, inputs=["u"], outputs=["front", "pitch"], states=car.state_labels,
                         params=car.params)
    plant, data = as_plant(both), replace(DATA, Y=np.repeat(DATA.Y, 2, axis=1))
    states = np.random.default_rng(0).normal(size=(64, 4))
    s = find_structure(plant, states, data.U, data.Y, ["N"], ["mm", "rad"], data.sample_time, 6.0, ())
    place = next(p for e in effect_by_id("end_stop") for p in e.places(s) if p.signal == "front")
    assert (place.units["position"], place.units["force"]) == ({"m": 1}, {"N": 1})
