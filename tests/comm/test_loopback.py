"""The loopback channel."""

from __future__ import annotations

import numpy as np
import pytest

from clusterviz.comm import LoopbackChannel, run_loopback
from clusterviz.comm.channel import MessageError


def test_collective_calls() -> None:
    def run(channel: LoopbackChannel) -> tuple[object, ...]:
        channel.barrier()
        r = channel.rank
        return channel.allgather(r * r), channel.gather(r, 1), channel.broadcast(r, 2), channel.maximum(r)

    assert run_loopback(3, run) == [
        ([0, 1, 4], None, 2, 2),
        ([0, 1, 4], [0, 1, 2], 2, 2),
        ([0, 1, 4], None, 2, 2),
    ]


def test_messages_of_one_source_and_tag_keep_their_order() -> None:
    def run(channel: LoopbackChannel) -> list[int]:
        got = []
        for value in range(5):
            if channel.rank == 0:
                channel.isend(np.array([value], np.int16), 1, 9)
            else:
                buffer = np.zeros(3, np.int16)
                assert channel.wait_some([channel.post_receive(buffer, 0, 9)]) == [(0, 2)]
                got.append(int(buffer[0]))
        channel.wait_sends()
        return got

    assert run_loopback(2, run)[1] == [0, 1, 2, 3, 4]


def test_whatever_has_arrived_is_reported() -> None:
    def run(channel: LoopbackChannel) -> set[int]:
        if channel.rank:
            channel.isend(np.full(channel.rank, channel.rank, np.uint8), 0, 0)
            channel.wait_sends()
            return set()
        buffers = {source: np.zeros(4, np.uint8) for source in (1, 2, 3)}
        waiting = [(source, channel.post_receive(buffer, source, 0)) for source, buffer in buffers.items()]
        sizes = set()
        while waiting:
            done = dict(channel.wait_some([pending for _, pending in waiting]))
            sizes |= {10 * waiting[index][0] + size for index, size in done.items()}
            waiting = [item for index, item in enumerate(waiting) if index not in done]
        return sizes

    assert run_loopback(4, run)[0] == {11, 22, 33}


def test_a_raise_on_one_rank_ends_all_with_that_error() -> None:
    def run(channel: LoopbackChannel) -> None:
        if channel.rank == 2:
            raise KeyError("lost")
        channel.barrier()

    with pytest.raises(KeyError, match="lost"):
        run_loopback(4, run)


def test_a_deadlock_ends_by_time_out() -> None:
    def run(channel: LoopbackChannel) -> None:
        channel.wait_some([channel.post_receive(np.zeros(1, np.uint8), 1 - channel.rank, 0)])

    with pytest.raises(TimeoutError, match="no progress for"):
        run_loopback(2, run, timeout_seconds=0.1)


def test_a_send_that_nobody_receives_ends_by_time_out() -> None:
    def run(channel: LoopbackChannel) -> None:
        channel.isend(np.zeros(1), 1 - channel.rank, 0)
        channel.wait_sends()

    with pytest.raises(TimeoutError, match="waits for its sends"):
        run_loopback(2, run, timeout_seconds=0.1)


def test_a_message_longer_than_its_buffer_is_an_error() -> None:
    def run(channel: LoopbackChannel) -> None:
        if channel.rank:
            channel.isend(np.zeros(9, np.uint8), 0, 0)
        else:
            channel.wait_some([channel.post_receive(np.zeros(8, np.uint8), 1, 0)])

    with pytest.raises(MessageError, match="from rank 1 with tag 0 is longer than the 8 bytes"):
        run_loopback(2, run)


def test_a_buffer_with_gaps_is_refused() -> None:
    with pytest.raises(ValueError, match="contiguous"):
        LoopbackChannel().isend(np.zeros((4, 4))[:, ::2], 0, 0)


def test_one_rank_alone_needs_no_thread_and_no_mpi() -> None:
    channel = LoopbackChannel()
    assert (channel.rank, channel.size) == (0, 1)
    assert channel.allgather("a") == ["a"]
    assert channel.gather("b") == ["b"]
    assert channel.broadcast("c") == "c"
    assert channel.maximum(-3) == -3
    assert channel.placement().local_size == 1
