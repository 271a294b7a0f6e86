"""Console output: escaping of control characters, verbosity, and a progress bar on terminals.

All that a command prints passes through `escaped_output`, so that no text of a file, of a picture's record or of a
server reaches the terminal as a command to it. The library that draws tables and bars writes to the streams below. The
bar appears after two seconds, and only on a terminal, so that logs and pipes hold no control characters.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from enum import IntEnum
from io import TextIOWrapper
from itertools import accumulate
from pathlib import Path
from threading import Lock, Timer
from time import perf_counter
from typing import TYPE_CHECKING, Any, TextIO, cast

from clusterviz.cli.termination import launched_rank
from clusterviz.errors import escaped

if TYPE_CHECKING:
    from clusterviz.frame import Progress


class Verbosity(IntEnum):
    """Verbosity by `--quiet` and `--verbose`."""

    QUIET = -1
    NORMAL = 0
    VERBOSE = 1


_current = Verbosity.NORMAL


def set_verbosity(verbosity: Verbosity) -> None:
    """Set the verbosity of the current command."""
    global _current
    _current = verbosity


def verbosity() -> Verbosity:
    """Return the verbosity of the current command."""
    return _current


class _EscapedStream:
    """Text stream that escapes control characters on their way to another one."""

    def __init__(self, stream: TextIO) -> None:
        self.rich_proxied_file = stream  # rich writes there: its colours are control characters

    def write(self, text: str) -> int:
        return self.rich_proxied_file.write(escaped(text))

    def writelines(self, lines: Iterable[str]) -> None:
        self.rich_proxied_file.writelines(map(escaped, lines))

    def __getattr__(self, name: str) -> Any:
        return getattr(self.rich_proxied_file, name)


@contextmanager
def escaped_output() -> Iterator[None]:
    """Context in which control characters are escaped on stdout and stderr, see `errors.escaped`."""
    streams = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (each and cast(TextIO, _EscapedStream(each)) for each in streams)  # None if it is closed
    try:
        yield
    finally:
        sys.stdout, sys.stderr = streams


def print_info(text: str) -> None:
    """Print a line on stdout that is not the command's result; with `--quiet`, nothing."""
    if _current > Verbosity.QUIET:
        print(text, flush=True)


def print_document(text: str) -> None:
    """Print a document for programs: UTF-8 whatever the encoding of the terminal is, control characters escaped."""
    sys.stdout.flush()
    sys.stdout.buffer.write(escaped(text).encode("utf-8", "surrogateescape"))
    sys.stdout.flush()


def prepare_streams() -> None:
    """Let closed standard streams lead nowhere, and escape characters that the encoding of others lacks."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:  # else the next file that is opened would get the messages
            os.open(os.devnull, os.O_RDWR)
    sys.stdout = sys.stdout or os.fdopen(1, "w", closefd=False)
    sys.stderr = sys.stderr or os.fdopen(2, "w", closefd=False)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


DELAY_SECONDS = 2.0
"""Delay before the bar appears."""


@contextmanager
def show_progress(steps: Sequence[str], weights: Sequence[float] = (), *, per_step: bool = False) -> Iterator[Progress]:
    """Yield a function that reports the current step and its completed share; the bar is removed at the end.

    With `--verbose` each step is a line on stderr instead; with `--quiet` nothing is shown.

    `steps`: the names of the steps in order; nothing is shown without steps. `weights`: relative durations of the
    steps; equal by default. `per_step`: whether the bar shows one step at a time instead of all.
    """
    with ExitStack() as stack:
        if steps and verbosity() is Verbosity.VERBOSE:
            yield _StepLines()
            return
        terminal = _open_terminal(stack) if steps and verbosity() is Verbosity.NORMAL else None
        if terminal is None:
            yield lambda step, done=0.0: None
            return
        bar = _Bar(terminal, steps, [] if per_step else weights or [1.0] * len(steps))
        stack.callback(bar.close)
        yield bar


def announce_compilation() -> None:
    """Install a callback that reports the first compilation of a kernel, on a terminal or with `--verbose`."""
    from clusterviz.kernels import objects

    announced: list[str] = []

    def announce(name: str) -> None:
        with ExitStack() as stack:
            terminal = sys.stderr if verbosity() is Verbosity.VERBOSE else _open_terminal(stack)
            if terminal is not None and not announced and verbosity() is not Verbosity.QUIET:
                text = "compiling kernels for this CPU, once (`clusterviz prepare` does it ahead)"
                print(f"clusterviz: {text}", file=terminal, flush=True)
            announced.append(name)

    objects.on_compiling = announce


class _StepLines:
    """Progress as one line for each step, with the seconds since the first."""

    def __init__(self) -> None:
        self._began, self._last = perf_counter(), ""

    def __call__(self, step: str, done: float = 0.0) -> None:
        if step != self._last:
            print(f"{perf_counter() - self._began:8.3f} s  {step}", file=sys.stderr, flush=True)
        self._last = step


class _Bar:
    """Progress bar that appears after a delay.

    `weights`: relative durations of the steps; empty for a bar of one step at a time.
    """

    def __init__(self, terminal: TextIO, steps: Sequence[str], weights: Sequence[float]) -> None:
        self._open_terminal, self._total = terminal, sum(weights)
        self._intervals = dict(zip(steps, zip(accumulate(weights, initial=0.0), weights, strict=False), strict=False))
        self._state: tuple[str, float] = "", 0.0
        self._lock, self._bar, self._task, self._shown = Lock(), None, None, ""
        self._closed = False
        self._timer = Timer(DELAY_SECONDS, self._appear)
        self._timer.daemon = True
        self._timer.start()

    def __call__(self, step: str, done: float = 0.0) -> None:
        with self._lock:
            self._state = step, done
            self._update()

    def close(self) -> None:
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
            console = Console(file=self._open_terminal, force_terminal=True)
            columns = [SpinnerColumn(), BarColumn(), TextColumn("{task.description}", markup=False)]
            columns += [TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn()]
            # Estimate the remaining time from all steps done, not from the last seconds.
            bar: Any = Progress(*columns, console=console, transient=True, speed_estimate_period=1e9)
            bar.start()
            # A rank that is killed cannot restore the cursor, so it stays visible.
            console.show_cursor(True)
            self._bar, self._task = bar, bar.add_task("", total=self._total or None)
            self._update()

    def _update(self) -> None:
        (step, done), bar = self._state, self._bar
        if bar is None:
            return
        if self._intervals:
            begin, weight = self._intervals[step]
            bar.update(self._task, completed=begin + done * weight, description=step)
            return
        if step != self._shown:
            bar.reset(self._task, total=None, description=step)
        self._shown = step
        if done:
            bar.update(self._task, total=1.0, completed=done)


def _open_terminal(stack: ExitStack) -> TextIO | None:
    """Return stderr if it is a terminal, else the launcher's terminal under mpirun, else None."""
    if sys.stderr.isatty():
        return sys.stderr
    if launched_rank() is None:
        return None
    try:
        return stack.enter_context(open(_launcher_terminal(), "w"))
    except (OSError, ValueError):
        return None


def _launcher_terminal() -> str:
    """Return the terminal of the nearest parent process whose stderr is not a pipe; raise OSError if there is none."""
    pid = os.getppid()
    while pid > 1:
        place = os.readlink(f"/proc/{pid}/fd/2")
        if not place.startswith("pipe:"):
            if place.startswith(("/dev/pts/", "/dev/tty")):
                return place
            break
        pid = int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
    raise OSError("the launcher writes to no terminal")
