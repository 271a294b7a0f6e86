"""How much a command says: results always; reports unless `--quiet`; steps with their times with `--verbose`."""

from __future__ import annotations

from enum import IntEnum


class Verbosity(IntEnum):
    """What `--quiet` and `--verbose` ask for."""

    QUIET = -1
    USUAL = 0
    VERBOSE = 1


_asked = Verbosity.USUAL


def set_verbosity(verbosity: Verbosity) -> None:
    """For the command that runs now."""
    global _asked
    _asked = verbosity


def verbosity() -> Verbosity:
    """Of the command that runs now."""
    return _asked


def say(text: str) -> None:
    """Print a line on stdout that is not the command's result, unless `--quiet`."""
    if _asked > Verbosity.QUIET:
        print(text, flush=True)
