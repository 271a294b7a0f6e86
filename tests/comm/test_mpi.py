"""The MPI channel, on real ranks."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from clusterviz.comm import MessageError, agree
from clusterviz.comm.mpi import MpiChannel
from clusterviz.errors import RankError


@pytest.mark.mpi(ranks=[2, 3], timeout=60)
def test_channel_on_real_ranks(mpi_ranks: int) -> None:
    """One start of MPI serves several checks, because starting takes longer than they do."""
    channel = MpiChannel(chunk_bytes=1000)
    assert channel.size == mpi_ranks
    assert not re.search(
        r"/dev/shm/mpich\S*$", Path("/proc/self/maps").read_text(), re.MULTILINE
    )  # named: would be left
    _check_collectives(channel)
    for size in (0, 1, 999, 1000, 1001, 2000, 12_345):
        _check_ring(channel, size)
    _check_agreement(channel)
    for size in (0, 1, 999, 1000, 1001, 2500):
        _check_too_long(channel, size)
    assert channel.wait_some([]) == []
    channel.close()


def _check_collectives(channel: MpiChannel) -> None:
    n = channel.size
    assert channel.allgather(channel.rank) == list(range(n))
    assert channel.gather("a", 1) == (["a"] * n if channel.rank == 1 else None)
    assert channel.broadcast(channel.rank, n - 1) == n - 1
    assert channel.maximum(-channel.rank) == 0
    assert channel.allgather_numbers([channel.rank, -(2**62)]).tolist() == [[rank, -(2**62)] for rank in range(n)]
    assert channel.allgather_numbers([]).shape == (n, 0)
    place = channel.placement()
    assert (place.local_size, place.node, place.nodes) == (n, 0, 1)
    assert sorted(channel.allgather(place.local_rank)) == list(range(n))
    channel.barrier()


def _check_ring(channel: MpiChannel, size: int) -> None:
    """Check messages from each rank to the next, also of whole multiples of a chunk."""
    source, target = (channel.rank - 1) % channel.size, (channel.rank + 1) % channel.size
    buffer = np.zeros(20_000, np.uint8)
    pending = [channel.post_receive(buffer, source, 5)]
    sent = np.random.default_rng(channel.rank).integers(0, 256, size, np.uint8)
    channel.isend(sent, target, 5)
    assert channel.wait_some(pending) == [(0, size)]
    channel.wait_sends()
    assert np.array_equal(buffer[:size], np.random.default_rng(source).integers(0, 256, size, np.uint8))
    assert not buffer[size:].any()


def _check_agreement(channel: MpiChannel) -> None:
    text = "nothing was raised"
    try:
        with agree(channel, 4, "draw"):
            if channel.rank == 1:
                raise OSError("lost")
    except RankError as error:
        text = str(error)
    assert text == "rank 1, frame 4, draw: OSError: lost"


def _check_too_long(channel: MpiChannel, room: int) -> None:
    """Check that a message one byte too long is reported by source and tag, and that others still arrive."""
    if channel.rank == 0:
        channel.isend(np.ones(room + 1, np.uint8), 1, room)
    if channel.rank == 1:
        pending = channel.post_receive(np.zeros(room, np.uint8), 0, room)
        text = f"^a message from rank 0 with tag {room} is longer than the {room} bytes expected$"
        with pytest.raises(MessageError, match=text) as caught:
            channel.wait_some([pending])
        assert caught.value.__suppress_context__
    channel.barrier()
    channel.wait_sends()
