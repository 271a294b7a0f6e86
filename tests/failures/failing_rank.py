"""clusterviz with one function that fails on one rank: failing_rank.py RANK MODULE:NAME HOW ARGUMENTS…

HOW is "raise", "kill" (SIGKILL), "wait" (says so, and waits for ctrl-C), "native" (the same, in a C function, where
Python hears of no signal), "delete" (in a `__del__`, where Python drops what is raised), or "turn" (gives its array the
other way round, and fails by nothing else). All else is the product as it is.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import time
from contextlib import suppress
from functools import partial
from importlib import import_module
from typing import Any, NoReturn

from clusterviz.cli import main as run
from clusterviz.cli.termination import launched_rank


class Waiting:
    """Object whose end waits."""

    def __del__(self) -> None:
        print("waiting", os.getpid(), flush=True)
        time.sleep(60)


def fail(how: str, *_: Any, **__: Any) -> NoReturn:
    """Stands in place of the function."""
    if how == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    if how in ("wait", "native"):
        print("waiting", os.getpid(), flush=True)
    if how == "wait":
        time.sleep(60)
    if how == "delete":
        Waiting()
        with suppress(KeyboardInterrupt):
            time.sleep(60)
        print("interrupted once more", flush=True)
    if how == "native":
        end = time.monotonic() + 60
        while time.monotonic() < end:
            with suppress(KeyboardInterrupt):
                ctypes.CDLL(None).sleep(60)
    raise ValueError("odd")


def turned(function: Any) -> Any:
    """The function, whose array comes out the other way round."""
    return lambda *args, **keys: function(*args, **keys)[::-1].copy()


def main() -> None:
    """Put `fail` in its place, then do what the command line says."""
    rank, place, how = int(sys.argv[1]), sys.argv[2], sys.argv[3]
    if rank == (launched_rank() or 0):
        module, _, name = place.partition(":")
        *owners, last = name.split(".")
        owner: Any = import_module(module)
        for part in owners:
            owner = getattr(owner, part)
        found = getattr(owner, last)  # a name that is not there would fail nowhere
        setattr(owner, last, turned(found) if how == "turn" else partial(fail, how))
    sys.argv[1:] = sys.argv[4:]
    run()


if __name__ == "__main__":
    main()
