"""Watch over blocks that run for long: a rank says which, and a time limit ends all ranks.

A kernel without end cannot be stopped from Python: machine code and drivers do not look for interrupts. So a thread
of its own watches the blocks of a rank. It names a block that has run for a minute, again after two, four and so on.
Where a block passes the time limit of its job, it ends the processes of all ranks.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
from time import monotonic
from traceback import walk_stack
from types import TracebackType

from clusterviz.comm import Channel
from clusterviz.comm.agree import abort

NOTICE_SECONDS = 60.0
"""How long a block may run before it is named."""
LOOKS_SECONDS = 0.2
BLOCK_FUNCTION = "_run_block"
"""Function of this package that calls that of a job."""
_PACKAGE = str(Path(__file__).parents[1])


@dataclass
class _Running:
    """Block that a thread runs: its name, its time limit, when it began, and the seconds after which it is named."""

    name: str
    limit: float | None
    began: float
    notice: float


class BlockWatch:
    """Context in which the blocks of this rank are watched.

    Parameters
    ----------
    channel : to all ranks
    """

    def __init__(self, channel: Channel) -> None:
        self._channel, self._ended = channel, threading.Event()
        self._running: dict[int, _Running] = {}

    def __enter__(self) -> BlockWatch:
        threading.Thread(target=self._watch, name="blocks", daemon=True).start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._ended.set()

    @contextmanager
    def block(self, name: str, limit: float | None) -> Iterator[None]:
        """Context of a block that this thread runs.

        Parameters
        ----------
        limit : seconds that it may take; None: any
        """
        thread = threading.get_ident()
        self._running[thread] = _Running(name, limit, monotonic(), NOTICE_SECONDS)
        try:
            yield
        finally:
            del self._running[thread]

    def _watch(self) -> None:
        while not self._ended.wait(LOOKS_SECONDS):
            for thread, block in list(self._running.items()):
                seconds, who = monotonic() - block.began, f"rank {self._channel.rank}, {block.name}"
                if block.limit is not None and seconds > block.limit:
                    self._end(f"{who}: not done within its {block.limit:g} s{_line(thread)}")
                if seconds > block.notice:
                    text = f"{who} has run for {seconds:.0f} s{_line(thread)}"
                    print(f"clusterviz: {text}", file=sys.stderr, flush=True)
                    block.notice *= 2

    def _end(self, message: str) -> None:
        """End the processes of all ranks, since no exception would reach the block."""
        abort(self._channel, message, 1)
        os._exit(1)  # the ranks share this process


def _line(thread: int) -> str:
    """Return the line of the block's function, or of what it calls outside of this package, that a thread is in."""
    calls = [(frame.f_code, line) for frame, line in walk_stack(sys._current_frames().get(thread))]
    inner = [*takewhile(lambda call: call[0].co_name != BLOCK_FUNCTION, calls)][::-1]
    own = [*takewhile(lambda call: not call[0].co_filename.startswith(_PACKAGE), inner)]
    return f", at {own[-1][0].co_filename}:{own[-1][1]}" if own else ""
