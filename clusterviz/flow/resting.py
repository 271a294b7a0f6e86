"""Regions at rest: connected samples, or vertices, whose vectors are all zero.

Samples of a grid are connected along its lines, vertices along the edges of tetrahedra: the vectors vanish on the edges
between them, too. On a grid the samples of a line form runs, so that a fluid at rest takes as much memory as its
surface. A sample alone is no region: the vectors may turn around it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.source import Grid
from clusterviz.data.vectors import world_from_index
from clusterviz.flow.cells import Cells

Array = NDArray[np.float64]
Whole = NDArray[np.int64]
Resting = Callable[[Array], NDArray[np.bool_]]
"""Whether places (n, 3), by the index or in the world, lie on regions at rest."""
SAME = 1e-6
"""Samples, or share of a tetrahedron, within which two places are one."""


@dataclass(frozen=True)
class Region:
    """Connected samples without a vector.

    Attributes
    ----------
    middle : (x, y, z), mean of their positions, world
    samples : how many there are, at least 2
    """

    middle: tuple[float, float, float]
    samples: int


def resting_runs(resting: NDArray[np.bool_], first_layer: int) -> Whole:
    """Return runs of samples at rest along x: int64 (n, 4), layer z, row y, first sample and end.

    Parameters
    ----------
    resting : bool (z, y, x), which samples are at rest
    first_layer : z of the first of them
    """
    edges = np.diff(np.pad(resting, ((0, 0), (0, 0), (1, 1))).astype(np.int8), axis=2)
    begins, ends = np.argwhere(edges == 1), np.argwhere(edges == -1)
    return np.column_stack([begins[:, 0] + first_layer, begins[:, 1:], ends[:, 2]]).astype(np.int64)


def regions_of_runs(runs: Whole, grid: Grid) -> tuple[tuple[Region, ...], Resting]:
    """Return the regions that runs form, and whether places by the index lie on one; see `resting_runs`."""
    z, y, begin, end = runs.T
    stride = grid.shape_zyx[2] + 1
    row = z * (grid.shape_zyx[1] + 1) + y
    begins, ends = row * stride + begin, row * stride + end
    pairs = [np.empty((0, 2), np.int64)]
    for rows_on in (1, grid.shape_zyx[1] + 1):
        first = np.searchsorted(ends, begins + rows_on * stride, "right")
        count = np.maximum(np.searchsorted(begins, ends + rows_on * stride, "left") - first, 0)
        own = np.repeat(np.arange(len(runs)), count)
        other = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count) + np.repeat(first, count)
        pairs.append(np.column_stack([own, other]))
    length = end - begin
    sums = np.column_stack([length * (begin + end - 1) / 2, length * y, length * z])
    regions, of_run, samples = _regions(len(runs), np.concatenate(pairs), length, sums)
    middles = world_from_index(np.array([one.middle for one in regions]).reshape(-1, 3), grid)
    found = tuple(Region(tuple(at), one.samples) for at, one in zip(middles.tolist(), regions, strict=True))

    def is_resting(places: Array) -> NDArray[np.bool_]:
        # All samples that have a part in the vectors there.
        low, high = np.floor(places + SAME).astype(np.int64), np.ceil(places - SAME).astype(np.int64)
        every = np.ones(len(places), bool)
        for n in range(8):
            at = np.where([n & 1, n >> 1 & 1, n >> 2], high, low)
            key = (at[:, 2] * (grid.shape_zyx[1] + 1) + at[:, 1]) * stride + at[:, 0]
            run = np.searchsorted(begins, key, "right") - 1
            inside = (run >= 0) & (key < ends[run]) if len(runs) else np.zeros(len(at), bool)
            every &= inside & (samples[of_run[run]] > 1) if len(runs) else inside
        return every

    return found, is_resting


def regions_of_vertices(cells: Cells) -> tuple[tuple[Region, ...], Resting]:
    """Return the regions that vertices of tetrahedra form, and whether places in the world lie on one."""
    places = cells.places.reshape(-1, 3).astype(np.float64)
    if cells.on_cells or not len(places):
        return (), lambda at: np.zeros(len(at), bool)
    resting = (cells.vectors.reshape(-1, 4)[:, :3] == 0).all(axis=1)
    corners = cells.corners.reshape(-1, 4)
    pairs = [corners[resting[corners[:, [i, k]]].all(axis=1)][:, [i, k]] for i, k in combinations(range(4), 2)]
    number = np.cumsum(resting) - 1
    at_rest = places[resting]
    regions, of_vertex, samples = _regions(
        len(at_rest), number[np.concatenate(pairs)], np.ones(len(at_rest), np.int64), at_rest
    )
    still = at_rest[samples[of_vertex] > 1] if len(at_rest) else at_rest
    size = cells.size

    def is_resting(at: Array) -> NDArray[np.bool_]:
        # A vertex, since tetrahedra with two of a region are flat.
        cell = {tuple(key) for key in np.rint(still / (size * SAME)).astype(np.int64).tolist()}
        return np.array(
            [tuple(key) in cell for key in np.rint(at / (size * SAME)).astype(np.int64).tolist()], bool
        ).reshape(len(at))

    return regions, is_resting


def _regions(count: int, pairs: Whole, samples: Whole, sums: Array) -> tuple[tuple[Region, ...], Whole, Whole]:
    """Return connected parts of more than one sample, the part of each item, and the samples of each part.

    Parameters
    ----------
    count : of items
    pairs : int64 (m, 2), items that are connected
    samples : int64 (count,), of each item
    sums : float64 (count, 3), of the positions of its samples
    """
    root = np.arange(count)
    while (apart := root[pairs[:, 0]] != root[pairs[:, 1]]).any():
        ends = root[pairs[apart]]
        np.minimum.at(root, ends.max(axis=1), ends.min(axis=1))
        while (root[root] != root).any():
            root = root[root]
    roots, of_item = np.unique(root, return_inverse=True)
    total = np.bincount(of_item, samples, len(roots)).astype(np.int64)
    middles = np.column_stack([np.bincount(of_item, part, len(roots)) for part in sums.T]) / total[:, None]
    order = [n for n in np.argsort(-total, kind="stable").tolist() if total[n] > 1]
    return tuple(Region(tuple(middles[n].tolist()), int(total[n])) for n in order), of_item, total
