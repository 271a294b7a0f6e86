"""A composition that goes wrong half way ends on every rank with one message that names the stage."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from clusterviz.comm import LoopbackChannel, run_loopback
from clusterviz.comm.channel import Buffer
from clusterviz.composite import Compositor
from clusterviz.composite.messages import ExchangeError

JOB = Path(__file__).parent / "exchange_job.py"
SECONDS = 40


def _run(*arguments: str, ranks: int) -> tuple[int, str]:
    command = ["mpirun", "-n", str(ranks), sys.executable, str(JOB), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=SECONDS)
    return done.returncode, done.stderr


@pytest.mark.fresh
@pytest.mark.parametrize(
    ("how", "algorithm", "stage", "ranks", "text"),
    [
        ("raise", "parallel-pipeline", 1, 5, "rank 1, frame 0, composite: stage 2 of 4: no more"),
        ("corrupt", "direct-send", 0, 3, r"rank \d, frame 0, composite: stage 1 of 1: message from rank 1: .*"),
        ("truncate", "direct-send", 0, 3, r"rank \d, frame 0, composite: stage 1 of 1: message from rank 1: .*"),
    ],
)
def test_a_failing_rank_ends_the_rest_with_one_message(
    how: str, algorithm: str, stage: int, ranks: int, text: str
) -> None:
    status, said = _run(how, algorithm, str(stage), ranks=ranks)
    assert status == 1
    lines = [line for line in said.splitlines() if line.startswith("clusterviz: ")]
    # Several ranks may find the damage of one before the first of them has ended the job.
    assert lines
    assert all(re.fullmatch(f"clusterviz: {text}", line) for line in lines)
    assert len(lines) == 1 or how in ("corrupt", "truncate")
    assert "Traceback" not in said


@pytest.mark.fresh
def test_a_rank_killed_in_the_exchange_ends_the_job() -> None:
    status, said = _run("kill", "direct-send", "0", ranks=3)
    assert status != 0
    assert "Traceback" not in said


class _Damaging(LoopbackChannel):
    """Rank 1's messages arrive with one byte changed, or too short."""

    change: int
    length: int | None

    def isend(self, buffer: Buffer, target: int, tag: int) -> None:
        data = buffer.reshape(-1).view(np.uint8).copy()
        if self.rank == 1:
            data[self.change % data.size] ^= 0x55
            data = data[: self.length]
        super().isend(data, target, tag)


@pytest.mark.parametrize("codec", ["active", "active+lz4", "rectangle", "shuffle+lz4"])
def test_a_damaged_message_never_crashes(codec: str) -> None:
    for change, length in ((0, None), (1, None), (5, None), (9, None), (14, None), (0, 1), (0, 9)):
        check_damaged(codec, change, length)


def check_damaged(codec: str, change: int, length: int | None) -> None:
    image = np.zeros((16, 16, 4), np.float32)
    image[3:6, 2:9] = np.linspace(0, 1, 7, dtype=np.float32)[:, None]

    def run(channel: LoopbackChannel) -> None:
        channel.__class__ = type("Damaging", (_Damaging,), {"change": change, "length": length})
        compositor = Compositor(channel, (16, 16), algorithm="serial", codec=codec, transport="messages")
        compositor.composite(image, [0, 1])

    # Where the damage only meets pixels there is a picture, with one of them wrong.
    try:
        run_loopback(2, run)
    except ExchangeError as error:
        told = str(error)
    else:
        told = ""
    assert re.fullmatch("(stage 1 of 1: message from rank 1: .+)?", told)
