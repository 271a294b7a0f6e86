"""Channel through a simulated slow link, to measure codecs for networks that are not at hand.

Each rank receives through one link of a given rate, one message at a time. A message reaches the link one latency after
the inner channel has it, waits until the link is free, and takes bytes / rate to pass. Arrivals are noticed when the
receiver polls, and once more whenever a message has passed.

Not simulated: the sender's link (`wait_sends` returns as early as the inner channel's), links that the ranks of a node
share, switches, packet headers, congestion, and CPU time of the network's protocol. Messages really pass through the
inner channel first, whose time is added, and a message for an idle link starts only when the receiver polls: times are
too long rather than too short. Collective calls, counters, windows and remote memory run at full speed.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from clusterviz.comm.channel import Buffer, Channel, Pending
from clusterviz.errors import InputError

# The highest tag that every MPI allows; only this module sends messages to the own rank.
_PROBE_TAG = 32767


@dataclass(slots=True)
class _Receive:
    """Posted receive; once received by the inner channel, its size and the time at which it has passed the link."""

    inner: Pending
    size: int = 0
    arrival: float | None = None


class ThrottledChannel:
    """Channel whose messages reach this rank through a simulated slow link.

    `channel`: inner channel, which carries the messages; `bytes_per_second`: rate of each rank's incoming link, above
    0; `latency_seconds`: time from the inner channel to the link; `clock`, `sleep`: functions that return the time in
    seconds and wait. Raises InputError for an invalid rate or latency.
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

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the inner channel: all that is not said here happens at full speed."""
        return getattr(self._channel, name)

    def post_receive(self, buffer: Buffer, source: int, tag: int) -> Pending:
        return _Receive(self._channel.post_receive(buffer, source, tag))

    def wait_some(self, pending: Sequence[Pending]) -> list[tuple[int, int]]:
        """Wait until a message has passed the link."""
        receives = cast(Sequence[_Receive], pending)
        if not receives:
            return []
        self._enqueue(receives, wait=all(receive.arrival is None for receive in receives))
        first = min(receive.arrival for receive in receives if receive.arrival is not None)
        while (now := self._clock()) < first:
            self._sleep(first - now)
        # Messages that arrived meanwhile start to pass now, not when the caller polls again.
        self._enqueue(receives, wait=False)
        return _passed(receives, now)

    def test_some(self, pending: Sequence[Pending]) -> list[tuple[int, int]]:
        """Return the messages that have passed the link."""
        receives = cast(Sequence[_Receive], pending)
        if receives:
            self._enqueue(receives, wait=False)
        return _passed(receives, self._clock())

    def _enqueue(self, receives: Sequence[_Receive], *, wait: bool) -> None:
        """Put messages that the inner channel has received in line for the link."""
        in_transit = [receive for receive in receives if receive.arrival is None]
        inner_pending = [receive.inner for receive in in_transit]
        if not wait:
            # A message to the own rank turns the wait into a poll.
            inner_pending.append(self._channel.post_receive(np.empty(0, np.uint8), self.rank, _PROBE_TAG))
            self._channel.isend(np.empty(0, np.uint8), self.rank, _PROBE_TAG)
        probed = wait
        while True:
            for index, size in self._channel.wait_some(inner_pending):
                if index == len(in_transit):
                    probed = True
                    continue
                self._free = max(self._free, self._clock() + self._latency) + size / self._rate
                in_transit[index].size, in_transit[index].arrival = size, self._free
            if probed:
                return
            in_transit = [receive for receive in in_transit if receive.arrival is None]
            inner_pending = [*(receive.inner for receive in in_transit), inner_pending[-1]]

    def for_thread(self) -> ThrottledChannel | None:
        """Return the inner channel's channel for a thread, through a link of its own with the same rate."""
        inner = self._channel.for_thread()
        return None if inner is None else self._throttled(inner)

    def duplicate(self) -> ThrottledChannel:
        """Return a duplicate of the inner channel, through a link of its own with the same rate."""
        return self._throttled(self._channel.duplicate())

    def _throttled(self, inner: Channel) -> ThrottledChannel:
        return ThrottledChannel(inner, self._rate, self._latency, clock=self._clock, sleep=self._sleep)


def _passed(receives: Sequence[_Receive], now: float) -> list[tuple[int, int]]:
    return [(i, r.size) for i, r in enumerate(receives) if r.arrival is not None and r.arrival <= now]
