"""The exception tree: every failure that a user can meet is one of these, with one readable message.

A command turns an `InputError` into exit status 2 and any other `ClustervizError` into exit status 1,
prints its text without a traceback, and leaves no half-written output behind.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

MOST_LINES, MOST_LETTERS = 12, 1000
"""How long a message may be, and a line of it; `found` and `allowed` have at most a half of a line each."""


class ClustervizError(Exception):
    """Anything that clusterviz itself reports; `exit_status` is what a command ends with."""

    exit_status = 1
    agreed = False


class InputError(ClustervizError):
    """What the user gave cannot be used.

    Parameters
    ----------
    what : str
        What is wrong, as a short clause: "the file is truncated".
    where : str, optional
        The file, key or option: "head.nrrd", "scene.yaml: quality.step".
    found, allowed : object, optional
        What was there, and what may be there instead.

    Notes
    -----
    Text from a file may be of any length and hold anything: it is cut, and what no terminal should get is escaped.
    """

    exit_status = 2

    def __init__(self, what: str, *, where: str = "", found: object = None, allowed: object = None) -> None:
        what = "\n".join(_cut(line, MOST_LETTERS) for line in what.splitlines()[:MOST_LINES])
        parts = [f"{_cut(where, MOST_LETTERS)}: {what}" if where else what]
        if found is not None:
            parts.append(f"found {_cut(str(found), MOST_LETTERS // 4)}")
        if allowed is not None:
            parts.append(f"allowed {_cut(str(allowed), MOST_LETTERS // 2)}")
        super().__init__("; ".join(parts))


def _cut(text: str, letters: int) -> str:
    """One line of printable text, with its end left out where it is long."""
    text = text if len(text) <= letters else text[: letters - 1] + "…"
    return text if text.isprintable() else "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


@contextmanager
def guard(kind: type[InputError], where: object) -> Iterator[None]:
    """Whatever a reader did not expect, as an error of the user's input that names the file and the cause.

    Parameters
    ----------
    kind : of the error
    where : the file
    """
    try:
        yield
    except ClustervizError:
        raise
    except MemoryError as error:
        raise kind("it takes more memory than there is", where=str(where)) from error
    except RecursionError as error:
        raise kind("nested too deeply", where=str(where)) from error
    except Exception as error:
        cause = " ".join(f"{type(error).__name__}: {error}".split())
        raise kind(f"damaged, or not a file of its kind: {cause}", where=str(where)) from error


class SceneError(InputError):
    """A scene file or an override names an unknown key, a wrong type or an impossible value."""


class DataError(InputError):
    """A data file is missing, damaged, of an unknown format, or not what its header says."""


class OutputError(InputError):
    """The output path cannot be written; nothing is left at it."""


class DeviceError(ClustervizError):
    """No OpenGL context, or one that lacks what the plan needs."""


class RankError(ClustervizError):
    """One rank failed; every rank raises this with the same text: rank, frame, stage and cause."""

    def __init__(self, rank: int, frame: int, stage: str, cause: str, exit_status: int = 1) -> None:
        super().__init__(f"rank {rank}, frame {frame}, {stage}: {cause}")
        self.rank, self.frame, self.stage, self.cause = rank, frame, stage, cause
        self.exit_status = exit_status


def mark_agreed(error: ClustervizError) -> ClustervizError:
    """Say that every rank raises this very error."""
    error.agreed = True
    return error


def is_agreed(error: BaseException) -> bool:
    """Whether every rank raises this error."""
    return isinstance(error, ClustervizError) and error.agreed
