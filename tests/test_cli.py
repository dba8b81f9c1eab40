"""The command: results written, exit codes, one line for unusable input."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest

from pwaid import PWAMap
from pwaid.cli import main


def write(path, X, y, header="x1 [m],x2,y [N]"):
    rows = "\n".join(",".join(f"{v:.6g}" for v in (*x, b)) for x, b in zip(X, y, strict=True))
    path.write_text(f"{header}\n{rows}\n")
    return path


@pytest.fixture
def table(tmp_path, rng):
    X = rng.uniform(-1, 1, (300, 2))
    return write(tmp_path / "train.csv", X, np.abs(X[:, 0]) + 0.01 * rng.standard_normal(300))


def test_sweep_writes_path_map_and_pictures(table, tmp_path, rng, capsys):
    X = rng.uniform(-1, 1, (200, 2))
    held_out = write(tmp_path / "val.csv", X, np.abs(X[:, 0]))
    out = tmp_path / "out"
    code = main(
        ["sweep", str(table), "--inputs", "x1,x2", "--output", "y", "--validation", str(held_out), "--points", "80",
         "--lambdas", "6", "--tol", "1e-3", "-o", str(out)]
    )  # fmt: skip
    text = capsys.readouterr()
    assert code == 0 and "← best" in text.out and "chosen: λ" in text.out and "λ path" not in text.err
    assert {p.name for p in out.iterdir()} == {"map.npz", "map.png", "path.csv", "path.png"}
    with (out / "path.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 6 and all(float(r["gap"]) <= 1e-3 for r in rows)
    f = PWAMap.load(out / "map.npz")
    assert f([[0.5, 0.0]])[0] == pytest.approx(0.5, abs=0.05)


def test_sweep_without_held_out_file_cross_validates(table, tmp_path, capsys):
    out = tmp_path / "out"
    options = ["--points", "50", "--lambdas", "4", "--tol", "1e-2", "-o", str(out)]
    assert main(["sweep", str(table), "--inputs", "x1", "--output", "y", *options]) == 0
    assert "held-out RMSE" in capsys.readouterr().out
    assert not (out / "map.png").exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"data": "nothing.csv"}, "is not a file"),
        ({"inputs": "x1,x3"}, "has no column 'x3'; its columns are ['x1', 'x2', 'y']"),
        ({"inputs": "x1,x1"}, "expected different column names"),
        ({"points": "3"}, "expected at least 5"),
        ({"lambdas": "0"}, "at least 1"),
    ],
)
def test_unusable_input_is_one_line_and_exit_code_2(table, tmp_path, capsys, change, message):
    call = {"data": str(table), "inputs": "x1,x2", "points": "50", "lambdas": "3", **change}
    code = main(
        ["sweep", call["data"], "--inputs", call["inputs"], "--output", "y", "--points", call["points"], "--lambdas",
         call["lambdas"], "-o", str(tmp_path / "out")]
    )  # fmt: skip
    err = capsys.readouterr().err
    assert code == 2 and message in err and len(err.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_an_internal_failure_is_exit_code_1(table, monkeypatch, capsys):
    monkeypatch.setattr("pwaid.cli.read_table", lambda path: 1 / 0)
    assert main(["sweep", str(table), "--inputs", "x1", "--output", "y"]) == 1
    assert "internal failure" in capsys.readouterr().err


def test_demo_sweeps_and_explains_and_says_where(tmp_path, capsys):
    out = tmp_path / "demo"
    assert main(["demo", "-o", str(out)]) == 0
    text = capsys.readouterr().out
    assert "error against the noise-free pyramid" in text and (out / "sweep" / "map.png").exists()
    report = json.loads((out / "explained" / "report.json").read_text())
    assert report["schema"] == "pwaid.mismatch/1" and report["verdict"] == "named"
    assert [e["id"] for e in report["effects"]] == ["coulomb_friction"]
    assert str(out / "explained" / "report.html") in text


def test_explain_refuses_a_folder_without_a_case_in_one_line(tmp_path, capsys):
    assert main(["explain", str(tmp_path), "-o", str(tmp_path / "out")]) == 2
    err = capsys.readouterr().err
    assert "case.toml" in err and len(err.strip().splitlines()) == 1 and not (tmp_path / "out").exists()


def test_explain_refuses_an_unknown_effect_bad_jobs_and_bad_minutes(tmp_path, capsys):
    from pwaid.mismatch import demo_case_path

    out = str(tmp_path / "out")
    assert main(["explain", str(demo_case_path()), "-o", out, "--without", "gremlins"]) == 2
    assert "gremlins" in capsys.readouterr().err
    for option, value in (("--jobs", "0"), ("--minutes", "0"), ("--minutes", "long"), ("--minutes", "inf")):
        with pytest.raises(SystemExit) as stop:
            main(["explain", str(demo_case_path()), option, value])
        assert stop.value.code == 2 and repr(value) in capsys.readouterr().err


def test_effects_lists_the_catalogue(capsys):
    assert main(["effects"]) == 0
    text = capsys.readouterr().out
    for name in ("coulomb_friction", "backlash", "overflow", "parameter_drift", "sensor_quantization"):
        assert f"{name}  (" in text


def test_sweep_of_an_affine_table_and_of_a_folder_that_is_a_file(tmp_path, rng, capsys):
    x = rng.uniform(0, 1, 60)
    path = tmp_path / "affine.csv"
    write(path, np.column_stack([x, rng.uniform(0, 1, 60)]), 2 * x + 1)
    words = ["sweep", str(path), "--inputs", "x1,x2", "--output", "y", "--validation", str(path)]
    assert main([*words, "-o", str(tmp_path / "out")]) == 0
    assert (tmp_path / "out" / "map.npz").is_file()
    assert main([*words, "-o", str(path / "inside")]) == 2
    assert "cannot be written" in capsys.readouterr().err
