"""Whole folders or none: a report appears under its name only once all of its files are there."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from clusterviz.errors import OutputError
from clusterviz.image.replace import folder_error, lock_temporary, remove_temporary, temporary_name


@contextmanager
def replacing_folder(path: str | os.PathLike[str], known_by: str) -> Iterator[Path]:
    """Give a temporary folder beside `path`; when the block ends well it becomes `path`, else it is removed.

    Parameters
    ----------
    path : the folder to be; an empty folder, or an older report, may stand there
    known_by : the file by which an older report is recognised, and may be replaced

    Raises
    ------
    OutputError
        Something else stands there, or the folder cannot be made, written (any OSError of the block) or renamed.
    """
    target = Path(path).absolute()
    temporary = _create(target, known_by)
    try:
        yield temporary
        _rename(temporary, target)
    except OSError as error:
        raise OutputError("cannot be written", where=str(target), found=error.strerror or error) from error
    finally:
        remove_temporary(temporary)


def check_folder(path: str | os.PathLike[str], known_by: str) -> None:
    """Find out before minutes of work whether `replacing_folder` could begin.

    Raises
    ------
    OutputError
    """
    remove_temporary(_create(Path(path).absolute(), known_by))


def _create(target: Path, known_by: str) -> Path:
    """An empty hidden folder beside the target, which nothing may be lost to."""
    if target.exists() and not target.is_dir():
        raise OutputError("cannot be a folder", where=str(target), found="a file", allowed="a folder's name")
    if target.is_dir() and any(target.iterdir()) and not (target / known_by).is_file():
        allowed = f"a new name, an empty folder, or one with an older {known_by}, which is replaced"
        raise OutputError("would overwrite other files", where=str(target), found="a folder in use", allowed=allowed)
    temporary = temporary_name(target)
    try:
        temporary.mkdir()
        lock_temporary(temporary)
    except OSError as error:
        raise folder_error(target, error) from error
    return temporary


def _rename(temporary: Path, target: Path) -> None:
    """Put the new folder in the place of the old one, which is out of the way for one rename only."""
    if not target.is_dir():
        os.rename(temporary, target)
        return
    old = temporary_name(target)
    os.rename(target, old)
    try:
        os.rename(temporary, target)
    except OSError:
        os.rename(old, target)
        raise
    shutil.rmtree(old, ignore_errors=True)
