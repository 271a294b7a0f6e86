"""Reference ray caster in float64 NumPy, with which every fast path is compared.

It follows the definition of the picture (docs/, frames and units: the optical model, the sampling lattice) and shares
no code with the renderer, only the scene's values and the grid.

It has no early ray termination, hardware texture filter or float32 pixels, as it measures their errors. A ray stops
only when its transmittance is at most 2⁻⁶⁰, below the last bit of float64.

A thin lens is the mean of the pictures that its points see. All rays of a pixel meet in one point of the plane in
focus, so that what is there is sharp. The error of the mean falls as the number of points grows, at about its power −1
for smooth scenes, −3/4 at edges.

Reference: P. Haeberli, K. Akeley: The accumulation buffer: hardware support for high-quality rendering, SIGGRAPH 1990,
4. H. Vogel: A better way to construct the sunflower head, Mathematical Biosciences 44, 1979.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.content.volume.optics import optical_function
from clusterviz.data.source import Grid
from clusterviz.errors import InputError
from clusterviz.reference.ambient_occlusion import lit_volume
from clusterviz.reference.cells import PlacedCells
from clusterviz.reference.fragments import SectionGeometry, place
from clusterviz.reference.grading import glow_and_extinction, needs_gradient
from clusterviz.reference.layers import HalfOpacity, gradient_normals, layers_of
from clusterviz.reference.lighting import SAMPLERS, gradient_at
from clusterviz.reference.multi_volume import PlacedVolume, march_mixture
from clusterviz.reference.preintegrated import is_ramped, march_preintegrated
from clusterviz.reference.projections import projection_of
from clusterviz.reference.rays import (
    Floats,
    Rays,
    camera_rays,
    kept,
    on_slices,
    pixel_shifts,
    to_index_space,
    view_direction,
)
from clusterviz.reference.refraction import Bent
from clusterviz.reference.slabs import slabs
from clusterviz.reference.surfaces import march_surfaces
from clusterviz.reference.transfer import transfer_function
from clusterviz.scene.background import background_rgb
from clusterviz.scene.values import Scene

RAYS_AT_ONCE = 1 << 14  # all temporaries of one slab together stay near 5 MB: cache, not memory
DARK = 2.0**-60


def reference_layers(
    scene: Scene,
    grid: Grid | Sequence[Grid],
    voxels: NDArray[Any] | Sequence[NDArray[Any]],
    geometry: Sequence[SectionGeometry] = (),
) -> dict[str, NDArray[Any]]:
    """Return all layers of a scene's picture, see `layers_of`; parameters and errors as of `render_reference`."""
    met = HalfOpacity.of(camera_rays(scene.camera, scene.image.size).direction)
    rgba = render_reference(scene, grid, voxels, met=met, geometry=geometry)
    return layers_of(met, rgba, view_direction(scene.camera))


def render_reference(
    scene: Scene,
    grid: Grid | Sequence[Grid],
    voxels: NDArray[Any] | Sequence[NDArray[Any]],
    step: float | None = None,
    met: HalfOpacity | None = None,
    geometry: Sequence[SectionGeometry] = (),
    cells: Sequence[PlacedCells] = (),
    lens_point: Sequence[float] = (0.0, 0.0),
) -> Floats:
    """Ray cast the scene's volume; `multi_volume.py` handles several, and geometry.

    Along a ray through a pixel's centre, slab k is [t0 + k·h, t0 + (k+1)·h), the last one cut where the ray leaves the
    box [first sample, last sample]. With jitter, t0 lies a fraction of h in front of the box, and the first slab is cut
    as well. With slices, slabs lie between planes, see `on_slices`. The scalar is interpolated at the midpoint and then
    classified. A slab of length d adds T · c · (1 −
    e^{−κd}) and multiplies the transmittance T by e^{−κd}. See `projections.py` and `surfaces.py` for other blend
    modes. The volume is transparent next to NaN and infinite voxels (in the cells that they touch; for `nearest`, where
    they are the nearest), and where a midpoint is clipped.

    Returns float64 (h, w, 4), premultiplied, before the background; transparent if the box has no thickness along an
    axis. It converges with order step² where voxels and transfer function are smooth along the ray. Raises InputError:
    the shape of `voxels` is not the grid's, the step is not positive, the camera is degenerate or not complete, or
    there are not as many grids as volumes.

    Reference: N. Max: Optical models for direct volume rendering, IEEE TVCG 1(2), 1995, section 4 (absorption plus
    emission).

    Parameters
    ----------
    scene : complete (every default filled in)
    grid : grid of the samples, with any invertible direction matrix; a sequence for several volumes
    voxels : (z, y, x), of the grid's shape, any integer or float type; a sequence for several volumes
    step : h in units of the smallest spacing; by default the scene's `quality.step`
    met : written, if given, for the layers of the picture; not of projections
    geometry : meshes, lines and points with their sections, in the order of the scene
    cells : unstructured grids in the world, with their transfer functions
    lens_point : from which the scene is seen, see `camera_rays` and `lens.py`
    """
    if (geometry or cells) and isinstance(grid, Grid):
        grid, voxels = [grid], [np.asarray(voxels)]
    if not isinstance(grid, Grid):
        if len(scene.volumes) != 1 or geometry or cells:
            return _render_mixture(scene, grid, list(voxels), step, met, geometry, cells, lens_point)
        (grid,), (voxels,) = grid, voxels
    if not isinstance(voxels, np.ndarray):
        raise InputError("not an array", where="voxels", found=type(voxels).__name__, allowed="an array of the grid")
    _check(scene, grid, voxels)
    length = _slab_length(scene.quality.step if step is None else step, grid)
    width, height = scene.image.size
    rgba = np.zeros((width * height, 4))
    if scene.volumes and min(grid.shape_zyx) > 1:
        voxels = np.ascontiguousarray(voxels)
        placed = camera_rays(scene.camera, (width, height), lens_point)
        rays = to_index_space(placed, grid)
        shifts = pixel_shifts((width, height))
        for begin in range(0, len(rgba), RAYS_AT_ONCE):
            part = slice(begin, begin + RAYS_AT_ONCE)
            volume = scene.volumes[0]
            has_surfaces = volume.blending in ("composite", "isosurface") and bool(volume.isosurfaces)
            jittered = scene.quality.jitter and not has_surfaces
            some = Rays(rays.start[part], rays.direction[part], shifts[part] if jittered else 0.0)
            most, passed = 2 * min(grid.spacing), met and met.part(part)
            length = min(length, most) if is_ramped(volume, scene) else length
            if scene.quality.renderer == "slices" and not has_surfaces:
                last = np.array(voxels.shape[::-1]) - 1.0
                some = on_slices(some, placed.direction[part], last, grid.corners, length, scene)
            if has_surfaces:
                # Surfaces alone are the same, however long slabs are.
                each = most if volume.blending == "isosurface" else min(length, most)
                rgba[part] = march_surfaces(some, voxels, each, scene, grid, passed)
            elif is_ramped(volume, scene):
                rgba[part] = march_preintegrated(some, voxels, length, scene, grid, passed)
            elif volume.optics is not None and volume.refracts:
                background = background_rgb(scene.image.background) or (0.0, 0.0, 0.0)
                bent = Bent(len(some.direction), optical_function(volume.optics), background)
                bent.march(some, voxels, min(length, most), volume, grid)
                rgba[part] = bent.finish(transfer_function(volume))
            elif volume.blending == "composite":
                rgba[part] = _march(some, voxels, length, scene, grid, passed)
            else:
                rgba[part] = _project(some, voxels, length, scene, grid)
    return rgba.reshape(height, width, 4)


def _render_mixture(
    scene: Scene,
    grids: Sequence[Grid],
    voxels: Sequence[NDArray[Any]],
    step: float | None,
    met: HalfOpacity | None,
    geometry: Sequence[SectionGeometry],
    cells: Sequence[PlacedCells],
    lens_point: Sequence[float],
) -> Floats:
    """Return the picture of several volumes, geometry and unstructured grids."""
    if not len(grids) == len(voxels) == len(scene.volumes):
        found = f"{len(grids)} grids, {len(voxels)} arrays"
        raise InputError("not one for each volume", where="volumes", found=found, allowed=len(scene.volumes))
    volumes = [
        PlacedVolume(*each) for each in zip(scene.volumes, grids, map(np.ascontiguousarray, voxels), strict=True)
    ]
    for placed in volumes:
        if placed.voxels.shape != placed.grid.shape_zyx:
            raise InputError(
                "not the grid's shape", where="voxels", found=placed.voxels.shape, allowed=placed.grid.shape_zyx
            )
    width, height = scene.image.size
    rgba = np.zeros((width * height, 4))
    jittered = scene.quality.jitter and not any(volume.isosurfaces for volume in scene.volumes)
    rays, shifts = camera_rays(scene.camera, (width, height), lens_point), pixel_shifts((width, height))
    placed_geometry = [place(*each) for each in geometry]
    for begin in range(0, len(rgba) if volumes or placed_geometry or cells else 0, RAYS_AT_ONCE):
        part = slice(begin, begin + RAYS_AT_ONCE)
        some = Rays(rays.start[part], rays.direction[part], shifts[part] if jittered else 0.0)
        length = scene.quality.step if step is None else step
        rgba[part] = march_mixture(some, volumes, length, scene, met and met.part(part), placed_geometry, cells)
    return rgba.reshape(height, width, 4)


def _march(
    rays: Rays, voxels: NDArray[Any], length: float, scene: Scene, grid: Grid, met: HalfOpacity | None
) -> Floats:
    """Return the colours of rays, (n, 4), slab after slab for all rays that are inside and not opaque."""
    volume = scene.volumes[0]
    classify, sample = transfer_function(volume), SAMPLERS[volume.interpolation]
    rgba = np.zeros((len(rays.direction), 4))
    transmittance = np.ones(len(rgba))
    for slab in slabs(rays, voxels.shape, length, lambda: transmittance > DARK):
        scalar, valid = sample(voxels, *slab.point.T)
        valid &= kept(slab.point, scene.clip, grid)
        gradient = gradient_at(volume, voxels, slab.point) if needs_gradient(volume) else None
        colour, extinction = glow_and_extinction(volume, classify, scalar, gradient, grid, slab.point)
        depth = np.where(valid, extinction, 0) * (slab.end - slab.begin)
        if met:
            part, normals = (slab.begin, slab.end), gradient_normals(slab.point, (volume, voxels, grid))
            met.take(slab.rays, transmittance[slab.rays], depth, part, 0, normals)
        # expm1: 1 − e^{−κd} would lose an opacity of 1e-8 to rounding.
        weight = transmittance[slab.rays] * -np.expm1(-depth)
        colour = np.where(valid[:, None], colour, 0)
        ray = rays.direction[slab.rays]
        colour = lit_volume((volume, voxels, grid), scene, colour, gradient, slab.point, ray, voxels.shape)
        rgba[slab.rays, :3] += weight[:, None] * colour
        rgba[slab.rays, 3] += weight
        transmittance[slab.rays] *= np.exp(-depth)
    return rgba


def _project(rays: Rays, voxels: NDArray[Any], length: float, scene: Scene, grid: Grid) -> Floats:
    """Return the colours of rays, (n, 4), in a projection or of isosurfaces."""
    volume = scene.volumes[0]
    classify, sample = transfer_function(volume), SAMPLERS[volume.interpolation]
    background = background_rgb(scene.image.background) or (0.0, 0.0, 0.0)
    projection = projection_of(volume, len(rays.direction), classify, background)
    for slab in slabs(rays, voxels.shape, length, lambda: True):
        scalar, valid = sample(voxels, *slab.point.T)
        valid &= kept(slab.point, scene.clip, grid)
        projection.take(slab.rays, scalar, valid, slab.end - slab.begin)
    return projection.finish(classify)


def _slab_length(step: float, grid: Grid) -> float:
    if not (step > 0 and math.isfinite(step)):
        raise InputError("no step", where="step", found=step, allowed="above 0")
    return step * min(grid.spacing)


def _check(scene: Scene, grid: Grid, voxels: NDArray[Any]) -> None:
    if voxels.shape != grid.shape_zyx:
        raise InputError("not the grid's shape", where="voxels", found=voxels.shape, allowed=grid.shape_zyx)
    if len(scene.volumes) > 1:
        raise InputError("one grid for several volumes", where="grid", found=1, allowed=len(scene.volumes))


GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))


def disc_points(count: int) -> Floats:
    """Return points spread evenly over a disc of radius 1, float64 (count, 2), as the seeds of a sunflower."""
    number = np.arange(count)
    radius, angle = np.sqrt((number + 0.5) / count), number * GOLDEN_ANGLE
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def render_lens(scene: Scene, grid: Any, voxels: Any, *, points: Floats, **more: Any) -> Floats:
    """Return the picture of a scene with `camera.aperture`, float64 (h, w, 4), premultiplied.

    `scene`: complete; `grid`, `voxels`, `more`: as of `render_reference`; `points`: float64 (n, 2), of the lens, in its
    radii.
    """
    total: Floats = np.zeros((*scene.image.size[::-1], 4))
    for point in points:
        total += render_reference(scene, grid, voxels, lens_point=point.tolist(), **more)
    return total / len(points)
