"""How a signal ends a command: within a second, whatever its threads do, with no temporary file left.

Ctrl-C, SIGTERM and SIGHUP raise KeyboardInterrupt in the main thread. Python does so between two bytecodes: not while a
kernel or a library computes, maybe for minutes, and in vain where a library drops exceptions. So a thread that every
signal wakes ends the process after a grace period.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from typing import NoReturn

from clusterviz.cli.failure import INTERRUPTED, launched_rank, message

GRACE_SECONDS = 0.7
ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def end_on_signals() -> None:
    """Have these signals end the process; those that it was started to ignore stay ignored. For the main thread."""
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    for number in ENDING:
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _interrupt)
    threading.Thread(target=_watch, args=(reader,), name="signals", daemon=True).start()


def end_process(status: int) -> NoReturn:
    """End this process now: no thread is waited for, and temporary files are removed.

    Under a launcher it is killed: Hydra ends a job when a process is killed, but lets the others wait for ever where
    one exits before it has called MPI_Init.
    """
    replace = sys.modules.get("clusterviz.image.replace")  # not imported here: the main thread may hold the lock
    remove = getattr(replace, "remove_temporaries", None)
    if remove:
        remove()
    # Slurm's variable stands in batch scripts too, and srun ends a step when a process of it exits with a failure.
    if launched_rank({name: value for name, value in os.environ.items() if name != "SLURM_PROCID"}) is not None:
        os.kill(os.getpid(), signal.SIGKILL)
    os._exit(status)


def _interrupt(number: int, _: object) -> None:
    # A terminal and the launcher may both tell of one ctrl-C: the second must not break what the first began.
    for each in ENDING:
        signal.signal(each, signal.SIG_IGN)
    raise KeyboardInterrupt


def _watch(reader: int) -> None:
    while os.read(reader, 1)[0] not in ENDING:
        pass
    time.sleep(GRACE_SECONDS)
    if (launched_rank() or 0) == 0:
        os.write(2, (message(KeyboardInterrupt(), debug=False) + "\n").encode())  # no lock of another thread's
    end_process(INTERRUPTED)
