"""Command termination: error messages, exit statuses and signals.

An error that all ranks raise is printed by one of them. An error of a single rank ends the job through
`comm.abort_on_failure` once MPI has been started; before that, the launcher's environment gives the rank.

Ctrl-C, SIGTERM and SIGHUP raise KeyboardInterrupt in the main thread between two bytecodes. A kernel or library may
delay that for minutes, or drop the exception, so a thread woken by every signal ends the process after a grace period.
Within that it interrupts once more where Python itself has dropped the exception, in a `__del__` for example.
Where one rank alone is interrupted, that one says so: ranks other than 0 wait, so that rank 0 can end them.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Mapping
from contextlib import suppress
from typing import NoReturn

from clusterviz.errors import ClustervizError, known, without_secrets

INTERRUPTED = 130
REPORT_GRACE_SECONDS = 1.0
RANK_VARIABLES = ("PMI_RANK", "PMIX_RANK", "OMPI_COMM_WORLD_RANK", "PALS_RANKID", "SLURM_PROCID")


def launched_rank(environment: Mapping[str, str] | None = None) -> int | None:
    """Return the rank of this process from the launcher's environment; None without a launcher."""
    variables = os.environ if environment is None else environment
    return next((int(variables[name]) for name in RANK_VARIABLES if variables.get(name, "").isdigit()), None)


def fail(error: BaseException, debug: bool) -> int:
    """Report an error that ends the command; an error of a single rank ends the MPI job.

    `debug`: whether to print the traceback.
    """
    if _signalled and not isinstance(error, KeyboardInterrupt):  # which Python or a library has wrapped
        error = KeyboardInterrupt()
    if isinstance(error, OSError):
        _leave_stdout()
    if isinstance(error, BrokenPipeError):
        return 1
    error = known(error) if isinstance(error, Exception) else error
    if "mpi4py.MPI" in sys.modules:
        _abort_other_ranks(error, debug)
    if not _should_print(error) and not has_channel():
        time.sleep(REPORT_GRACE_SECONDS)  # the launcher ends all ranks, also rank 0, when one fails
    if _should_print(error) or isinstance(error, KeyboardInterrupt):  # rank 0 was not interrupted
        with suppress(OSError):  # nobody reads it
            if debug:
                traceback.print_exception(error)
            print(error_message(error, debug), file=sys.stderr, flush=True)
    if isinstance(error, KeyboardInterrupt):
        return INTERRUPTED
    return error.exit_status if isinstance(error, ClustervizError) else 1


def _leave_stdout() -> None:
    """Drop what stdout could not write, or the interpreter would fail to write it at its end."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def error_message(error: BaseException, debug: bool) -> str:
    """Return the error message for the user; errors of other libraries include their type."""
    if isinstance(error, KeyboardInterrupt):
        return "clusterviz: interrupted"
    if isinstance(error, ClustervizError):
        return f"clusterviz: error: {error}"
    text = " ".join(without_secrets(f"{type(error).__name__}: {error}").split())
    return f"clusterviz: error: {text}" + ("" if debug else "; run with --debug for the traceback")


def _should_print(error: BaseException) -> bool:
    """Return whether this rank prints an error: rank 0, or any rank for errors that others may not have."""
    return launched_rank() in (None, 0) or not isinstance(error, (ClustervizError, KeyboardInterrupt))


def has_channel() -> bool:
    """Return whether this process has opened an MPI channel, through which it can end other ranks."""
    if "mpi4py.MPI" not in sys.modules:
        return False
    from clusterviz.comm import opened_channel

    return opened_channel() is not None


def _abort_other_ranks(error: BaseException, debug: bool) -> None:
    """End the job if there are other ranks that do not raise the same error."""
    from clusterviz.comm import abort_on_failure, opened_channel

    channel = opened_channel()
    try:
        if channel:
            with abort_on_failure(channel, debug=debug):
                raise error
    except BaseException as passed:
        if passed is not error:
            raise


GRACE_SECONDS, RETRY_SECONDS = 0.7, 0.01
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_signalled: list[int] = []
_dropped = threading.Event()


def end_on_signals() -> None:
    """Install handlers that end the process on `SIGNALS`, except ignored ones; call it in the main thread."""
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    for number in SIGNALS:
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _interrupt)
    sys.unraisablehook = _note_dropped
    threading.Thread(target=_watch, args=(reader,), name="signals", daemon=True).start()


def end_process(status: int) -> NoReturn:
    """End this process at once, without waiting for threads; temporary files and MPI's shared memory are removed.

    Under a launcher the process kills itself: Hydra ends a job when a process is killed, but not when one exits before
    MPI_Init.
    """
    # Not imported here: the main thread may hold the lock.
    for name, function in (("image.replace", "remove_temporaries"), ("comm.mpi", "unlink_segments")):
        remove = getattr(sys.modules.get(f"clusterviz.{name}"), function, None)
        if remove:
            remove()
    # SLURM_PROCID is also set in batch scripts, and srun ends a step when one of its processes fails.
    if launched_rank({name: value for name, value in os.environ.items() if name != "SLURM_PROCID"}) is not None:
        os.kill(os.getpid(), signal.SIGKILL)
    os._exit(status)


def _interrupt(number: int, _: object) -> None:
    # The terminal and the launcher may both send a signal for one ctrl-C; only the first is handled.
    for each in SIGNALS:
        signal.signal(each, signal.SIG_IGN)
    _signalled.append(number)
    raise KeyboardInterrupt


def _note_dropped(unraisable: sys.UnraisableHookArgs) -> None:
    """Have the main thread interrupted once more, where Python cannot pass the exception on."""
    if not isinstance(unraisable.exc_value, KeyboardInterrupt):
        sys.__unraisablehook__(unraisable)
        return
    signal.signal(signal.SIGINT, _interrupt)
    _dropped.set()


def _watch(reader: int) -> None:
    while os.read(reader, 1)[0] not in SIGNALS:
        pass
    ends = time.monotonic() + GRACE_SECONDS + ((launched_rank() or 0) > 0) * REPORT_GRACE_SECONDS
    while _dropped.wait(max(0.0, ends - time.monotonic())):
        _dropped.clear()
        time.sleep(RETRY_SECONDS)  # the main thread leaves what has dropped it
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
    with suppress(OSError):
        os.write(2, (error_message(KeyboardInterrupt(), debug=False) + "\n").encode())  # no lock of another thread's
    end_process(INTERRUPTED)
