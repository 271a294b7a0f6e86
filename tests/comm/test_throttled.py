"""The simulated slow link, with a clock that the tests advance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from clusterviz.comm import Channel, LoopbackChannel, ThrottledChannel, run_loopback
from clusterviz.comm.channel import Pending
from clusterviz.errors import InputError


class Clock:
    """Time that passes only by sleep and work."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


def throttled(channel: Channel, clock: Clock, latency_seconds: float = 0.0) -> ThrottledChannel:
    return ThrottledChannel(channel, 1000.0, latency_seconds, clock=clock, sleep=clock.sleep)


def receive(channel: ThrottledChannel, clock: Clock, sizes: Sequence[int], work: float = 0.0) -> list[float]:
    """Return when each message from rank 0 was reported, with some work after each report."""
    waiting = {tag: channel.post_receive(np.zeros(10_000, np.uint8), 0, tag) for tag in range(len(sizes))}
    times = [0.0] * len(sizes)
    while waiting:
        tags = list(waiting)
        for index, size in channel.wait_some([waiting[tag] for tag in tags]):
            assert size == sizes[tags[index]]
            times[tags[index]] = clock.now - 100
            del waiting[tags[index]]
        clock.sleep(work)
    return times


def times_of(sizes: Sequence[int], latency_seconds: float = 0.0, work: float = 0.0) -> list[float]:
    """Return the times for messages that rank 0 sends before rank 1 polls."""

    def run(channel: LoopbackChannel) -> list[float]:
        clock = Clock()
        slow = throttled(channel, clock, latency_seconds)
        if slow.rank == 0:
            for tag, size in enumerate(sizes):
                slow.isend(np.zeros(size, np.uint8), 1, tag)
        slow.barrier()
        times = receive(slow, clock, sizes, work) if slow.rank == 1 else []
        slow.wait_sends()
        return times

    return run_loopback(2, run)[1]


def test_messages_pass_one_after_the_other() -> None:
    assert times_of([1000, 500, 0, 2000]) == pytest.approx([1.0, 1.5, 1.5, 3.5])


def test_latency_delays_the_first_and_does_not_add_up() -> None:
    assert times_of([1000, 1000], latency_seconds=0.25) == pytest.approx([1.25, 2.25])


def test_the_link_goes_on_while_the_receiver_works() -> None:
    assert times_of([1000, 1000, 1000], work=0.75) == pytest.approx([1.0, 2.0, 3.0])
    assert times_of([1000, 1000, 1000], work=1.5) == pytest.approx([1.0, 2.5, 4.0])


class Drip:
    """Inner channel that receives one message more at each poll, and messages to its own rank at once."""

    rank, size = 1, 2

    def __init__(self, sizes: Sequence[int]) -> None:
        self.sizes = list(sizes)

    def post_receive(self, buffer: np.ndarray, source: int, tag: int) -> int:
        return source

    def isend(self, buffer: np.ndarray, target: int, tag: int) -> None: ...

    def wait_some(self, pending: Sequence[Pending]) -> list[tuple[int, int]]:
        done = [(0, self.sizes.pop(0))] if pending[0] == 0 else []
        return done + [(index, 0) for index, source in enumerate(pending) if source == 1]


def test_what_comes_while_another_passes_is_next_without_a_gap() -> None:
    clock = Clock()
    slow = throttled(Drip([1000, 1000, 1000]), clock)  # type: ignore[arg-type]
    assert receive(slow, clock, [1000] * 3, work=0.5) == pytest.approx([1.0, 2.0, 3.0])


def test_an_idle_link_starts_anew() -> None:
    clock = Clock()
    slow = throttled(Drip([1000, 1000]), clock)  # type: ignore[arg-type]
    assert receive(slow, clock, [1000]) == pytest.approx([1.0])
    clock.sleep(5)
    assert receive(slow, clock, [1000]) == pytest.approx([7.0])


def test_everything_else_passes_at_full_speed() -> None:
    def run(channel: LoopbackChannel) -> tuple[object, ...]:
        clock = Clock()
        slow = throttled(channel, clock)
        window = slow.window(8)
        window.part(window.index)[:] = slow.rank
        rows = window.exchange([slow.rank]).tolist()
        window.free()
        slow.barrier()
        numbers = slow.allgather_numbers([slow.rank, 7]).tolist()
        told = slow.allgather("a"), slow.gather(slow.rank), slow.broadcast(slow.rank, 1), slow.maximum(slow.rank)
        return rows, numbers, told, slow.nodes(), slow.placement().local_size, slow.wait_some([]), clock.now

    rows, numbers = [[0], [1]], [[0, 7], [1, 7]]
    assert run_loopback(2, run) == [
        (rows, numbers, (["a", "a"], [0, 1], 1, 1), ((0, 1),), 2, [], 100.0),
        (rows, numbers, (["a", "a"], None, 1, 1), ((0, 1),), 2, [], 100.0),
    ]


@pytest.mark.parametrize(("rate", "latency"), [(0.0, 0.0), (-1.0, 0.0), (float("nan"), 0.0), (1.0, -1.0)])
def test_links_that_cannot_be_are_refused(rate: float, latency: float) -> None:
    with pytest.raises(InputError, match="no such link"):
        ThrottledChannel(LoopbackChannel(), rate, latency)


@pytest.mark.mpi(ranks=2, timeout=60)
def test_a_slow_link_over_mpi_delivers_everything() -> None:
    from clusterviz.comm.mpi import MpiChannel

    channel = MpiChannel(chunk_bytes=1000)
    slow = ThrottledChannel(channel, 1e7, 1e-4)
    buffers = [np.zeros(5000, np.uint8) for _ in range(4)]
    waiting = [(tag, slow.post_receive(buffer, 1 - slow.rank, tag)) for tag, buffer in enumerate(buffers)]
    for tag in range(4):
        slow.isend(np.full(1500 * tag, tag + slow.rank, np.uint8), 1 - slow.rank, tag)
    while waiting:
        done = dict(slow.wait_some([pending for _, pending in waiting]))
        assert all(size == 1500 * waiting[index][0] for index, size in done.items())
        waiting = [item for index, item in enumerate(waiting) if index not in done]
    slow.wait_sends()
    for tag, buffer in enumerate(buffers):
        assert (buffer[: 1500 * tag] == tag + 1 - slow.rank).all()
        assert not buffer[1500 * tag :].any()
    channel.close()
