"""A failing rank ends the job with one message and a non-zero status, while others wait in calls."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

JOB = Path(__file__).parent / "failing_job.py"
SECONDS = 30

pytestmark = pytest.mark.fresh


def _start(how: str, waiting: str = "message", ranks: int = 3) -> subprocess.Popen[str]:
    command = ["mpirun", "-n", str(ranks), sys.executable, str(JOB), how, waiting]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.mark.parametrize(
    ("how", "waiting", "status", "text"),
    [
        ("bad-input", "message", 2, "rank 1, frame 2, read: a.npy: truncated\n"),
        ("raise", "message", 1, "clusterviz: rank 1, frame 2, composite: ValueError: odd\n"),
        ("raise", "window", 1, "clusterviz: rank 1, frame 2, composite: ValueError: odd\n"),
    ],
)
def test_one_rank_raising_ends_the_job(how: str, waiting: str, status: int, text: str) -> None:
    job = _start(how, waiting)
    _, said = job.communicate(timeout=SECONDS)
    assert job.returncode == status
    assert said.count(text) == 1
    assert "Traceback" not in said


@pytest.mark.parametrize(("waiting", "ranks"), [("message", 3), ("window", 5)])
def test_a_killed_rank_ends_the_job(waiting: str, ranks: int) -> None:
    job = _start("kill", waiting, ranks)
    job.communicate(timeout=SECONDS)
    assert job.returncode != 0


@pytest.mark.parametrize("waiting", ["message", "window"])
def test_ctrl_c_ends_a_job_that_waits(waiting: str) -> None:
    job = _start("wait", waiting)
    assert job.stdout is not None
    assert "waiting" in job.stdout.readline()
    job.send_signal(signal.SIGINT)
    _, said = job.communicate(timeout=SECONDS)
    assert job.returncode != 0
    assert said.count("clusterviz: interrupted") <= 1
    assert "Traceback" not in said
