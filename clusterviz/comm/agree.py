"""Agreement on errors: a failure of one rank ends all ranks with one message.

A stage without messages (reading, drawing) runs under `agree`. At its end one small reduction tells all ranks whether
any failed, and all raise the same error before the next collective call. A stage with messages (compositing, gathering)
runs under `abort_on_failure`, as the whole program does: the other ranks wait for messages that will not come, so the
job is aborted. So it is, in any stage, by what ends a program: ctrl-C and `sys.exit()`.
"""

from __future__ import annotations

import sys
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from clusterviz.comm.channel import Channel
from clusterviz.errors import ClustervizError, InputError, RankError, is_agreed, known, mark_agreed

__all__ = ["abort_on_failure", "agree", "describe", "is_agreed", "mark_agreed"]

INTERRUPTED_STATUS = 130
RANK_0_SECONDS = 0.9
"""After which another rank says that it was interrupted: ctrl-C reaches all ranks, and rank 0 says it and ends them."""


def describe(error: BaseException) -> str:
    """Return the message of an error in one line, with its type unless it is a ClustervizError or well known."""
    error = known(error) if isinstance(error, Exception) else error
    if not isinstance(error, ClustervizError):
        error = ClustervizError(f"{type(error).__name__}: {error}" if str(error) else type(error).__name__)
    return str(error)


def exit_status_of(error: BaseException) -> int:
    """Return the exit status of a job that an error ends, which is never 0."""
    error = known(error) if isinstance(error, Exception) else error
    found = error.code if isinstance(error, SystemExit) else getattr(error, "exit_status", 1)
    return found if isinstance(found, int) and 0 < found < 256 else 1


@contextmanager
def agree(channel: Channel, frame: int | None, stage: str) -> Iterator[None]:
    """Context of a stage without communication: an error on one rank is raised on every rank.

    If all ranks raise the same ClustervizError (a missing file, for example), it is raised unchanged. A stage may
    communicate within, if an `agree` of its own around all that was done before precedes each exchange.

    Raises RankError on every rank, with the text of the lowest rank that failed. On that rank the cause is
    chained.
    """
    error: Exception | None = None
    try:
        yield
    except Exception as raised:
        if is_agreed(raised):  # within this step, so that no rank is at its end
            raise
        error = known(raised)
    except BaseException as raised:
        _end_all(channel, _place(channel, frame, stage), raised)
        raise
    if channel.maximum(error is not None):
        _raise_together(channel, frame, stage, error)


def _raise_together(channel: Channel, frame: int | None, stage: str, error: Exception | None) -> None:
    mine = None if error is None else (isinstance(error, ClustervizError), describe(error), exit_status_of(error))
    reports = channel.allgather(mine)
    if isinstance(error, ClustervizError) and all(report == reports[0] for report in reports):
        raise mark_agreed(error)
    rank, report = next((rank, report) for rank, report in enumerate(reports) if report is not None)
    raise mark_agreed(RankError(rank, frame, stage, report[1], report[2])) from (
        error if rank == channel.rank else None
    )


@contextmanager
def agreed_errors() -> Iterator[None]:
    """Mark input errors as agreed, in code that every rank runs with the same values."""
    try:
        yield
    except InputError as error:
        raise mark_agreed(error) from None


def check_faults(channel: Channel, fault: str, kind: Callable[[str], ClustervizError]) -> None:
    """Raise the fault of the lowest rank that has one on every rank; collective.

    `fault`: of this rank, as a short clause, or ""; `kind`: makes the error of a text.
    """
    if channel.maximum(bool(fault)):
        faults = channel.allgather(fault)
        raise mark_agreed(kind(next(f"rank {rank}: {text}" for rank, text in enumerate(faults) if text)))


@contextmanager
def abort_on_failure(
    channel: Channel, frame: int | None = None, stage: str = "", debug: bool = False
) -> Iterator[None]:
    """Context that ends all ranks when this rank raises an error that was not agreed on.

    Errors that were agreed on pass through, and so does any error on a channel of one rank. Any other error, ctrl-C and
    `sys.exit()` included, prints one message (with `debug`, a traceback too) and aborts the job with the error's exit
    status: 1 for a bug, 130 for ctrl-C.
    """
    try:
        yield
    except BaseException as error:
        if not is_agreed(error):
            _end_all(channel, _place(channel, frame, stage), error, debug)
        raise


def _place(channel: Channel, frame: int | None, stage: str) -> str:
    return f"rank {channel.rank}" + ("" if frame is None else f", frame {frame}") + (f", {stage}" if stage else "")


def _end_all(channel: Channel, place: str, error: BaseException, debug: bool = False) -> None:
    """End all ranks with one message; do nothing on a channel of one rank."""
    if channel.size == 1:
        return
    if isinstance(error, KeyboardInterrupt):
        if channel.rank > 0:
            time.sleep(RANK_0_SECONDS)
        abort(channel, "interrupted", INTERRUPTED_STATUS)
        return
    if debug:
        traceback.print_exception(error)
    abort(channel, f"{place}: {describe(error)}", exit_status_of(error))


def abort(channel: Channel, message: str, status: int) -> None:
    """Print a message, unless it is empty, and end all ranks."""
    if message:
        with suppress(OSError):  # nobody reads it
            print(f"clusterviz: {message}", file=sys.stderr, flush=True)
    channel.abort(status)
