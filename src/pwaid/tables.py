"""Tables: named columns of numbers, with their units where the header gives them, from CSV and MATLAB files.

Nothing is known here of time or of inputs and outputs: a static map's samples are a table, and a `pwaid.recording`
is made from one.
"""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path

import numpy as np

from pwaid.errors import InputError

__all__ = ["read_mat", "read_table"]

_HEADER = re.compile(r"^\s*(?P<name>.*?)\s*(?:[\[(](?P<unit>[^\])]*)[\])])?\s*$")


def read_table(path: str | Path) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Read a CSV file with a header line.

    Returns
    -------
    columns : dict of name to array, shape (N,)
    units : dict of name to unit
        For headers written ``name [unit]`` or ``name (unit)``.

    Raises
    ------
    InputError
        Missing or empty file, no header, repeated names, ragged rows, or a cell that is not a number.
    """
    path = _existing(path)
    text = _text(path)
    first = next((line for line in text.splitlines() if line.strip() and not line.startswith("#")), "")
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=max(",;\t", key=first.count))
    try:
        rows, lines = [], []
        for row in reader:
            if row and not row[0].startswith("#"):
                rows.append(row)
                lines.append(reader.line_num)
    except csv.Error as error:
        raise InputError(f"{path.name} cannot be read near line {reader.line_num} ({error}); is a quote left open?"
                         ) from error
    if len(rows) < 2:
        raise InputError(f"{path.name} has {len(rows)} lines; expected a header line and at least one row")
    names, units = _header(rows[0])
    if any(_is_number(n) for n in names):
        raise InputError(f"the first line of {path.name} holds numbers ({rows[0][:3]}…); expected column names")
    repeated = sorted({n for n in names if names.count(n) > 1})
    if repeated:
        raise InputError(f"{path.name} has the column {repeated[0]!r} twice; expected different names")
    ragged = next((i for i, row in enumerate(rows) if len(row) != len(names)), None)
    if ragged is not None:
        raise InputError(
            f"line {lines[ragged]} of {path.name} has {len(rows[ragged])} cells, the header {len(names)}; "
            "expected the same number: is a delimiter or a decimal comma in the way?"
        )
    try:
        data = np.array(rows[1:], dtype=float)
    except ValueError as error:
        for i, row in zip(lines[1:], rows[1:], strict=True):
            for name, cell in zip(names, row, strict=True):
                if not _is_number(cell):
                    raise InputError(
                        f"line {i}, column {name!r} of {path.name} holds {cell!r}; expected a number"
                    ) from error
        raise InputError(f"{path.name} cannot be read as numbers ({error})") from error
    return {name: np.ascontiguousarray(data[:, j]) for j, name in enumerate(names)}, units


def _text(path: Path) -> str:
    """The text of a file in UTF-8, or as Windows programs write it in western Europe."""
    data = path.read_bytes()
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return data.decode("utf-16", errors="replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252", errors="replace")


def _header(cells: list[str]) -> tuple[list[str], dict[str, str]]:
    """Names and units of the columns; whole cells are names where what stands in brackets tells them apart."""
    names, units = [], {}
    for cell in cells:
        match = _HEADER.match(cell)
        name = match["name"] if match else cell.strip()
        names.append(name)
        if match and match["unit"] is not None:
            units[name] = match["unit"].strip()
    whole = [cell.strip() for cell in cells]
    return (names, units) if len(set(names)) == len(names) or len(set(whole)) < len(whole) else (whole, {})


def read_mat(path: str | Path) -> dict[str, np.ndarray]:
    """Read the real numeric arrays of a MATLAB file (up to version 7.2), each as a vector under its name.

    Raises
    ------
    InputError
        Missing or empty file, or one that SciPy cannot read (version 7.3).
    """
    from scipy.io import loadmat

    path = _existing(path)
    try:
        content = loadmat(path)
    except (ValueError, NotImplementedError, TypeError, OSError) as error:
        raise InputError(
            f"{path.name} cannot be read as a MATLAB file ({error}); expected version 7.2 or older: "
            "save it with -v7"
        ) from error
    return {
        k: np.asarray(v, dtype=float).ravel()
        for k, v in content.items()
        if not k.startswith("__") and getattr(v, "dtype", np.dtype(object)).kind in "fiub"
    }


def _existing(path: str | Path) -> Path:
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path} is not a file; expected the path of a recording")
    if path.stat().st_size == 0:
        raise InputError(f"{path.name} is empty; expected a header line and rows of numbers")
    return path


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
