"""Reference intersections of rays with triangles, spheres and the segments of tubes, in float64.

Every ray is tested with every primitive whose box it meets; primitives are divided at the median of their boxes until
few are left. Lengths t along a ray are in world units, and those in front of its start are found, t ≥ 0.

A ray through an edge that two triangles share meets one of them, or, at a fold, both or none, as pixels do under the
top-left rule: no surface is missed or counted twice. Triangles with the same three vertices are met at the same t, to
the last bit.

Reference: S. Woop, C. Benthin, I. Wald: Watertight ray/triangle intersection, JCGT 2(1), 2013.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from clusterviz.reference.rays import Columns, Floats, Rays, inside

Indices = NDArray[np.int64]
PAIRS = 1 << 13  # of rays and primitives that are tested without dividing them further


@dataclass(frozen=True)
class Hits(Columns):
    """Intersections of rays with primitives, (k,) each."""

    # int64 (k,)
    ray: Indices
    primitive: Indices
    t: Floats  # float64 (k,), length along the ray
    normal: Floats  # float64 (k, 3), of the primitive, outward or by the order of the vertices; not normalised
    weights: Floats  # float64 (k, c), of the primitive's c vertices at the intersection


class Primitives(Protocol):
    """Primitives with boxes around them, whose corners are `low` and `high`, float64 (m, 3)."""

    @property
    def low(self) -> Floats: ...

    @property
    def high(self) -> Floats: ...

    def meet(self, rays: Rays, ray: Indices, primitive: Indices) -> Hits:
        """Return the intersections of all pairs of rays (r,) and primitives (p,)."""
        ...


def intersect(rays: Rays, primitives: Primitives) -> Hits:
    """Return all intersections with t ≥ 0, in no order."""
    found = [primitives.meet(rays, *pair) for pair in near_pairs(rays, primitives.low, primitives.high)]
    nothing = np.empty(0, np.int64)
    count = found[0].weights.shape[1] if found else 1
    whole = Hits(nothing, nothing, np.empty(0), np.empty((0, 3)), np.empty((0, count))).joined(found)
    return whole.some(whole.t >= 0)


def near_pairs(rays: Rays, lows: Floats, highs: Floats) -> Iterator[tuple[Indices, Indices]]:
    """Yield rays (r,) and primitives (p,) that may meet.

    `lows`, `highs`: float64 (m, 3), corners of the boxes around primitives.
    """
    waiting = [(np.arange(len(rays.direction)), np.arange(len(lows)))]
    while waiting:
        ray, some = waiting.pop()
        if not len(some):
            continue
        low, high = lows[some].min(axis=0), highs[some].max(axis=0)
        start = rays.start[ray]
        margin = 1e-9 * (high - low).max() + 1e-13 * max(np.abs([low, high]).max(), np.abs(start).max(initial=0))
        near, far = inside(Rays(start - (low - margin), rays.direction[ray]), high - low + 2 * margin)
        ray = ray[near <= far]
        if not len(ray):
            continue
        if len(some) == 1 or len(ray) * len(some) <= PAIRS:
            yield ray, some
            continue
        axis = int((high - low).argmax())
        half = len(some) // 2
        order = np.argpartition(lows[some, axis] + highs[some, axis], half)
        waiting += [(ray, some[order[half:]]), (ray, some[order[:half]])]


@dataclass(frozen=True)
class Triangles:
    vertices: Floats  # float64 (n, 3)
    corners: Indices  # int64 (m, 3), indices of vertices

    @property
    def low(self) -> Floats:
        low: Floats = self.vertices[self.corners].min(axis=1)
        return low

    @property
    def high(self) -> Floats:
        high: Floats = self.vertices[self.corners].max(axis=1)
        return high

    def meet(self, rays: Rays, ray: Indices, primitive: Indices) -> Hits:
        """Return the intersections; the weights are those of the three corners."""
        corners = self.corners[primitive]
        # In one order of the vertices, whatever the triangle's, so that equal triangles have equal t.
        rows = self.vertices[corners]
        by_axis = [np.argsort(rows[:, :, 2], axis=1, kind="stable")]
        for axis in (1, 0):
            before = by_axis[-1]
            again = np.argsort(np.take_along_axis(rows[:, :, axis], before, 1), axis=1, kind="stable")
            by_axis.append(np.take_along_axis(before, again, 1))
        order = by_axis[-1]
        a, b, c = np.moveaxis(np.take_along_axis(rows, order[:, :, None], 1), 1, 0)
        start, direction = rays.start[ray], rays.direction[ray]
        z = np.abs(direction).argmax(axis=1)
        x, y = (z + 1) % 3, (z + 2) % 3
        scale = np.take_along_axis(direction, z[:, None], 1)
        slope = [np.take_along_axis(direction, axis[:, None], 1) / scale for axis in (x, y)]

        def sheared(corner: Floats) -> tuple[Floats, Floats, Floats]:
            """Return a corner (r, p) in the plane across the ray, and its length along it."""
            moved = corner[None] - start[:, None]
            u, v, w = (np.take_along_axis(moved, axis[:, None, None], 2)[:, :, 0] for axis in (x, y, z))
            return u - slope[0] * w, v - slope[1] * w, w / scale

        (ax, ay, at), (bx, by, bt), (cx, cy, ct) = (sheared(corner) for corner in (a, b, c))
        # Exchanging the ends of an edge changes the sign of its function and nothing else, also in rounding.
        first, second, third = cx * by - cy * bx, ax * cy - ay * cx, bx * ay - by * ax
        whole = first + second + third
        sign = np.sign(whole)
        met = whole != 0
        for side, dx, dy in ((first, cx - bx, cy - by), (second, ax - cx, ay - cy), (third, bx - ax, by - ay)):
            owned = (sign * dy > 0) | ((dy == 0) & (sign * dx > 0))
            met &= (sign * side > 0) | ((side == 0) & owned)
        i, j = np.nonzero(met)
        shares = np.stack([first[i, j], second[i, j], third[i, j]], axis=1) / whole[i, j][:, None]
        t = (shares * np.stack([at[i, j], bt[i, j], ct[i, j]], axis=1)).sum(axis=1)
        weights = np.empty(shares.shape)
        np.put_along_axis(weights, order[j], shares, 1)
        normal = np.cross(rows[:, 1] - rows[:, 0], rows[:, 2] - rows[:, 0])
        return Hits(ray[i], primitive[j], t, normal[j], weights)


@dataclass(frozen=True)
class Spheres:
    centres: Floats  # float64 (m, 3)
    radii: Floats  # float64 (m,)

    @property
    def low(self) -> Floats:
        return self.centres - self.radii[:, None]

    @property
    def high(self) -> Floats:
        return self.centres + self.radii[:, None]

    def meet(self, rays: Rays, ray: Indices, primitive: Indices) -> Hits:
        """Return the two intersections of each pair; rays that touch a sphere meet it twice at one t."""
        start, direction = rays.start[ray][:, None], rays.direction[ray][:, None]
        t, met = _on_sphere(start, direction, self.centres[primitive][None], self.radii[primitive][None])
        i, j, _ = np.nonzero(met)
        length = t[met]
        normal = start[i, 0] + length[:, None] * direction[i, 0] - self.centres[primitive[j]]
        return Hits(ray[i], primitive[j], length, normal, np.ones((len(i), 1)))


@dataclass(frozen=True)
class Segments:
    """Segments of tubes: all points within a radius of polylines, whose surface is met once where segments join.

    Of a segment, what lies in the segment before or after it is no surface. Segments that are no neighbours may
    penetrate each other; then each has its own surface.
    """

    # float64 (m, 3), different
    begins: Floats
    ends: Floats
    radius: float  # of the tubes
    # int64 (m,), the neighbours along the line; −1 at its ends
    before: Indices
    after: Indices

    @property
    def low(self) -> Floats:
        return np.minimum(self.begins, self.ends) - self.radius

    @property
    def high(self) -> Floats:
        return np.maximum(self.begins, self.ends) + self.radius

    def meet(self, rays: Rays, ray: Indices, primitive: Indices) -> Hits:
        """Return the intersections; the weights are those of the two ends, and constant on a cap."""
        start, direction = rays.start[ray][:, None], rays.direction[ray][:, None]
        begin, end = self.begins[primitive][None], self.ends[primitive][None]
        axis, length = _axis(begin, end)
        # On the side: the circle across the axis, from the point of the ray that is nearest to it.
        across = direction - (direction * axis).sum(axis=2, keepdims=True) * axis
        away = start - begin
        away = away - (away * axis).sum(axis=2, keepdims=True) * axis
        square = (across**2).sum(axis=2)
        with np.errstate(divide="ignore", invalid="ignore"):
            middle = -(away * across).sum(axis=2) / square
            nearest = away + middle[..., None] * across
            half = np.sqrt((self.radius**2 - (nearest**2).sum(axis=2)) / square)
        candidates = [(middle[..., None] + half[..., None] * [-1, 1], 0)]
        for cap, centre in ((-1, begin), (1, end)):
            t, met = _on_sphere(start, direction, centre, np.array(self.radius))
            candidates.append((np.where(met, t, np.nan), cap))
        parts = []
        for t, cap in candidates:
            i, j, k = np.nonzero(np.isfinite(t))
            which, at = primitive[j], t[i, j, k]
            point = start[i, 0] + at[:, None] * direction[i, 0]
            along = ((point - begin[0, j]) * axis[0, j]).sum(axis=1)
            of_cap = np.where(along < 0, -1, np.where(along > length[0, j], 1, 0))
            surface = (of_cap == cap) & ~self._hidden(point, which, cap)
            share = np.clip(along / length[0, j], 0, 1)
            normal = point - (begin[0, j] + (share * length[0, j])[:, None] * axis[0, j])
            hits = Hits(ray[i], which, at, normal, np.stack([1 - share, share], axis=1))
            parts.append(hits.some(surface))
        return parts[0].joined(parts[1:])

    def _hidden(self, point: Floats, which: Indices, cap: int) -> NDArray[np.bool_]:
        """Return which points (k, 3) on segments lie in a neighbour; the cap between two belongs to the first."""
        hidden = np.zeros(len(which), bool)
        for neighbour, sign in ((self.before[which], -1), (self.after[which], 1)):
            there = neighbour >= 0
            begin, end = self.begins[neighbour], self.ends[neighbour]
            axis, length = _axis(begin, end)
            along = ((point - begin) * axis).sum(axis=1)
            if cap == sign:
                # On the sphere around the end that both share: hidden where the neighbour's side begins.
                hidden |= there & ((along >= 0) | (cap < 0))
            else:
                nearest = begin + np.clip(along, 0, length)[:, None] * axis
                hidden |= there & (((point - nearest) ** 2).sum(axis=1) < self.radius**2 * (1 - 1e-12))
        return hidden


def _axis(begin: Floats, end: Floats) -> tuple[Floats, Floats]:
    length = np.linalg.norm(end - begin, axis=-1)
    return (end - begin) / length[..., None], length


def _on_sphere(start: Floats, direction: Floats, centre: Floats, radius: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Return both t (r, p, 2) of unit directions, and where there are any.

    The distance is that of the ray's nearest point, which keeps its digits when the start is far away.
    """
    away = start - centre
    middle = -(away * direction).sum(axis=2)
    nearest = away + middle[..., None] * direction
    square = radius**2 - (nearest**2).sum(axis=2)
    half = np.sqrt(np.maximum(square, 0))
    return middle[..., None] + half[..., None] * [-1, 1], np.repeat((square >= 0)[..., None], 2, axis=2)
