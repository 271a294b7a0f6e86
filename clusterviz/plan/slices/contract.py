"""Contract of slice generators: the polygons in which planes cut axis-aligned boxes.

A generator is a function `(cuts: Cuts) -> Polygons`. It takes boxes, each with one plane, and returns the vertices of
the plane's polygon in each box, in order around it. A plane of a level holds the points p with `normal · p = level`.
Levels of the planes of one slicing differ by integers (`SlicePlanes`, in distances), which some generators use.

Corners are named from the plane's own side: bit d of a corner is set if it lies on the far side of the box along axis
d, so corner 0 is nearest, corner 7 farthest, and levels rise along every edge from the corner without the bit to the
one with it. A plane is in an edge if `level(near) ≤ level < level(far)`. This test is all that decides on the form of a
polygon, it is monotone, and corners that boxes share have the same level in each of them. So

- a polygon has 0 or 3 to 6 vertices and is convex, whatever rounding does to the levels;
- boxes that share a face have the same vertices on it, bit for bit: slices have neither gaps nor overlaps;
- a plane through a corner, an edge or a face of several boxes is in those behind it, with vertices exactly there.

References
----------
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 5.3.3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]

EDGES = np.array([(near, near | bit) for bit in (1, 2, 4) for near in range(8) if not near & bit])
"""The twelve edges of a box: near and far corner."""
AXES = np.repeat([0, 1, 2], 4)
"""Axis of each edge."""
FAR = (np.arange(8)[:, None] >> np.arange(3) & 1).astype(bool)
"""Corners, bool (8, 3): whether each coordinate is that of the far side."""
MOST_VERTICES = 6


@dataclass(frozen=True)
class Cuts:
    """Boxes, and a plane for each. `low`, `high`: float64 (n, 3), corners (x, y, z) with low ≤ high."""

    low: Floats
    high: Floats
    normal: Floats  # float64 (n, 3) or (3,), not zero
    level: Floats  # float64 (n,)

    @property
    def near(self) -> Floats:
        """Nearest corners, float64 (n, 3)."""
        return np.where(self.normal < 0, self.high, self.low)

    @property
    def far(self) -> Floats:
        """Farthest corners, float64 (n, 3)."""
        return np.where(self.normal < 0, self.low, self.high)

    @property
    def corner_levels(self) -> Floats:
        """Levels of the corners, float64 (n, 8), by one expression of their coordinates."""
        sides = np.stack([self.near, self.far]) * self.normal
        each = [sides[FAR[:, axis].astype(int), :, axis] for axis in range(3)]
        levels: Floats = ((each[0] + each[1]) + each[2]).T
        return levels

    @property
    def in_front(self) -> Flags:
        """Corners that do not lie behind the plane, bool (n, 8)."""
        return self.corner_levels <= self.level[:, None]


@dataclass(frozen=True)
class Polygons:
    """Polygons of planes in boxes."""

    vertices: Floats  # float64 (n, m, 3), in order around the polygon, then the last one again; neighbours may be equal
    counts: Integers  # int64 (n,), vertices, without repetitions at the end; 0 where the plane does not meet the box

    @property
    def areas(self) -> Floats:
        """Areas, float64 (n,), if the order of the vertices is right."""
        spokes = self.vertices[:, 1:] - self.vertices[:, :1]
        fan = np.cross(spokes[:, :-1], spokes[:, 1:]).sum(axis=1)
        return np.where(self.counts > 0, 0.5 * np.linalg.norm(fan, axis=1), 0.0)


def shares(level: Floats, near: Floats, far: Floats) -> Floats:
    """Return the part of edges in front of a plane, in [0, 1], from the levels of their ends; 0 at the near corner."""
    span = far - near
    found: Floats = np.clip((level - near) / np.where(span > 0, span, 1.0), 0.0, 1.0)
    return found


def points_on(cuts: Cuts, edges: Integers, share: Floats) -> Floats:
    """Return points of edges, float64 (n, m, 3).

    `edges`: int64 (n, m), numbers of `EDGES`. `share`: float64 (n, m), of each edge from its near corner.
    """
    near, far = cuts.near[:, None], cuts.far[:, None]
    points = np.where(FAR[EDGES[edges, 0]], far, near)
    low, high = (
        np.take_along_axis(side, AXES[edges][..., None], axis=2) for side in np.broadcast_arrays(near, far, points)[:2]
    )
    along = low + (high - low) * share[..., None]
    np.put_along_axis(
        points, AXES[edges][..., None], np.clip(along, np.minimum(low, high), np.maximum(low, high)), axis=2
    )
    return points


def repeated(edges: Integers, counts: Integers) -> Integers:
    """Return lists of edges (n, m) with the last of `counts` again in the rest of each."""
    places = np.minimum(np.arange(edges.shape[1]), np.maximum(counts, 1)[:, None] - 1)
    return np.take_along_axis(edges, places, axis=1)
