"""Vertex-array template: the slices of one box serve all boxes of its size; six clip planes cut what lies outside.

The template is that of a box that reaches one distance of planes further to the front, so that it can be moved by part
of a distance to where the whole slicing has its planes. It is sent to the GPU once, a box then needs an offset and six
clip planes. Here, polygons are clipped in NumPy; render/slices lets the GPU clip them.

Boxes that share a face have vertices on it that agree but for rounding, not bit for bit.

References
----------
B. Moloney, D. Weiskopf, T. Möller, M. Strengert: Scalable sort-first parallel direct volume rendering with dynamic load
balancing, EGPGV 2007. M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart
2010, section 5.3.3. I. Sutherland, G. Hodgman: Reentrant polygon clipping, CACM 17(1), 1974.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clusterviz.plan.slices.contract import Cuts, Flags, Floats, Polygons
from clusterviz.plan.slices.marching_cubes_table import marching_cubes_table

ROUNDING = 8 * float(np.finfo(np.float64).eps)
"""Share of the largest coordinate of a box or its template by which a polygon that is moved may be off."""


@dataclass(frozen=True)
class Moves:
    """Planes of a template, and how far they are moved."""

    template: Cuts  # the boxes of the template at the origin, and planes whose levels are integers
    offset: Floats  # float64 (n, 3), from there to where the polygon is


def moves_of(cuts: Cuts, beyond: float = 0.0) -> Moves:
    """Return the planes of a template for planes in boxes of its size.

    `beyond`: length by which the template's box is larger on all sides, as rasterisers round.
    """
    normal = np.broadcast_to(cuts.normal, cuts.low.shape)
    ahead = normal / (normal**2).sum(axis=1, keepdims=True)  # one distance
    size = cuts.far - cuts.near
    passed = cuts.level - cuts.corner_levels[:, 0]
    level = np.floor(passed)
    low, high = np.minimum(-ahead, size) - beyond, np.maximum(-ahead, size) + beyond
    return Moves(Cuts(low, high, normal, level), cuts.near + (passed - level)[:, None] * ahead)


def vertex_array_template(cuts: Cuts) -> Polygons:
    """Return the polygons of planes in boxes; there may be more than six vertices, some of them equal."""
    moves = moves_of(cuts)
    found = marching_cubes_table(moves.template)
    levels = cuts.corner_levels
    is_met = (levels[:, 0] <= cuts.level) & (cuts.level < levels[:, 7])
    polygons = Polygons(found.vertices + moves.offset[:, None], np.where(is_met, found.counts, 0))
    near, far = cuts.near, cuts.far
    # A polygon on a face is moved there but for rounding, and must not be cut away.
    sides = near, far, moves.template.low, moves.template.high
    rounding = ROUNDING * np.abs(sides).max(axis=(0, 2))
    for axis in range(3):
        rises = np.broadcast_to(cuts.normal, near.shape)[:, axis] >= 0
        ahead, behind = (side[:, axis] for side in (near, far))
        for bound, keeps_above in ((ahead, rises), (behind, ~rises)):
            polygons = _clipped(polygons, axis, bound, keeps_above, rounding)
    low, high = np.minimum(near, far)[:, None], np.maximum(near, far)[:, None]
    return Polygons(np.clip(polygons.vertices, low, high), polygons.counts)


def _clipped(polygons: Polygons, axis: int, bound: Floats, keeps_above: Flags, rounding: Floats) -> Polygons:
    """Return the parts of polygons on one side of planes perpendicular to an axis, or beyond them by rounding."""
    vertices, counts = polygons.vertices, polygons.counts
    places = np.arange(vertices.shape[1])
    after = np.take_along_axis(vertices, ((places + 1) % np.maximum(counts, 1)[:, None])[..., None], axis=1)
    sign = np.where(keeps_above, 1.0, -1.0)[:, None]
    here, there = (sign * (each[..., axis] - bound[:, None]) for each in (vertices, after))
    least = -rounding[:, None]
    is_one, inside = places < counts[:, None], here >= least
    leaves = is_one & (inside != (there >= least))
    met = vertices + (after - vertices) * (here / np.where(here != there, here - there, 1.0))[..., None]
    met[..., axis] = bound[:, None]
    kept = np.stack([is_one & inside, leaves], axis=2).reshape(len(counts), -1)
    both = np.stack([vertices, met], axis=2).reshape(len(counts), -1, 3)
    found = kept.sum(axis=1)
    order = np.argsort(~kept, axis=1, kind="stable")[:, : max(1, int(found.max(initial=0)))]
    order = np.take_along_axis(order, np.minimum(np.arange(order.shape[1]), np.maximum(found, 1)[:, None] - 1), axis=1)
    return Polygons(np.take_along_axis(both, order[..., None], axis=1), np.where(found >= 3, found, 0))
