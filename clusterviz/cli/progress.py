"""A progress bar by steps, on a terminal only: logs and pipes stay free of control characters."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TextIO

from clusterviz.cli.failure import launched_rank


@contextmanager
def show_progress(steps: Sequence[str]) -> Iterator[Callable[[str], None]]:
    """Give a function that is told each step as it begins; the bar goes away at the end.

    Parameters
    ----------
    steps : the names of the steps in their order; none, to show nothing
    """
    with ExitStack() as stack:
        terminal = _terminal(stack) if steps else None
        if terminal is None:
            yield lambda step: None
            return
        from rich.console import Console
        from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

        console = Console(file=terminal, force_terminal=True)
        columns = (SpinnerColumn(), BarColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
        bar = stack.enter_context(Progress(*columns, console=console, transient=True))
        # A rank that is killed or aborted never comes back here: it must not leave the terminal without a cursor.
        console.show_cursor(True)
        task = bar.add_task("", total=len(steps))
        yield lambda step: bar.update(task, completed=steps.index(step), description=step)


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
