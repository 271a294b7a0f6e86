"""Reference of isosurfaces, alone or in a volume: every crossing of every ray, front to back.

Along a ray, a trilinear field is a cubic polynomial in each cell. Slabs are cut at the faces of cells, and each piece
at the extrema of the polynomial. Between extrema the field is monotone and crosses a value at most once; the crossing
is found by bisection. Splines have degree nine in a cell: their extrema are those of the cubic through four points.
Nearest voxels give a constant field that jumps at the faces half-way between voxels.

Reference: G. Marmitt, A. Kleer, I. Wald, H. Friedrich, P. Slusallek: Fast and accurate ray-voxel intersection
techniques for iso-surface ray tracing, VMV 2004, section 3 (the extrema of the cubic isolate its roots). S. Parker, P.
Shirley, Y. Livnat, C. Hansen, P.-P. Sloan: Interactive ray tracing for isosurface rendering, IEEE Visualization 1998,
section 3.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.source import Grid
from clusterviz.reference.ambient_occlusion import lit_volume
from clusterviz.reference.grading import glow_and_extinction, needs_gradient
from clusterviz.reference.layers import HalfOpacity, gradient_normals
from clusterviz.reference.lighting import SAMPLERS, gradient_at
from clusterviz.reference.rays import Floats, Rays, kept
from clusterviz.reference.slabs import Slab, in_brick, pieces_of, slabs
from clusterviz.reference.transfer import transfer_function
from clusterviz.scene.values import Scene

HALVINGS = 48  # of an interval between two extrema, to the last digits of float64
THIRDS = np.array([0.0, 1 / 3, 2 / 3, 1.0])


@dataclass(frozen=True)
class Crossings:
    """The n-th crossing of rays in their slabs."""

    slabs: NDArray[np.int64]  # int (c,), indices of the slabs
    place: Floats  # float64 (c,), world lengths along the rays
    surface: NDArray[np.int64]  # int (c,), indices of the values
    inside: Floats  # float64 (c, 3), points in the rays' cells, where the field has a gradient


class RayField:
    """Field along rays, from slab to slab.

    `rays`: rays in index space; `values`: values of the isosurfaces, ascending.
    """

    def __init__(self, rays: Rays, voxels: NDArray[Any], interpolation: str, values: Floats) -> None:
        self._voxels, self._sample, self._values = voxels, SAMPLERS[interpolation], np.asarray(values, np.float64)
        # Nearest voxels are the centres of their cells.
        self._shift = 0.5 if interpolation == "nearest" else 0.0
        self._rays = rays
        self._before = np.full(len(rays.direction), np.nan)

    def crossings(self, which: NDArray[np.int64], begin: Floats, end: Floats) -> Iterator[Crossings]:
        """Yield the first crossing of each ray in its slab, then the second, and so on.

        The field is continuous between pieces, so that no crossing is lost between them. Next to an invalid voxel there
        is no field, and no crossing.
        """
        rays = Rays(self._rays.start[which] + self._shift, self._rays.direction[which])
        shape = tuple(samples + int(2 * self._shift) for samples in self._voxels.shape)
        every = Slab(np.arange(len(which)), begin, np.maximum(begin, end), rays.start)
        found = [self._in_cells(part, rays, which) for part in pieces_of(every, rays, shape, 1)]
        parts = [np.concatenate(some) for some in zip(*found, strict=True)]
        slabs, place, surface, inside = (part[np.argsort(parts[0], kind="stable")] for part in parts)
        nth = np.arange(len(slabs)) - np.searchsorted(slabs, slabs)
        for n in range(nth.max(initial=-1) + 1):
            yield Crossings(slabs[nth == n], place[nth == n], surface[nth == n], inside[nth == n])

    def _in_cells(
        self, part: Slab, rays: Rays, which: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], Floats, NDArray[np.int64], Floats]:
        """Return the crossings in one cell of each slab, front to back."""
        some = np.flatnonzero(part.end > part.begin)
        valid = self._field(rays, some, part.point[some], part.begin[some])[1]
        self._before[which[some[~valid]]] = np.nan
        some = some[valid]
        piece = part.some(some)
        cuts, at_cuts = self._monotone(rays, piece)
        before = self._before[which[some]]
        at_cuts[0] = np.where(np.isnan(before), at_cuts[0], before)
        self._before[which[some]] = at_cuts[-1]
        # Along (part, number of the crossing in it, piece): a decreasing field meets the highest value first.
        reached = at_cuts[:, None] >= self._values[:, None]
        rises = (at_cuts[1:] > at_cuts[:-1])[:, None]
        nth = np.arange(len(self._values))[:, None]
        surface = np.where(rises, nth, nth[::-1])
        crossed = np.take_along_axis(reached[1:] != reached[:-1], surface, axis=1)
        piece_of, part_of, nth_of = np.nonzero(crossed.transpose(2, 0, 1))
        met = surface[part_of, nth_of, piece_of]
        low, high = cuts[part_of, piece_of], cuts[part_of + 1, piece_of]
        place = self._root(rays, piece, piece_of, (low, high), self._values[met], rises[part_of, 0, piece_of])
        inside = self._inside(rays, some[piece_of], piece.point[piece_of], place)
        return some[piece_of], place, met, inside

    def _monotone(self, rays: Rays, piece: Slab) -> tuple[Floats, Floats]:
        """Return ends of the intervals in which the field is monotone, and its values there, float64 (4, p) each."""
        length = piece.end - piece.begin
        places = piece.begin + THIRDS[:, None] * length
        fields = np.stack([self._field(rays, piece.rays, piece.point, at)[0] for at in places])
        turns = np.sort(extrema(fields), axis=0)
        cuts = np.stack([piece.begin, *(piece.begin + turns * length), piece.end])
        at_turns = [self._field(rays, piece.rays, piece.point, at)[0] for at in cuts[1:3]]
        return cuts, np.stack([fields[0], *at_turns, fields[3]])

    def _root(
        self,
        rays: Rays,
        piece: Slab,
        of: NDArray[np.int64],
        between: tuple[Floats, Floats],
        value: Floats,
        rises: NDArray[np.bool_],
    ) -> Floats:
        low, high = between
        for _ in range(HALVINGS if len(of) else 0):
            middle = low + (high - low) / 2
            before = (self._field(rays, piece.rays[of], piece.point[of], middle)[0] < value) == rises
            low, high = np.where(before, middle, low), np.where(before, high, middle)
        return low

    def _field(self, rays: Rays, of: NDArray[np.int64], cell: Floats, at: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Return the field of given cells; a point on a face may lie outside of its cell by rounding."""
        field: tuple[Floats, NDArray[np.bool_]] = self._sample(self._voxels, *self._inside(rays, of, cell, at).T)
        return field

    def _inside(self, rays: Rays, of: NDArray[np.int64], cell: Floats, at: Floats) -> Floats:
        point = in_brick(rays.start[of] + at[:, None] * rays.direction[of], cell, 1)
        return np.floor(cell) if self._shift else point


def extrema(fields: Floats) -> Floats:
    """Return the extrema of cubic polynomials, float64 (2, p) in 0 … 1; 1 where there is none.

    `fields`: float64 (4, p), values of the polynomials at 0, 1/3, 2/3 and 1.
    """
    a, b, c, d = fields / np.maximum(np.abs(fields).max(axis=0), np.finfo(np.float64).tiny)
    slope, bend, twist = -11 * a + 18 * b - 9 * c + 2 * d, 9 * (2 * a - 5 * b + 4 * c - d), 27 * (3 * (b - c) + d - a)
    # Twice the derivative is slope + 2 · bend · t + twist · t².
    square = bend * bend - slope * twist
    root = -(bend + np.copysign(np.sqrt(np.maximum(square, 0)), bend))
    with np.errstate(divide="ignore", invalid="ignore"):
        turns = np.stack([root / twist, slope / root])
    return np.where((square > 0) & (turns > 0) & (turns < 1), turns, 1.0)


def march_surfaces(
    rays: Rays, voxels: NDArray[Any], length: float, scene: Scene, grid: Grid, passed: HalfOpacity | None = None
) -> Floats:
    """Return the colours of rays, (n, 4).

    The surfaces of a slab are all of its crossings. In a composited volume the parts of a slab before, between and
    behind its surfaces absorb light as its midpoint does. `passed` is written.
    """
    volume = scene.volumes[0]
    classify, sample = transfer_function(volume), SAMPLERS[volume.interpolation]
    entries = [e if isinstance(e, tuple) else (e, float(classify.opacity(e))) for e in volume.isosurfaces]
    wanted, numbers = sorted(entries), 1 + np.array(sorted(range(len(entries)), key=lambda n: entries[n][0]))
    rgba = np.zeros((len(rays.direction), 4))

    def absorb(
        pixels: NDArray[np.int64],
        alpha: Floats,
        colour: Floats,
        way: tuple[Floats, Floats],
        number: NDArray[np.int64] | int = 0,
        points: Floats | None = None,
    ) -> None:
        if passed:
            if points is None:
                points = rays.start[pixels] + (0.5 * (way[0] + way[1]))[:, None] * rays.direction[pixels]
            with np.errstate(divide="ignore"):
                depth = -np.log1p(-alpha)
            normals = gradient_normals(points, (volume, voxels, grid))
            passed.take(pixels, 1 - rgba[pixels, 3], depth, way, number, normals)
        share = (1 - rgba[pixels, 3:]) * alpha[:, None]
        rgba[pixels] += share * np.append(colour, np.ones((len(pixels), 1)), axis=1)

    def gradients(point: Floats) -> Floats | None:
        return gradient_at(volume, voxels, point) if needs_gradient(volume) else None

    def lit_up(
        colour: Floats, gradient: Floats | None, point: Floats, pixels: NDArray[np.int64], box: tuple[int, ...] = ()
    ) -> Floats:
        return lit_volume((volume, voxels, grid), scene, colour, gradient, point, rays.direction[pixels], box)

    course = RayField(rays, voxels, volume.interpolation, np.array([value for value, _ in wanted]))
    opacities, colours = (np.array([entry[1] for entry in wanted]), classify.colour(np.array([v for v, _ in wanted])))
    for slab in slabs(rays, voxels.shape, length, lambda: rgba[:, 3] < 1):
        middle, known = sample(voxels, *slab.point.T)
        known &= kept(slab.point, scene.clip, grid) & (volume.blending == "composite")
        gradient = gradients(slab.point)
        glow, extinction = glow_and_extinction(volume, classify, middle, gradient, grid, slab.point)
        glow, extinction = lit_up(glow, gradient, slab.point, slab.rays, voxels.shape), np.where(known, extinction, 0)
        begin = slab.begin.copy()
        for met in course.crossings(slab.rays, slab.begin, slab.end):
            here, pixels = met.slabs, slab.rays[met.slabs]
            way = begin[here], met.place
            absorb(pixels, -np.expm1(-extinction[here] * (way[1] - way[0])), glow[here], way)
            begin[here] = met.place
            point = rays.start[pixels] + met.place[:, None] * rays.direction[pixels]
            colour = lit_up(colours[met.surface], gradients(met.inside), point, pixels)
            alpha = np.where(kept(point, scene.clip, grid), opacities[met.surface], 0)
            absorb(pixels, alpha, colour, (met.place, met.place), numbers[met.surface], met.inside)
        absorb(slab.rays, -np.expm1(-extinction * (slab.end - begin)), glow, (begin, slab.end))
    return rgba
