"""The README's code runs and prints what the README shows."""

from __future__ import annotations

import contextlib
import io
import re
from pathlib import Path

import numpy as np

README = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")


def test_the_code_prints_what_the_readme_shows():
    code, shown = re.search(r"```python\n(.+?)\n```\n+```\n(.+?)\n```", README, re.S).groups()
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(code, "README.md", "exec"), {})
    number = r"-?\d+\.?\d*(?:e-?\d+)?"
    ours, theirs = printed.getvalue().strip(), shown.strip()
    assert re.sub(number, "#", ours) == re.sub(number, "#", theirs)
    for mine, line in zip(ours.splitlines(), theirs.splitlines(), strict=True):
        if "gap" not in mine:
            values = [[float(x) for x in re.findall(number, text)] for text in (mine, line)]
            np.testing.assert_allclose(*values, rtol=0.02, atol=0.02)
    assert len(code.splitlines()) <= 16


def test_each_command_is_one_line_and_makes_its_own_environment():
    for name in ("demo-command", "test-command"):
        command = re.search(rf"<!-- {name} -->\s*```\w*\n(.+?)\n```", README, re.S)[1]
        assert "\n" not in command and command.startswith("python3 -m venv ")


def test_every_page_and_picture_that_the_readme_names_exists():
    for target in re.findall(r"\]\(([^)#:]+)\)", README):
        assert (Path(__file__).parents[1] / target).exists(), target
