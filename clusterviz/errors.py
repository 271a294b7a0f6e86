"""The exception tree: every failure that a user can meet is one of these, with one readable message.

A command turns an `InputError` into exit status 2 and any other `ClustervizError` into exit status 1,
prints its text without a traceback, and leaves no half-written output behind.
"""

from __future__ import annotations


class ClustervizError(Exception):
    """Anything that clusterviz itself reports; `exit_status` is what a command ends with."""

    exit_status = 1


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
    """

    exit_status = 2

    def __init__(self, what: str, *, where: str = "", found: object = None, allowed: object = None) -> None:
        parts = [f"{where}: {what}" if where else what]
        if found is not None:
            parts.append(f"found {found}")
        if allowed is not None:
            parts.append(f"allowed {allowed}")
        super().__init__("; ".join(parts))


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
