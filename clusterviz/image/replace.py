"""Atomic replacement of output files: an output appears under its name only when it is complete.

All outputs (pictures, statistics, movies) are written through `replacing`, so that a full disk, an exception or ctrl-C
leaves neither part of a file nor a damaged older one. A process that is killed leaves its temporary files. Their names
contain the machine's name, and each is locked while its process lives. The next process that writes into the folder on
that machine removes those that are not locked.
"""

from __future__ import annotations

import fcntl
import os
import re
import secrets
import shutil
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from clusterviz.errors import OutputError

_MARK = f"clusterviz-{re.sub('[^A-Za-z0-9]', '-', socket.gethostname())[:40]}-"
_locks: dict[Path, int] = {}  # descriptors that hold the locks of this process's temporary files and folders
_clean_folders: set[Path] = set()  # folders without leftovers of this machine's killed processes


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Context with a temporary file in the folder of `path`, renamed to `path` on success and removed on failure.

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
        remove_temporary(temporary)


def check_replaceable(path: str | os.PathLike[str]) -> None:
    """Check early that `replacing(path)` can begin, by making and removing a temporary file.

    Raises
    ------
    OutputError
        The folder is missing or not writable, or `path` is a folder.
    """
    remove_temporary(_create(Path(path)))


def temporary_name(target: Path) -> Path:
    """Return a hidden name in the folder of `target`, with its extension; removes the folder's leftovers first."""
    if target.parent not in _clean_folders:
        _clean_folders.add(target.parent)
        remove_leftovers(target.parent)
    return target.with_name(f".{target.stem[:80]}.{_MARK}{secrets.token_hex(4)}{target.suffix}")


def lock_temporary(path: Path) -> bool:
    """Lock a temporary file or folder of this process; return whether it still exists."""
    handle = _locks[path] = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    with suppress(OSError):  # a file system without locks, on which no file counts as a leftover
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    return os.fstat(handle).st_nlink > 0


def remove_temporary(path: Path) -> None:
    """Remove a temporary file or folder of this process, unless it has been renamed, and its lock."""
    _remove(path)
    handle = _locks.pop(path, None)
    if handle is not None:
        os.close(handle)


def remove_temporaries() -> None:
    """Remove all temporary files and folders of this process, at its end."""
    for path in list(_locks):
        remove_temporary(path)


def remove_leftovers(folder: Path) -> list[Path]:
    """Remove temporary files and folders of this user's ended processes on this machine.

    Returns
    -------
    removed : their paths
    """
    removed = []
    for path in folder.glob(f".*.{_MARK}*"):
        with suppress(OSError):
            handle = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
            try:
                if os.fstat(handle).st_uid == os.getuid():
                    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)  # fails while its process lives
                    _remove(path)
                    removed.append(path)
            finally:
                os.close(handle)
    return removed


def _remove(path: Path) -> None:
    with suppress(OSError):
        path.unlink() if not path.is_dir() else shutil.rmtree(path, ignore_errors=True)


def _create(target: Path) -> Path:
    """Create an empty temporary file for `target`, with the permissions of a new file."""
    if target.is_dir():
        raise OutputError("cannot be written", where=str(target), found="a folder", allowed="a file name")
    while True:
        temporary = temporary_name(target)
        try:
            os.close(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
        except OSError as error:
            raise folder_error(target, error) from error
        with suppress(FileNotFoundError):  # removed as a leftover before it was locked
            if lock_temporary(temporary):
                return temporary


def folder_error(target: Path, error: OSError) -> OutputError:
    """Return the error of a target in whose folder no file can be made."""
    folder = target.parent
    if not folder.exists() and not isinstance(error, NotADirectoryError):
        return OutputError(f"the folder {folder} is missing", where=str(target), allowed="a folder that is there")
    if not folder.is_dir():
        return OutputError(f"{folder} is not a folder", where=str(target), allowed="a file in a folder")
    return OutputError(f"nothing can be made in {folder}", where=str(target), found=_reason(error))


def _flush_to_disk(path: Path) -> None:
    """Flush a file to disk; a quota or a network disk may report only now that it is full."""
    handle = os.open(path, os.O_RDWR)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _reason(error: OSError) -> str:
    return error.strerror or str(error)
