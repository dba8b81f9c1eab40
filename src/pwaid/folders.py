"""Folders for results, made before the work begins: what cannot be written is found out then."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from pwaid.errors import InputError

__all__ = ["ready_folder"]


@contextmanager
def ready_folder(folder: str | Path) -> Iterator[Path]:
    """The folder, made and tried; where the work inside fails, what was made for it goes again.

    Raises
    ------
    InputError
        It is a file, or cannot be made or written.
    """
    folder = Path(folder)
    made = [p for p in (folder, *folder.parents) if not p.exists()]
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder} is a file; expected a folder for the results")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        trial = folder / ".pwaid-trial"
        trial.touch()
        trial.unlink()
    except OSError as error:
        raise InputError(f"{folder} cannot be written ({error.strerror}); name another folder for the results"
                         ) from error
    try:
        yield folder
    except BaseException:
        for p in made:
            with suppress(OSError):
                p.rmdir()
        raise
