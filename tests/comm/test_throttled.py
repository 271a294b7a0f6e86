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


@pytest.mark.parametrize(
    ("sizes", "keys", "times"),
    [
        ([1000, 500, 0, 2000], {}, [1.0, 1.5, 1.5, 3.5]),
        ([1000, 1000], {"latency_seconds": 0.25}, [1.25, 2.25]),
        ([1000, 1000, 1000], {"work": 0.75}, [1.0, 2.0, 3.0]),
        ([1000, 1000, 1000], {"work": 1.5}, [1.0, 2.5, 4.0]),
    ],
    ids=["one after the other", "latency delays the first", "the link goes on", "while the receiver works"],
)
def test_messages_take_their_time(sizes: list[int], keys: dict[str, float], times: list[float]) -> None:
    assert times_of(sizes, **keys) == pytest.approx(times)


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


def test_what_comes_while_another_passes_is_next_and_an_idle_link_starts_anew() -> None:
    clock = Clock()
    slow = throttled(Drip([1000, 1000, 1000]), clock)  # type: ignore[arg-type]
    assert receive(slow, clock, [1000] * 3, work=0.5) == pytest.approx([1.0, 2.0, 3.0])
    clock = Clock()
    slow = throttled(Drip([1000, 1000]), clock)  # type: ignore[arg-type]
    assert receive(slow, clock, [1000]) == pytest.approx([1.0])
    clock.sleep(5)
    assert receive(slow, clock, [1000]) == pytest.approx([7.0])


def test_collective_calls_and_windows_pass_at_full_speed() -> None:
    def run(channel: LoopbackChannel) -> tuple[object, ...]:
        clock = Clock()
        slow = throttled(channel, clock)
        window = slow.window(8)
        window.part(window.index)[:] = slow.rank
        rows = window.exchange([slow.rank]).tolist()
        window.free()
        slow.barrier()
        numbers, told = slow.allgather_numbers([slow.rank, 7]).tolist(), slow.gather(slow.rank, 1)
        return rows, numbers, told, slow.broadcast(slow.rank, 1), slow.maximum(slow.rank), slow.nodes(), clock.now

    first, second = run_loopback(2, run)
    assert first == ([[0], [1]], [[0, 7], [1, 7]], None, 1, 1, ((0, 1),), 100.0)
    assert second == (*first[:2], [0, 1], *first[3:])


@pytest.mark.parametrize(("rate", "latency"), [(0.0, 0.0), (-1.0, 0.0), (float("nan"), 0.0), (1.0, -1.0)])
def test_links_that_cannot_be_are_refused(rate: float, latency: float) -> None:
    with pytest.raises(InputError, match="no such link"):
        ThrottledChannel(LoopbackChannel(), rate, latency)
