"""The house rules of the source tree: imports point one way, and heavy packages stay in their one file."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import pwaid

SOURCE = Path(pwaid.__file__).parent

# A file may import only from lines above its own; files on one line may import each other's folder siblings.
ORDER = [
    ["_kernel_cache"],
    ["_version"],
    ["errors"],
    ["folders"],
    ["tables"],
    ["recording"],
    ["vertices"],
    ["scaling"],
    ["walk"],
    ["triangulation"],
    ["delaunay"],
    ["lerp"],
    ["assembly"],
    ["fronts"],
    ["separator"],
    ["dissection"],
    ["dense"],
    ["cholesky"],
    ["problem"],
    ["nearest"],
    ["pwa_map"],  # above solution, so that a solution can carry its map
    ["solution"],
    ["admm"],
    ["engine"],
    ["lambda_max"],
    ["reference"],
    ["solve"],
    ["sqrt_loss"],
    ["noise_free"],
    ["path"],
    ["regions"],
    ["estimator"],
    ["dynamics"],
    ["hinfstruct"],
    ["systems"],
    ["plotting"],  # above mismatch, so that a report can draw itself; it takes what it draws as plain objects
    ["mismatch"],
    ["cli"],
    ["__init__", "__main__"],
]
RANK = {name: i for i, names in enumerate(ORDER) for name in names}
ONLY_IN = {"matplotlib": "plotting", "cvxpy": "reference"}


def top(path: Path) -> str:
    return path.relative_to(SOURCE).with_suffix("").parts[0]


def imports(path: Path):
    """Every absolute module name that a file imports, late imports counted."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name}: write absolute imports"
            for alias in node.names:
                yield f"{node.module}.{alias.name}"


FILES = sorted(SOURCE.rglob("*.py"))


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(SOURCE)))
def test_imports_point_one_way(path):
    mine = top(path)
    assert mine in RANK, f"{mine} has no place in the import order of tests/test_house.py"
    for name in imports(path):
        parts = name.split(".")
        if parts[0] != "pwaid" or len(parts) < 2 or parts[1] not in RANK:
            continue
        if parts[1] == mine and path.parent != SOURCE:
            continue
        assert RANK[parts[1]] < RANK[mine] or parts[1] == mine, f"{path.name} imports {name}, from below"


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(SOURCE)))
def test_heavy_packages_stay_in_one_file(path):
    for name in imports(path):
        package = name.split(".")[0]
        if package in ONLY_IN:
            assert top(path) == ONLY_IN[package], f"{package} belongs to {ONLY_IN[package]}.py alone"


def test_every_python_file_opens_with_a_docstring():
    trees = {p: ast.parse(p.read_text(encoding="utf-8")) for p in FILES if p.name != "_version.py"}
    bare = [p for p, tree in trees.items() if ast.get_docstring(tree) is None]
    assert not bare, f"files without a docstring that says what they are for: {bare}"
