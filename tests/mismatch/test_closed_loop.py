"""The whole loop around a simulator: against a loop written out by hand, and as the report shows it."""

from __future__ import annotations

from types import SimpleNamespace

import control
import numpy as np
import pytest
from scipy.linalg import expm

from pwaid.cli import main
from pwaid.errors import InputError
from pwaid.mismatch import effects_table, explain, explain_case
from pwaid.mismatch.case import write_case
from pwaid.mismatch.closed_loop import controller_starts, make_loop, simulate_loop
from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.effects.registry import effect_by_id
from pwaid.mismatch.fit import Fit
from pwaid.mismatch.intervals import feedback_widening
from pwaid.mismatch.model import Model, Settings
from pwaid.mismatch.plant import as_plant
from pwaid.recording import Recording

DT, KP, KD = 0.01, 20.0, 160.0
A, B = np.array([[0.0, 1.0], [4.0, -0.3]]), np.array([0.0, 1.0])  # unstable: falls over by itself
SIMULATOR = '''"""A pendulum on its head."""
import control


def build():
    return control.ss([[0, 1], [GAIN, -0.3]], [[0], [1]], [[1, 0]], 0, inputs=["u"], outputs=["y"], states=["x", "v"])
'''
CONTROLLER = f'''"""Proportional-derivative: u = KP e + KD (e - last e)."""
import control


def build():
    return control.ss([[0]], [[1, -1]], [[-{KD}]], [[{KP + KD}, -{KP + KD}]], {DT})
'''


def pd(references: bool):
    """The controller from (r, y), or from y alone."""
    if references:
        return control.ss([[0]], [[1, -1]], [[-KD]], [[KP + KD, -(KP + KD)]], DT)
    return control.ss([[0]], [[-1]], [[-KD]], [[-(KP + KD)]], DT)


def loop(seed: int, noise=0.0, samples=300, level=0.0, x0=(0.0, 0.0), bias=0.0):
    """A recording of the closed loop and its reference; `level` is dry friction that never sticks, `bias` a force."""
    rng = np.random.default_rng(seed)
    t = np.arange(samples) * DT
    r = 0.3 * np.sin(2 * np.pi * np.outer(t, [0.3, 0.9, 2.1]) + rng.uniform(0, 6.28, 3)).sum(axis=1)
    M = expm(np.block([[A, B[:, None]], [np.zeros((1, 3))]]) * DT)
    x, before, Y, U = np.array(x0, dtype=float), 0.0, np.empty(samples), np.empty(samples)
    for k in range(samples):
        Y[k] = x[0] + noise * rng.standard_normal()
        e = r[k] - Y[k]
        U[k], before = KP * e + KD * (e - before), e
        x = M[:2, :2] @ x + M[:2, 2] * (U[k] + bias - level * np.sign(x[1]))
    return Recording(t, U, Y, ("u",), ("y",), {"u": "N", "y": "m"}, name=f"r{seed}.csv"), r[:, None]


def plant(gain=4.0):
    return as_plant(control.ss([[0, 1], [gain, -0.3]], [[0], [1]], [[1, 0]], 0, inputs=["u"], outputs=["y"]))


def fitted(p, data, x0=(0.0, 0.0)):
    model = Model(Settings(p, np.full(2, -1), np.zeros(2), (), np.zeros(0), substeps=4))
    return Fit(model, np.zeros(0), np.array([x0] * len(data.segments), dtype=float), 0.0, data.Y, data.Y, 0)


@pytest.mark.parametrize("references", [True, False])
def test_the_loop_is_the_one_written_out_by_hand(references):
    rec, r = loop(1, x0=(0.1, 0.0))
    data = Dataset.from_recordings([rec])
    given = make_loop(pd(references), plant(), {rec.name: r} if references else {}, DT, [rec])
    starts, faithful = controller_starts(given, data, ("u",))
    Y, U = simulate_loop(given, fitted(plant(), data, (0.1, 0.0)), data, starts)
    np.testing.assert_allclose(Y, rec.outputs, atol=1e-7)
    np.testing.assert_allclose(U, rec.inputs, atol=1e-5)
    assert (faithful is None) == (not references)
    assert not references or faithful["u"] > 99.99


def test_without_references_a_linear_controller_gives_the_same_loop():
    rec, r = loop(1, noise=1e-3)
    data = Dataset.from_recordings([rec])
    wrong = fitted(plant(2.0), data)
    ends = []
    for references in (True, False):
        given = make_loop(pd(references), plant(), {rec.name: r} if references else {}, DT, [rec])
        ends.append(simulate_loop(given, wrong, data, controller_starts(given, data, ("u",))[0]))
    np.testing.assert_allclose(ends[0][0], ends[1][0], atol=1e-8)
    np.testing.assert_allclose(ends[0][1], ends[1][1], atol=1e-6)


def test_a_case_with_a_controller_reports_the_loop(tmp_path):
    found = [loop(s, noise=1e-4, bias=0.5) for s in (1, 2, 3)]
    files = {r.name: r for r, _ in found}
    train, test = dict(list(files.items())[:2]), dict(list(files.items())[2:])
    folder = write_case(tmp_path / "case", SIMULATOR.replace("GAIN", "4.0"), train, test,
                        extra='controller = "controller.py"\n[references]\nr = "m"')
    (folder / "controller.py").write_text(CONTROLLER)
    for (name, rec), (_, r) in zip(files.items(), found, strict=True):
        table = np.column_stack([rec.time, r, rec.inputs, rec.outputs])
        np.savetxt(folder / name, table, delimiter=",", header="t,r,u,y", comments="")
    others = [e["id"] for e in effects_table() if e["id"] != "constant_load"]
    report = explain_case(folder, tmp_path / "out", without=others)
    closed = report.content["closed_loop"]
    assert closed["controller_bft"]["u"] > 99.9
    stages = closed["fit"]["r3.csv"]
    assert [e["id"] for e in report.effects] == ["constant_load"]
    assert stages["y"]["repaired"]["rmse"] < 0.2 * stages["y"]["refitted"]["rmse"]
    assert stages["u"]["repaired"]["rmse"] < 0.5 * stages["u"]["refitted"]["rmse"]
    assert 0.0 < closed["shows_in_inputs"] < 1.0
    assert any("known controller" in w for w in report.content["warnings"])


def test_feedback_widens_intervals_and_open_loop_does_not():
    rng = np.random.default_rng(0)
    e = np.cumsum(rng.standard_normal(400)) * 0.1
    u = np.concatenate([[0.0], -3.0 * e[:-1]])  # the controller answers the last error
    data = Dataset.from_recordings([Recording(np.arange(400) * DT, u, e)])
    fit = SimpleNamespace(Y=np.zeros((400, 1)))

    def factor(feedback, data=data):
        return feedback_widening(SimpleNamespace(settings=SimpleNamespace(feedback=feedback), train=data), fit)

    assert factor(False) == 1.0
    assert factor(True) > 10.0
    white = Dataset.from_recordings([Recording(np.arange(400) * DT, u, rng.standard_normal(400))])
    assert factor(True, white) < 2.0


def test_closed_loop_without_controller_says_so():
    recs = [loop(s, noise=1e-3)[0] for s in (1, 2, 3)]
    report = explain(control.ss(A, B[:, None], [[1, 0]], 0, inputs=["u"], outputs=["y"]), recs[:2], recs[2:], [],
                     closed_loop=True, effects=effect_by_id("constant_load"))
    assert any("controller unknown" in w and "widened" in w for w in report.content["warnings"])
    assert report.problem.settings.feedback and "closed_loop" not in report.content


@pytest.mark.parametrize(("controller", "message"), [
    (control.ss([[0]], [[1]], [[1]], [[1]], DT), r"has 1 inputs; expected 2: 1 references"),
    (control.ss([[0]], [[1, 1]], [[1], [1]], [[1, 1], [1, 1]], DT), r"has 2 outputs; expected the plant's 1 inputs u"),
    (control.ss([[0]], [[1, -1]], [[1]], [[1, -1]], 2 * DT), r"steps 0.02 s, the recordings are sampled every 0.01"),
    (lambda z: z, "plain callable"),
    ("pid", "is a str"),
])
def test_a_controller_that_does_not_fit_gets_one_line(controller, message):
    rec, r = loop(1)
    with pytest.raises(InputError, match=message):
        make_loop(controller, plant(), {rec.name: r}, DT, [rec])


def test_a_black_box_cannot_be_closed():
    with pytest.raises(InputError, match="cannot be closed sample by sample"):
        make_loop(pd(True), as_plant(lambda u: u, ("u",), ("y",)), {}, DT, [])


@pytest.mark.parametrize(("extra", "message"), [
    ('controller = "controller.py"', "controller.py does not exist; expected the controller"),
    ('[references]\nr = "m"', "has [references] and no controller"),
    ('controller = 3', "expected a file name"),
])
def test_a_case_whose_controller_is_missing_ends_in_one_line(tmp_path, capsys, extra, message):
    rec = loop(1)[0]
    folder = write_case(tmp_path / "case", SIMULATOR.replace("GAIN", "4.0"), {"a.csv": rec}, {"b.csv": loop(2)[0]},
                        extra=extra)
    assert main(["explain", str(folder), "-o", str(tmp_path / "out")]) == 2
    err = capsys.readouterr().err
    assert message in err and len(err.strip().splitlines()) == 1 and not (tmp_path / "out").exists()


def test_one_recording_with_references_is_split_with_them():
    recording, r = loop(3, samples=600)
    report = explain(plant(), recording, None, ["A[1,0]"], controller=pd(True), references={recording.name: r},
                     effects=effect_by_id("constant_load"))
    assert report.content["closed_loop"]["references"]


@pytest.mark.parametrize("array, message", [(np.zeros(50), "have 50 samples, the recording 300"),
                                            (np.zeros((300, 1, 1)), "expected \\(N, n_references\\)")])
def test_references_of_another_shape_get_one_line(array, message):
    recordings = [loop(seed)[0] for seed in (1, 2)]
    with pytest.raises(InputError, match=message):
        explain(plant(), recordings[:1], recordings[1:], ["A[1,0]"], controller=pd(True),
                references={r.name: array for r in recordings})
