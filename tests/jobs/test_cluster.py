"""Jobs: the same values in one process, on several devices, in threads and on ranks; failures as one message."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from jobs.kernels import smooth

from clusterviz import jobs
from clusterviz.comm import LoopbackChannel, open_channel, run_loopback

GRID = (2, 3, 4)


def program(comm: Any = None, devices: Any = None, schedule: Any = "local") -> tuple[bytes, Any]:
    """Return the bytes of a sum in a fixed order, and the run."""

    @jobs.task
    def part(number: int, block: Any) -> np.ndarray:
        src = np.random.default_rng([number, *block]).random((3, 5, 20), np.float32)
        dst = np.zeros_like(src)
        smooth[src.shape](src, dst, 0.3)
        return dst

    @jobs.job
    def run(block: Any) -> np.ndarray:
        return sum(part[3](block))

    with jobs.cluster(comm, devices) as c:
        found = c.run(run, GRID, schedule)
        return c.reduce(found, np.add).tobytes(), found


@pytest.fixture(scope="module")
def alone() -> bytes:
    """Return what one rank finds, without MPI."""
    return program(LoopbackChannel())[0]


@pytest.mark.parametrize("devices", [["cpu", "cpu"], ["cpu"] * 5])
def test_several_devices_find_the_same(devices: Any, alone: bytes) -> None:
    assert program(devices=devices)[0] == alone


@pytest.mark.parametrize("ranks", [2, 3, 7])
@pytest.mark.parametrize("schedule", ["local", "shared", "static", "random"])
def test_threads_find_the_same(ranks: int, schedule: str, alone: bytes) -> None:
    found = run_loopback(ranks, lambda channel: program(channel, schedule=schedule))
    assert {each for each, _ in found} == {alone}
    assert found[0][1].blocks.sum() == np.prod(GRID)


@pytest.mark.mpi(ranks=[1, 2, 3, 5, 7], timeout=60)
def test_ranks_find_the_same(alone: bytes) -> None:
    found, run = program(open_channel())
    assert found == alone
    assert run.blocks.sum() == np.prod(GRID)
