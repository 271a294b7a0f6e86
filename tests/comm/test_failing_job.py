"""A rank that fails ends the whole job: non-zero, soon, with one message."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

JOB = Path(__file__).parent / "failing_job.py"
SECONDS = 10

pytestmark = pytest.mark.fresh


def _start(how: str) -> subprocess.Popen[str]:
    command = ["mpirun", "-n", "3", sys.executable, str(JOB), how]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.mark.parametrize(
    ("how", "status", "text"),
    [
        ("agreed", 1, "rank 1, frame 2, read: ValueError: odd\n"),
        ("bad-input", 2, "rank 1, frame 2, read: a.npy: truncated\n"),
        ("raise", 1, "clusterviz: rank 1, frame 2, composite: ValueError: odd\n"),
    ],
)
def test_one_rank_raising_ends_the_job(how: str, status: int, text: str) -> None:
    job = _start(how)
    _, said = job.communicate(timeout=SECONDS)
    assert job.returncode == status
    assert said.count(text) == 1
    assert "Traceback" not in said


def test_a_killed_rank_ends_the_job() -> None:
    job = _start("kill")
    job.communicate(timeout=SECONDS)
    assert job.returncode != 0


def test_ctrl_c_ends_a_job_that_waits() -> None:
    job = _start("wait")
    assert job.stdout is not None
    assert "waiting" in job.stdout.readline()
    job.send_signal(signal.SIGINT)
    _, said = job.communicate(timeout=SECONDS)
    assert job.returncode != 0
    assert said.count("clusterviz: interrupted") <= 1
    assert "Traceback" not in said
