"""The check of every file that is read: a regular one, since opening another may wait for ever."""

from __future__ import annotations

import os
import stat

from clusterviz.errors import InputError

_KINDS = {stat.S_IFIFO: "a FIFO", stat.S_IFCHR: "a device", stat.S_IFBLK: "a device", stat.S_IFSOCK: "a socket"}


def require_regular_file(path: str | os.PathLike[str], kind: type[InputError] = InputError, where: str = "") -> None:
    """Check, before a file is opened, that its name is that of a regular file, of a folder, or of nothing.

    To open a FIFO waits for its writer, and devices have no end. What is missing or a folder is told by what opens it.

    Raises InputError: it is a FIFO, a device or a socket.

    Parameters
    ----------
    kind : class of the error
    where : the name in errors; by default the path
    """
    try:
        found = _KINDS.get(stat.S_IFMT(os.stat(path).st_mode))
    except (OSError, ValueError):
        return
    if found:
        raise kind("not a regular file", where=where or str(path), found=found, allowed="a file on a disk")
