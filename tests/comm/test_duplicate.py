"""Duplicated channels, and `test_some`."""

from __future__ import annotations

import numpy as np
import pytest

from clusterviz.comm import Channel, ThrottledChannel, run_loopback
from clusterviz.comm.mpi import MpiChannel


def ask(channel: Channel) -> None:
    """Check `test_some` with late and arrived messages, and that sends of one channel do not delay the other."""
    second = channel.duplicate()
    right, left = (channel.rank + 1) % channel.size, (channel.rank - 1) % channel.size
    buffers = [np.zeros(200_000, np.int64) for _ in range(2)]
    pending = [second.post_receive(buffer, left, tag) for tag, buffer in enumerate(buffers)]
    assert second.test_some(pending) == []
    assert second.test_some([]) == []
    channel.barrier()
    second.isend(np.full(200_000, 10 + channel.rank), right, 1)
    channel.isend(np.full(3, -1), right, 1)
    first = np.zeros(3, np.int64)
    channel.wait_some([channel.post_receive(first, left, 1)])
    channel.wait_sends()
    assert (first == -1).all()
    channel.barrier()
    done: list[tuple[int, int]] = []
    while not done:
        done = second.test_some(pending)
    assert done == [(1, 1_600_000)]
    assert (buffers[1] == 10 + left).all()
    assert not buffers[0].any()
    assert second.test_some(pending[:1]) == []
    channel.barrier()
    second.isend(buffers[1], right, 0)
    second.wait_some(pending[:1])
    second.wait_sends()
    second.close()


@pytest.mark.parametrize("ranks", [1, 3])
def test_loopback(ranks: int) -> None:
    run_loopback(ranks, ask)
    run_loopback(ranks, lambda channel: ask(ThrottledChannel(channel, 1e9)))


@pytest.mark.mpi(ranks=[3], timeout=60)
def test_mpi(mpi_ranks: int) -> None:
    channel = MpiChannel(chunk_bytes=500_000)
    assert channel.size == mpi_ranks
    ask(channel)
    channel.close()
