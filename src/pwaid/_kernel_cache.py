"""Compiled functions cached by an older state of the package, removed when the package is imported.

numba caches a compiled function beside its module and looks at that file alone: when a helper that was compiled into
it changes in another file, as after `git pull` in an editable install, the old machine code would run on.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from time import time_ns

__all__ = ["drop_stale"]


def drop_stale(package: Path) -> int:
    """Remove the cached functions that are older than any module of a package that has cached functions; how many.

    Another process may be doing the same at this moment.
    """
    indices = list(package.rglob("__pycache__/*.nbi"))
    modules = {index.parent.parent / f"{index.name.partition('.')[0]}.py" for index in indices}
    times, now = [_changed(m) for m in modules], time_ns()
    newest = max((t for t in times if t <= now), default=0)  # a date ahead of the clock would drop them every time
    stale = [index for index in indices if 0 < _changed(index) < newest]
    for index in stale:
        with suppress(OSError):  # the folder may not be writable
            index.unlink()
    return len(stale)


def _changed(file: Path) -> int:
    """When a file was last changed, in ns; 0 where it is not there any more."""
    try:
        return file.stat().st_mtime_ns
    except OSError:
        return 0


drop_stale(Path(__file__).resolve().parent)
