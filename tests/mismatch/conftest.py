"""Fixtures of the mismatch tests."""

from __future__ import annotations

import pytest
from tests_support import record


@pytest.fixture(scope="session")
def friction_recordings():
    return [record(s, level=0.4) for s in (1, 2, 3)]


@pytest.fixture(scope="session")
def clean_recordings():
    return [record(s) for s in (1, 2, 3)]
