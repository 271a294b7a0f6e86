"""Exceptions of clusterviz: every failure that a user can meet is one of these, with one readable message.

A command turns an `InputError` into exit status 2 and any other `ClustervizError` into exit status 1, prints its text
without a traceback, and leaves no incomplete output.
"""

from __future__ import annotations

import errno
import json
import os
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

MAX_LINES, MAX_CHARACTERS = 12, 1000
"""Lines of a message and characters of a line, at most; `found` gets a quarter of a line, `allowed` half of one."""
ADDRESS = re.compile(r"[a-z][a-z0-9+.-]*://\S+?(?=[.,:;!)\]}>'\"]*(\s|$))", re.IGNORECASE)
"""Address of a file on a server, in a text; it ends at white space."""
CONTROL = re.compile(r"[\0-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069]")
"""Characters that a terminal obeys instead of showing them, but the ends of lines and tabs."""


def public_address(text: str) -> str:
    """Return an address without what may be secret: user, password and query; any other text as it is."""
    scheme, mark, rest = text.partition("://")
    if not mark or not ADDRESS.match(text):
        return text
    host, slash, path = rest.partition("/")
    return f"{scheme}://{(host.rpartition('@')[2] + slash + path).partition('?')[0]}"


def without_secrets(text: str) -> str:
    """Return a text in which all addresses are as of `public_address`."""
    return ADDRESS.sub(lambda found: public_address(found[0]), text) if "://" in text else text


def escaped(text: str) -> str:
    """Return a text for a terminal, with `CONTROL` characters as \\u001b, which is what they are in JSON too."""
    return CONTROL.sub(lambda found: json.dumps(found[0])[1:-1], text)


class ClustervizError(Exception):
    """Failure that clusterviz reports; its text has no secrets of addresses and no control characters."""

    exit_status = 1  # of the command
    agreed = False  # whether every rank raises this error

    def __init__(self, *values: object) -> None:
        super().__init__(*(escaped(without_secrets(each)) if isinstance(each, str) else each for each in values))


class InputError(ClustervizError):
    """Input that cannot be used.

    Text from files may have any length and content. Long text is cut, and characters that are not printable are
    escaped.

    Parameters
    ----------
    what : what is wrong, as a short clause: "the file is truncated"
    where : the file, key or option: "head.nrrd", "scene.yaml: quality.step"
    found, allowed : what was found, and what is allowed
    """

    exit_status = 2

    def __init__(self, what: str, *, where: str = "", found: object = None, allowed: object = None) -> None:
        what = "\n".join(_cut(line, MAX_CHARACTERS) for line in what.splitlines()[:MAX_LINES])
        parts = [f"{_cut(where, MAX_CHARACTERS)}: {what}" if where else what]
        if found is not None:
            parts.append(f"found {_cut(str(found), MAX_CHARACTERS // 4)}")
        if allowed is not None:
            parts.append(f"allowed {_cut(str(allowed), MAX_CHARACTERS // 2)}")
        super().__init__("; ".join(parts))


def _cut(text: str, characters: int) -> str:
    """Return text as one printable line without secrets, shortened to `characters` characters."""
    text = without_secrets(text)
    text = text if len(text) <= characters else text[: characters - 1] + "…"
    return text if text.isprintable() else "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


DAMAGED = "damaged, or not a file of its kind"
REASONS: tuple[tuple[tuple[type[Exception], ...], str], ...] = (
    ((ImportError,), "needs a package that is not installed"),
    ((NotImplementedError,), "holds what is not supported"),
    ((EOFError,), DAMAGED),
    ((OSError,), "the file cannot be read"),
    ((TypeError, AttributeError, NameError, AssertionError), "damaged, or a fault of the reader"),
)
"""Reasons by the kind of an unexpected error of a reader; others mean that the file is damaged."""


@contextmanager
def guard(kind: type[InputError], where: object) -> Iterator[None]:
    """Context that turns unexpected errors of a reader into errors of the input that name the file and the cause.

    `kind`: class of the error; `where`: the file.
    """
    try:
        yield
    except ClustervizError:
        raise
    except Exception as error:
        what, allowed = _failure_of_machine(error)
        if "allow_pickle" in str(error):  # NumPy's advice to run what a file says
            what = "damaged, or holds objects of Python, which are not read"
        cause = " ".join(f"{type(error).__name__}: {error}".split())
        reason = next((text for types, text in REASONS if isinstance(error, types)), DAMAGED)
        what = what or f"{reason}: {cause}"
        raise kind(what, where=str(where), allowed=allowed) from error


def known(error: Exception) -> Exception:
    """Return a failure of the machine (memory, disk, open files) as an error in one clear line; others as they are."""
    what, allowed = ("", None) if isinstance(error, ClustervizError) else _failure_of_machine(error)
    if not what:
        return error
    file = getattr(error, "filename", None)
    found = InputError(what, where="" if file is None else os.fsdecode(file), allowed=allowed)
    found.__cause__ = error
    return found


def _failure_of_machine(error: Exception) -> tuple[str, str | None]:
    """Return what failed in a clause, and what is allowed; "" of other errors."""
    text = f"{error} {error.__cause__ or error.__context__}".lower()  # llvmlite hides why its library is not loaded
    if isinstance(error, MemoryError) or "cannot allocate memory" in text or "failed to map segment" in text:
        return "it takes more memory than there is", "less data at a time, more ranks, or a larger ulimit -v"
    if isinstance(error, RecursionError):
        return "nested too deeply", None
    if isinstance(error, RuntimeError) and "can't start new thread" in text:
        return "no thread can be started", "fewer threads, or a larger ulimit -u or -v"
    if isinstance(error, OSError) and error.strerror and isinstance(error.errno, int):
        files = "more files: ulimit -n" if error.errno in (errno.EMFILE, errno.ENFILE) else None
        return error.strerror.lower(), files
    return "", None


class SceneError(InputError):
    """Scene file or override with an unknown key, a wrong type or an impossible value."""


class DataError(InputError):
    """Data file that is missing, damaged, of an unknown format, or not as its header says."""


class DataWarning(Warning):
    """Part of a data file that is not used, or not as a user may expect."""


def warn_of_data(what: str, *, where: str, found: object = None, allowed: object = None) -> None:
    """Warn once in a form like that of `InputError`; on the first rank only, where a command runs on several."""
    text = str(DataError(what, where=where, found=found, allowed=allowed))
    warnings.warn(text, DataWarning, stacklevel=2)


class OutputError(InputError):
    """Output path that cannot be written; no file is left there."""


class DeviceError(ClustervizError):
    """Missing OpenGL context, or one that lacks a required feature."""


class FullDeviceError(DeviceError, MemoryError):
    """No memory on a device for a buffer."""


class RankError(ClustervizError):
    """Failure of one rank; every rank raises this with the same text: rank, frame if there is one, stage and cause."""

    def __init__(self, rank: int, frame: int | None, stage: str, cause: str, exit_status: int = 1) -> None:
        super().__init__(f"rank {rank}, {'' if frame is None else f'frame {frame}, '}{stage}: {cause}")
        self.rank, self.frame, self.stage, self.cause = rank, frame, stage, cause
        self.exit_status = exit_status


def installation(extra: str) -> str:
    """Return how the packages of an extra are installed: from a checkout, since no index has clusterviz yet."""
    return f"pip install '.[{extra}]' in a checkout of clusterviz"


def mark_agreed(error: ClustervizError) -> ClustervizError:
    """Mark an error as raised by every rank, and return it."""
    error.agreed = True
    return error


def is_agreed(error: BaseException) -> bool:
    """Return whether every rank raises this error."""
    return isinstance(error, ClustervizError) and error.agreed
