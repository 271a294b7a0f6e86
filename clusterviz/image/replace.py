"""Whole files or none: an output appears under its name only once it is complete.

Everything that clusterviz writes (pictures, statistics, movies) goes through `replacing`, so that a full disk, an
exception or ctrl-C leaves neither half a file nor a damaged older one. A process that is killed leaves its temporary
files. Their names tell the machine, and each is locked while its process lives: the next process that writes into the
folder on that machine removes those that are not.
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
_locks: dict[Path, int] = {}  # of this process's temporary files and folders, the descriptors that hold their locks
_clean_folders: set[Path] = set()  # as far as killed processes of this machine are concerned


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
        remove_temporary(temporary)


def check_replaceable(path: str | os.PathLike[str]) -> None:
    """Find out before hours of work whether `replacing(path)` could begin: makes and removes a temporary file.

    Raises
    ------
    OutputError
        The folder is missing or not writable, or `path` is a folder.
    """
    remove_temporary(_create(Path(path)))


def temporary_name(target: Path) -> Path:
    """A hidden name beside `target`, with its extension; what killed processes left in this folder is removed first."""
    if target.parent not in _clean_folders:
        _clean_folders.add(target.parent)
        remove_leftovers(target.parent)
    return target.with_name(f".{target.stem[:80]}.{_MARK}{secrets.token_hex(4)}{target.suffix}")


def lock_temporary(path: Path) -> bool:
    """Say that this process lives and needs a temporary file or folder; whether it is still there."""
    handle = _locks[path] = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    with suppress(OSError):  # a file system without locks: nobody takes it for a leftover then
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    return os.fstat(handle).st_nlink > 0


def remove_temporary(path: Path) -> None:
    """Remove a temporary file or folder of this process, if it has not become something else."""
    _remove(path)
    handle = _locks.pop(path, None)
    if handle is not None:
        os.close(handle)


def remove_temporaries() -> None:
    """Remove all temporary files and folders of this process, which is about to end."""
    for path in list(_locks):
        remove_temporary(path)


def remove_leftovers(folder: Path) -> list[Path]:
    """Remove temporary files and folders of this user whose processes, on this machine, have ended; which."""
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
    """An empty new file beside `target`, with the permissions that any new file would get."""
    if target.is_dir():
        raise OutputError("cannot be written", where=str(target), found="a folder", allowed="a file name")
    while True:
        temporary = temporary_name(target)
        try:
            os.close(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
        except OSError as error:
            raise no_place(target, error) from error
        with suppress(FileNotFoundError):  # taken for a leftover before it was locked
            if lock_temporary(temporary):
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
