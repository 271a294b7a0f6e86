"""The engine: runs the traffic of any schedule over any channel.

In each stage every receive is posted before any send, the sends start in rotated order so that no two ranks begin with
one target, and messages are merged as they arrive. It knows nothing of algorithms, and nothing of how pixels blend.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import replace
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.codec import pack, unpack
from clusterviz.codec.contract import Bytes
from clusterviz.comm.channel import Channel
from clusterviz.composite.chain import Chain
from clusterviz.composite.counters import StageCounters
from clusterviz.composite.fragment import Fragment
from clusterviz.composite.patch import Patch
from clusterviz.composite.traffic import Message, StageTraffic


def run_exchange(
    own: Fragment, traffic: Sequence[StageTraffic], order: Sequence[int], position: int, channel: Channel, codec: str
) -> tuple[tuple[Fragment, ...], tuple[StageCounters, ...]]:
    """Run all stages.

    Parameters
    ----------
    own : this rank's image, over the whole canvas; its pixels are not changed
    traffic : what this rank sends and receives, in positions
    order : the channel's rank of each position
    position : this rank's
    codec : a name from the codec registry

    Returns
    -------
    fragments : the pixels that this rank owns now
    counters : one for each stage
    """
    held: tuple[Fragment, ...] = (own,)
    counters = []
    for tag, stage in enumerate(traffic):
        held, counted = _Stage(stage, order, position, channel, codec, tag).run(held)
        counters.append(counted)
    channel.wait_sends()
    return held, tuple(counters)


class _Stage:
    """One stage under way on one rank."""

    def __init__(
        self, traffic: StageTraffic, order: Sequence[int], position: int, channel: Channel, codec: str, tag: int
    ) -> None:
        self._traffic = traffic
        self._order = order
        self._position = position
        self._channel = channel
        self._codec = codec
        self._tag = tag

    def run(self, held: tuple[Fragment, ...]) -> tuple[tuple[Fragment, ...], StageCounters]:
        """Post, send, merge."""
        dtype = held[0].pixels.dtype if held else np.dtype(np.float32)
        buffers = [np.empty(message.pixels * 4 * dtype.itemsize, np.uint8) for message in self._traffic.receives]
        pending = [
            self._channel.post_receive(buffer, self._order[message.peer], self._tag)
            for buffer, message in zip(buffers, self._traffic.receives, strict=True)
        ]
        counters = self._send(held)
        chains = self._chains(held)
        waiting = list(zip(pending, buffers, self._traffic.receives, strict=True))
        seconds_wait = seconds_blend = 0.0
        while waiting:
            started = perf_counter()
            done = dict(self._channel.wait_some([receive for receive, _, _ in waiting]))
            arrived = perf_counter()
            for index, size in sorted(done.items()):
                _, buffer, message = waiting[index]
                _merge(chains, message, _fragments(message, buffer[:size], dtype))
            waiting = [item for index, item in enumerate(waiting) if index not in done]
            seconds_wait += arrived - started
            seconds_blend += perf_counter() - arrived
        started = perf_counter()
        merged = tuple(chain.finish() for chain in chains)
        seconds_blend += perf_counter() - started
        return merged, replace(counters, seconds_wait=seconds_wait, seconds_blend=seconds_blend)

    def _send(self, held: tuple[Fragment, ...]) -> StageCounters:
        started = perf_counter()
        pixels = bytes_raw = bytes_sent = 0
        starts = _starts([fragment.patch for fragment in held])
        # Begin with the next rank behind, and go round.
        for message in sorted(self._traffic.sends, key=lambda m: (m.peer < self._position, m.peer)):
            parts = [_part(held, starts, patch).pixels for patch in message.patches]
            payload: NDArray[Any] = parts[0] if len(parts) == 1 else np.concatenate(parts)
            data = pack(payload, self._codec)
            self._channel.isend(data, self._order[message.peer], self._tag)
            pixels += message.pixels
            bytes_raw += payload.nbytes
            bytes_sent += data.nbytes
        return StageCounters(len(self._traffic.sends), pixels, bytes_raw, bytes_sent, perf_counter() - started)

    def _chains(self, held: tuple[Fragment, ...]) -> list[Chain]:
        """One chain for each patch that this rank keeps."""
        traffic = self._traffic
        sources: list[list[int]] = [[] for _ in traffic.held]
        starts = _starts(traffic.held)
        for message in traffic.receives:
            for index in {bisect_right(starts, patch.begin) - 1 for patch in message.patches}:
                sources[index].append(message.peer)
        begins = _starts([fragment.patch for fragment in held])
        return [
            Chain(self._position, _part(held, begins, kept), result, peers)
            for kept, result, peers in zip(traffic.kept, traffic.held, sources, strict=True)
        ]


def _starts(patches: Sequence[Patch]) -> list[int]:
    """Where the ranges of patches begin, which lie one after the other."""
    return [patch.begin for patch in patches]


def _part(held: Sequence[Fragment], starts: list[int], patch: Patch) -> Fragment:
    """The part of what this rank holds that a patch names."""
    return held[bisect_right(starts, patch.begin) - 1].cut(patch)


def _fragments(message: Message, data: Bytes, dtype: np.dtype[np.float32] | np.dtype[np.uint8]) -> list[Fragment]:
    """The fragments of a message that arrived."""
    pixels = unpack(data, message.pixels, dtype)
    fragments, begin = [], 0
    for patch in message.patches:
        fragments.append(Fragment(patch, pixels[begin : begin + patch.count], True))
        begin += patch.count
    return fragments


def _merge(chains: Sequence[Chain], message: Message, fragments: Sequence[Fragment]) -> None:
    """Give each chain its fragments of a message."""
    starts = _starts([chain.result for chain in chains])
    mine: dict[int, list[Fragment]] = {}
    for fragment in fragments:
        mine.setdefault(bisect_right(starts, fragment.patch.begin) - 1, []).append(fragment)
    for index, found in mine.items():
        chains[index].add(message.peer, found)
