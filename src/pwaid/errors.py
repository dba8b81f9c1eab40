"""The exceptions of pwaid. Each message says what came, what was expected, and what to do."""

from __future__ import annotations

__all__ = ["InputError", "MissingExtraError", "OutsideMeshError", "PwaidError", "SolverError"]


class PwaidError(Exception):
    """Base class of every error that pwaid raises on purpose."""


class InputError(PwaidError, ValueError):
    """Data, options or files that cannot be used as they came."""


class OutsideMeshError(InputError):
    """Points lie outside the mesh, and no rule for the outside was named."""


class SolverError(PwaidError, RuntimeError):
    """A solver ended without an answer that its certificate supports."""


class MissingExtraError(PwaidError, ImportError):
    """An optional package is needed and is not installed."""

    def __init__(self, package: str, purpose: str, extra: str | None = None):
        hint = f"pip install 'pwaid[{extra}]'" if extra else f"pip install {package}"
        super().__init__(f"{purpose} needs the package {package!r}, which is not installed; run: {hint}")
