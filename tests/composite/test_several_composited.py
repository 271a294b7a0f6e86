"""Several images a rank, composited: they lie between those of others, and nothing between two of them is hidden."""

from __future__ import annotations

import numpy as np
import pytest
from composite.images import over_all, random_partial, random_rect

from clusterviz.comm import LoopbackChannel, run_loopback
from clusterviz.composite import ALGORITHMS, Compositor, collect, composite
from clusterviz.composite.schedules.algorithms import SEVERAL_IMAGES
from clusterviz.image.region import Rect

SIZE = (31, 23)


def bound(images: int) -> float:
    """n·2⁻²³ and a little for the float64 oracle."""
    return images * 2.0**-23


@pytest.mark.parametrize("algorithm", [*sorted(SEVERAL_IMAGES), "auto"])
@pytest.mark.parametrize("transport", ["messages", "shared", "hierarchical"])
def test_several_images_a_rank_lie_between_those_of_others(algorithm: str, transport: str) -> None:
    rng = np.random.default_rng(3)
    ranks, per_node = 5, 2 if transport == "hierarchical" else None
    counts = [3, 1, 0, 4, 2]
    order = [int(rank) for rank in rng.permutation(np.repeat(np.arange(ranks), counts))]
    layers = [random_partial(rng, random_rect(rng, SIZE), np.float32) for _ in order]

    def run(channel: LoopbackChannel) -> np.ndarray | None:
        mine = [layer for layer, owner in zip(layers, order, strict=True) if owner == channel.rank]
        compositor = Compositor(channel, SIZE, algorithm=algorithm, transport=transport)
        picture, _ = compositor.composite(mine, order)
        kept = None if picture is None else picture.copy()
        compositor.close()
        return kept

    picture = run_loopback(ranks, run, ranks_per_node=per_node)[0]
    assert np.abs(picture - over_all(layers, range(len(layers)), SIZE)).max() <= bound(len(layers))


@pytest.mark.parametrize("algorithm", sorted(SEVERAL_IMAGES))
def test_several_images_that_no_other_rank_meets(algorithm: str) -> None:
    rng = np.random.default_rng(12)
    layers = [random_partial(rng, Rect(0, 0, 9, 9), np.float32) for _ in range(3)]
    elsewhere = random_partial(rng, Rect(20, 0, 25, 9), np.float32)

    def run(channel: LoopbackChannel) -> np.ndarray | None:
        mine = layers if channel.rank == 0 else [elsewhere]
        piece, _ = composite(mine, [0, 0, 1, 0] if channel.size > 1 else [0] * 3, channel, algorithm)
        return collect(piece, SIZE, channel)

    assert np.abs(run_loopback(1, run)[0] - over_all(layers, range(3), SIZE)).max() <= bound(3)
    wanted = over_all([*layers, elsewhere], [0, 1, 3, 2], SIZE)
    assert np.abs(run_loopback(2, run)[0] - wanted).max() <= bound(4)


@pytest.mark.parametrize("root", [0, 1, 2])
@pytest.mark.parametrize("algorithm", sorted(SEVERAL_IMAGES))
def test_a_box_around_two_images_hides_nothing_between_them(algorithm: str, root: int) -> None:
    rng = np.random.default_rng(13)
    rects = [Rect(0, 0, 5, SIZE[1]), Rect(8, 0, 15, SIZE[1]), Rect(20, 0, *SIZE)]
    layers = [random_partial(rng, rect, np.float32) for rect in rects]

    def run(channel: LoopbackChannel) -> np.ndarray | None:
        mine = [[layers[0], layers[2]], [layers[1]], []][channel.rank]
        piece, _ = composite(mine, [0, 1, 0], channel, algorithm)
        return collect(piece, SIZE, channel, root)

    wanted = over_all(layers, range(3), SIZE).astype(np.float32)
    assert np.array_equal(run_loopback(3, run)[root], wanted)


@pytest.mark.parametrize("algorithm", sorted(ALGORITHMS.keys() - SEVERAL_IMAGES))
def test_an_algorithm_of_one_image_a_rank_runs_where_images_may_be_brought_side_by_side(algorithm: str) -> None:
    """Else direct send does: where each of two ranks has images in front of the other's."""
    rng = np.random.default_rng(17)
    left, right, whole = Rect(0, 0, 9, SIZE[1]), Rect(9, 0, *SIZE), Rect(0, 0, *SIZE)
    # Of ranks 0, 1, 2, 0, 1: rank 0's second image lies beside rank 1's first.
    for rects, ran in (
        ((whole, left, left, right, left), algorithm),
        ((whole, left, left, whole, left), "direct-send"),
    ):
        layers = [random_partial(rng, rect, np.float32) for rect in rects]
        order = [0, 1, 2, 0, 1] if ran == "direct-send" else [0, 1, 1, 0, 2]

        def run(channel: LoopbackChannel, layers: list = layers, order: list = order) -> tuple:
            mine = [layer for layer, rank in zip(layers, order, strict=True) if rank == channel.rank]
            piece, counters = composite(mine, order, channel, algorithm)
            return collect(piece, SIZE, channel), counters.algorithm

        picture, used = run_loopback(3, run)[0]
        assert used == ran
        assert np.abs(picture - over_all(layers, range(5), SIZE)).max() < 1e-6
