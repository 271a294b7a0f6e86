"""How an error ends a command: one message, a status, and no rank left waiting.

An error that all ranks raise is printed by one of them. An error that only one rank knows of ends the job, through
`comm.abort_on_failure`, if MPI has been started; launchers say which rank a process is before that.
"""

from __future__ import annotations

import os
import sys
import time
import traceback
from collections.abc import Mapping

from clusterviz.errors import ClustervizError

INTERRUPTED = 130
TELLING_SECONDS = 1.0
RANK_VARIABLES = ("PMI_RANK", "PMIX_RANK", "OMPI_COMM_WORLD_RANK", "PALS_RANKID", "SLURM_PROCID")


def launched_rank(environment: Mapping[str, str] | None = None) -> int | None:
    """Which rank a launcher says this process is; None where there is no launcher."""
    variables = os.environ if environment is None else environment
    return next((int(variables[name]) for name in RANK_VARIABLES if variables.get(name, "").isdigit()), None)


def fail(error: BaseException, debug: bool) -> int:
    """Report an error that ends the command; under MPI, end the other ranks too if they do not know of it.

    Parameters
    ----------
    error : what the command raised
    debug : whether to print the traceback as well

    Returns
    -------
    status : what the process should exit with, where it has not been ended already
    """
    if isinstance(error, BrokenPipeError):
        # The reader of our output has gone: nobody to tell, and the interpreter must not try again at its end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    if "mpi4py.MPI" in sys.modules:
        _end_other_ranks(error, debug)
    if _mine_to_tell(error):
        if debug:
            traceback.print_exception(error)
        print(message(error, debug), file=sys.stderr, flush=True)
    elif isinstance(error, ClustervizError) and not has_met_ranks():
        time.sleep(TELLING_SECONDS)  # a launcher ends the others, rank 0 included, when the first exits with a failure
    if isinstance(error, KeyboardInterrupt):
        return INTERRUPTED
    return error.exit_status if isinstance(error, ClustervizError) else 1


def message(error: BaseException, debug: bool) -> str:
    """What the user reads; our own errors speak for themselves, of others the type is told."""
    if isinstance(error, KeyboardInterrupt):
        return "clusterviz: interrupted"
    if isinstance(error, ClustervizError):
        return f"clusterviz: error: {error}"
    text = " ".join(f"{type(error).__name__}: {error}".split())
    return f"clusterviz: error: {text}" + ("" if debug else "; run with --debug for the traceback")


def _mine_to_tell(error: BaseException) -> bool:
    """Whether this rank prints: our own errors are the same on every rank, a bug may be on this one only."""
    return launched_rank() in (None, 0) or not isinstance(error, (ClustervizError, KeyboardInterrupt))


def has_met_ranks() -> bool:
    """Whether this process has a channel to other ranks, which can end them."""
    if "mpi4py.MPI" not in sys.modules:
        return False
    from clusterviz.comm import opened_channel

    return opened_channel() is not None


def _end_other_ranks(error: BaseException, debug: bool) -> None:
    """End the job, if there are other ranks and they do not raise the same; return otherwise."""
    from clusterviz.comm import abort_on_failure, opened_channel

    channel = opened_channel()
    try:
        if channel:
            with abort_on_failure(channel, debug=debug):
                raise error
    except (Exception, KeyboardInterrupt) as passed:
        if passed is not error:
            raise
