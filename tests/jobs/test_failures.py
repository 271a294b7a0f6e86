"""A block that fails, a rank that dies and blocks that wait for each other end all ranks, with one message."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jobs.kernels import smooth

from clusterviz import jobs
from clusterviz.comm import LoopbackChannel, run_loopback
from clusterviz.errors import InputError, RankError

PROGRAM = Path(__file__).parent / "failing_program.py"
SECONDS = 30


@pytest.mark.fresh
@pytest.mark.parametrize(
    ("how", "statuses", "messages"),
    [
        ("kernel", [2], ["wrong.glsl:2:22: expected an expression; found )\n"]),
        ("raise", [1], ["clusterviz: rank 1: ValueError: odd\n"]),
        ("exit", [3], ["job run, block 17: SystemExit: 3\n"]),
        ("leave", [1], ["clusterviz: rank 1: SystemExit\n"]),
        ("endless", [1], ["job run, block 17: not done within its 1 s, at "]),
        ("kill", range(1, 256), []),  # mpirun tells of it
    ],
)
def test_all_ranks_end_with_one_message(how: str, statuses: Any, messages: list[str], tmp_path: Path) -> None:
    """Also the ranks that read the blocks of the one that fails, or wait for it."""
    ranks = "3" if how in ("raise", "leave") else "2"  # where the third reads
    command = ["mpirun", "-n", ranks, sys.executable, str(PROGRAM), how, str(tmp_path)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=SECONDS)
    assert ended.returncode in statuses
    assert ended.stderr.count("clusterviz: ") == len(messages)
    assert all(text in ended.stderr for text in messages)
    assert "Traceback" not in ended.stderr


def outcome(channel: Any, job: jobs.Job, schedule: Any) -> str:
    """Return the error of a run on a rank."""
    with pytest.raises((RankError, InputError)) as raised, jobs.cluster(channel) as c:
        c.run(job, 12, schedule)
    return str(raised.value)


@pytest.mark.parametrize("schedule", ["local", "shared", "static"])
def test_every_rank_raises_the_same_error(schedule: str) -> None:
    @jobs.job(after=lambda block: range(block % 4, block, 4))
    def run(block: int) -> None:
        if block in (5, 6):
            raise ValueError(f"odd {block}")

    (text,) = set(run_loopback(3, lambda channel: outcome(channel, run, schedule)))
    assert text.startswith("rank ")
    assert "job run, block 5: ValueError: odd 5" in text or "job run, block 6: ValueError: odd 6" in text


def test_a_write_out_of_a_block_ends_all_ranks_and_frees_their_arrays(monkeypatch: pytest.MonkeyPatch) -> None:
    freed: list[str] = []
    monkeypatch.setattr(jobs.DistributedArray, "free", lambda array: freed.append(array.name))

    def fail(channel: Any) -> None:
        with jobs.cluster(channel) as c:
            dst = c.array((4, 4, 4), np.float32, blocks=2)

            @jobs.job
            def run(block: Any) -> None:
                part = np.zeros((2, 2, 2), np.float32)
                smooth[2, 2, 3 if block == (1, 0, 1) else 2](np.zeros_like(part), part, 0.5)
                dst[dst.box(block)] = part

            c.run(run, dst.blocks)

    def program(channel: Any) -> str:
        with pytest.raises(RankError) as raised:
            fail(channel)
        return str(raised.value)

    (text,) = set(run_loopback(3, program))
    assert "job run, block (1, 0, 1): kernel smooth: wrote outside of the array dst; found" in text
    assert freed == ["array"] * 3


def test_a_job_within_a_block_is_refused() -> None:
    def program(channel: Any) -> str:
        with pytest.raises(RankError) as raised, jobs.cluster(channel) as c:
            c.run(jobs.job(lambda block: c.run(jobs.job(print), 3)), 1)
        return str(raised.value)

    (text,) = set(run_loopback(2, program))
    assert "a block of a job cannot run jobs" in text


@pytest.mark.parametrize(
    ("job", "grid", "said"),
    [
        (jobs.job(after=lambda block: [block + 1])(print), 3, "job print, block 2 waits for a block that is not run"),
        (
            jobs.job(after=lambda block: [(block + 1) % 3])(print),
            3,
            "found print 0 waits for print 1 waits",
        ),
        (jobs.job(reads=lambda block: [3])(print), 3, "no box of a distributed array"),
        (jobs.job(print), (2, -1), "wrong grid of blocks"),
    ],
)
def test_wrong_jobs_are_refused_before_a_block_is_run(job: jobs.Job, grid: Any, said: str) -> None:
    def program(channel: Any) -> str:
        with pytest.raises(InputError) as raised, jobs.cluster(channel) as c:
            c.run(job, grid)
        return str(raised.value)

    (text,) = set(run_loopback(2, program))
    assert said in text


def test_jobs_that_wait_for_each_other_are_named() -> None:
    first = jobs.job(after=lambda block: [(second, block)])(print)
    second = jobs.job(after=lambda block: [(first, block)])(abs)
    text = r"without end; found (print|abs) (\d) waits for (print|abs) \2 waits for"
    with jobs.cluster(LoopbackChannel()) as c, pytest.raises(InputError, match=text):
        c.run_all([(first, 2), (second, 2)])


def test_wrong_devices_are_refused() -> None:
    for devices in (["gpu"], [], "cpu", [99]):
        with pytest.raises(InputError, match="device"), jobs.cluster(devices=devices):  # type: ignore[arg-type]
            pass
