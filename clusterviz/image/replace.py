"""Atomic replacement of output files: an output appears under its name only when it is complete.

All outputs (pictures, statistics, movies) are written through `replacing`, so that a full disk, an exception or ctrl-C
leaves neither part of a file nor a damaged older one. A process that is killed leaves its temporary files. Their names
contain the machine's name, and each is locked while its process lives. The next process that writes into the folder on
that machine removes those that are not locked.

A symbolic link stays, and the file behind it is replaced. A FIFO, a character device and /dev/stdout are written to,
once the output is complete.
"""

from __future__ import annotations

import errno
import fcntl
import os
import re
import secrets
import shutil
import socket
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from clusterviz.errors import OutputError

_MARK = f"clusterviz-{re.sub('[^A-Za-z0-9]', '-', socket.gethostname())[:40]}-"
_locks: dict[Path, int] = {}  # descriptors that hold the locks of this process's temporary files and folders
LONGEST_NAME = 255
"""Bytes of a file's name."""
STREAMS = ("/dev/stdout", "/dev/stderr", "/dev/fd/")
"""Beginnings of names of open files of the process, whatever they are."""
_clean_folders: set[Path] = set()  # folders without leftovers of this machine's killed processes


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Context with a temporary file in the folder of `path`, renamed to `path` on success and removed on failure.

    Of a symbolic link, in the folder of the file behind it; of a stream, in that of temporary files. The temporary name
    is hidden and keeps the extension, since many writers choose the format by it.

    Raises
    ------
    OutputError
        The file cannot be made, written (any OSError of the block) or renamed.
    """
    target = Path(path)
    is_stream, place = _place(target)
    temporary = _create(place)
    try:
        yield temporary
        if is_stream:
            _copy(temporary, target)
        else:
            _flush_to_disk(temporary)
            os.replace(temporary, place)
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
    remove_temporary(_create(_place(Path(path))[1]))


def behind_links(target: Path) -> Path:
    """Return the path of what a symbolic link stands for, there or not; other paths as they are."""
    return Path(os.path.realpath(target)) if os.path.islink(target) else target


def _place(target: Path) -> tuple[bool, Path]:
    """Return whether a target is a stream, which is written to, and the path beside which the temporary file lies."""
    try:
        mode = os.stat(target).st_mode
    except OSError:  # missing, or told when the temporary file is made
        return False, behind_links(target)
    if stat.S_ISFIFO(mode) or stat.S_ISCHR(mode) or str(target).startswith(STREAMS):
        return True, Path(tempfile.gettempdir()) / f"stream{target.suffix}"
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise OutputError("cannot be written", where=str(target), found="a device or a socket", allowed="a file")
    return False, behind_links(target)


def _copy(temporary: Path, target: Path) -> None:
    """Write a complete output into a stream; one that nobody reads is an error, since to open it would wait."""
    try:
        handle = os.open(target, os.O_WRONLY | os.O_NONBLOCK)
    except OSError as error:
        reason = "a FIFO that no process reads" if error.errno == errno.ENXIO else _reason(error)
        raise OutputError("cannot be written", where=str(target), found=reason) from error
    os.set_blocking(handle, True)
    with temporary.open("rb") as source, open(handle, "wb") as stream:
        shutil.copyfileobj(source, stream)


def temporary_name(target: Path) -> Path:
    """Return a hidden name in the folder of `target`, with its extension; removes the folder's leftovers first."""
    if target.parent not in _clean_folders:
        _clean_folders.add(target.parent)
        remove_leftovers(target.parent)
    return target.with_name(f".{target.stem[:30]}.{_MARK}{secrets.token_hex(4)}{target.suffix}")


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
    """Remove temporary files and folders of this user's ended processes on this machine."""
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
    with suppress(OSError):  # a name that is too long is told below
        if target.is_dir():
            raise OutputError("cannot be written", where=str(target), found="a folder", allowed="a file name")
    if len(os.fsencode(target.name)) > LONGEST_NAME:
        found, allowed = f"a name of {len(os.fsencode(target.name))} bytes", f"at most {LONGEST_NAME}"
        raise OutputError("cannot be written", where=str(target), found=found, allowed=allowed)
    while True:
        try:
            temporary = temporary_name(target)
            os.close(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
        except OSError as error:
            raise folder_error(target, error) from error
        with suppress(FileNotFoundError):  # removed as a leftover before it was locked
            if lock_temporary(temporary):
                return temporary


def folder_error(target: Path, error: OSError) -> OutputError:
    """Return the error of a target in whose folder no file can be made."""
    folder = target.parent
    if error.errno == errno.ENAMETOOLONG:
        return OutputError("cannot be written", where=str(target), found=_reason(error))
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
