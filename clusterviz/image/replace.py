"""Whole files or none: an output appears under its name only once it is complete.

Everything that clusterviz writes (pictures, statistics, movies) goes through `replacing`, so that a full disk, an
exception or ctrl-C leaves neither half a file nor a damaged older one.
"""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from clusterviz.errors import OutputError


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a temporary file in the folder of `path`; when the block ends well, it becomes `path`, else it is removed.

    The temporary name is hidden and keeps the extension, since many writers choose the format by it.

    Raises
    ------
    OutputError
        The file cannot be made, written (any OSError of the block) or renamed.
    """
    target = Path(path)
    temporary = _create(target)
    try:
        yield temporary
        _flush_to_disk(temporary)
        os.replace(temporary, target)
    except OSError as error:
        raise OutputError("cannot be written", where=str(target), found=_reason(error)) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def check_replaceable(path: str | os.PathLike[str]) -> None:
    """Find out before hours of work whether `replacing(path)` could begin: makes and removes a temporary file.

    Raises
    ------
    OutputError
        The folder is missing or not writable, or `path` is a folder.
    """
    with suppress(OSError):
        _create(Path(path)).unlink()


def _create(target: Path) -> Path:
    """An empty new file beside `target`, with the permissions that any new file would get."""
    if target.is_dir():
        raise OutputError("cannot be written", where=str(target), found="a folder", allowed="a file name")
    temporary = target.with_name(f".{target.stem[:100]}.{secrets.token_hex(4)}{target.suffix}")
    try:
        os.close(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
    except OSError as error:
        raise no_place(target, error) from error
    return temporary


def no_place(target: Path, error: OSError) -> OutputError:
    """Why nothing can be made beside `target`."""
    folder = target.parent
    if not folder.exists() and not isinstance(error, NotADirectoryError):
        return OutputError(f"the folder {folder} is missing", where=str(target), allowed="a folder that is there")
    if not folder.is_dir():
        return OutputError(f"{folder} is not a folder", where=str(target), allowed="a file in a folder")
    return OutputError(f"nothing can be made in {folder}", where=str(target), found=_reason(error))


def _flush_to_disk(path: Path) -> None:
    """Wait for the bytes: a quota or a network disk may report only now that it is full."""
    handle = os.open(path, os.O_RDWR)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _reason(error: OSError) -> str:
    return error.strerror or str(error)
