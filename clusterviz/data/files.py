"""The first look at a data file, the same for every format: can it be read, is it what its name says?"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from clusterviz.errors import DataError


def require_file(path: Path, magic: tuple[bytes, ...] = ()) -> int:
    """Check that `path` is a readable, non-empty regular file that begins with one of `magic`.

    Returns
    -------
    size : bytes in the file

    Raises
    ------
    DataError
        Missing, a directory, unreadable, empty, or a wrong magic.
    """
    with readable(path):
        descriptor = os.open(path, os.O_RDONLY)
        try:
            status = os.fstat(descriptor)
            if stat.S_ISDIR(status.st_mode):
                raise DataError("a directory, not a data file", where=str(path))
            if not stat.S_ISREG(status.st_mode):
                raise DataError("not a regular file", where=str(path))
            if status.st_size == 0:
                raise DataError("the file is empty", where=str(path))
            start = os.read(descriptor, max((len(m) for m in magic), default=0))
        finally:
            os.close(descriptor)
    if magic and not start.startswith(magic):
        raise DataError("wrong magic: not a file of this format", where=str(path), found=start, allowed=magic)
    return status.st_size


@contextmanager
def readable(path: Path) -> Iterator[None]:
    """Turn what the system says about `path` into a `DataError`."""
    try:
        yield
    except FileNotFoundError as error:
        raise DataError("no such file", where=str(path), allowed=_remedy(path)) from error
    except OSError as error:
        raise DataError(f"the file cannot be read: {error.strerror or error}", where=str(path)) from error


def _remedy(path: Path) -> str | None:
    """What gives a path to the data that the examples name by the sample's name alone."""
    from clusterviz.data.samples import SAMPLES

    name = path.name.split(".")[0]
    return f"-D volumes.0.path=$(clusterviz samples {name})" if name in SAMPLES else None


def refuse_array(array: str | None, path: Path) -> None:
    """For formats whose files hold one unnamed array: naming one is an error."""
    if array is not None:
        raise DataError("no such array", where=str(path), found=array, allowed="none: the file holds one unnamed array")
