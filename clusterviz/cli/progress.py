"""A progress bar on a terminal, after two seconds: logs and pipes stay free of control characters."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from itertools import accumulate
from pathlib import Path
from threading import Lock, Timer
from time import perf_counter
from typing import TYPE_CHECKING, Any, TextIO

from clusterviz.cli.failure import launched_rank
from clusterviz.cli.verbosity import Verbosity, verbosity

if TYPE_CHECKING:
    from clusterviz.frame import Progress

DELAY_SECONDS = 2.0
"""What is done sooner shows no bar."""


@contextmanager
def show_progress(steps: Sequence[str], weights: Sequence[float] = (), *, one: bool = False) -> Iterator[Progress]:
    """Give a function that is told each step as it begins, and how much of it is done; the bar goes away at the end.

    With `--verbose` each step is a line on stderr instead; with `--quiet` nothing is shown.

    Parameters
    ----------
    steps : the names of the steps in their order; none, to show nothing
    weights : how long each takes, in any unit; by default all take equally long
    one : the bar is that of one step at a time, not of all
    """
    with ExitStack() as stack:
        if steps and verbosity() is Verbosity.VERBOSE:
            yield _Lines()
            return
        terminal = _terminal(stack) if steps and verbosity() is Verbosity.USUAL else None
        if terminal is None:
            yield lambda step, done=0.0: None
            return
        bar = _Bar(terminal, steps, [] if one else weights or [1.0] * len(steps))
        stack.callback(bar.close)
        yield bar


def announce_compiling() -> None:
    """Say on a terminal, or with `--verbose`, that a kernel is being compiled: it takes seconds, and only once."""
    from clusterviz.kernels import objects

    told: list[str] = []

    def tell(name: str) -> None:
        with ExitStack() as stack:
            terminal = sys.stderr if verbosity() is Verbosity.VERBOSE else _terminal(stack)
            if terminal is not None and not told and verbosity() is not Verbosity.QUIET:
                text = "compiling kernels for this processor, once (`clusterviz prepare` does it ahead)"
                print(f"clusterviz: {text}", file=terminal, flush=True)
            told.append(name)

    objects.on_compiling = tell


class _Lines:
    """Each step as a line with the seconds since the first."""

    def __init__(self) -> None:
        self._began, self._last = perf_counter(), ""

    def __call__(self, step: str, done: float = 0.0) -> None:
        if step != self._last:
            print(f"{perf_counter() - self._began:8.3f} s  {step}", file=sys.stderr, flush=True)
        self._last = step


class _Bar:
    """A bar that appears late.

    Parameters
    ----------
    weights : of the steps; none, where the bar is that of one step at a time
    """

    def __init__(self, terminal: TextIO, steps: Sequence[str], weights: Sequence[float]) -> None:
        self._terminal, self._total = terminal, sum(weights)
        self._places = dict(zip(steps, zip(accumulate(weights, initial=0.0), weights, strict=False), strict=False))
        self._now: tuple[str, float] = "", 0.0
        self._lock, self._bar, self._task, self._shown = Lock(), None, None, ""
        self._closed = False
        self._timer = Timer(DELAY_SECONDS, self._appear)
        self._timer.daemon = True
        self._timer.start()

    def __call__(self, step: str, done: float = 0.0) -> None:
        with self._lock:
            self._now = step, done
            self._update()

    def close(self) -> None:
        """Take the bar away."""
        self._timer.cancel()
        with self._lock:
            self._closed = True
            if self._bar is not None:
                self._bar.stop()

    def _appear(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

        with self._lock:
            if self._closed:
                return
            console = Console(file=self._terminal, force_terminal=True)
            columns = [SpinnerColumn(), BarColumn(), TextColumn("{task.description}", markup=False)]
            columns += [TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn()]
            # The time that is left is told by all that was done, not by the last seconds.
            bar: Any = Progress(*columns, console=console, transient=True, speed_estimate_period=1e9)
            bar.start()
            # A rank that is killed or aborted never comes back here: it must not leave the terminal without a cursor.
            console.show_cursor(True)
            self._bar, self._task = bar, bar.add_task("", total=self._total or None)
            self._update()

    def _update(self) -> None:
        (step, done), bar = self._now, self._bar
        if bar is None:
            return
        if self._places:
            begin, weight = self._places[step]
            bar.update(self._task, completed=begin + done * weight, description=step)
            return
        if step != self._shown:
            bar.reset(self._task, total=None, description=step)
        self._shown = step
        if done:
            bar.update(self._task, total=1.0, completed=done)


def _terminal(stack: ExitStack) -> TextIO | None:
    """Where the user looks, if that is a terminal. Under mpirun stderr is a pipe, whose other end a parent holds."""
    if sys.stderr.isatty():
        return sys.stderr
    if launched_rank() is None:
        return None
    try:
        return stack.enter_context(open(_terminal_of_launcher(), "w"))
    except (OSError, ValueError):
        return None


def _terminal_of_launcher() -> str:
    """The terminal on which the nearest parent whose stderr is no pipe writes; Linux tells, others raise OSError."""
    pid = os.getppid()
    while pid > 1:
        place = os.readlink(f"/proc/{pid}/fd/2")
        if not place.startswith("pipe:"):
            if place.startswith(("/dev/pts/", "/dev/tty")):
                return place
            break
        pid = int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
    raise OSError("the launcher writes to no terminal")
