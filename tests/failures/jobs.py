"""Starting whole commands for the tests, and what every failure has in common."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from clusterviz.cli.jobs import OVERSUBSCRIBE, find_mpirun

DRIVER = Path(__file__).parent / "failing_rank.py"
SECONDS = 60
FIELD = "field:marschner-lobb:16"
SMALL = ("--size", "24x18", "-D", "cluster.brick=8")


@dataclass(frozen=True)
class Ended:
    """How a job ended."""

    status: int
    out: str
    err: str


def _hear_signals() -> None:
    """Undo what a shell that runs the tests in its background has children ignore: ctrl-C; nohup, SIGHUP."""
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


def start(ranks: int, *arguments: str, environment: dict[str, str] | None = None) -> subprocess.Popen[str]:
    """Start Python with arguments on some ranks, as leader of a process group."""
    launcher = [find_mpirun(), "-n", str(ranks)] if ranks > 1 else []
    return subprocess.Popen(
        [*launcher, sys.executable, *arguments],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=OVERSUBSCRIBE | os.environ | (environment or {}),
        start_new_session=True,
        preexec_fn=_hear_signals,
    )


def finish(job: subprocess.Popen[str], seconds: float = SECONDS) -> Ended:
    """Wait for its end; one that hangs is killed, with all its ranks: no later test shares the cores with it."""
    try:
        out, err = job.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        for signalled in (signal.SIGTERM, signal.SIGKILL):  # mpirun ends ranks that are not of its process group
            os.killpg(job.pid, signalled)
            time.sleep(1)
        raise
    return Ended(job.returncode, out, err)


def render(ranks: int, *arguments: str, environment: dict[str, str] | None = None) -> Ended:
    """`clusterviz render` on some ranks."""
    return finish(start(ranks, "-m", "clusterviz", "render", *arguments, environment=environment))


def failing(rank: int | str, place: str, how: str, ranks: int, *arguments: str) -> subprocess.Popen[str]:
    """Start a command whose function at `place` fails on one rank; with commas, again for each rank and place."""
    return start(ranks, str(DRIVER), str(rank), place, how, *arguments)


def messages_of(ended: Ended) -> list[str]:
    """The lines that tell of failures; there are no tracebacks among them."""
    assert "Traceback" not in ended.err + ended.out
    return [line for line in ended.err.splitlines() if line.startswith("clusterviz: ")]


def check_failure(ended: Ended, status: int, text: str, folder: Path) -> None:
    """One clear message, the right status, no traceback, and nothing left in the folder."""
    assert ended.status == status, ended.err
    (message,) = messages_of(ended)
    assert text in message
    assert "the picture is" not in ended.out
    assert [path.name for path in folder.iterdir()] == []
