"""Reference of unstructured grids: rays through tetrahedra in float64, with exact predicates, and exact integrals.

A ray enters a tetrahedron through one face and leaves it through another. On which side of an edge the ray passes is
the sign of a determinant, which is exact. A ray through an edge or a corner counts as if it were moved by (ε, ε², ε³)
along x, y and z, for an ε below every number: it then meets no edge, and every tetrahedron in two faces or none. So it
passes each at most once, and where it leaves one it enters the next, through whatever corners and edges it runs.

Between two faces the scalar is linear. Colour and extinction are smooth between the control points of the transfer
function, so the ray is cut there, and each part is halved until Gaussian quadrature agrees with that of both halves.
Tetrahedra that overlap, of one grid or of several, are a mixture as volumes are: extinctions add up.

Reference: H. Edelsbrunner, E. P. Mücke: Simulation of simplicity, ACM Transactions on Graphics 9(1), 1990. N. Max:
Optical models for direct volume rendering, IEEE TVCG 1(2), 1995, section 4.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from clusterviz.content.grid.section import GridSection
from clusterviz.data.predicates import determinant_sign
from clusterviz.data.source import Grid
from clusterviz.data.tetrahedra import Tetrahedra, make_tetrahedra
from clusterviz.data.unstructured import FACES, UnstructuredGrid
from clusterviz.reference.fragments import Fragments
from clusterviz.reference.intersections import near_pairs
from clusterviz.reference.lighting import Material, lit
from clusterviz.reference.preintegrated import NODES, TO_NODES, WEIGHTS
from clusterviz.reference.rays import Columns, Floats, Rays
from clusterviz.reference.transfer import TransferFunction, transfer_function
from clusterviz.scene.values import Clip, Scene

Indices = NDArray[np.int64]
TOLERANCE = 1e-14
"""Of a part of a ray; thousands of parts stay below 1e-10."""
DARK = 2.0**-60
DIGITS = 1e-9
"""Relative error of a face's weights above which they are computed in fractions."""


@dataclass(frozen=True)
class PlacedCells:
    """One grid of a scene: its tetrahedra in the world, its transfer function, and what it reflects, if it is lit."""

    tetrahedra: Tetrahedra
    transfer: TransferFunction
    material: Material | None = None

    def lit(self, rays: Rays, scene: Scene, passages: Passages, own: Indices, t: Floats, colour: Floats) -> Floats:
        """Return straight colours (k, n, 3) at lengths t (k, n) of some passages under the lights of a scene."""
        assert self.material, "it is lit"
        ray, cell = passages.ray[own], passages.tetrahedron[own]
        corners = self.tetrahedra.corners[cell].astype(np.int64)
        points, values = (each[corners].astype(np.float64) for each in (self.tetrahedra.points, self.tetrahedra.values))
        edges, rises = points[:, 1:] - points[:, :1], values[:, 1:] - values[:, :1]
        gradient = np.linalg.solve(edges, rises[..., None])[..., 0]
        point = rays.start[ray, None] + t[..., None] * rays.direction[ray, None]
        several = (np.repeat(each, t.shape[1], axis=0) for each in (gradient, rays.direction[ray]))
        slope, way = several
        world = Grid((2, 2, 2))
        return lit(colour.reshape(-1, 3), slope, point.reshape(-1, 3), way, self.material, scene, world).reshape(
            colour.shape
        )


def place_cells(section: GridSection, grid: UnstructuredGrid) -> PlacedCells:
    """Return the tetrahedra of a completed section in the world."""
    found = make_tetrahedra(grid, section.array)
    if section.transform is not None:
        matrix = np.array(section.transform, np.float64)
        corners = found.corners if np.linalg.det(matrix[:3, :3]) > 0 else found.corners[:, [1, 0, 2, 3]]
        points = found.points @ matrix[:3, :3].T + matrix[:3, 3]
        found = replace(found, points=points, corners=corners)
    return PlacedCells(found, transfer_function(section), section if section.shade else None)


@dataclass(frozen=True)
class Passages(Columns):
    """Parts of rays in tetrahedra, (k,) each, in no order."""

    # int64 (k,)
    ray: Indices
    tetrahedron: Indices
    # float64 (k,), lengths along the ray, 0 ≤ begin ≤ end
    begin: Floats
    end: Floats
    # float64 (k,), scalars there
    front: Floats
    back: Floats

    def within(self, near: Floats, far: Floats) -> Passages:
        """Return the parts between two lengths of each ray, float64 (rays,)."""
        begin, end = np.maximum(self.begin, near[self.ray]), np.minimum(self.end, far[self.ray])
        at = self._scalar(begin), self._scalar(end)
        return Passages(self.ray, self.tetrahedron, begin, end, *at).some(begin < end)

    def _scalar(self, t: Floats) -> Floats:
        length = np.where(self.end > self.begin, self.end - self.begin, 1)
        scalar: Floats = self.front + (self.back - self.front) * ((t - self.begin) / length)
        return scalar


def find_passages(rays: Rays, tetrahedra: Tetrahedra) -> Passages:
    """Return where rays pass through tetrahedra, in front of their starts."""
    points, corners = tetrahedra.points.astype(np.float64), tetrahedra.corners.astype(np.int64)
    around = points[corners]
    boxes = around.min(axis=1), around.max(axis=1)
    found = [_meet(rays, points, corners, tetrahedra, *pair) for pair in near_pairs(rays, *boxes)]
    columns = [np.concatenate([np.empty(0), *each]) for each in zip(*found, strict=True)] or [np.empty(0)] * 6
    ray, cell = (column.astype(np.int64) for column in columns[:2])
    count = len(rays.direction)
    return Passages(ray, cell, *columns[2:]).within(np.zeros(count), np.full(count, np.inf))


def _meet(
    rays: Rays, points: Floats, corners: Indices, tetrahedra: Tetrahedra, ray: Indices, cell: Indices
) -> tuple[Floats, ...]:
    """Return ray, tetrahedron, begin, end, front and back of all pairs of rays (r,) and tetrahedra (p,)."""
    pairs = np.stack(np.meshgrid(ray, cell, indexing="ij"), axis=-1).reshape(-1, 2)
    sides = {edge: _side(rays, points, pairs[:, 0], *corners[pairs[:, 1]][:, edge].T) for edge in EDGES}
    entering, leaving = np.full(len(pairs), -1), np.full(len(pairs), -1)
    for number, face in enumerate(FACES["tetra"]):
        signs = [sides[a, b] if a < b else -sides[b, a] for a, b in zip(face, face[1:] + face[:1], strict=True)]
        for sign, met in ((-1, entering), (1, leaving)):
            met[np.logical_and.reduce([each == sign for each in signs])] = number
    hit = np.flatnonzero((entering >= 0) & (leaving >= 0))
    at, scalars = [], []
    for met in (entering, leaving):
        face = np.array(FACES["tetra"])[met[hit]]
        # In one order from both sides, so that t has the same digits.
        own = np.sort(np.take_along_axis(corners[pairs[hit, 1]], face, 1), axis=1)
        t, weights = _weights(rays, points, pairs[hit, 0], own)
        at.append(t)
        if tetrahedra.on_cells:
            scalars.append(tetrahedra.values[pairs[hit, 1]].astype(np.float64))
        else:
            scalars.append((weights * tetrahedra.values[own].astype(np.float64)).sum(axis=1))
    return pairs[hit, 0], pairs[hit, 1], at[0], np.maximum(*at), *scalars


EDGES = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))


def _side(rays: Rays, points: Floats, ray: Indices, begin: Indices, end: Indices) -> NDArray[np.int8]:
    """Return on which side of edges rays pass, 1 or −1; 0 for edges along the ray that it runs through."""
    start, direction, a, b = rays.start[ray], rays.direction[ray], points[begin], points[end]
    signs = determinant_sign((direction, a, b), (None, start, start))
    for axis in np.eye(3):
        left = np.flatnonzero(signs == 0)
        if not len(left):
            break
        along = np.broadcast_to(axis, (len(left), 3))
        signs[left] = determinant_sign((direction[left], b[left], along), (None, a[left], None))
    return signs


def _weights(rays: Rays, points: Floats, ray: Indices, corners: Indices) -> tuple[Floats, Floats]:
    """Return where rays meet the planes of faces (k, 3), t (k,), and the weights of the corners there (k, 3)."""
    start, direction = rays.start[ray], rays.direction[ray]
    away = points[corners] - start[:, None]
    a, b, c = np.moveaxis(away, 1, 0)
    parts = np.stack([(direction * np.cross(u, v)).sum(axis=1) for u, v in ((b, c), (c, a), (a, b))], axis=1)
    whole = parts.sum(axis=1)
    size = np.abs(direction).max(axis=1) * np.abs(away).max(axis=(1, 2)) ** 2
    weak = np.abs(whole) * DIGITS <= 2.0**-50 * size
    weights = np.clip(parts / np.where(weak, 1, whole)[:, None], 0, None)
    for n in np.flatnonzero(weak).tolist():
        weights[n] = _exact_weights(start[n], direction[n], points[corners[n]])
    weights /= weights.sum(axis=1, keepdims=True)
    t = (weights * (away * direction[:, None]).sum(axis=2)).sum(axis=1)
    return t, weights


def _exact_weights(start: Floats, direction: Floats, corners: Floats) -> list[float]:
    """Return the weights of three corners where a ray meets their plane, which is not along it."""
    o, d = ([Fraction(x) for x in each.tolist()] for each in (start, direction))
    a, b, c = ([Fraction(x) - y for x, y in zip(corner.tolist(), o, strict=True)] for corner in corners)

    def volume(u: list[Fraction], v: list[Fraction]) -> Fraction:
        return sum((d[i] * (u[i - 2] * v[i - 1] - u[i - 1] * v[i - 2]) for i in range(3)), Fraction(0))

    parts = [volume(b, c), volume(c, a), volume(a, b)]
    return [float(part / sum(parts)) for part in parts]


class Medium(Protocol):
    """What absorbs and glows by a scalar: a transfer function, or slabs of volumes by their number."""

    @property
    def colour_values(self) -> Floats: ...

    @property
    def opacity_values(self) -> Floats: ...

    def colour(self, s: Floats) -> Floats: ...

    def extinction(self, s: Floats) -> Floats: ...


@dataclass(frozen=True)
class UniformSlabs(Columns):
    """Slabs of rays that absorb evenly, such as those of volumes; the scalar is a slab's number."""

    ray: Indices  # int64 (k,)
    # float64 (k,), lengths along the ray, begin < end
    begin: Floats
    end: Floats
    depth: Floats  # float64 (k,), optical depth of each
    glow: Floats  # float64 (k, 3), its colour times its depth

    colour_values = opacity_values = np.empty(0)

    def colour(self, s: Floats) -> Floats:
        """Return straight colours (…, 3)."""
        found: Floats = (self.glow / np.where(self.depth > 0, self.depth, 1)[:, None])[np.rint(s).astype(np.int64)]
        return found

    def extinction(self, s: Floats) -> Floats:
        """Return extinctions (…,) per world unit."""
        found: Floats = (self.depth / (self.end - self.begin))[np.rint(s).astype(np.int64)]
        return found

    @property
    def passages(self) -> Passages:
        """The slabs as parts of rays."""
        number = np.arange(len(self.ray))
        scalar = number.astype(np.float64)
        return Passages(self.ray, number, self.begin, self.end, scalar, scalar)


def clip_range(rays: Rays, clip: Clip) -> tuple[Floats, Floats]:
    """Return the part [near, far] of each ray in the world that is not clipped, float64 (n,) each."""
    near, far = np.zeros(len(rays.direction)), np.full(len(rays.direction), np.inf)
    planes = [(np.array(origin), np.array(normal)) for origin, normal in clip.planes]
    if clip.box is not None:
        low, high = np.reshape(clip.box, (3, 2)).T
        planes += [(low, axis) for axis in np.eye(3)] + [(high, -axis) for axis in np.eye(3)]
    for origin, normal in planes:
        ahead, rate = (rays.start - origin) @ normal, rays.direction @ normal
        with np.errstate(divide="ignore", invalid="ignore"):
            t = -ahead / rate
        near = np.where(rate > 0, np.maximum(near, t), near)
        far = np.where(rate < 0, np.minimum(far, t), np.where((rate == 0) & (ahead < 0), -np.inf, far))
    return near, far


def march_cells(
    rays: Rays,
    grids: Sequence[PlacedCells],
    clip: Clip | None = None,
    fragments: Fragments | None = None,
    slabs: UniformSlabs | None = None,
    scene: Scene | None = None,
) -> Floats:
    """Return the colours of rays in the world, float64 (n, 4), premultiplied.

    The error of the integrals is below 1e-10; t itself is exact to a few roundings of its size.

    Parameters
    ----------
    grids : in any order
    clip : cuts rays where they cross its planes
    fragments : of meshes, lines and points, not clipped; what is in front of them is absorbed first
    slabs : of volumes, not clipped, which mix with the grids
    scene : whose lights the grids reflect; None: they are not lit
    """
    count = len(rays.direction)
    near, far = clip_range(rays, clip or Clip())
    every = [find_passages(rays, placed.tetrahedra).within(near, far) for placed in grids]
    media: list[Medium] = [placed.transfer for placed in grids]
    if slabs is not None:
        every, media = [*every, slabs.passages], [*media, slabs]
    lights = {}
    if scene is not None:
        lights = {n: partial(one.lit, rays, scene) for n, one in enumerate(grids) if one.material}
    course = _Course(every, media, fragments, count, lights)
    rgba, transmittance = np.zeros((count, 4)), np.ones(count)
    ray, emission, depth = course.parts()
    place = np.arange(len(ray)) - np.searchsorted(ray, ray)
    by_place = np.argsort(place, kind="stable")
    ends = np.cumsum(np.bincount(place))
    for begin, end in pairwise([0, *ends.tolist()]):
        some = by_place[begin:end]
        here = transmittance[ray[some], None]
        rgba[ray[some]] += here * np.column_stack([emission[some], -np.expm1(-depth[some])])
        transmittance[ray[some]] *= np.exp(-depth[some])
    return rgba


Lights = Mapping[int, Callable[[Passages, Indices, Floats, Floats], Floats]]


class _Course:
    """Rays cut at the ends of all passages, at control points and at fragments.

    An interval lies between two cuts of a ray. A member is a passage in an interval.
    """

    def __init__(
        self, every: list[Passages], media: list[Medium], fragments: Fragments | None, rays: int, lights: Lights
    ) -> None:
        self.media, self.lights = media, lights
        self.grid = np.repeat(np.arange(len(every)), [len(each.ray) for each in every])
        nothing = np.empty(0, np.int64)
        self.passages = Passages(nothing, nothing, *[np.empty(0)] * 4).joined(every)
        whole = self.passages
        cuts = [(whole.ray, whole.begin), (whole.ray, whole.end), *self._knots()]
        self.solid = np.empty((0, 2)), np.empty((0, 4))
        if fragments:
            of = np.repeat(np.arange(rays), np.diff(fragments.begins))
            cuts.append((of, fragments.t))
            self.solid = np.column_stack([of, fragments.t]), fragments.rgba
        ray, t = (np.concatenate(each) for each in zip(*cuts, strict=True))
        order = np.lexsort((t, ray))
        ray, t = ray[order], t[order]
        is_new = np.append(True, (ray[1:] != ray[:-1]) | (t[1:] != t[:-1]))[: len(ray)]
        self.ray, self.t = ray[is_new], t[is_new]
        # Members: the intervals that each passage covers.
        first, last = (self._place(whole.ray, at) for at in (whole.begin, whole.end))
        member = np.repeat(np.arange(len(whole.ray)), last - first)
        interval = np.repeat(first, last - first) + _within(last - first)
        by_interval = np.argsort(interval, kind="stable")
        self.member, interval = member[by_interval], interval[by_interval]
        self.begins = np.searchsorted(interval, np.arange(len(self.ray) + 1))

    def _knots(self) -> list[tuple[Indices, Floats]]:
        """Return rays and lengths where the scalar of a passage is that of a control point."""
        found, whole = list[tuple[Indices, Floats]](), self.passages
        for number, medium in enumerate(self.media):
            knots = np.unique(np.concatenate([medium.colour_values, medium.opacity_values]))
            some = np.flatnonzero(self.grid == number)
            front, back = whole.front[some], whole.back[some]
            low = np.searchsorted(knots, np.minimum(front, back), side="right")
            high = np.maximum(low, np.searchsorted(knots, np.maximum(front, back), side="left"))
            of = np.repeat(np.arange(len(some)), high - low)
            knot = knots[np.repeat(low, high - low) + _within(high - low)]
            share = (knot - front[of]) / (back - front)[of]
            begin, end = whole.begin[some][of], whole.end[some][of]
            found.append((whole.ray[some][of], np.clip(begin + share * (end - begin), begin, end)))
        return found

    def _place(self, ray: Indices, t: Floats) -> Indices:
        keys = np.empty(len(self.ray), [("ray", "i8"), ("t", "f8")])
        keys["ray"], keys["t"] = self.ray, self.t
        wanted = np.empty(len(ray), keys.dtype)
        wanted["ray"], wanted["t"] = ray, t
        # Records sort slowly, so both are ranked together.
        _, rank = np.unique(np.concatenate([keys, wanted]), return_inverse=True)
        return np.searchsorted(rank[: len(keys)], rank[len(keys) :])

    def parts(self) -> tuple[Indices, Floats, Floats]:
        """Return ray (k,), emission (k, 3) and optical depth (k,) of parts of rays, sorted by ray and length."""
        interval = np.flatnonzero(np.diff(self.begins) > 0)
        begin, end = self.t[interval], self.t[np.minimum(interval + 1, len(self.t) - 1)]
        emission, depth = self._integrate(interval, begin, end)
        done = np.zeros(len(interval), bool)
        while not done.all():
            ray = self.ray[interval]
            light = np.exp(-_before(ray, depth))
            todo = np.flatnonzero(~done & (light > DARK))
            done[:] = True
            middle = begin[todo] + (end[todo] - begin[todo]) / 2
            left = self._integrate(interval[todo], begin[todo], middle)
            right = self._integrate(interval[todo], middle, end[todo])
            both = left[0] + np.exp(-left[1])[:, None] * right[0], left[1] + right[1]
            wrong = np.maximum(np.abs(both[0] - emission[todo]).max(axis=1, initial=0), np.abs(both[1] - depth[todo]))
            apart = (light[todo] * wrong > TOLERANCE) & (middle > begin[todo]) & (middle < end[todo])
            emission[todo], depth[todo] = both
            cut = todo[apart]
            emission[cut], depth[cut] = left[0][apart], left[1][apart]
            done[cut] = False
            interval = np.insert(interval, cut + 1, interval[cut])
            begin, after = np.insert(begin, cut + 1, middle[apart]), end[cut]
            end[cut] = middle[apart]
            end, done = np.insert(end, cut + 1, after), np.insert(done, cut + 1, False)
            emission = np.insert(emission, cut + 1, right[0][apart], axis=0)
            depth = np.insert(depth, cut + 1, right[1][apart])
        (solid_ray, solid_t), rgba = self.solid[0].T, self.solid[1]
        with np.errstate(divide="ignore"):
            solid_depth = -np.log1p(-rgba[:, 3])
        ray, t = np.append(solid_ray, self.ray[interval]).astype(np.int64), np.append(solid_t, begin)
        emission = np.concatenate([rgba[:, 3:] * rgba[:, :3], emission])
        order = np.lexsort((t, ray))
        return ray[order], emission[order], np.append(solid_depth, depth)[order]

    def _integrate(self, interval: Indices, begin: Floats, end: Floats) -> tuple[Floats, Floats]:
        """Return emission (k, 3) and optical depth (k,) of parts of intervals by Gaussian quadrature."""
        counts = np.diff(self.begins)[interval]
        part = np.repeat(np.arange(len(interval)), counts)
        member = self.member[np.repeat(self.begins[interval], counts) + _within(counts)]
        kappa, glow = np.zeros((len(interval), 8)), np.zeros((len(interval), 8, 3))
        whole, t = self.passages, begin[:, None] + (end - begin)[:, None] * NODES
        length = np.where(whole.end > whole.begin, whole.end - whole.begin, 1)
        for number, medium in enumerate(self.media):
            some = np.flatnonzero(self.grid[member] == number)
            own, of = member[some], part[some]
            share = (t[of] - whole.begin[own, None]) / length[own, None]
            scalar = whole.front[own, None] + share * (whole.back - whole.front)[own, None]
            extinction = medium.extinction(scalar)
            np.add.at(kappa, of, extinction)
            colour = medium.colour(scalar)
            if number in self.lights:
                colour = self.lights[number](whole, own, t[of], colour)
            np.add.at(glow, of, extinction[..., None] * colour)
        way = end - begin
        before = way[:, None] * (kappa @ TO_NODES.T)
        emission = way[:, None] * np.einsum("kn,knc->kc", WEIGHTS * np.exp(-before), glow)
        return emission, way * (kappa @ WEIGHTS)


def _within(counts: Indices) -> Indices:
    return np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)


def _before(ray: Indices, depth: Floats) -> Floats:
    """Return about the optical depth in front of each part of sorted rays, limited to what is dark."""
    limited = np.minimum(depth, 64.0)
    total = np.cumsum(limited) - limited
    first = np.searchsorted(ray, ray)
    found: Floats = total - total[first]
    return found
