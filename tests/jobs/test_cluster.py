"""Jobs: the same values in one process, on several devices, in threads and on ranks."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
import pytest
from jobs.kernels import smooth

from clusterviz import jobs
from clusterviz.comm import LoopbackChannel, open_channel, run_loopback

SHAPE, BLOCKS = (13, 17, 40), (5, 6, 16)


def program(comm: Any = None, devices: Any = None, schedule: Any = "local") -> tuple[bytes, jobs.Run]:
    """Return the bytes of a smoothed array and of a sum in a fixed order, and the run."""
    with jobs.cluster(comm, devices) as c:
        src, dst = (c.array(SHAPE, np.float32, blocks=BLOCKS) for _ in range(2))

        @jobs.job
        def fill(block: Any) -> None:
            (z0, y0, x0), (z1, y1, x1) = box = src.box(block)
            src.write(box, np.random.default_rng(block).random((z1 - z0, y1 - y0, x1 - x0), np.float32))

        @jobs.job(reads=lambda block: (src, src.box(block, halo=1)), after=lambda block: [(fill, block)])
        def run(block: Any) -> np.float32:
            begin, end = box = dst.box(block)
            first, _ = halo = src.box(block, halo=1)
            given = src.read(halo)
            found = np.empty_like(given)
            smooth[given.shape](given, found, 0.3)
            inside = tuple(slice(b - f, e - f) for b, e, f in zip(begin, end, first, strict=True))
            dst.write(box, found[inside])
            return found[inside].sum()

        c.run(fill, src.blocks, schedule)
        made = c.run_all([(fill, src.blocks), (run, dst.blocks)], schedule)[1]
        total = c.reduce(made, np.add)
        return dst.read(((0, 0, 0), SHAPE)).tobytes() + total.tobytes(), made


@pytest.fixture(scope="module")
def alone() -> bytes:
    """Return what one rank finds, without MPI."""
    return program(LoopbackChannel())[0]


@pytest.mark.parametrize(
    ("ranks", "schedule"), [(2, "local"), (3, "shared"), (3, "static"), (5, "random"), (5, "local"), (7, "local")]
)
def test_threads_find_the_same(ranks: int, schedule: str, alone: bytes) -> None:
    found = run_loopback(ranks, lambda channel: program(channel, schedule=schedule))
    assert {each for each, _ in found} == {alone}
    assert found[0][1].blocks.sum() == 3 * 3 * 3


@pytest.mark.mpi(ranks=[3], timeout=60)
def test_ranks_find_the_same_with_one_device_and_with_two(alone: bytes) -> None:
    channel = open_channel(several_threads=True)
    for devices in (["cpu"], ["cpu", "cpu"]):
        found, run = program(channel, devices)
        assert found == alone
        assert run.blocks.sum() == 3 * 3 * 3


@jobs.task
def part(number: int, src: np.ndarray) -> np.ndarray:
    """Smooth a part of an array."""
    dst = np.zeros_like(src[number])
    smooth[dst.shape](src[number], dst, 0.3)
    return dst


@pytest.mark.parametrize("devices", [["cpu"] * 5, pytest.param(["cpu", 0], marks=pytest.mark.gl)])
@pytest.mark.parametrize("spread", ["one", "all"])
def test_blocks_and_tasks_are_spread_over_devices(devices: Any, spread: Any) -> None:
    src = np.random.default_rng(7).random((6, 3, 5, 20), np.float32)
    threads = set()

    @jobs.job(devices=spread)
    def run(block: int) -> np.ndarray:
        threads.add(threading.get_ident())
        return sum(part[6](src)) * block

    with jobs.cluster(LoopbackChannel(), devices) as c:
        found = c.reduce(c.run(run, 4), np.add)
    np.testing.assert_allclose(found, 6 * sum(part[6](src)), rtol=1e-5)
    assert (threads == {threading.get_ident()}) == (spread == "all")


def test_a_slow_rank_loses_its_blocks() -> None:
    """The first block of rank 0 ends when all others are done, which rank 1 must have stolen."""
    others, started = threading.Semaphore(0), threading.Barrier(2)

    @jobs.job
    def run(block: int) -> None:
        if block in (0, 5):  # the first of each rank
            started.wait(20)
        if block:
            others.release()
        else:
            for _ in range(9):
                assert others.acquire(timeout=20)

    def program(channel: Any) -> jobs.Run:
        with jobs.cluster(channel) as c:
            return c.run(run, 10)

    for found in run_loopback(2, program):
        assert found.blocks.tolist() == [1, 9]
        assert found.stolen.tolist() == [0, 4]


def test_a_slow_device_gets_fewer_blocks() -> None:
    """The first block ends when all others are done, by the other device of the rank."""
    others = threading.Semaphore(0)

    @jobs.job
    def run(block: int) -> int:
        if block:
            others.release()
        else:
            for _ in range(9):
                assert others.acquire(timeout=20)
        return threading.get_ident()

    with jobs.cluster(LoopbackChannel(), ["cpu", "cpu"]) as c:
        threads = c.collect(c.run(run, 10))
    assert threads.count(threads[0]) == 1


def test_blocks_that_read_where_they_lie_fetch_nothing() -> None:
    """Scheduled by what they declare to read, against a random order."""
    together = threading.Barrier(3)  # no rank takes its next block before the others

    def program(channel: Any) -> list[int]:
        with jobs.cluster(channel) as c:
            src = c.array((8, 8, 12), np.float32, blocks=2, distribution="interleaved")

            @jobs.job(reads=lambda block: (src, src.box(block)))
            def run(block: Any) -> None:
                together.wait(20)
                src.read(src.box(block))

            runs = [c.run(run, src.blocks, "local"), c.run(run, src.blocks, "random")]
            return [int(each.bytes_fetched.sum()) for each in runs]

    local, random = run_loopback(3, program)[0]
    assert local == 0
    assert random > 8 * 8 * 12 * 4 // 2
