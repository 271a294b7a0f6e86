"""Which voxels a brick of a domain needs: always enough, and what is hidden costs nothing."""

from __future__ import annotations

import numpy as np
import pytest

from clusterviz.data.bricks import BrickLayout, read_bricks
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid
from clusterviz.plan.domain import Cut, count_in_boxes, domain_layout, make_cut, make_domain, samples_in_bricks

OTHER = Grid((9, 12, 7), (1.0, 1.0, 1.0), (-3.0, 2.0, 1.0))
GRIDS = {
    "same": Grid((14, 11, 9)),
    "finer": Grid((14, 21, 9), (0.4, 0.5, 0.3), (1.0, 1.0, 1.0)),
    "coarser": Grid((4, 3, 5), (3.0, 4.0, 5.0)),
    "turned": Grid(
        (10, 11, 12), (1.0, 1.2, 0.9), (5.0, 0.0, 0.0), ((0.6, -0.8, 0.0), (0.8, 0.6, 0.0), (0.0, 0.0, 1.0))
    ),
    "mirrored": Grid((10, 11, 12), (1.0, 1.2, 0.9), (5.0, 0.0, 0.0), ((0, 0, -1.0), (0, 1.0, 0), (1.0, 0, 0))),
}


def cut_of(name: str, brick: int = 5, margin: int = 0) -> Cut:
    grid = GRIDS[name]
    domain = make_domain([OTHER, grid])
    return make_cut(domain, domain_layout(domain, brick), grid, margin)


@pytest.mark.parametrize("name", GRIDS)
def test_every_point_of_a_brick_finds_its_cell_in_the_box_of_the_brick(name: str) -> None:
    cut, grid = cut_of(name), GRIDS[name]
    rng = np.random.default_rng(3)
    begin, end = cut.brick_edges()
    last = np.array(grid.shape_zyx[::-1]) - 1
    seen = 0
    for index in np.ndindex(*cut.layout.counts_zyx):
        points = begin[index] + rng.random((200, 3)) * (end[index] - begin[index])
        local = points @ cut.index_from_domain[:, :3].T + cut.index_from_domain[:, 3]
        local = local[((local >= 0) & (local <= last)).all(axis=1)]
        if not len(local):
            continue
        seen += 1
        assert cut.meets(*cut.images(begin[index], end[index]))
        (low, high), most = cut.cell_box(index), cut.most_cells_zyx
        assert (local >= low[::-1]).all()
        assert (local <= high[::-1]).all()
        assert (np.subtract(high, low) <= most).all()
    assert seen


def test_boxes_are_read_with_their_margin() -> None:
    grid = GRIDS["turned"]
    voxels = np.arange(np.prod(grid.shape_zyx), dtype=np.float32).reshape(grid.shape_zyx)
    cut = cut_of("turned", margin=1)
    met = [
        i
        for i in np.ndindex(*cut.layout.counts_zyx)
        if cut.meets(*(edge[i] for edge in cut.images(*cut.brick_edges())))
    ]
    padded = np.pad(voxels, 1, mode="edge")
    for index, samples in read_bricks(ArraySource(voxels, grid), cut, met):
        (z, y, x), _ = cut.cell_box(index)
        nz, ny, nx = samples.shape
        assert np.array_equal(samples, padded[z : z + nz, y : y + ny, x : x + nx])


def test_a_flat_volume_meets_nothing() -> None:
    flat = Grid((1, 8, 8))
    domain = make_domain([OTHER, flat])
    cut = make_cut(domain, domain_layout(domain, 4), flat, 0)
    assert not cut.meets(*cut.images(*cut.brick_edges())).any()


def test_costs_are_the_cells_that_the_volume_fills_and_none_where_it_is_hidden() -> None:
    grid = GRIDS["same"]
    domain = make_domain([grid])
    cut, own = make_cut(domain, domain_layout(domain, 5), grid, 0), BrickLayout(grid.shape_zyx, 5)
    shown = np.zeros(own.counts_zyx, bool)
    assert samples_in_bricks(cut, own, shown).sum() == pytest.approx(13 * 10 * 8)
    assert not samples_in_bricks(cut, own, ~shown).any()
    hidden = ~shown
    hidden[0, 0, 0] = False
    cost = samples_in_bricks(cut, own, hidden)
    # Neighbours may sample the one layer that they share with it.
    assert cost[0, 0, 0] == 125
    assert not cost[2].any()


def test_sums_over_boxes_are_counts() -> None:
    flags = np.random.default_rng(1).random((4, 5, 6)) < 0.3
    begin, end = np.array([[0, 0, 0], [1, 2, 3], [2, 2, 2]]), np.array([[4, 5, 6], [3, 4, 4], [2, 5, 6]])
    expected = [int(flags[a:d, b:e, c:f].sum()) for (a, b, c), (d, e, f) in zip(begin, end, strict=True)]
    assert count_in_boxes(flags, begin, end).tolist() == expected
