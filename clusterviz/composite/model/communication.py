"""What each algorithm moves, in closed form: a frame has no time to follow every message of every algorithm.

A few numbers stand for the footprints: how many images, and how much of the canvas each covers. Neighbours in depth are
taken to lie close: a share c of the canvas covered by one of n images grows to c^(1 − log k / log n) for the bounding
rectangle of k of them, which is 1 for all n, and c·k^(2/3) for bricks of a cube. The tests hold these forms against
counts of the schedules.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from clusterviz.composite.schedules.pipeline import automatic_batches
from clusterviz.composite.schedules.radix_k import automatic_factors


@dataclass(frozen=True)
class ImageStatistics:
    """What is composed, in few numbers.

    Attributes
    ----------
    images : that are not empty, of as many ranks unless some have several
    pixels : of the canvas
    cover, largest : the mean and the largest share of the canvas that one image covers
    bytes_per_pixel : 4, 8 or 16
    front_is_root : whether the front image lies where the picture shall be
    """

    images: int
    pixels: int
    cover: float
    largest: float
    bytes_per_pixel: int
    front_is_root: bool

    def union(self, images: float) -> float:
        """The share of the canvas that the bounding rectangle of so many neighbours in depth covers."""
        if self.images < 2:
            return self.cover
        return min(1.0, float(self.cover ** (1 - math.log(images) / math.log(self.images))))


@dataclass(frozen=True)
class CommunicationCost:
    """What an algorithm moves, until every pixel has an owner.

    Attributes
    ----------
    rounds : one after the other
    messages : of the busiest rank, sent or received
    pixels : sent or received by the busiest rank
    pixels_all : sent by all ranks together
    messages_all : likewise
    gathered : pixels that the root still has to receive, and `pieces`, from how many ranks
    """

    rounds: float
    messages: float
    pixels: float
    pixels_all: float
    messages_all: float
    gathered: float
    pieces: int


def _ends_on_one_rank(
    stats: ImageStatistics, rounds: float, messages: float, pixels: float, pixels_all: float
) -> CommunicationCost:
    """An algorithm that ends with the whole picture on one rank, the front one."""
    away = not stats.front_is_root
    return CommunicationCost(rounds, messages, pixels, pixels_all, stats.images - 1, away * stats.pixels, int(away))


def _ends_on_all_ranks(
    stats: ImageStatistics, rounds: float, messages: float, pixels: float, pixels_all: float, all_: float
) -> CommunicationCost:
    """An algorithm that ends with a piece on every rank."""
    gathered = stats.pixels * (1 - 1 / stats.images)
    return CommunicationCost(rounds, messages, pixels, pixels_all, all_, gathered, stats.images - 1)


def serial(stats: ImageStatistics) -> CommunicationCost:
    """Everybody sends the root what it has."""
    pixels = (stats.images - 1) * stats.cover * stats.pixels
    return _ends_on_one_rank(stats, 1, stats.images - 1, pixels, pixels)


def tree(stats: ImageStatistics) -> CommunicationCost:
    """The front rank receives the unions of 1, 2, 4, … images."""
    rounds = math.ceil(math.log2(stats.images))
    unions = [stats.union(min(2**r, stats.images)) * stats.pixels for r in range(rounds)]
    # In round r half as many ranks send as in the one before.
    return _ends_on_one_rank(
        stats, rounds, rounds, sum(unions), sum(u * stats.images / 2 ** (r + 1) for r, u in enumerate(unions))
    )


def pipeline(stats: ImageStatistics) -> CommunicationCost:
    """Batches pass all ranks, one a round: rounds that each move a batch stand for what the busiest rank moves."""
    batches = automatic_batches(stats.pixels)
    rounds = stats.images - 2 + batches if stats.images > 1 else 0
    mean = _mean_union(stats) * stats.pixels
    made = _ends_on_one_rank(stats, rounds, rounds, rounds / batches * mean, (stats.images - 1) * mean)
    return replace(made, messages_all=(stats.images - 1.0) * batches)


def parallel_pipeline(stats: ImageStatistics) -> CommunicationCost:
    """n − 1 rounds, in each of which every rank hands on the n-th part of what it has merged."""
    n, mean = stats.images, _mean_union(stats) * stats.pixels
    return _ends_on_all_ranks(stats, n - 1, n - 1, (1 - 1 / n) * mean, (n - 1) * mean, n * (n - 1))


def _mean_union(stats: ImageStatistics) -> float:
    """The mean share that the unions of 1, 2, …, n images cover."""
    return 1 / (1 - math.log(stats.cover) / math.log(stats.images)) if stats.images > 1 else stats.cover


def direct_send(stats: ImageStatistics) -> CommunicationCost:
    """Full-width strips with as much cover each, dealt to ranks whose images lie there."""
    n, depth = stats.images, max(1.0, stats.images * stats.cover)
    # Of what lies on a strip, its owner has between 1 / n (dealt blindly) and 1 / depth (if the images were strips).
    foreign = 1 - 1 / math.sqrt(n * depth)
    # An image is about as high as the root of its share, and touches the strips there; in the middle lie more of them.
    touched = min(n - 1.0, 1.25 * n * math.sqrt(stats.cover))
    pixels = foreign * max(stats.cover, stats.largest) * stats.pixels
    all_pixels = n * stats.cover * foreign * stats.pixels
    return _ends_on_all_ranks(stats, min(1, n - 1), min(n - 1.0, 1.5 * touched), pixels, all_pixels, n * touched)


def _swap(stats: ImageStatistics, factors: Sequence[int]) -> CommunicationCost:
    """Rounds of direct send in groups of each factor's size, with the images of groups before merged."""
    pixels, pixels_all, group = 0.0, 0.0, 1
    for factor in factors:
        union = stats.union(group)
        group *= factor
        # A piece is one of `group`, as wide as the union at most: it may be full where others are blank.
        pixels += (factor - 1) * min(union, math.sqrt(union) / group)
        pixels_all += (factor - 1) * union * stats.images / group
    messages = sum(factors) - len(factors)
    size, count = stats.pixels, messages * stats.images
    return _ends_on_all_ranks(stats, len(factors), messages, pixels * size, pixels_all * size, count)


def _power_of_two(stats: ImageStatistics) -> tuple[CommunicationCost, int]:
    """Binary swap of as many images as the largest power of two holds, merged from all; and how many are too many."""
    depth = stats.images.bit_length() - 1
    kept = replace(stats, images=2**depth, cover=stats.union(stats.images / 2**depth))
    made = _swap(kept, (2,) * depth)
    return replace(made, gathered=stats.pixels * (1 - 1 / stats.images)), stats.images - 2**depth


def binary_swap(stats: ImageStatistics) -> CommunicationCost:
    """What exceeds a power of two is folded into it first: whole images, in a round of their own."""
    made, rest = _power_of_two(stats)
    return _with_remainder(made, stats, 1, 1, rest, 1.0) if rest else made


def telescope(stats: ImageStatistics) -> CommunicationCost:
    """Blocks of powers of two swap by themselves, and hand their pieces to the next larger block in a round more."""
    made, rest = _power_of_two(stats)
    blocks = [bit for bit in range(stats.images.bit_length()) if stats.images >> bit & 1]
    count = sum(bit * 2**bit for bit in blocks) + sum(2**bit for bit in blocks[:-1]) - made.messages_all
    return _with_remainder(made, stats, 1, 1, count, 1 / (stats.images - rest)) if rest else made


def remainder(stats: ImageStatistics) -> CommunicationCost:
    """In each round one group of three, where the number is odd; one of the three drops out."""
    made, rest = _power_of_two(stats)
    count, left, groups = 0, stats.images, 1
    while left > 1:
        count += groups * (left - left % 2 + 2 * (left % 2))
        left, groups = left // 2, 2 * groups
    return _with_remainder(made, stats, 0, 1, count - made.messages_all, 1 / (stats.images - rest)) if rest else made


def swap_2_3(stats: ImageStatistics) -> CommunicationCost:
    """Groups of two or three, where a rank's new piece is cut from up to two old ones of each other child."""
    made, rest = _power_of_two(stats)
    depth = made.rounds
    # 1.7 and 1 / 8 are what schedules of up to 1000 ranks were counted to have.
    count = 1.7 * depth * stats.images - made.messages_all
    return _with_remainder(made, stats, 0, depth, count, 1 / 8) if rest else made


def _with_remainder(
    made: CommunicationCost, stats: ImageStatistics, rounds: int, messages: float, messages_all: float, share: float
) -> CommunicationCost:
    """A swap with more rounds, more messages of the busiest rank and of all, and a share of an image more to move."""
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
    """Automatic factors."""
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
