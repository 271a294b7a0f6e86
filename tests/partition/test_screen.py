"""What all ways to share the screen have in common: every pixel is drawn once, whoever draws it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clusterviz.data.source import Grid
from clusterviz.image.partial import Rect
from clusterviz.partition.screen import (
    COARSE,
    CostMap,
    ScreenPartition,
    adapt,
    build_cuts,
    carried,
    coarse_partition,
    cost_map_of_blocks,
    cost_map_of_rects,
    interleaved_tiles,
    pattern_tiles,
    rank_groups,
    tile_queue,
)
from clusterviz.partition.screen.cost_map import CELL
from clusterviz.partition.screen.tiles import tile_counts
from clusterviz.plan.view import View, make_view
from clusterviz.scene.values import Camera

EXTENT = (25.0, 18.0, 30.0)


def view_of(size: tuple[int, int], position: tuple[float, float, float] = (70, 50, 60), **lens: float) -> View:
    camera = Camera(position=position, focal_point=(12, 9, 15), view_up=(0.1, 0.2, 1), **lens)
    return make_view(camera, size, Grid((31, 19, 26)))


def blank_map(size: tuple[int, int]) -> CostMap:
    return CostMap(size, np.zeros(tile_counts(size, CELL)))


def random_map(size: tuple[int, int], seed: int, empty: float = 0.5) -> CostMap:
    random = np.random.default_rng(seed)
    cost = random.random(blank_map(size).cost.shape) ** 3
    return CostMap(size, np.where(random.random(cost.shape) < empty, 0.0, cost))


def cuts(size: tuple[int, int], groups: int, side: int) -> ScreenPartition:
    return build_cuts(random_map(size, side), tuple(1 + number % 3 for number in range(groups))).partition()


def moved_cuts(size: tuple[int, int], groups: int, side: int) -> ScreenPartition:
    tree = build_cuts(random_map(size, side), (1,) * groups)
    return adapt(tree, random_map(size, side + 1)).partition()


STRATEGIES: dict[str, Callable[[tuple[int, int], int, int], ScreenPartition]] = {
    "interleaved": interleaved_tiles,
    "pattern": lambda size, groups, side: pattern_tiles(view_of(size), EXTENT, groups, side, 2),
    "cuts": cuts,
    "moved cuts": moved_cuts,
}


def check_mosaic(partition: ScreenPartition, size: tuple[int, int], groups: int) -> None:
    """Every pixel has one group, and windows lie in the picture."""
    assert partition.size == size
    assert partition.groups == groups
    assert sum(window.pixels for windows in partition.rects for window in windows) == size[0] * size[1]
    assert all(window.intersect(Rect(0, 0, *size)) == window for windows in partition.rects for window in windows)
    assert partition.owner().min() >= 0


@pytest.mark.parametrize("name", STRATEGIES)
@settings(deadline=None, max_examples=25)
@given(
    size=st.tuples(st.integers(1, 90), st.integers(1, 70)), groups=st.integers(1, 9), side=st.sampled_from([1, 8, 13])
)
def test_every_pixel_is_drawn_once(name: str, size: tuple[int, int], groups: int, side: int) -> None:
    partition = STRATEGIES[name](size, groups, side)
    check_mosaic(partition, size, groups)
    check_mosaic(coarse_partition(partition), (-(-size[0] // COARSE), -(-size[1] // COARSE)), groups)


@pytest.mark.parametrize("groups", range(1, 13))
def test_interleaved_groups_take_turns_in_rows_and_columns(groups: int) -> None:
    owner = interleaved_tiles((8 * groups, 8 * groups), groups, 8).owner()[::8, ::8]
    assert all(sorted(line) == list(range(groups)) for line in [*owner, *owner.T])


@pytest.mark.cover
@pytest.mark.parametrize("groups", [1, 2, 3, 7, 8])
@pytest.mark.parametrize(
    "view",
    [view_of((160, 120)), view_of((160, 120), parallel_scale=30.0), view_of((160, 120), (12, 9, 80))],
    ids=["perspective", "parallel", "one face"],
)
def test_a_pattern_gives_each_group_its_share_of_the_faces(view: View, groups: int) -> None:
    """Far enough away, with faces nearly as large as each other on the screen or not."""
    owner = pattern_tiles(view, EXTENT, groups, 1, 3).owner()
    begin, end = (0.0, 0.0, 0.0), EXTENT
    box = view.footprint(begin, end)
    counts = np.bincount(owner[box.y_begin : box.y_end, box.x_begin : box.x_end].ravel(), minlength=groups)
    assert counts.min() >= 0.5 * counts.mean()
    assert counts.max() <= 1.5 * counts.mean()


@pytest.mark.long
def test_more_repetitions_leave_the_groups_more_alike() -> None:
    view, cost = view_of((240, 240)), np.zeros((240, 240))
    cost[60:140, 90:150] = 1.0
    loads = [
        np.bincount(pattern_tiles(view, EXTENT, 8, 1, n).owner().ravel(), cost.ravel(), minlength=8) for n in (1, 3, 9)
    ]
    spreads = [float(load.max() / load.mean()) for load in loads]
    assert spreads[0] > spreads[1] > spreads[2]
    assert spreads[2] < 1.3
    # Along an axis and from inside, too, all of them paint the volume.
    for view in (view_of((60, 60), (12, 9, -40)), view_of((60, 60), (12, 9, 15.5), view_angle=80.0)):
        assert len(np.unique(pattern_tiles(view, EXTENT, 6, 1, 1).owner())) == 6


def bump(at: tuple[float, float]) -> CostMap:
    """A smooth cost round a cell of a picture of 640 × 480."""
    y, x = np.mgrid[0:30, 0:40]
    return CostMap((640, 480), np.exp(-((x - at[0]) ** 2 + (y - at[1]) ** 2) / 60))


def test_cuts_are_even_where_the_cost_can_be_divided() -> None:
    """Smooth costs, unequal weights: every rank of a group has nearly the same, first and after moves."""
    for weights in ((1,) * 8, (2, 1, 3), (1,) * 5):
        tree = build_cuts(bump((12, 9)), weights)
        for at in ((12, 9), (13, 10), (15, 11), (34, 25)):
            tree = adapt(tree, bump(at))
            even = bump(at).cost.sum() / sum(weights)
            assert tree.busiest(bump(at)) <= 1.25 * even


def test_a_cost_is_carried_to_the_next_camera() -> None:
    """The model knows where the cost goes, but neither its scale nor all of it."""
    before, now = bump((12, 9)), bump((16, 12))
    halved, doubled = (CostMap(now.size, factor * now.cost) for factor in (0.5, 2.0))
    last = CostMap(before.size, 2.0 * before.cost)
    np.testing.assert_allclose(carried(last, before, now).cost, doubled.cost, atol=1e-9 * doubled.cost.max())
    tree = build_cuts(last, (1,) * 4)
    even = doubled.cost.sum() / 4
    assert adapt(tree, carried(last, before, now)).busiest(doubled) < 1.1 * even < adapt(tree, last).busiest(doubled)
    np.testing.assert_array_equal(carried(last, halved, halved).cost, last.cost)
    np.testing.assert_array_equal(carried(last, blank_map(now.size), now).cost, last.cost)


def test_cuts_lie_at_any_pixel_and_stay_while_they_are_good_enough_or_without_a_cost() -> None:
    even = CostMap((70, 45), np.ones(blank_map((70, 45)).cost.shape))
    for groups in (2, 3, 5):
        assert build_cuts(even, (1,) * groups).busiest(even) < 1.03 * even.cost.sum() / groups
    cost = random_map((640, 480), 3, 0.0)
    tree = build_cuts(cost, (1,) * 7)
    nudged = CostMap(cost.size, cost.cost * np.linspace(1.0, 1.004, 40))
    for now in (cost, nudged, blank_map(cost.size)):
        assert adapt(tree, now) == tree


def test_a_map_tells_the_cost_of_any_rectangle() -> None:
    cost = random_map((70, 45), 1, 0.0)
    rows, columns = (np.minimum(CELL, n - np.arange(0, n, CELL)) for n in (45, 70))
    pixels = np.repeat(np.repeat(cost.cost / np.outer(rows, columns), rows, 0), columns, 1)
    for rect in (Rect(0, 0, 70, 45), Rect(3, 5, 69, 44), Rect(20, 17, 21, 18), Rect(5, 5, 5, 9)):
        part = pixels[rect.y_begin : rect.y_end, rect.x_begin : rect.x_end]
        for axis in (0, 1):
            expected = np.concatenate([[0.0], np.cumsum(part.sum(axis=1 - axis))])
            np.testing.assert_allclose(cost.profile(rect, axis), expected, atol=1e-12)
        assert cost.total(rect) == pytest.approx(part.sum())


def test_spread_costs_keep_their_sum_and_their_place() -> None:
    rects = np.array([[0, 0, 16, 16], [10, 20, 50, 40], [3, 3, 3, 9], [60, 40, 70, 45]])
    found = cost_map_of_rects((70, 45), rects, np.array([2.0, 3.0, 7.0, 5.0]))
    assert found.cost.sum() == pytest.approx(10.0)
    assert found.cost[0, 0] == 2.0
    assert found.total(Rect(64, 32, 70, 45)) > 0
    assert found.total(Rect(16, 0, 70, 16)) == 0


def test_counts_of_blocks_come_to_where_they_were_counted() -> None:
    """Of a coarse picture too, whose edges do not fall on the fine one's."""
    counts = np.array([[5, 0, 1], [0, 7, 0]], np.uint32)
    found = cost_map_of_blocks((640, 480), [(Rect(100, 200, 124, 216), counts)])
    assert found.cost.sum() == 13
    assert found.total(Rect(96, 192, 128, 224)) == pytest.approx(13)
    coarse = cost_map_of_blocks((99, 77), [(Rect(0, 0, 25, 20), np.ones((20, 25), np.uint32))], COARSE, 1)
    assert coarse.cost.sum() == 20 * 25 * COARSE**2
    inner = coarse.cost[1:-2, 1:-2]
    assert inner.min() == inner.max() == (CELL // COARSE) ** 2 * COARSE**2


def test_the_queue_has_every_tile_that_costs_something_dearest_first() -> None:
    cost = random_map((150, 100), 4, 0.7)
    tiles = tile_queue(cost, 32)
    costs = [cost.total(tile) for tile in tiles]
    assert costs == sorted(costs, reverse=True)
    assert min(costs) > 0
    assert len(set(tiles)) == len(tiles)
    assert sum(costs) == pytest.approx(cost.cost.sum())


@pytest.mark.parametrize("ranks", [1, 2, 5, 8])
def test_groups_are_neighbours_and_nearly_of_one_size(ranks: int) -> None:
    for groups in range(1, ranks + 1):
        found = rank_groups(ranks, groups)
        assert [rank for group in found for rank in group] == list(range(ranks))
        sizes = [len(group) for group in found]
        assert max(sizes) - min(sizes) <= 1
