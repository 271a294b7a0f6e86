"""Vertex shader: each of six vertices finds its own edge; the NumPy twin of shaders/slices/six_vertices.glsl.

Three paths of edges lead from the nearest corner to the farthest one and meet each plane once: they hold the even
vertices. Each odd vertex is on the edge that leaves its path to the side, or else equal to the even one before. As λ on
that edge says on which side of it the plane lies, at most three edges are tried by a vertex and 15 by all six; in the
order of [1], four and 21.

References
----------
[1] K. Engel, M. Hadwiger, J. Kniss, C. Rezk-Salama, D. Weiskopf: Real-time volume graphics, 2006, section 3.5.2.
[2] M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 5.3.3
(the order of edges used here).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clusterviz.plan.slices.contract import EDGES, Cuts, Integers, Polygons, points_on, shares

NUMBER = {(int(near), int(far)): number for number, (near, far) in enumerate(EDGES)}


class Path(NamedTuple):
    """Numbers of three edges from the nearest corner to the farthest one, and of the edge to the side."""

    begin: int
    middle: int
    end: int
    side: int


def _path(axis: int) -> Path:
    first = 1 << axis
    second, beside = first | 1 << (axis + 2) % 3, first | 1 << (axis + 1) % 3
    return Path(NUMBER[0, first], NUMBER[first, second], NUMBER[second, 7], NUMBER[first, beside])


PATHS = tuple(_path(axis) for axis in range(3))


def vertex_shader(cuts: Cuts) -> Polygons:
    """Return the polygons of planes in boxes; vertices that are equal are neighbours."""
    edges, _ = choose_edges(cuts)
    levels = cuts.corner_levels
    near, far = (np.take_along_axis(levels, EDGES[edges, end], axis=1) for end in (0, 1))
    is_met = (levels[:, 0] <= cuts.level) & (cuts.level < levels[:, 7])
    vertices = points_on(cuts, edges, shares(cuts.level[:, None], near, far))
    return Polygons(vertices, np.where(is_met, edges.shape[1], 0))


def choose_edges(cuts: Cuts, in_order_of_1: bool = False) -> tuple[Integers, Integers]:
    """Return the edges of the six vertices, int64 (n, 6), and the number of edges that each has tried, int64 (n, 6).

    `in_order_of_1`: an odd vertex that is not to the side tries its path from the begin, as in [1].
    """
    levels, level = cuts.corner_levels, cuts.level[:, None]
    crossed = (levels[:, EDGES[:, 0]] <= level) & (level < levels[:, EDGES[:, 1]])
    edges, tried = [], []
    for path in PATHS:
        begins, goes_on, aside = crossed[:, path.begin], crossed[:, path.middle], crossed[:, path.side]
        even = np.where(begins, path.begin, np.where(goes_on, path.middle, path.end))
        tests = np.where(begins, 1, np.where(goes_on, 2, 3))
        is_before = cuts.level < levels[:, EDGES[path.side, 0]]
        mirrored = np.where(is_before | crossed[:, path.end], 1, 2)
        edges += [even, np.where(aside, path.side, even)]
        tried += [tests, np.where(aside, 1, 1 + (tests if in_order_of_1 else mirrored))]
    return np.stack(edges, axis=1), np.stack(tried, axis=1)
