"""clusterviz with one function that fails on one rank: failing_rank.py RANK MODULE:NAME HOW ARGUMENTS…

HOW is "raise", "kill" (SIGKILL), "wait" (says so, and waits for ctrl-C), or "turn" (gives its array the other way
round, and fails by nothing else). All else is the product as it is.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from importlib import import_module
from typing import Any, NoReturn

from clusterviz.cli import run
from clusterviz.cli.failure import launched_rank


def fail(*_: Any, **__: Any) -> NoReturn:
    """Stands in place of the function."""
    if sys.argv[3] == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    if sys.argv[3] == "wait":
        print("waiting", flush=True)
        time.sleep(60)
    raise ValueError("odd")


def turned(function: Any) -> Any:
    """The function, whose array comes out the other way round."""
    return lambda *args, **keys: function(*args, **keys)[::-1].copy()


def main() -> int:
    """Put `fail` in its place, then do what the command line says."""
    # A shell that runs the tests in its background has them, and their children, ignore ctrl-C.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    rank, place = int(sys.argv[1]), sys.argv[2]
    if rank == (launched_rank() or 0):
        module, _, name = place.partition(":")
        *owners, last = name.split(".")
        owner: Any = import_module(module)
        for part in owners:
            owner = getattr(owner, part)
        found = getattr(owner, last)  # a name that is not there would fail nowhere
        setattr(owner, last, turned(found) if sys.argv[3] == "turn" else fail)
    return run(sys.argv[4:])


if __name__ == "__main__":
    sys.exit(main())
