"""clusterviz with one function that fails on one rank: failing_rank.py RANK MODULE:NAME HOW ARGUMENTS…

Both may be several, with commas: the command runs once for each place, where all ranks outlive its failure.

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
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from functools import partial, reduce
from importlib import import_module
from typing import Any, NoReturn

from clusterviz.cli import main as run_main
from clusterviz.cli import run
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


@contextmanager
def failing(place: str, how: str) -> Iterator[None]:
    """Context in which the function at a place fails."""
    module, _, name = place.partition(":")
    *owners, last = name.split(".")
    owner: Any = reduce(getattr, owners, import_module(module))
    found = getattr(owner, last)  # a name that is not there would fail nowhere
    setattr(owner, last, turned(found) if how == "turn" else partial(fail, how))
    yield
    setattr(owner, last, found)


def main() -> None:
    """Do what the command line says, with `fail` in the function's place."""
    (*former, last), how = zip(sys.argv[1].split(","), sys.argv[2].split(","), strict=True), sys.argv[3]
    sys.argv[1:] = sys.argv[4:]
    own = str(launched_rank() or 0)
    for rank, place in former:
        with failing(place, how) if rank == own else nullcontext():
            run(sys.argv[1:])
    with failing(last[1], how) if last[0] == own else nullcontext():
        run_main()


if __name__ == "__main__":
    main()
