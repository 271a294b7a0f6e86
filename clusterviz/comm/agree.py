"""How a failure on one rank ends all ranks with one message, never with a hang.

Two kinds of stage need two ways. A stage that works alone (reading, drawing) runs under `agree`: at its end all ranks
ask, with one small reduction, whether anyone failed, and then all raise the same error before the next collective
call. A stage that talks (compositing, gathering) cannot be agreed on half way, since the others wait for messages of
the rank that failed: it runs under `abort_on_failure`, as the whole program does, which ends the job.
"""

from __future__ import annotations

import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager

from clusterviz.comm.agreed import is_agreed, mark_agreed
from clusterviz.comm.channel import Channel
from clusterviz.errors import ClustervizError, RankError

__all__ = ["abort_on_failure", "agree", "describe", "is_agreed", "mark_agreed"]

INTERRUPTED_STATUS = 130


def describe(error: BaseException) -> str:
    """One line for a reader: our own errors speak for themselves, others need their type."""
    if isinstance(error, ClustervizError):
        return str(error)
    return f"{type(error).__name__}: {error}" if str(error) else type(error).__name__


def _status(error: BaseException) -> int:
    return error.exit_status if isinstance(error, ClustervizError) else 1


@contextmanager
def agree(channel: Channel, frame: int, stage: str) -> Iterator[None]:
    """Run a stage that does not communicate; if it raises on one rank, it raises on every rank.

    Where all ranks raise one and the same ClustervizError (a missing file, say), it comes out as it is.

    Raises
    ------
    RankError
        On every rank with the same text: that of the lowest rank that failed. On that rank its cause is chained.
    """
    error: Exception | None = None
    try:
        yield
    except Exception as raised:
        error = raised
    if channel.maximum(error is not None):
        _raise_together(channel, frame, stage, error)


def _raise_together(channel: Channel, frame: int, stage: str, error: Exception | None) -> None:
    """Tell each other what went wrong, and raise the same error everywhere."""
    mine = None if error is None else (isinstance(error, ClustervizError), describe(error), _status(error))
    reports = channel.allgather(mine)
    if isinstance(error, ClustervizError) and all(report == reports[0] for report in reports):
        raise mark_agreed(error)
    rank, report = next((rank, report) for rank, report in enumerate(reports) if report is not None)
    raise mark_agreed(RankError(rank, frame, stage, report[1], report[2])) from (
        error if rank == channel.rank else None
    )


@contextmanager
def abort_on_failure(
    channel: Channel, frame: int | None = None, stage: str = "", debug: bool = False
) -> Iterator[None]:
    """End all ranks when this one fails in a way that the others do not know of.

    Errors that were agreed on pass through, and so does everything where the rank is alone or shares its process. Any
    other error, ctrl-C included, prints one message (a traceback too, with `debug`) and ends the job: with the error's
    exit status, 1 for a bug, or 130 for ctrl-C.
    """
    try:
        yield
    except KeyboardInterrupt:
        if channel.size > 1:
            _abort(channel, "interrupted" if channel.rank == 0 else "", INTERRUPTED_STATUS)
        raise
    except Exception as error:
        if channel.size > 1 and not is_agreed(error):
            if debug:
                traceback.print_exc()
            where = (
                f"rank {channel.rank}" + ("" if frame is None else f", frame {frame}") + (f", {stage}" if stage else "")
            )
            _abort(channel, f"{where}: {describe(error)}", _status(error))
        raise


def _abort(channel: Channel, message: str, status: int) -> None:
    if message:
        print(f"clusterviz: {message}", file=sys.stderr, flush=True)
    channel.abort(status)
