"""Recordings: reading, checking, slicing; every bad input has one clear message."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.io import savemat

from pwaid import InputError, Recording
from pwaid.recording import check_samples
from pwaid.tables import read_table

T = np.arange(10) * 0.1


def recording(**changes):
    fields = {
        "time": T,
        "inputs": np.sin(T),
        "outputs": np.column_stack([T, T**2]),
        "input_names": ("u",),
        "output_names": ("x", "v"),
        "units": {"u": "N m"},
    }
    return Recording(**{**fields, **changes})


def test_channels_units_and_sample_time():
    rec = recording()
    assert rec.inputs.shape == (10, 1) and rec.outputs.shape == (10, 2) and len(rec) == 10
    assert rec.sample_time == pytest.approx(0.1)
    assert rec.units == {"u": "N m", "x": "", "v": ""}
    np.testing.assert_array_equal(rec["v"], T**2)


def test_arrays_are_read_only_copies():
    source = np.sin(T)
    rec = recording(inputs=source)
    source[0] = 5.0
    assert rec.inputs[0, 0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        rec.outputs[0, 0] = 1.0


def test_slices_and_splits_keep_order_and_names():
    rec = recording()
    first, second = rec.split(0.6)
    assert len(first) == 6 and len(second) == 4 and second.time[0] == pytest.approx(0.6)
    assert rec[2:5].names == rec.names and len(rec.between(0.2, 0.5)) == 3
    assert rec.decimate(2).sample_time == pytest.approx(0.2)


def test_csv_with_units_and_mat_and_frame_agree(tmp_path):
    pandas = pytest.importorskip("pandas")
    u, x = np.sin(T), T**2
    csv = tmp_path / "r.csv"
    rows = [",".join(repr(float(v)) for v in row) for row in zip(T, u, x, strict=True)]
    csv.write_text("\n".join(["t [s],u [N m],x (rad)", *rows]))
    savemat(tmp_path / "r.mat", {"t": T, "u": u, "x": x})
    frame = pandas.DataFrame({"t": T, "u": u, "x": x})
    recs = [
        Recording.from_csv(csv, ["u"], ["x"]),
        Recording.from_mat(tmp_path / "r.mat", ["u"], ["x"]),
        Recording.from_frame(frame, ["u"], ["x"]),
        Recording.from_frame(frame.set_index("t"), ["u"], ["x"], time=None),
    ]
    assert recs[0].units == {"u": "N m", "x": "rad"}
    for rec in recs:
        np.testing.assert_array_equal(rec.inputs[:, 0], u)
        np.testing.assert_array_equal(rec.outputs[:, 0], x)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"time": T[::-1]}, "time goes backwards or stands still at sample 1"),
        ({"time": np.r_[T[:5], T[4:9]]}, "stands still"),
        ({"time": np.r_[T[:5], T[5:] + 0.3]}, "not uniformly sampled: the step after sample 4"),
        ({"inputs": np.r_[np.nan, T[1:]]}, r"inputs has 1 entries that are NaN or infinite, the first at index \(0"),
        ({"outputs": np.full((10, 2), np.inf)}, "outputs has 20 entries"),
        ({"outputs": np.zeros((2, 10))}, "looks transposed"),
        ({"inputs": T[:5]}, "inputs has 5 rows for 10 time stamps"),
        ({"time": T[:1], "inputs": T[:1], "outputs": np.zeros((1, 2))}, "needs at least 2"),
        ({"output_names": ("x", "u")}, "used twice"),
        ({"output_names": ("x",)}, "1 output_names came for 2 outputs"),
        ({"units": {"w": "m"}}, "which are not channels"),
        ({"inputs": ["a"] * 10}, "cannot be read as numbers"),
    ],
)
def test_bad_recordings(changes, message):
    with pytest.raises(InputError, match=message):
        recording(**changes)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("t,u,x\n", "expected a header line and at least one row"),
        ("0,1,2\n0,1,2\n", "expected column names"),
        ("t,u,u\n0,1,2\n", "column 'u' twice"),
        ("t,u,x\n0,1\n1,2,3\n", "line 2 of r.csv has 2 cells"),
        ("t,u,x\n0,1,2\n1,zwei,3\n", "line 3, column 'u' of r.csv holds 'zwei'"),
        ("t,u,z\n0,1,2\n1,2,3\n", "has no column 'x'"),
        ("t,u,x\n0,1,nan\n1,2,3\n", "NaN or infinite"),
    ],
)
def test_bad_csv(tmp_path, text, message):
    path = tmp_path / "r.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        Recording.from_csv(path, ["u"], ["x"])


def test_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match=r"nothing\.csv is not a file"):
        read_table(tmp_path / "nothing.csv")


def test_rounded_time_stamps_can_be_replaced(tmp_path):
    path = tmp_path / "r.csv"
    path.write_text("t,u,x\n0.0,0,0\n0.0,1,1\n0.1,2,2\n")
    assert Recording.from_csv(path, "u", "x", sample_time=0.025).sample_time == pytest.approx(0.025)


@pytest.mark.parametrize(
    ("X", "y", "message"),
    [
        (np.zeros((2, 9)), np.zeros(9), "looks transposed"),
        (np.zeros((9, 2)), np.zeros(8), "X has 9 samples and y has 8"),
        (np.zeros((3, 2)), np.zeros(3), "need at least 4"),
        (np.zeros((9, 2)), np.zeros((9, 2)), "fit one output at a time"),
        (np.full((9, 2), np.nan), np.zeros(9), "X has 18 entries"),
        (np.zeros((9, 2)), np.r_[np.zeros(8), np.inf], "y has 1 entries"),
    ],
)
def test_bad_samples(X, y, message):
    with pytest.raises(InputError, match=message):
        check_samples(X, y)


def test_dates_are_seconds_from_the_first():
    start = np.datetime64("2026-03-01T08:00:00", "us")
    for stamps in (start + np.arange(50) * np.timedelta64(10_000, "us"), np.arange(50) * np.timedelta64(10, "ms"),
                   (start + np.arange(50) * np.timedelta64(10_000, "us")).astype("datetime64[ns]")):
        r = Recording(stamps, np.zeros(50), np.zeros(50))
        assert r.sample_time == pytest.approx(0.01) and r.time[0] == 0.0
    with pytest.raises(InputError, match="expected real numbers"):
        Recording(np.arange(50) * 0.1, stamps, np.zeros(50))
    with pytest.raises(InputError, match="masked"):
        Recording(np.arange(50) * 0.1, np.zeros(50), np.ma.masked_equal(np.arange(50.0), 3.0))


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252", "utf-16"])
def test_files_of_other_programs(tmp_path, encoding):
    path = tmp_path / "r.csv"
    path.write_bytes("# exported, by hand\n\nt;T [°C]\n0;1.5\n1;2.5\n".encode(encoding))
    columns, units = read_table(path)
    np.testing.assert_array_equal(columns["T"], [1.5, 2.5])
    assert units == {"T": "°C"}


def test_brackets_that_tell_columns_apart_are_no_units(tmp_path):
    path = tmp_path / "r.csv"
    path.write_text("y(k-1),y(k-2),y\n0,1,2\n1,2,3\n")
    assert list(read_table(path)[0]) == ["y(k-1)", "y(k-2)", "y"]


def test_lines_of_the_file_are_counted(tmp_path):
    path = tmp_path / "r.csv"
    path.write_text("# made by hand\n\nt,x\n0,1\n\n1,zwei\n")
    with pytest.raises(InputError, match="line 6, column 'x'"):
        read_table(path)
    path.write_text('t,x\n0,"' + "1\n" * 100_000)
    with pytest.raises(InputError, match=r"quote left open|has 2 cells|holds"):
        read_table(path)
