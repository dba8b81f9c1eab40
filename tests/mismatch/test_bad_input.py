"""Unusable cases through the command: exit code 2, one line that says what to do, nothing written."""

from __future__ import annotations

import shutil

import control
import numpy as np
import pytest
from tests_support import output, record, update

from pwaid.cli import main
from pwaid.errors import InputError
from pwaid.mismatch import explain
from pwaid.mismatch.case import write_case
from pwaid.mismatch.plant import as_plant

SIMULATOR = '''"""Mass, spring, damper as matrices: nothing to compile."""
import control


def build():
    return control.ss([[0, 1], [-3.0, -0.5]], [[0], [1]], [[1, 0]], [[0]], inputs=["F"], outputs=["x"])
'''
TRAIN, TEST = record(1, samples=80), record(2, samples=80)


def toml(old, new):
    def change(folder):
        path = folder / "case.toml"
        assert old in path.read_text()
        path.write_text(path.read_text().replace(old, new))
    return change


def option(line):
    return toml('time = "t"', f'time = "t"\n{line}')


def lines(edit, file="train.csv"):
    """Change the list of lines of a recording."""
    def change(folder):
        path = folder / file
        path.write_text("\n".join(edit(path.read_text().splitlines())) + "\n")
    return change


def cell(row, column, text):
    def edit(rows):
        cells = rows[row].split(",")
        cells[column] = text
        return [*rows[:row], ",".join(cells), *rows[row + 1:]]
    return lines(edit)


def column(k, value, file="train.csv"):
    """Every cell of column k from the old one."""
    def edit(rows):
        found = [rows[0]]
        for row in rows[1:]:
            cells = row.split(",")
            cells[k] = value(cells[k])
            found.append(",".join(cells))
        return found
    return lines(edit, file)


def simulator(text):
    return lambda folder: (folder / "simulator.py").write_text(text)


@pytest.mark.parametrize(("change", "message"), [
    (shutil.rmtree, "case.toml does not exist"),
    (toml("simulator =", "simulator = ="), "not valid TOML"),
    (lambda f: (f / "train.csv").unlink(), "train.csv does not exist"),
    (lambda f: (f / "simulator.py").unlink(), "simulator.py does not exist"),
    (lambda f: (f / "train.csv").write_text(""), "train.csv is empty"),
    (lines(lambda rows: rows[:1]), "expected a header line and at least one row"),
    (lines(lambda rows: rows[:8]), "train.csv has 7 samples; expected at least 20"),
    (lines(lambda rows: rows[:8], "test.csv"), "test.csv has 7 samples; expected at least 20"),
    (toml('train = ["train.csv"]', 'train = "train.csv"'), "expected a list of file names"),
    (toml('train = ["train.csv"]', 'train = ["train.csv", "train.csv"]'), "listed twice"),
    (toml('test = ["test.csv"]', 'test = ["train.csv"]'), "listed as training and as test"),
    (option("repeats = [1, 2]"), "holds 1; expected a list of lists"),
    (option('repeats = ["train.csv", "test.csv"]'), "holds 'train.csv'; expected a list of lists"),
    (option("noise_floor = { x = inf }"), "is inf; expected a positive number"),
    (lambda f: (f / "case.toml").write_bytes("title = 'Prüfstand'".encode("cp1252")), "is not UTF-8 text"),
    (lambda f: shutil.copy(f / "train.csv", f / "test.csv"), "its samples are in train.csv"),
    (lambda f: (f / "test.csv").write_text("\n".join(["t,F,x"] + [
        f"{0.02 * k},{row.split(',', 1)[1]}" for k, row in enumerate((f / "train.csv").read_text().split()[30:70])])),
     "its samples are in train.csv"),
    (column(0, lambda t: str(2 * float(t)), "test.csv"), "sampled every 0.04 s, the training ones every 0.02 s"),
    (cell(30, 0, "0.595"), "train.csv: time is not uniformly sampled"),
    (cell(30, 0, "0.1"), "train.csv: time goes backwards"),
    (cell(30, 2, "nan"), "train.csv: outputs has 1 entries that are NaN"),
    (cell(30, 1, "inf"), "train.csv: inputs has 1 entries that are NaN or infinite"),
    (cell(30, 2, "abc"), "line 31, column 'x' of train.csv holds 'abc'"),
    (column(2, lambda y: "1"), "output 'x' is constant (1)"),
    (toml('x = "m"', 'x = "furlong"'), "unknown unit 'furlong'"),
    (toml('x = "m"', 'z = "m"'), "no column 'z'"),
    (toml('F = "N"', 'F = "N"\nx2 = "N"'), "the simulator has 1 inputs, case.toml lists 2 (F, x2)"),
    (toml('free_parameters = []', 'free_parameters = ["mass"]'), "'mass' is not a parameter"),
    (toml('free_parameters = []', 'free_parameters = "m"'), "expected a list of names"),
    (option("tolerances = { mass = 0.3 }"), "'mass' is no parameter"),
    (option('tolerances = { "A[1,0]" = -0.3 }'), "expected a positive number"),
    (option('noise_floor = { x = "low" }'), "expected a positive number"),
    (option("noise_floor = { v = 0.1 }"), "'v', which is not an output"),
    (option('repeats = [["train.csv", "tain.csv"]]'), "'tain.csv', which is no recording"),
    (option('hold = "second"'), "expected 'zero' or 'first'"),
    (option('holt = "zero"'), "unknown key 'holt'"),
    (simulator("1/0"), "raised ZeroDivisionError"),
    (simulator("import sys\nsys.exit(3)"), "raised SystemExit: 3"),
    (simulator("def build(:"), "raised SyntaxError"),
    (simulator("x = 1"), "has no build()"),
    (simulator("def build():\n    raise OSError('no licence')"), "raised OSError: no licence"),
    (simulator("def build():\n    return None"), "is a NoneType; expected control.nlsys"),
    (simulator(SIMULATOR.replace("[[0], [1]]", "[[0, 0], [1, 1]]").replace("[[0]]", "[[0, 0]]").replace('["F"]', "2")),
     "the simulator has 2 inputs, case.toml lists 1 (F)"),
    (simulator(SIMULATOR.replace("[[1, 0]], [[0]]", "[[1, 0], [0, 1]], 0").replace('["x"]', "2")),
     "the simulator has 2 outputs, case.toml lists 1 (x)"),
    (simulator(SIMULATOR.replace("-0.5]", "900.0]")), "diverges from every start state"),
    (simulator(SIMULATOR.replace("[[0]], ", "[[0]], dt=0.01, ")), "steps 0.01 s, the recordings are"),
    (simulator(SIMULATOR.replace("[[0]], ", "[[0]], dt=True, ")), "unspecified step"),
    (lambda f: (f / "out").write_text(""), "out is a file; expected a folder"),
])
def test_unusable_cases_end_in_one_line(tmp_path, capsys, change, message):
    folder = write_case(tmp_path / "case", SIMULATOR, {"train.csv": TRAIN}, {"test.csv": TEST})
    change(folder)
    assert main(["explain", str(folder), "-o", str(folder / "out")]) == 2
    err = capsys.readouterr().err
    assert message in err and len(err.strip().splitlines()) == 1
    assert not (folder / "out").is_dir()


def nonlinear(rhs, out=output):
    return control.nlsys(rhs, out, inputs=["F"], outputs=["x"], states=["x", "v"],
                         params={"m": 1.0, "b": 0.5, "k": 3.0})


def no_licence(t, x, u, params):
    raise OSError("no licence")


@pytest.mark.parametrize(("system", "message"), [
    (nonlinear(no_licence), r"raised OSError: no licence; expected derivatives at x = \[0.1, 0.1\]"),
    (nonlinear(update, no_licence), "output function raised OSError: no licence"),
    (nonlinear(lambda t, x, u, params: x[:1]), "1 derivatives for 2 states"),
    (nonlinear(update, lambda t, x, u, params: x), "2 outputs, expected 1"),
    (nonlinear(lambda t, x, u, params: x * np.nan), "expected finite numbers"),
    (3.0, "is a float; expected control.nlsys"),
])
def test_unusable_simulators_end_in_one_line(system, message):
    with pytest.raises(InputError, match=message):
        explain(system, [TRAIN], [TEST])


def behind_a_stop(t, x, u, params):
    if x[0] > 0.2:
        raise ValueError("beyond the stop")
    return np.array([x[1], (u[0] - params["b"] * x[1] - params["k"] * x[0]) / params["m"]])


def in_kelvin(t, x, u, params):
    if x[0] < 200.0:
        raise ValueError("below the table")
    return np.array([params["a"] * (u[0] - x[0])])


def test_a_simulator_that_raises_at_some_states_diverges_there():
    plant = as_plant(nonlinear(behind_a_stop))
    assert plant.rhs is not None  # compiled
    assert np.isnan(plant.derivative([0.3, 0.0], [0.0])).all()
    np.testing.assert_allclose(plant.derivative([0.1, 0.0], [0.0]), [0.0, -0.3])
    assert any("can raise" in n for n in plant.notes)
    warm = as_plant(control.nlsys(in_kelvin, None, inputs=["u"], states=["T"], params={"a": 0.1}))
    assert warm.rhs is not None and np.isnan(warm.derivative([100.0], [0.0])).all()
