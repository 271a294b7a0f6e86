"""The mark of an error that every rank raises, so that nobody needs to be aborted for it."""

from __future__ import annotations

from clusterviz.errors import ClustervizError

_MARK = "_raised_on_every_rank"


def mark_agreed(error: ClustervizError) -> ClustervizError:
    """Say that every rank raises this very error."""
    setattr(error, _MARK, True)
    return error


def is_agreed(error: BaseException) -> bool:
    """Whether every rank raises this error."""
    return getattr(error, _MARK, False) is True
