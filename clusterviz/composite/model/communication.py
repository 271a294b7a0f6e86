"""Communication cost of each algorithm in closed form, cheap enough to be evaluated in every frame.

The footprints are summarized by the number of images and the fraction of the canvas that each covers. Neighbours in
depth are assumed to be close: if one of n images covers a fraction c of the canvas, the bounding rectangle of k of them
covers c^(1 − log k / log n), which is 1 for k = n, and c·k^(2/3) for bricks of a cube. The tests compare these forms
with counts of the schedules.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

from clusterviz.composite.schedules.algorithms import ALGORITHMS
from clusterviz.composite.schedules.pipeline import automatic_batches
from clusterviz.composite.schedules.radix_k import automatic_factors
from clusterviz.composite.schedules.schedule import Algorithm, Load


@dataclass(frozen=True)
class ImageStatistics:
    """Statistics of the images to be composited."""

    images: int  # number of images that are not empty; as many ranks, unless some have several
    pixels: int  # pixels of the canvas
    # mean and largest fraction of the canvas that one image covers
    cover: float
    largest: float
    bytes_per_pixel: int  # 4, 8 or 16
    front_is_root: bool  # whether the front image lies on the root

    def union(self, images: float) -> float:
        """Return the fraction of the canvas that the bounding rectangle of `images` neighbours in depth covers."""
        if self.images < 2:
            return self.cover
        return min(1.0, float(self.cover ** (1 - math.log(images) / math.log(self.images))))


@dataclass(frozen=True)
class CommunicationCost:
    """Messages and pixels of an algorithm, until every pixel has an owner."""

    rounds: float  # number of consecutive rounds
    messages: float  # messages sent or received by the busiest rank
    pixels: float  # pixels sent or received by the busiest rank
    pixels_all: float  # pixels sent by all ranks together
    messages_all: float  # messages sent by all ranks together
    gathered: float  # pixels that the root receives in the final gather
    pieces: int  # ranks from which it receives them


def _ends_on_one_rank(
    stats: ImageStatistics, rounds: float, messages: float, pixels: float, pixels_all: float
) -> CommunicationCost:
    """Return the cost of an algorithm that ends with the whole picture on the front rank."""
    away = not stats.front_is_root
    return CommunicationCost(rounds, messages, pixels, pixels_all, stats.images - 1, away * stats.pixels, int(away))


def _ends_on_all_ranks(
    stats: ImageStatistics, rounds: float, messages: float, pixels: float, pixels_all: float, all_: float
) -> CommunicationCost:
    """Return the cost of an algorithm that ends with a piece on every rank."""
    gathered = stats.pixels * (1 - 1 / stats.images)
    return CommunicationCost(rounds, messages, pixels, pixels_all, all_, gathered, stats.images - 1)


def serial(stats: ImageStatistics) -> CommunicationCost:
    """Return the cost of the serial gather."""
    pixels = (stats.images - 1) * stats.cover * stats.pixels
    return _ends_on_one_rank(stats, 1, stats.images - 1, pixels, pixels)


def tree(stats: ImageStatistics) -> CommunicationCost:
    """Return the cost of the binary tree: the front rank receives the unions of 1, 2, 4, … images."""
    rounds = math.ceil(math.log2(stats.images))
    unions = [stats.union(min(2**r, stats.images)) * stats.pixels for r in range(rounds)]
    # In round r half as many ranks send as in the one before.
    return _ends_on_one_rank(
        stats, rounds, rounds, sum(unions), sum(u * stats.images / 2 ** (r + 1) for r, u in enumerate(unions))
    )


def pipeline(stats: ImageStatistics) -> CommunicationCost:
    """Return the cost of the pipeline: each round moves one batch."""
    batches = automatic_batches(stats.pixels)
    rounds = stats.images - 2 + batches if stats.images > 1 else 0
    mean = _mean_union(stats) * stats.pixels
    made = _ends_on_one_rank(stats, rounds, rounds, rounds / batches * mean, (stats.images - 1) * mean)
    return replace(made, messages_all=(stats.images - 1.0) * batches)


def parallel_pipeline(stats: ImageStatistics) -> CommunicationCost:
    """Return the cost of the parallel pipeline: in n − 1 rounds every rank sends on 1/n of what it has merged."""
    n, mean = stats.images, _mean_union(stats) * stats.pixels
    return _ends_on_all_ranks(stats, n - 1, n - 1, (1 - 1 / n) * mean, (n - 1) * mean, n * (n - 1))


def _mean_union(stats: ImageStatistics) -> float:
    return 1 / (1 - math.log(stats.cover) / math.log(stats.images)) if stats.images > 1 else stats.cover


def direct_send(stats: ImageStatistics) -> CommunicationCost:
    """Return the cost of direct send: full-width strips of equal cover, assigned to ranks whose images lie there."""
    n, depth = stats.images, max(1.0, stats.images * stats.cover)
    # The owner of a strip has between 1 / n of its pixels (any assignment) and 1 / depth (if the images were strips).
    foreign = 1 - 1 / math.sqrt(n * depth)
    # An image is about as high as the root of its fraction, and touches the strips there; the middle has more of them.
    touched = min(n - 1.0, 1.25 * n * math.sqrt(stats.cover))
    pixels = foreign * max(stats.cover, stats.largest) * stats.pixels
    all_pixels = n * stats.cover * foreign * stats.pixels
    return _ends_on_all_ranks(stats, min(1, n - 1), min(n - 1.0, 1.5 * touched), pixels, all_pixels, n * touched)


def _swap(stats: ImageStatistics, factors: Sequence[int]) -> CommunicationCost:
    """Return the cost of rounds of direct send in groups of each factor's size."""
    pixels, pixels_all, group = 0.0, 0.0, 1
    for factor in factors:
        union = stats.union(group)
        group *= factor
        # A piece is one of `group`, at most as wide as the union: it may be full where others are blank.
        pixels += (factor - 1) * min(union, math.sqrt(union) / group)
        pixels_all += (factor - 1) * union * stats.images / group
    messages = sum(factors) - len(factors)
    size, count = stats.pixels, messages * stats.images
    return _ends_on_all_ranks(stats, len(factors), messages, pixels * size, pixels_all * size, count)


def _power_of_two(stats: ImageStatistics) -> tuple[CommunicationCost, int]:
    """Return the cost of binary swap of the largest power of two of merged images, and the number of images beyond."""
    depth = stats.images.bit_length() - 1
    kept = replace(stats, images=2**depth, cover=stats.union(stats.images / 2**depth))
    made = _swap(kept, (2,) * depth)
    return replace(made, gathered=stats.pixels * (1 - 1 / stats.images)), stats.images - 2**depth


def binary_swap(stats: ImageStatistics) -> CommunicationCost:
    """Return the cost of binary swap: images beyond a power of two are folded first, in a round of their own."""
    made, rest = _power_of_two(stats)
    return _with_remainder(made, stats, 1, 1, rest, 1.0) if rest else made


def telescope(stats: ImageStatistics) -> CommunicationCost:
    """Return the cost of telescoped binary swap: one more round, in which blocks send to the next larger block."""
    made, rest = _power_of_two(stats)
    blocks = [bit for bit in range(stats.images.bit_length()) if stats.images >> bit & 1]
    count = sum(bit * 2**bit for bit in blocks) + sum(2**bit for bit in blocks[:-1]) - made.messages_all
    return _with_remainder(made, stats, 1, 1, count, 1 / (stats.images - rest)) if rest else made


def remainder(stats: ImageStatistics) -> CommunicationCost:
    """Return the cost of binary swap with remainders: a group of three in each round with an odd number."""
    made, rest = _power_of_two(stats)
    count, left, groups = 0, stats.images, 1
    while left > 1:
        count += groups * (left - left % 2 + 2 * (left % 2))
        left, groups = left // 2, 2 * groups
    return _with_remainder(made, stats, 0, 1, count - made.messages_all, 1 / (stats.images - rest)) if rest else made


def swap_2_3(stats: ImageStatistics) -> CommunicationCost:
    """Return the cost of 2-3 swap: a rank's new piece is cut from up to two old ones of each other child."""
    made, rest = _power_of_two(stats)
    depth = made.rounds
    # 1.7 and 1 / 8 fit the counts of schedules of up to 1000 ranks.
    count = 1.7 * depth * stats.images - made.messages_all
    return _with_remainder(made, stats, 0, depth, count, 1 / 8) if rest else made


def _with_remainder(
    made: CommunicationCost, stats: ImageStatistics, rounds: int, messages: float, messages_all: float, share: float
) -> CommunicationCost:
    """Return the cost of a swap with more rounds and messages, and a fraction `share` of an image more to move."""
    pixels = share * stats.cover * stats.pixels
    rest = stats.images - 2 ** (stats.images.bit_length() - 1)
    return replace(
        made,
        rounds=made.rounds + rounds,
        messages=made.messages + messages,
        messages_all=made.messages_all + messages_all,
        pixels=made.pixels + pixels,
        pixels_all=made.pixels_all + rest * stats.cover * stats.pixels,
    )


def radix_k(stats: ImageStatistics) -> CommunicationCost:
    """Return the cost of radix-k with automatic factors."""
    return _swap(stats, automatic_factors(stats.images))


COMMUNICATION_COSTS: dict[str, Callable[[ImageStatistics], CommunicationCost]] = {
    "serial": serial,
    "pipeline": pipeline,
    "tree": tree,
    "direct-send": direct_send,
    "binary-swap": binary_swap,
    "binary-swap-telescope": telescope,
    "binary-swap-remainder": remainder,
    "2-3-swap": swap_2_3,
    "radix-k": radix_k,
    "parallel-pipeline": parallel_pipeline,
    "slic": direct_send,
}
"""Closed forms; algorithms without one are counted, see `communication_cost`."""


def communication_cost(algorithm: str, stats: ImageStatistics) -> CommunicationCost:
    """Return the cost of an algorithm: in closed form, else what its schedule moves, scaled by what images cover."""
    if closed_form := COMMUNICATION_COSTS.get(algorithm):
        return closed_form(stats)
    load = _dense_load(ALGORITHMS[algorithm], stats.images, stats.pixels)
    loads = (load.rounds, load.most_messages, stats.cover * load.most_pixels, stats.cover * load.pixels)
    if load.pixels_sent[0]:
        return _ends_on_all_ranks(stats, *loads, load.messages)
    return replace(_ends_on_one_rank(stats, *loads), messages_all=load.messages)


@lru_cache(maxsize=64)
def _dense_load(schedule: Algorithm, images: int, pixels: int) -> Load:
    return schedule(images, pixels, ()).counts()
