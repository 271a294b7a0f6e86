"""Shared-memory windows and their synchronisation."""

from __future__ import annotations

import errno
import random
import time

import numpy as np
import pytest

from clusterviz.comm import Channel, LoopbackChannel, WindowError, mpi_window, run_loopback
from clusterviz.comm.mpi import MpiChannel
from clusterviz.comm.placement import RANKS_PER_NODE_VARIABLE
from clusterviz.errors import InputError, is_agreed

ROUNDS = 300


def check_window(channel: Channel, size: int) -> None:
    """Check that every member sees what all members wrote, in every round, with random delays."""
    window = channel.window(size)
    assert channel.rank == window.members[window.index]
    assert window.members in channel.nodes()
    for index in range(len(window.members)):
        part = window.part(index)
        assert part.dtype == np.uint8
        assert part.shape == (size,)
        assert not part.any()
    window.exchange([])
    dawdle = random.Random(channel.rank)
    for step in range(ROUNDS):
        if dawdle.random() < 0.01:
            time.sleep(0.001)
        window.part(window.index)[:] = (step + channel.rank) % 251
        numbers = [step * rank for rank in range(1 + step % 16)]
        numbers[0] = channel.rank
        seen = window.exchange(np.array(numbers, np.int64))
        assert seen[:, 0].tolist() == list(window.members)
        assert (seen[:, 1:] == numbers[1:]).all()
        for index, member in enumerate(window.members):
            assert (window.part(index) == (step + member) % 251).all()
        window.exchange([step])
    window.free()


@pytest.mark.parametrize(("ranks", "ranks_per_node"), [(1, None), (2, None), (5, None), (5, 2), (3, 1)])
@pytest.mark.parametrize("size", [0, 1, 5000])
def test_threads_share_memory(ranks: int, ranks_per_node: int | None, size: int) -> None:
    run_loopback(ranks, lambda channel: check_window(channel, size), ranks_per_node=ranks_per_node)


@pytest.mark.mpi(ranks=[1, 2, 5], timeout=60)
def test_processes_share_memory(mpi_ranks: int) -> None:
    channel = MpiChannel()
    assert channel.nodes() == (tuple(range(mpi_ranks)),)
    for size in (0, 1, 100_000):
        check_window(channel, size)
    check_refusals(channel)
    channel.close()


@pytest.mark.mpi(ranks=5, timeout=60)
def test_processes_share_memory_within_pretended_nodes(mpi_ranks: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(RANKS_PER_NODE_VARIABLE, "2")
    channel = MpiChannel()
    assert channel.nodes() == ((0, 1), (2, 3), (4,))
    assert channel.placement().local_size == mpi_ranks
    check_window(channel, 10)
    channel.close()


@pytest.mark.mpi(ranks=2, timeout=60)
def test_a_wrong_size_of_a_node_is_told_on_every_rank(monkeypatch: pytest.MonkeyPatch) -> None:
    channel = MpiChannel()
    monkeypatch.setenv(RANKS_PER_NODE_VARIABLE, "none" if channel.rank == 0 else "2")
    with pytest.raises(InputError, match="found none"):
        channel.nodes()
    channel.close()


def check_refusals(channel: Channel) -> None:
    """Check that impossible sizes are refused on every rank, and that the channel still works."""
    for size in (-1, -5 if channel.rank else 3) if channel.size > 1 else (-1, -5):
        with pytest.raises(InputError, match="shared window") as caught:
            channel.window(size)
        assert is_agreed(caught.value)
    channel.barrier()


@pytest.mark.parametrize("ranks", [1, 3])
def test_sizes_that_cannot_be_are_refused(ranks: int) -> None:
    run_loopback(ranks, check_refusals)


def test_a_row_holds_sixteen_numbers() -> None:
    window = LoopbackChannel().window(0)
    assert window.exchange(range(16)).tolist() == [list(range(16))]
    with pytest.raises(ValueError, match="17 numbers"):
        window.exchange(range(17))


def test_rows_are_the_callers_own() -> None:
    window = LoopbackChannel().window(0)
    first = window.exchange([7])
    window.exchange([8])
    window.exchange([9])
    assert first.tolist() == [[7]]


def test_a_member_that_never_comes_is_a_time_out() -> None:
    def run(channel: LoopbackChannel) -> None:
        window = channel.window(1)
        if channel.rank:
            window.exchange([1])

    with pytest.raises(TimeoutError, match="waits in a window"):
        run_loopback(3, run, timeout_seconds=0.1)


def test_a_member_that_raises_ends_those_who_wait_in_a_window() -> None:
    def run(channel: LoopbackChannel) -> None:
        window = channel.window(1)
        if channel.rank == 1:
            raise KeyError("lost")
        window.exchange([1])

    with pytest.raises(KeyError, match="lost"):
        run_loopback(3, run)


@pytest.mark.mpi(ranks=3, timeout=60)
def test_memory_that_is_not_there_is_told_on_every_rank(monkeypatch: pytest.MonkeyPatch) -> None:
    channel = MpiChannel()
    with pytest.raises(WindowError, match=r"/dev/shm has \d+ bytes left of .* set cluster.transport to messages"):
        channel.window(1 << 50)

    def touch(window: mpi_window.MpiWindow) -> None:
        if channel.rank == 1:
            raise OSError(errno.EFAULT, "Bad address")

    with monkeypatch.context() as patch:
        patch.setattr(mpi_window.MpiWindow, "touch", touch)
        with pytest.raises(WindowError, match="rank 1: Bad address while 100 bytes"):
            channel.window(100)
    check_window(channel, 100)
    channel.close()
