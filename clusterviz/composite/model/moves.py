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
class Scene:
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
class Moves:
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


def _at_one(scene: Scene, rounds: float, messages: float, pixels: float, pixels_all: float) -> Moves:
    """An algorithm that ends with the whole picture on one rank, the front one."""
    away = not scene.front_is_root
    return Moves(rounds, messages, pixels, pixels_all, scene.images - 1, away * scene.pixels, int(away))


def _spread(scene: Scene, rounds: float, messages: float, pixels: float, pixels_all: float, all_: float) -> Moves:
    """An algorithm that ends with a piece on every rank."""
    gathered = scene.pixels * (1 - 1 / scene.images)
    return Moves(rounds, messages, pixels, pixels_all, all_, gathered, scene.images - 1)


def serial(scene: Scene) -> Moves:
    """Everybody sends the root what it has."""
    pixels = (scene.images - 1) * scene.cover * scene.pixels
    return _at_one(scene, 1, scene.images - 1, pixels, pixels)


def tree(scene: Scene) -> Moves:
    """The front rank receives the unions of 1, 2, 4, … images."""
    rounds = math.ceil(math.log2(scene.images))
    unions = [scene.union(min(2**r, scene.images)) * scene.pixels for r in range(rounds)]
    # In round r half as many ranks send as in the one before.
    return _at_one(
        scene, rounds, rounds, sum(unions), sum(u * scene.images / 2 ** (r + 1) for r, u in enumerate(unions))
    )


def pipeline(scene: Scene) -> Moves:
    """Batches pass all ranks, one a round: rounds that each move a batch stand for what the busiest rank moves."""
    batches = automatic_batches(scene.pixels)
    rounds = scene.images - 2 + batches if scene.images > 1 else 0
    mean = _mean_union(scene) * scene.pixels
    made = _at_one(scene, rounds, rounds, rounds / batches * mean, (scene.images - 1) * mean)
    return replace(made, messages_all=(scene.images - 1.0) * batches)


def parallel_pipeline(scene: Scene) -> Moves:
    """n − 1 rounds, in each of which every rank hands on the n-th part of what it has merged."""
    n, mean = scene.images, _mean_union(scene) * scene.pixels
    return _spread(scene, n - 1, n - 1, (1 - 1 / n) * mean, (n - 1) * mean, n * (n - 1))


def _mean_union(scene: Scene) -> float:
    """The mean share that the unions of 1, 2, …, n images cover."""
    return 1 / (1 - math.log(scene.cover) / math.log(scene.images)) if scene.images > 1 else scene.cover


def direct_send(scene: Scene) -> Moves:
    """Full-width strips with as much cover each, dealt to ranks whose images lie there."""
    n, depth = scene.images, max(1.0, scene.images * scene.cover)
    # Of what lies on a strip, its owner has between 1 / n (dealt blindly) and 1 / depth (if the images were strips).
    foreign = 1 - 1 / math.sqrt(n * depth)
    # An image is about as high as the root of its share, and touches the strips there; in the middle lie more of them.
    touched = min(n - 1.0, 1.25 * n * math.sqrt(scene.cover))
    pixels = foreign * max(scene.cover, scene.largest) * scene.pixels
    all_pixels = n * scene.cover * foreign * scene.pixels
    return _spread(scene, min(1, n - 1), min(n - 1.0, 1.5 * touched), pixels, all_pixels, n * touched)


def _swap(scene: Scene, factors: Sequence[int]) -> Moves:
    """Rounds of direct send in groups of each factor's size, with the images of groups before merged."""
    pixels, pixels_all, group = 0.0, 0.0, 1
    for factor in factors:
        union = scene.union(group)
        group *= factor
        # A piece is one of `group`, as wide as the union at most: it may be full where others are blank.
        pixels += (factor - 1) * min(union, math.sqrt(union) / group)
        pixels_all += (factor - 1) * union * scene.images / group
    messages = sum(factors) - len(factors)
    size, count = scene.pixels, messages * scene.images
    return _spread(scene, len(factors), messages, pixels * size, pixels_all * size, count)


def _power_of_two(scene: Scene) -> tuple[Moves, int]:
    """Binary swap of as many images as the largest power of two holds, merged from all; and how many are too many."""
    depth = scene.images.bit_length() - 1
    kept = replace(scene, images=2**depth, cover=scene.union(scene.images / 2**depth))
    made = _swap(kept, (2,) * depth)
    return replace(made, gathered=scene.pixels * (1 - 1 / scene.images)), scene.images - 2**depth


def binary_swap(scene: Scene) -> Moves:
    """What exceeds a power of two is folded into it first: whole images, in a round of their own."""
    made, rest = _power_of_two(scene)
    return _extended(made, scene, 1, 1, rest, 1.0) if rest else made


def telescope(scene: Scene) -> Moves:
    """Blocks of powers of two swap by themselves, and hand their pieces to the next larger block in a round more."""
    made, rest = _power_of_two(scene)
    blocks = [bit for bit in range(scene.images.bit_length()) if scene.images >> bit & 1]
    count = sum(bit * 2**bit for bit in blocks) + sum(2**bit for bit in blocks[:-1]) - made.messages_all
    return _extended(made, scene, 1, 1, count, 1 / (scene.images - rest)) if rest else made


def remainder(scene: Scene) -> Moves:
    """In each round one group of three, where the number is odd; one of the three drops out."""
    made, rest = _power_of_two(scene)
    count, left, groups = 0, scene.images, 1
    while left > 1:
        count += groups * (left - left % 2 + 2 * (left % 2))
        left, groups = left // 2, 2 * groups
    return _extended(made, scene, 0, 1, count - made.messages_all, 1 / (scene.images - rest)) if rest else made


def swap_2_3(scene: Scene) -> Moves:
    """Groups of two or three, where a rank's new piece is cut from up to two old ones of each other child."""
    made, rest = _power_of_two(scene)
    depth = made.rounds
    # 1.7 and 1 / 8 are what schedules of up to 1000 ranks were counted to have.
    count = 1.7 * depth * scene.images - made.messages_all
    return _extended(made, scene, 0, depth, count, 1 / 8) if rest else made


def _extended(made: Moves, scene: Scene, rounds: int, messages: float, messages_all: float, share: float) -> Moves:
    """A swap with more rounds, more messages of the busiest rank and of all, and a share of an image more to move."""
    pixels = share * scene.cover * scene.pixels
    rest = scene.images - 2 ** (scene.images.bit_length() - 1)
    return replace(
        made,
        rounds=made.rounds + rounds,
        messages=made.messages + messages,
        messages_all=made.messages_all + messages_all,
        pixels=made.pixels + pixels,
        pixels_all=made.pixels_all + rest * scene.cover * scene.pixels,
    )


def radix_k(scene: Scene) -> Moves:
    """Automatic factors."""
    return _swap(scene, automatic_factors(scene.images))


MOVES: dict[str, Callable[[Scene], Moves]] = {
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
