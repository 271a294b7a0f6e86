"""Reference of several volumes and geometry in one scene: emission and absorption of their mixture, slab by slab.

Rays are cut into slabs in the axis-aligned box around all content. A slab lies in every volume that contains its
midpoint. The extinctions of these volumes add up, κ = Σ κ_i, and its colour is the mean Σ κ_i c_i / Σ κ_i. See
`volume_layers.py` for pre-integrated classification and isosurfaces.

A surface fragment at depth t belongs to the slab that holds t: the volumes are absorbed up to t, then the fragment,
then the rest. See `fragments.py`.

The midpoint of a slab decides whether the slab lies in a volume. For pre-integrated classification and isosurfaces, the
part of the slab in the volume is used: the scalar changes linearly from one end of that part to the other, or crosses
an isosurface's value between them. The integral gives the optical depth of the part and its mean colour weighted by κ.
The order of absorption within a slab is ignored, as it is mixed with other volumes.

Reference: N. Max: Optical models for direct volume rendering, IEEE TVCG 1(2), 1995, section 2 and 4: particles of
several kinds absorb and glow independently, so both densities are sums. K. Engel, M. Kraus, T. Ertl: High-quality
pre-integrated volume rendering using hardware-accelerated pixel shading, Graphics Hardware 2001, section 3.3 (integral
functions, without attenuation within a slab).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.content.flow.expansion import LicVolume
from clusterviz.data.source import Grid
from clusterviz.reference.ambient_occlusion import lit_volume
from clusterviz.reference.cells import PlacedCells, UniformSlabs, march_cells
from clusterviz.reference.fragments import Fragments, PlacedGeometry, find_fragments, joined_fragments
from clusterviz.reference.grading import glow_and_extinction, needs_gradient
from clusterviz.reference.layers import Field, HalfOpacity, gradient_normals
from clusterviz.reference.lighting import SAMPLERS, gradient_at, lit_line
from clusterviz.reference.preintegrated import is_ramped, ramp
from clusterviz.reference.rays import Floats, Rays, inside, kept, on_slices, to_index_space
from clusterviz.reference.slabs import Slab, slabs_in
from clusterviz.reference.surfaces import Crossings, RayField
from clusterviz.reference.transfer import transfer_function
from clusterviz.scene.values import Scene, Volume

Flags = NDArray[np.bool_]
SLACK = 1e-9
"""Of its length, by which a volume's box is widened, so that rounding does not decide who sees what lies on a face."""


@dataclass(frozen=True)
class PlacedVolume:
    """One volume: its scene entry, its grid and its voxels (z, y, x)."""

    volume: Volume
    grid: Grid
    voxels: NDArray[Any]

    @property
    def has_extent(self) -> bool:
        """Whether it has an extent along every axis; else it is not drawn."""
        return min(self.grid.shape_zyx) > 1


@dataclass(frozen=True)
class Layer:
    """A surface in a slab of rays: a fragment of geometry, or an isosurface."""

    place: Floats  # float64 (m,), world length along the ray
    opacity: Floats  # float64 (m,), 0 where the slab has no surface
    colour: Floats  # float64 (m, 3), straight
    number: NDArray[np.int64]  # int (m,), of the object
    # gives unit normals in the world, (k, 3), of some of the rays, int (k,)
    normals: Callable[[NDArray[np.int64]], Floats]

    def note(self, met: HalfOpacity, rays: NDArray[np.int64], before: Floats, opacity: Floats, place: Floats) -> None:
        """Let rays meet the surface at a place, with an opacity; parameters as of `HalfOpacity.take`."""
        with np.errstate(divide="ignore"):
            depth = -np.log1p(-opacity)
        met.take(rays, before, depth, (place, place), self.number, self.normals)


def has_ends(volume: Volume, scene: Scene) -> bool:
    """Return whether the picture depends on the field at the ends of slabs."""
    return bool(volume.isosurfaces) or is_ramped(volume, scene)


class VolumeRays:
    """Rays through one volume.

    `rays`: rays in the world. `first`: number of the volume as an object; its isosurfaces follow as they are listed.
    `components`: voxels of the components of a LIC volume's vectors.
    """

    def __init__(
        self, rays: Rays, placed: PlacedVolume, scene: Scene, first: int, components: Sequence[NDArray[Any]] = ()
    ) -> None:
        self.components = components
        self.volume, self.grid, self.voxels, self.scene = placed.volume, placed.grid, placed.voxels, scene
        self.field: Field = placed.volume, placed.voxels, placed.grid
        self.rays, self.last = to_index_space(rays, placed.grid), np.array(placed.grid.shape_zyx[::-1], np.float64) - 1
        self.transfer, self.sampler = transfer_function(placed.volume), SAMPLERS[placed.volume.interpolation]
        wider = Rays(self.rays.start + SLACK * self.last, self.rays.direction)
        self.entry, self.leave = inside(wider, (1 + 2 * SLACK) * self.last)
        entries = (e if isinstance(e, tuple) else (e, float(self.transfer.opacity(e))) for e in self.volume.isosurfaces)
        self.first = first
        self.wanted = sorted((*entry, first + n) for n, entry in enumerate(entries, start=1) if entry[1] > 0)
        values = np.array([value for value, _, _ in self.wanted])
        self.course = RayField(self.rays, self.voxels, self.volume.interpolation, values)

    def absorbing(self, slab: Slab, seen: Flags) -> tuple[Floats, Floats]:
        """Return the optical depth (m,) of a slab, and its colour times that (m, 3).

        `seen`: bool (m,), rays whose slab is not clipped.
        """
        if self.volume.blending != "composite":
            return np.zeros(len(seen)), np.zeros((len(seen), 3))
        return self._ramp(slab, seen) if is_ramped(self.volume, self.scene) else self._midpoint(slab, seen)

    def surfaces(self, slab: Slab) -> Iterator[Layer]:
        """Return the isosurfaces in a slab; they are clipped at their own positions."""
        if not self.wanted:
            return
        values, opacities, numbers = np.array(self.wanted).T
        colours, numbers = self.transfer.colour(values), numbers.astype(int)
        for met in self.course.crossings(slab.rays, *self._part(slab)):
            yield self._met(slab, met, opacities[met.surface], colours[met.surface], numbers[met.surface])

    def _met(self, slab: Slab, met: Crossings, opacity: Floats, colour: Floats, number: NDArray[np.int64]) -> Layer:
        """Return a surface at its position."""
        here, count = met.slabs, len(slab.rays)
        alpha, place, colours = np.zeros(count), np.full(count, np.inf), np.zeros((count, 3))
        place[here] = met.place
        point = self.rays.start[slab.rays[here]] + met.place[:, None] * self.rays.direction[slab.rays[here]]
        alpha[here] = np.where(kept(point, self.scene.clip, self.grid), opacity, 0)
        gradient = gradient_at(self.volume, self.voxels, met.inside) if self.volume.shade else None
        colours[here] = self._lit(slab.rays[here], point, colour, gradient, ())
        numbers, inside = np.zeros(count, np.int64), np.zeros((count, 3))
        numbers[here], inside[here] = number, met.inside
        return Layer(place, alpha, colours, numbers, gradient_normals(inside, self.field))

    def _midpoint(self, slab: Slab, seen: Flags) -> tuple[Floats, Floats]:
        """Return absorption of a slab with the sample of its midpoint."""
        middle = slab.begin + (slab.end - slab.begin) / 2
        inside = np.flatnonzero(seen & (middle >= self.entry[slab.rays]) & (middle <= self.leave[slab.rays]))
        depth, glow = np.zeros(len(seen)), np.zeros((len(seen), 3))
        point = np.clip(self.points(slab, middle)[inside], 0, self.last)
        scalar, valid = self.sampler(self.voxels, *point.T)
        gradient = self._gradient(point) if needs_gradient(self.volume) else None
        colour, extinction = glow_and_extinction(self.volume, self.transfer, scalar, gradient, self.grid, point)
        depth[inside] = np.where(valid, extinction, 0) * (slab.end - slab.begin)[inside]
        colour = self._lit(slab.rays[inside], point, np.where(valid[:, None], colour, 0), gradient)
        glow[inside] = depth[inside, None] * colour
        return depth, glow

    def _gradient(self, point: Floats) -> Floats:
        """Return the gradients at points (m, 3), or the vectors of a LIC volume."""
        if not isinstance(self.volume, LicVolume):
            return gradient_at(self.volume, self.voxels, point)
        vectors: Floats = np.stack([self.sampler(each, *point.T)[0] for each in self.components], axis=1)
        return vectors

    def _ramp(self, slab: Slab, seen: Flags) -> tuple[Floats, Floats]:
        """Return absorption of a slab with a linear scalar.

        Light and gradient opacity are those of the part's midpoint; an end without a scalar has the midpoint's.
        """
        begin, end = self._part(slab)
        places = [np.clip(self.points(slab, at), 0, self.last) for at in (begin, begin + (end - begin) / 2, end)]
        way = np.maximum(end - begin, 0)
        glow, depth, gradient = ramp(self.field, self.transfer, places, way, seen, attenuated=False)
        colour = glow / np.where(depth > 0, depth, 1)[:, None]
        return depth, depth[:, None] * self._lit(slab.rays, places[1], colour, gradient)

    def _part(self, slab: Slab) -> tuple[Floats, Floats]:
        """Return begin and end, (m,) each, of the part of a slab in the volume; end ≤ begin if there is none.

        Both lie in the slab; rays that miss the volume enter it at infinity.
        """
        entry, leave = self.entry[slab.rays], self.leave[slab.rays]
        return np.clip(entry, slab.begin, slab.end), np.clip(leave, slab.begin, slab.end)

    def points(self, slab: Slab, at: Floats) -> Floats:
        """Return the points (m, 3) of a slab's rays at given lengths."""
        points: Floats = self.rays.start[slab.rays] + at[:, None] * self.rays.direction[slab.rays]
        return points

    def _lit(
        self,
        rays: NDArray[np.int64],
        point: Floats,
        colour: Floats,
        gradient: Floats | None,
        box: tuple[int, ...] | None = None,
    ) -> Floats:
        """Return straight colours (m, 3), lit by the scene's lights if the volume is lit; `box` as in `lit`."""
        if not self.volume.shade:
            return colour
        if gradient is None:
            gradient = gradient_at(self.volume, self.voxels, np.clip(point, 0, self.last))
        direction = self.rays.direction[rays]
        if isinstance(self.volume, LicVolume):
            return lit_line(colour, gradient, point, direction, self.volume, self.scene, self.grid)
        box = self.voxels.shape if box is None else box
        return lit_volume(self.field, self.scene, colour, gradient, point, direction, box)


DARK = 2.0**-60
LONGEST = 2.0
"""Of a slab, in the smallest spacing, where anything depends on the field at its ends."""
GROWTH = 2.0**-10
"""Of the box around all where geometry lies beyond the volumes, in the smallest spacing."""


def march_mixture(
    rays: Rays,
    volumes: Sequence[PlacedVolume],
    step: float,
    scene: Scene,
    met: HalfOpacity | None = None,
    geometry: Sequence[PlacedGeometry] = (),
    cells: Sequence[PlacedCells] = (),
) -> Floats:
    """Return the colours of rays, float64 (n, 4), premultiplied.

    Volumes absorb evenly along a slab. Unstructured grids are integrated exactly, and where they overlap with a slab,
    extinctions add up at every point.

    Parameters
    ----------
    rays : rays in the world
    volumes : the volumes, in any order
    step : length of a slab in the smallest spacing of all volumes
    scene : for its lights, its clipping and its classification
    met : written, if given; a slab is that of the volume that absorbs most in it
    geometry : meshes, lines and points, in the order of the scene
    cells : unstructured grids, in any order
    """
    firsts = np.cumsum([0, *(1 + len(placed.volume.isosurfaces) for placed in volumes)]).tolist()
    fragments = FragmentQueue(find_fragments(rays, geometry, scene), firsts[-1], met)
    if not volumes:
        if cells:
            return march_cells(rays, cells, scene.clip, fragments.fragments, scene=scene)
        return fragments.composite_all()
    spacing = min(min(placed.grid.spacing) for placed in volumes)
    # The box is a little larger than geometry beyond the volumes, so that nothing lies on its faces by rounding.
    corners = np.concatenate([placed.grid.corners for placed in volumes])
    boxes = [np.array(placed.tetrahedra.bounds or np.empty((0, 3))) for placed in cells]
    bounds = np.concatenate([np.empty((0, 3)), *(each.bounds for each in geometry), *boxes])
    growth = GROWTH * spacing + 2.0**-48 * np.abs(bounds).max(initial=0.0)
    low, high = corners.min(axis=0), corners.max(axis=0)
    least, greatest = bounds.min(axis=0, initial=np.inf), bounds.max(axis=0, initial=-np.inf)
    low, high = np.where(least < low, least - growth, low), np.where(greatest > high, greatest + growth, high)
    most = LONGEST if any(has_ends(placed.volume, scene) for placed in volumes) else step
    length = min(step, most) * spacing
    # World lengths from the box's low corner.
    box = Grid((1, 1, 1), origin=(float(low[0]), float(low[1]), float(low[2])))
    placed_rays = to_index_space(rays, box)
    if scene.quality.renderer == "slices" and not any(placed.volume.isosurfaces for placed in volumes):
        around = np.array(list(product(*zip(low, high, strict=True))))
        placed_rays = on_slices(placed_rays, rays.direction, high - low, around, length, scene)
    rgba, transmittance = np.zeros((len(rays.direction), 4)), np.ones(len(rays.direction))
    passages = [
        VolumeRays(rays, placed, scene, first, [each.voxels for each in volumes[max(0, number - 3) : number]])
        for number, (placed, first) in enumerate(zip(volumes, firsts, strict=False))
        if placed.has_extent
    ]
    mixed, crossed = list[UniformSlabs](), list[Fragments]()
    nothing = np.empty(0)
    none = UniformSlabs(np.empty(0, np.int64), nothing, nothing, nothing, np.empty((0, 3)))
    for slab in slabs_in(placed_rays, high - low, length, lambda: transmittance > DARK):
        seen = kept(slab.point, scene.clip, box)
        depth, glow = np.zeros(len(seen)), np.zeros((len(seen), 3))
        each = [passage.absorbing(slab, seen) for passage in passages]
        for more, light in each:
            depth, glow = depth + more, glow + light
        colour = glow / np.where(depth > 0, depth, 1)[:, None]
        isosurfaces = [one for passage in passages for one in passage.surfaces(slab)]
        if cells:
            absorbing = UniformSlabs(slab.rays, slab.begin, slab.end, depth, glow)
            mixed.append(absorbing.some(np.flatnonzero(depth > 0)))
            crossed += [_as_fragments(slab, one, len(rgba)) for one in isosurfaces]
            continue
        passed = _Passed(met, slab, passages, np.array([more for more, _ in each])) if met else None
        _pass(rgba, transmittance, slab, depth, colour, [*isosurfaces, *fragments.take(slab)], passed)
    if cells:
        every = joined_fragments([*crossed, fragments.fragments])
        return march_cells(rays, cells, scene.clip, every, none.joined(mixed), scene)
    fragments.composite_rest(rgba, transmittance)
    return rgba


def _as_fragments(slab: Slab, surface: Layer, rays: int) -> Fragments:
    """Return the fragments of an isosurface in a slab, without normals and of no entry."""
    some = np.flatnonzero(surface.opacity > 0)
    begins = np.searchsorted(slab.rays[some], np.arange(rays + 1))
    rgba = np.column_stack([surface.colour, surface.opacity])[some]
    return Fragments(begins, surface.place[some], rgba, np.full(len(some), -1), np.zeros((len(some), 3)))


class FragmentQueue:
    """Fragments of rays, of which each slab takes those in front of its end; `next` is the first of each ray left.

    `first`: number of the first entry of geometry as an object; `met`: written by `composite_rest`.
    """

    def __init__(self, fragments: Fragments, first: int = 0, met: HalfOpacity | None = None) -> None:
        self.fragments, self.next = fragments, fragments.begins[:-1].copy()
        self.first, self.met = first, met

    def take(self, slab: Slab) -> Iterator[Layer]:
        """Yield the fragments of a slab, in order, one for each ray at a time."""
        while True:
            layer, here = self._layer(slab.rays, slab.end)
            if not here.any():
                return
            self.next[slab.rays[here]] += 1
            yield layer

    def composite_rest(self, rgba: Floats, transmittance: Floats) -> None:
        """Composite what is left behind the pixels: what rounding puts beyond the last slab, and rays without slabs."""
        rays = np.arange(len(rgba))
        while True:
            layer, here = self._layer(rays, np.full(len(rays), np.inf))
            if not here.any():
                return
            self.next[here] += 1
            if self.met:
                layer.note(self.met, rays, transmittance, layer.opacity, layer.place)
            weight = transmittance * layer.opacity
            rgba += weight[:, None] * np.column_stack([layer.colour, np.ones(len(rays))])
            transmittance *= 1 - layer.opacity

    def composite_all(self) -> Floats:
        """Return the picture of the fragments alone, float64 (n, 4)."""
        rgba, transmittance = np.zeros((len(self.next), 4)), np.ones(len(self.next))
        self.composite_rest(rgba, transmittance)
        return rgba

    def _layer(self, rays: NDArray[np.int64], end: Floats) -> tuple[Layer, Flags]:
        """Return the next fragment of each ray in front of `end`, and where there is one."""
        left = self.next[rays] < self.fragments.begins[rays + 1]
        t, rgba = np.full(len(rays), np.inf), np.zeros((len(rays), 4))
        t[left] = self.fragments.t[self.next[rays[left]]]
        here = left & (t < end)
        which, numbers, normals = self.next[rays[here]], np.zeros(len(rays), np.int64), np.zeros((len(rays), 3))
        rgba[here], numbers[here] = self.fragments.rgba[which], self.first + self.fragments.entry[which]
        normals[here] = self.fragments.normal[which]
        return Layer(np.where(here, t, np.inf), rgba[:, 3], rgba[:, :3], numbers, lambda some: normals[some]), here


def _pass(
    rgba: Floats,
    transmittance: Floats,
    slab: Slab,
    depth: Floats,
    colour: Floats,
    met: Sequence[Layer],
    passed: _Passed | None,
) -> None:
    """Composite a slab behind the pixels: its surfaces at their positions, and between them its uniform absorption.

    `depth`, `colour`: float64 (m,), (m, 3), optical depth and colour of the whole slab. `met`: surfaces of the slab,
    isosurfaces first; equal places keep this order. `passed`: takes all parts, if given.
    """
    places = np.array([one.place for one in met]).reshape(-1, len(depth))
    order = np.argsort(places, axis=0, kind="stable")
    alphas = np.array([one.opacity for one in met]).reshape(-1, len(depth))
    colours = np.array([one.colour for one in met]).reshape(-1, len(depth), 3)
    begin, pixel = slab.begin, np.arange(len(depth))
    for which in order:
        place = np.clip(places[which, pixel], slab.begin, slab.end)
        part = depth * (place - begin) / (slab.end - slab.begin)
        if passed:
            passed.take_part(transmittance, part, begin, place)
        _absorb(rgba, transmittance, slab.rays, part, colour)
        alpha = alphas[which, pixel]
        if passed:
            passed.take_surfaces(transmittance, alpha, place, which, met)
        weight = transmittance[slab.rays] * alpha
        rgba[slab.rays] += weight[:, None] * np.column_stack([colours[which, pixel], np.ones(len(depth))])
        transmittance[slab.rays] *= 1 - alpha
        begin = place
    part = depth * (slab.end - begin) / (slab.end - slab.begin)
    if passed:
        passed.take_part(transmittance, part, begin, slab.end)
    _absorb(rgba, transmittance, slab.rays, part, colour)


@dataclass(frozen=True)
class _Passed:
    """Takes the parts of a slab for `HalfOpacity`."""

    met: HalfOpacity
    slab: Slab
    volumes: Sequence[VolumeRays]
    depths: Floats  # float64 (volumes, m), optical depth of each volume in the slab

    def take_part(self, transmittance: Floats, depth: Floats, begin: Floats, end: Floats) -> None:
        """Take the mixture between two places (m,)."""
        densest, middle = self.depths.argmax(axis=0), 0.5 * (begin + end)
        for n, one in enumerate(self.volumes):
            rays = self.slab.rays
            own = np.where(densest == n, depth, 0)
            normals = gradient_normals(one.points(self.slab, middle), one.field)
            self.met.take(rays, transmittance[rays], own, (begin, end), one.first, normals)

    def take_surfaces(
        self, transmittance: Floats, alpha: Floats, place: Floats, which: NDArray[np.int64], met: Sequence[Layer]
    ) -> None:
        """Take one of the surfaces of each ray."""
        for n, one in enumerate(met):
            rays = self.slab.rays
            one.note(self.met, rays, transmittance[rays], np.where(which == n, alpha, 0), place)


def _absorb(rgba: Floats, transmittance: Floats, rays: NDArray[np.int64], depth: Floats, colour: Floats) -> None:
    weight = transmittance[rays] * -np.expm1(-depth)
    rgba[rays, :3] += weight[:, None] * colour
    rgba[rays, 3] += weight
    transmittance[rays] *= np.exp(-depth)
