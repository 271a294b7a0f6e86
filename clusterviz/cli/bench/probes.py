"""Timed operations of `clusterviz bench network`; all are collective and return the same seconds on every rank.

The result is the minimum over all repetitions, since other activity of a machine can only add time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import perf_counter

import numpy as np
from numpy.typing import DTypeLike, NDArray

from clusterviz.comm import Channel
from clusterviz.composite import Compositor
from clusterviz.composite.fragment import Patch
from clusterviz.composite.model.fitting import Link, fit_link
from clusterviz.composite.model.network import open_network
from clusterviz.composite.over.layers import Layer, blend_layers
from clusterviz.image.partial import PartialImage
from clusterviz.image.region import EMPTY, Rect

Bytes = NDArray[np.uint8]

SIZES = (0, 64, 1 << 10, 1 << 12, 1 << 14, 1 << 16, 1 << 18, 1 << 20, 1 << 22, 1 << 24)
LARGE_BYTES = 1 << 16  # from this size on, bytes dominate the cost of a message
BURSTS = (1, 2, 4, 8, 16)
BURST_BYTES = 64
ARENA_BYTES = 1 << 26
IMAGE = (1024, 1024)
LAYERS = 4
TINY_SIDE = 16  # width and height of images with negligible cost of pixels
SHORT_REPETITIONS = 5  # factor of the repetitions of short operations
WARM_UP_FRAMES = 3  # frames before timing
COPY_BYTES = 1 << 24
STEPS = 20  # exchanges in one timed call
ANSWER_TAG = 1000


@dataclass(frozen=True)
class LinkTimes:
    """Seconds of each repetition on one link.

    Attributes
    ----------
    by_size : bytes -> seconds of one message
    by_swap : bytes of each -> seconds of one message each way at once, as in compositing
    by_count : number -> seconds of a burst of small messages in one direction
    """

    by_size: dict[int, list[float]]
    by_swap: dict[int, list[float]]
    by_count: dict[int, list[float]]

    def fit(self) -> Link:
        """Return the constants of this link."""
        by_size, by_count, by_swap = (
            {key: min(found) for key, found in times.items()} for times in (self.by_size, self.by_count, self.by_swap)
        )
        return fit_link(by_size, by_count, by_swap)


def time_link(channel: Channel, pair: Sequence[int], frames: int) -> LinkTimes:
    """Time ping-pong, swaps and bursts between two ranks; all ranks get the times of the first.

    Each repetition covers all sizes and numbers, so that a disturbance affects all of them.
    """
    by_size: dict[int, list[float]] = {size: [] for size in SIZES}
    by_swap: dict[int, list[float]] = {size: [] for size in SIZES if size >= LARGE_BYTES}
    by_count: dict[int, list[float]] = {count: [] for count in BURSTS}
    channel.barrier()
    if channel.rank in pair:
        mine = list(pair).index(channel.rank)
        peer = pair[1 - mine]
        # Messages use memory outside of the caches, as the pixels of a frame do.
        data = [np.ones(ARENA_BYTES, np.uint8) for _ in range(2)]
        for frame in range(frames + 1):
            for size in SIZES:
                begin = frame * size % (ARENA_BYTES - size)
                parts = [memory[begin : begin + size] for memory in data]
                seconds = _ping_pong(channel, peer, mine, parts)
                by_size[size] += [seconds] * (frame > 0)
                if size in by_swap:
                    seconds = _swap(channel, peer, parts)
                    by_swap[size] += [seconds] * (frame > 0)
            for count in BURSTS:
                seconds = _burst(channel, peer, mine, data, count)
                by_count[count] += [seconds] * (frame > 0)
    return channel.broadcast(LinkTimes(by_size, by_swap, by_count), pair[0])


def _ping_pong(channel: Channel, peer: int, is_answering: int, data: Sequence[Bytes]) -> float:
    """Return half the time of a message and an answer of the same size."""
    pending = channel.post_receive(data[1], peer, 0)
    started = perf_counter()
    if is_answering:
        channel.wait_some([pending])
    channel.isend(data[0], peer, 0)
    if not is_answering:
        channel.wait_some([pending])
    channel.wait_sends()
    return (perf_counter() - started) / 2


def _swap(channel: Channel, peer: int, data: Sequence[Bytes]) -> float:
    """Return the time of a message each way at once, after a synchronisation."""
    channel.isend(data[0][:0], peer, ANSWER_TAG)
    channel.wait_some([channel.post_receive(data[1][:0], peer, ANSWER_TAG)])
    channel.wait_sends()
    started = perf_counter()
    pending = channel.post_receive(data[1], peer, 0)
    channel.isend(data[0], peer, 0)
    channel.wait_some([pending])
    channel.wait_sends()
    return perf_counter() - started


def _burst(channel: Channel, peer: int, is_answering: int, data: Sequence[Bytes], count: int) -> float:
    """Return the time of a burst of small messages in one direction and an empty answer."""
    if is_answering:
        parts = np.split(data[1][: count * BURST_BYTES], count)
        waiting = [channel.post_receive(part, peer, tag) for tag, part in enumerate(parts)]
        channel.isend(data[0][:0], peer, ANSWER_TAG)
        while waiting:
            done = {index for index, _ in channel.wait_some(waiting)}
            waiting = [pending for index, pending in enumerate(waiting) if index not in done]
        channel.isend(data[0][:0], peer, ANSWER_TAG)
        channel.wait_sends()
        return 0.0
    channel.wait_some([channel.post_receive(data[1][:0], peer, ANSWER_TAG)])
    pending = channel.post_receive(data[1][:0], peer, ANSWER_TAG)
    started = perf_counter()
    for tag in range(count):
        channel.isend(data[0][:BURST_BYTES], peer, tag)
    channel.wait_some([pending])
    channel.wait_sends()
    return perf_counter() - started


def time_blend(channel: Channel, dtype: DTypeLike, busy: bool, frames: int) -> float:
    """Return seconds per pixel and image when all busy ranks blend four images in one pass at the same time."""
    count = IMAGE[0] * IMAGE[1]
    rng, patch = np.random.default_rng(channel.rank), Patch(IMAGE[0], 0, count, Rect(0, 0, *IMAGE))
    largest = 100 if np.dtype(dtype).kind == "u" else 0.4
    layers = [Layer(patch, (rng.random((count, 4), np.float32) * largest).astype(dtype)) for _ in range(LAYERS)]
    out = np.empty((count, 4), dtype)
    return min(time_calls(channel, lambda: blend_layers(layers, patch, out), busy, frames)) / (count * LAYERS)


def time_copy(channel: Channel, busy: bool, frames: int) -> float:
    """Return seconds per byte when all busy ranks copy at the same time."""
    source, target = np.zeros(COPY_BYTES, np.uint8), np.ones(COPY_BYTES, np.uint8)
    return min(time_calls(channel, lambda: np.copyto(target, source), busy, frames)) / COPY_BYTES


def time_step(channel: Channel, frames: int) -> float:
    """Return seconds of an exchange of small numbers through a node's shared memory, on all nodes at once."""
    window = channel.window(0)
    numbers = np.zeros(4, np.int64)

    def steps() -> None:
        for _ in range(STEPS):
            window.exchange(numbers)

    seconds = min(time_calls(channel, steps, True, SHORT_REPETITIONS * frames)) / STEPS
    window.free()
    return seconds


def time_tiny(channel: Channel, ranks: int, frames: int) -> float:
    """Return seconds of direct-send compositing of tiny images by messages, on the slowest rank.

    Memory is touched before each frame, as by drawing; with warm caches compositing takes half the time.
    """
    rect = Rect(0, 0, TINY_SIDE, TINY_SIDE) if channel.rank < ranks else EMPTY
    image = PartialImage(rect, np.ones((rect.height, rect.width, 4), np.uint8))
    # A fixed algorithm and network, independent of the constants being measured.
    network = open_network("laptop")
    compositor = Compositor(
        channel, (TINY_SIDE, TINY_SIDE), algorithm="direct-send", codec="raw", transport="messages", network=network
    )
    order = range(channel.size)
    seconds = []
    drawn = np.zeros((2, COPY_BYTES), np.uint8)
    for _ in range(SHORT_REPETITIONS * frames + WARM_UP_FRAMES):
        np.copyto(drawn[0], drawn[1])
        channel.barrier()
        started = perf_counter()
        compositor.composite(image, order)
        seconds.append(perf_counter() - started)
    compositor.close()
    return float(min(map(max, zip(*channel.allgather(seconds[WARM_UP_FRAMES:]), strict=True))))


def time_calls(channel: Channel, call: Callable[[], object], busy: bool, frames: int) -> list[float]:
    """Return the time of each repetition of a call on all busy ranks at once, of the slowest rank."""
    seconds = []
    for _ in range(frames + 1):
        channel.barrier()
        started = perf_counter()
        if busy:
            call()
        seconds.append(perf_counter() - started if busy else 0.0)
    return [max(times) for times in zip(*channel.allgather(seconds[1:]), strict=True)]
