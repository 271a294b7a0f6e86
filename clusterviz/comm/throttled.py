"""A slow link where there is none: to see what a codec brings on a network that one does not have.

What is modelled: each rank receives through one link of a given rate, one message after the other. A message reaches
the link (a latency after the channel beneath has it), waits until the link is free, takes bytes / rate to pass, and is
reported then. What has arrived beneath is noticed when the receiver asks, and once more whenever a message has passed.

What is not: the sender's link (wait_sends returns as early as beneath), links that the ranks of a node share, switches,
packets and their headers, congestion, and the processor time that a network's protocol takes. The bytes really pass
through the channel beneath first, whose time comes on top, and one that arrives at an idle link while its receiver
works begins to pass only when the receiver asks again: times are rather too long than too short. Collective calls,
numbers and windows pass at full speed.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar, cast

import numpy as np

from clusterviz.comm.channel import Buffer, Channel, Pending
from clusterviz.comm.counters import Counters
from clusterviz.comm.nodes import Nodes
from clusterviz.comm.place import NodePlace
from clusterviz.comm.window import Numbers, SharedWindow
from clusterviz.errors import InputError

T = TypeVar("T")

# The highest that every MPI has; nobody else sends messages to himself.
_QUESTION_TAG = 32767


@dataclass(slots=True)
class _Receive:
    """A posted receive; once it is here, its size, and when it will have passed the link."""

    beneath: Pending
    size: int = 0
    passed: float | None = None


class ThrottledChannel:
    """A channel whose messages reach this rank through a slow link.

    Parameters
    ----------
    channel : what carries the messages
    bytes_per_second : rate of each rank's incoming link, above 0
    latency_seconds : how long a message is on its way to the link
    clock, sleep : the time in seconds, and how to let it pass

    Raises
    ------
    InputError
        A rate or latency that cannot be.
    """

    def __init__(
        self,
        channel: Channel,
        bytes_per_second: float,
        latency_seconds: float = 0.0,
        *,
        clock: Callable[[], float] = time.perf_counter,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        if not (bytes_per_second > 0 and 0 <= latency_seconds < float("inf")):
            found = f"{bytes_per_second} bytes per second, latency {latency_seconds} s"
            raise InputError("no such link", found=found, allowed="a rate above 0 and a latency of 0 or more")
        self._channel = channel
        self._rate = bytes_per_second
        self._latency = latency_seconds
        self._clock = clock
        self._sleep = sleep
        self._free = float("-inf")

    @property
    def rank(self) -> int:
        """This rank."""
        return self._channel.rank

    @property
    def size(self) -> int:
        """The number of ranks."""
        return self._channel.size

    def post_receive(self, buffer: Buffer, source: int, tag: int) -> Pending:
        """Start to receive beneath."""
        return _Receive(self._channel.post_receive(buffer, source, tag))

    def isend(self, buffer: Buffer, target: int, tag: int) -> None:
        """Start to send, at full speed."""
        self._channel.isend(buffer, target, tag)

    def wait_some(self, pending: Sequence[Pending]) -> list[tuple[int, int]]:
        """Wait until a message has passed the link."""
        receives = cast(Sequence[_Receive], pending)
        if not receives:
            return []
        self._notice(receives, wait=all(receive.passed is None for receive in receives))
        first = min(receive.passed for receive in receives if receive.passed is not None)
        while (now := self._clock()) < first:
            self._sleep(first - now)
        # What came meanwhile passes next, at once, however long the caller now works.
        self._notice(receives, wait=False)
        return [(i, r.size) for i, r in enumerate(receives) if r.passed is not None and r.passed <= now]

    def test_some(self, pending: Sequence[Pending]) -> list[tuple[int, int]]:
        """What has passed the link by now."""
        receives = cast(Sequence[_Receive], pending)
        if receives:
            self._notice(receives, wait=False)
        now = self._clock()
        return [(i, r.size) for i, r in enumerate(receives) if r.passed is not None and r.passed <= now]

    def _notice(self, receives: Sequence[_Receive], *, wait: bool) -> None:
        """Put what has arrived beneath in line for the link."""
        on_their_way = [receive for receive in receives if receive.passed is None]
        asked = [receive.beneath for receive in on_their_way]
        if not wait:
            # A message to oneself makes a question of a wait.
            asked.append(self._channel.post_receive(np.empty(0, np.uint8), self.rank, _QUESTION_TAG))
            self._channel.isend(np.empty(0, np.uint8), self.rank, _QUESTION_TAG)
        answered = wait
        while True:
            for index, size in self._channel.wait_some(asked):
                if index == len(on_their_way):
                    answered = True
                    continue
                self._free = max(self._free, self._clock() + self._latency) + size / self._rate
                on_their_way[index].size, on_their_way[index].passed = size, self._free
            if answered:
                return
            on_their_way = [receive for receive in on_their_way if receive.passed is None]
            asked = [*(receive.beneath for receive in on_their_way), asked[-1]]

    def wait_sends(self) -> None:
        """As beneath."""
        self._channel.wait_sends()

    def allgather(self, value: T) -> list[T]:
        """As beneath."""
        return self._channel.allgather(value)

    def allgather_numbers(self, values: Sequence[int] | Numbers) -> Numbers:
        """As beneath."""
        return self._channel.allgather_numbers(values)

    def gather(self, value: T, root: int = 0) -> list[T] | None:
        """As beneath."""
        return self._channel.gather(value, root)

    def broadcast(self, value: T, root: int = 0) -> T:
        """As beneath."""
        return self._channel.broadcast(value, root)

    def maximum(self, value: int) -> int:
        """As beneath."""
        return self._channel.maximum(value)

    def barrier(self) -> None:
        """As beneath."""
        self._channel.barrier()

    def place(self) -> NodePlace:
        """As beneath."""
        return self._channel.place()

    def nodes(self) -> Nodes:
        """As beneath."""
        return self._channel.nodes()

    def window(self, own_bytes: int) -> SharedWindow:
        """As beneath."""
        return self._channel.window(own_bytes)

    def counters(self, count: int) -> Counters:
        """As beneath."""
        return self._channel.counters(count)

    def for_thread(self) -> ThrottledChannel | None:
        """As beneath, through a link of its own that is as slow."""
        beneath = self._channel.for_thread()
        if beneath is None:
            return None
        return ThrottledChannel(beneath, self._rate, self._latency, clock=self._clock, sleep=self._sleep)

    def beside(self) -> ThrottledChannel:
        """As beneath, through a link of its own that is as slow."""
        return ThrottledChannel(self._channel.beside(), self._rate, self._latency, clock=self._clock, sleep=self._sleep)

    def close(self) -> None:
        """As beneath."""
        self._channel.close()

    def abort(self, status: int) -> None:
        """As beneath."""
        self._channel.abort(status)
