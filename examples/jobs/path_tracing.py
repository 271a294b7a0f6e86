"""Path tracing of a volume: light scattered many times, absorbed and emitted, traced from the eye by single-pixel jobs.

A collision in the volume emits `1 - scattering` of the transfer function's colour, and scatters `scattering` of it;
extinction is the transfer function's. Without scattering the picture is that of `clusterviz.render`; with it the volume
is lit by a uniform environment and by the directional light of the scene. `shade` has no effect.

Collisions are found by delta tracking, with the largest extinction of each block of the volume's summary; light from
one direction is found by next-event estimation, with ratio tracking. Random numbers are functions of pixel, sample and
their count on the path. So pixels do not depend on ranks, on the order of jobs, and on how voxels are divided: pictures
are equal bit for bit on devices of the same kind.

Jobs are groups of interleaved rows. Each rank holds a copy of the voxels if it has the memory; else they are in a
distributed array, and a job reads regions of it, one after the other, and traces its paths through each.

References
----------
E. Woodcock et al., Techniques used in the GEM code for Monte Carlo neutronics calculations, Argonne 1965. J. Novák,
A. Selle, W. Jarosz, Residual ratio tracking for estimating attenuation, ACM TOG 33(6), 2014. L. Szirmay-Kalos et al.,
Free path sampling in high resolution inhomogeneous participating media, CGF 30(1), 2011 (majorants of cells).
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 6.2.6.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from clusterviz.content.transfer import transfer_function
from clusterviz.data.bricks import Box
from clusterviz.data.source import Grid, Source
from clusterviz.data.summary import VolumeSummary, block_counts, block_sides
from clusterviz.errors import InputError, SceneError
from clusterviz.frame.opening import open_content
from clusterviz.frame.run import Options, Run
from clusterviz.image.picture import Image
from clusterviz.jobs.cluster import Cluster
from clusterviz.jobs.job import job
from clusterviz.jobs.kernel import kernel
from clusterviz.plan.view import View, make_view
from clusterviz.report.machine import HELD_SHARE_OF_MEMORY, memory
from clusterviz.scene import background_rgb
from clusterviz.scene.camera import camera_vectors
from clusterviz.scene.transfer import OPAQUE, TransferFunction
from clusterviz.scene.values import Scene

Floats = NDArray[np.float64]
Colour = tuple[float, float, float]
Place = tuple[int, ...]

PIXELS_OF_JOB = 1 << 13
REGION_CELLS = 128
"""Cells along the side of a region of voxels, about; a job reads one region at a time."""
REGIONS_KEPT = 4
ROUNDED = 1.0 + 1e-5
"""Factor of majorants, for rounded samples."""
PATH_PLANES, NUMBER_PLANES = 9, 14
PIXEL, BLOCK, SAMPLE = 3, 4, 13
"""Planes of `numbers`, as in trace_paths.glsl: number of the pixel, block of the path, number of the sample."""
SUMS = 7


@dataclass(frozen=True)
class PathTracing:
    """Settings of path tracing.

    Attributes
    ----------
    samples : paths of a pixel
    scattering : share of the extinction that scatters, 0 to 1; the rest absorbs, and emits the colour
    anisotropy : mean cosine of the scattering angle, −0.99 to 0.99 (Henyey and Greenstein); 0: isotropic
    environment : radiance from all directions, (r, g, b); it lights the volume, and is not in the picture
    max_scatterings : a path ends then, which darkens media that absorb next to nothing
    samples_of_pass : a picture is there after each pass
    seed : of the random numbers
    voxels : "replica": each rank holds all voxels; "blocks": they are distributed; "auto": by the memory
    """

    samples: int = 64
    scattering: float = 1.0
    anisotropy: float = 0.0
    environment: Colour = (1.0, 1.0, 1.0)
    max_scatterings: int = 1000
    samples_of_pass: int = 16
    seed: int = 1
    voxels: Literal["auto", "replica", "blocks"] = "auto"

    def __post_init__(self) -> None:
        limits: tuple[tuple[str, float, float], ...] = (
            *(("samples", 1, 1 << 24), ("scattering", 0, 1), ("anisotropy", -0.99, 0.99)),
            *(("max_scatterings", 0, 1 << 20), ("samples_of_pass", 1, 1 << 12), ("seed", 0, (1 << 31) - 1)),
        )
        for name, low, high in limits:
            if not low <= getattr(self, name) <= high:
                raise InputError("impossible value", where=name, found=getattr(self, name), allowed=f"{low} to {high}")
        if not all(math.isfinite(part) and part >= 0 for part in self.environment):
            raise InputError("no radiance", where="environment", found=self.environment, allowed="three numbers ≥ 0")


@dataclass(frozen=True, eq=False)
class TracedPicture:
    """Picture after some samples.

    Attributes
    ----------
    image : float32 (h, w, 4), premultiplied, before the background; opacity is the share of paths that met the volume
    standard_error : float32 (h, w, 4), of each mean; infinite after one sample
    samples : of each pixel, so far
    voxels : "replica" or "blocks"
    """

    image: Image
    standard_error: NDArray[np.float32]
    samples: int
    voxels: str


@kernel("numbers.glsl", "trace_paths.glsl", writes=("paths", "numbers"), vectors=("colours", "opacities", "paths"))
def advance_paths(
    voxels: Any,
    majorants: Any,
    colours: Any,
    opacities: Any,
    paths: Any,
    numbers: Any,
    first_voxel: Any,
    first_block: Any,
    end_block: Any,
    block_cells: Any,
    volume_cells: Any,
    voxels_along_x: float,
    voxels_along_y: float,
    voxels_along_z: float,
    per_unit: float,
    scattering: float,
    anisotropy: float,
    environment: float,
    irradiance: float,
    to_light: float,
    most_scatterings: int,
    seed: int,
    end_sample: int,
) -> None:
    """Advance the paths of pixels until they have all samples, leave the voxels at hand, or have many events."""


def trace_paths(
    cluster: Cluster, scene: Scene, settings: PathTracing | None = None, source: Source | None = None
) -> Iterator[TracedPicture | None]:
    """Yield the picture of a scene after each pass, on rank 0; None on others; collective.

    Parameters
    ----------
    cluster : whose ranks trace
    scene : one composited volume, with its transfer function, camera and at most one directional light
    source : of the voxels; by default the scene's file

    Raises
    ------
    SceneError
        The scene holds something that is not traced.
    """
    settings, channel = settings or PathTracing(), cluster.channel
    run = Run(channel, Options())
    with run.local("open"):
        _check_scene(scene)
    scene, opened, _ = open_content(run, scene, source)
    (volume,) = opened.volumes
    with run.local("plan"):
        medium = make_medium(volume.grid.shape_zyx, transfer_function(scene.volumes[0]), volume.summary)
        scattering = _scattering(scene, settings, medium, volume.grid)
        view = make_view(scene.camera, scene.image.size, volume.grid)
    held = _held_voxels(cluster, settings.voxels, medium, scene.cluster.memory_limit)
    regions = _regions(cluster, held, volume.source, medium)
    width, height = view.size
    groups = -(-height // max(1, min(PIXELS_OF_JOB // width, height)))
    sums = cluster.array((groups, -(-height // groups), width, 8), np.float64, (1, height, width))
    for first in range(0, settings.samples, settings.samples_of_pass):
        end = min(first + settings.samples_of_pass, settings.samples)

        @job(reads=lambda group: (sums, sums.box((group, 0, 0))))
        def trace_rows(group: int, first: int = first, end: int = end) -> None:
            rows = np.arange(group, height, groups)
            paths, numbers = start_paths(view, volume.grid, medium, rows, first)
            while (region := regions.most_wanted(numbers, end)) is not None:
                voxels, *places = regions.voxels(region)
                advance_paths[1, len(rows), width](
                    voxels, *medium.tables, paths, numbers, *places, *scattering, settings.seed, end
                )
            box = (group, 0, 0), (group + 1, len(rows), width)
            found = np.concatenate(list(paths[SUMS : SUMS + 2]), axis=-1)
            sums[box] = sums[box] + found

        cluster.run(trace_rows, grid=groups)
        sums.sync()
        yield _picture(sums[...], view.size, end, scene, held) if channel.rank == 0 else None


@dataclass(frozen=True, eq=False)
class Medium:
    """Volume as paths meet it; vectors (x, y, z), arrays (z, y, x).

    Attributes
    ----------
    cells : of the volume along each axis
    sides : cells along the sides of a block
    majorants : float32 (bz, by, bx), per world unit, not less than the extinction in a block
    colours : float32 (1, 1, n, 4), value and r, g, b of control points; values as of `scaled`
    opacities : float32 (1, 1, m, 4), value, opacity, 0, 0
    per_unit : 1 / unit distance of the opacity
    domain : the data values that become 0 and 1
    """

    cells: tuple[int, int, int]
    sides: tuple[int, int, int]
    majorants: NDArray[np.float32]
    colours: NDArray[np.float32]
    opacities: NDArray[np.float32]
    per_unit: float
    domain: tuple[float, float]

    @property
    def tables(self) -> tuple[NDArray[np.float32], ...]:
        """Majorants and control points, as arguments of `advance_paths`."""
        return self.majorants, self.colours, self.opacities

    @property
    def shape_zyx(self) -> tuple[int, int, int]:
        """Samples along z, y, x."""
        x, y, z = self.cells
        return z + 1, y + 1, x + 1

    def scaled(self, values: NDArray[Any]) -> NDArray[np.float32]:
        """Return data values with the domain as 0 to 1; NaN of those that are not finite."""
        low, high = self.domain
        # Half of each, as their difference may be larger than any float64.
        found = (np.asarray(values, np.float64) * 0.5 - low * 0.5) / (high * 0.5 - low * 0.5)
        return np.where(np.isfinite(values), np.clip(found, -1e30, 1e30), np.nan).astype(np.float32)


def make_medium(shape_zyx: tuple[int, int, int], transfer: TransferFunction, summary: VolumeSummary) -> Medium:
    """Return the medium of a volume, with majorants of the blocks of its summary."""
    z, y, x = shape_zyx
    blocks = summary.blocks
    if blocks is None:  # of a store that keeps none
        whole = [np.full(block_counts(shape_zyx), value) for value in summary.value_range]
        blocks = np.stack(whole)
    side_z, side_y, side_x = block_sides(shape_zyx)
    medium = Medium(
        (x - 1, y - 1, z - 1),
        (side_x, side_y, side_z),
        np.zeros(blocks.shape[1:], np.float32),
        np.zeros((1, 1, len(transfer.colours), 4), np.float32),
        np.zeros((1, 1, len(transfer.opacities), 4), np.float32),
        1.0 / transfer.unit_distance,
        transfer.domain,
    )
    medium.majorants[...] = ROUNDED * majorants(transfer, *blocks)
    medium.colours[0, 0, :, 0], medium.colours[0, 0, :, 1:] = medium.scaled(transfer.colour_values), transfer.colours
    medium.opacities[0, 0, :, 0] = medium.scaled(transfer.opacity_values)
    medium.opacities[0, 0, :, 1] = np.minimum(transfer.opacities, OPAQUE)
    return medium


def majorants(transfer: TransferFunction, low: Floats, high: Floats) -> Floats:
    """Return the largest extinction of the scalars in closed intervals, float64 (…); 0 of empty ones (low > high)."""
    is_empty = ~(low <= high)
    low, high = (np.where(is_empty, 0.0, end) for end in (low, high))
    # The ends may lie a rounding error away from where a step is.
    found = np.maximum(transfer.opacity(low), transfer.opacity(high))
    margin = 1e-6 * np.maximum(transfer.domain[1] - transfer.domain[0], np.maximum(np.abs(low), np.abs(high)))
    for value, opacity in zip(transfer.opacity_values, transfer.opacities, strict=True):
        inside = (low - margin <= value) & (value <= high + margin)
        found = np.where(inside, np.maximum(found, opacity), found)
    extinction = -np.log1p(-np.minimum(found, OPAQUE)) / transfer.unit_distance
    return np.where(is_empty, 0.0, extinction)


def start_paths(
    view: View, grid: Grid, medium: Medium, rows: NDArray[np.int64], first_sample: int
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Return the paths of rows of pixels, where their rays enter the volume.

    Parameters
    ----------
    grid : of the volume
    rows : of the picture

    Returns
    -------
    paths : float32 (9, rows, w, 4), as trace_paths.glsl keeps them
    numbers : int32 (14, rows, w); the number of a pixel is −1 where its ray does not meet the volume
    """
    width, (column, row) = view.size[0], view.centre
    right = (np.arange(width) + 0.5 - column) * view.pixel
    up = (row - rows - 0.5) * view.pixel
    across = right[None, :, None] * np.array(view.right) + up[:, None, None] * np.array(view.up)
    origin, along = np.broadcast_to(np.array(view.eye), across.shape), np.array(view.forward) + across
    if view.parallel:
        origin, along = origin + across, np.broadcast_to(np.array(view.forward), across.shape)
    else:  # one world unit long
        along = along / np.sqrt(1.0 + right[None, :] ** 2 + up[:, None] ** 2)[..., None]
    cells = np.array(medium.cells, np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        faces = np.stack([-origin, cells - origin]) / along
    beside = np.where((origin >= 0) & (origin <= cells), -np.inf, np.inf)
    enters = np.where(along == 0, beside, faces.min(axis=0)).max(axis=-1)
    leaves = np.where(along == 0, -beside, faces.max(axis=0)).min(axis=-1)
    enters = np.maximum(enters, 0.0)
    meets = leaves > enters
    at = np.clip(origin + np.where(meets, enters, 0.0)[..., None] * along, 0.0, cells)
    block = np.minimum(at // medium.sides, np.array(medium.majorants.shape[::-1]) - 1)
    paths = np.zeros((PATH_PLANES, len(rows), width, 4), np.float32)
    numbers = np.zeros((NUMBER_PLANES, len(rows), width), np.int32)
    paths[0, ..., :3] = at - block * medium.sides
    paths[1, ..., :3] = along @ grid.world_from_index[:3, :3].T
    numbers[:PIXEL] = numbers[BLOCK : BLOCK + 3] = np.moveaxis(block, -1, 0)
    numbers[PIXEL] = np.where(meets, rows[:, None] * width + np.arange(width), -1)
    numbers[SAMPLE] = first_sample
    return paths, numbers


class Regions:
    """Regions of voxels that a job reads, each of whole blocks and the samples around them.

    Parameters
    ----------
    read : reads a box of samples, (z, y, x)
    blocks : along the sides of a region, (x, y, z)
    """

    def __init__(self, read: Callable[[Box], NDArray[Any]], medium: Medium, blocks: tuple[int, int, int]) -> None:
        self._read, self._medium, self._blocks = read, medium, np.array(blocks)
        self._counts = -(-np.array(medium.majorants.shape[::-1]) // self._blocks)
        self.voxels = lru_cache(REGIONS_KEPT)(self._voxels)

    def most_wanted(self, numbers: NDArray[np.int32], end_sample: int) -> int | None:
        """Return the region in which most paths of `start_paths` wait; None if no path does."""
        waits = (numbers[PIXEL] >= 0) & (numbers[SAMPLE] < end_sample)
        if not waits.any():
            return None
        places = numbers[BLOCK : BLOCK + 3, waits] // self._blocks[:, None]
        return int(np.bincount(np.ravel_multi_index(tuple(places), tuple(self._counts))).argmax())

    def _voxels(self, region: int) -> tuple[NDArray[np.float32], Place, Place, Place]:
        """Return the voxels of a region, its first voxel, and its first and end block: as in `advance_paths`."""
        medium = self._medium
        begin = np.array(np.unravel_index(region, tuple(self._counts))) * self._blocks
        end = np.minimum(begin + self._blocks, medium.majorants.shape[::-1])
        first = begin * medium.sides
        last = np.minimum(end * medium.sides, medium.cells)
        (z, y, x), (z_end, y_end, x_end) = first[::-1].tolist(), (last[::-1] + 1).tolist()
        voxels = medium.scaled(self._read(((z, y, x), (z_end, y_end, x_end))))
        return voxels, (x, y, z), tuple(begin.tolist()), tuple(end.tolist())


def _regions(cluster: Cluster, held: str, source: Source, medium: Medium) -> Regions:
    """Return the voxels of a rank: all in one region, or regions of a distributed array; collective."""
    if held == "replica":
        x, y, z = medium.majorants.shape[::-1]
        return Regions(lambda box: source.read(*box), medium, (x, y, z))
    array = cluster.array_from(source)
    x, y, z = (max(1, REGION_CELLS // side) for side in medium.sides)
    return Regions(array.read, medium, (x, y, z))


def _held_voxels(cluster: Cluster, asked: str, medium: Medium, limit_bytes: int | None) -> str:
    """Return how voxels are held, the same on all ranks: "replica" or "blocks"; collective."""
    if asked != "auto":
        return asked
    channel = cluster.channel
    free = HELD_SHARE_OF_MEMORY * memory().available_bytes / channel.placement().local_size
    # While they are scaled, float64 values lie beside those that were read, and the float32 ones.
    needed = 20 * math.prod(medium.shape_zyx)
    fits = channel.allgather(needed <= min(free, limit_bytes or free))
    return "replica" if all(fits) else "blocks"


def _scattering(scene: Scene, settings: PathTracing, medium: Medium, grid: Grid) -> tuple[Any, ...]:
    """Return the arguments of `advance_paths` from `block_cells` to `most_scatterings`."""
    index_from_world = np.linalg.inv(grid.world_from_index[:3, :3])
    return (
        medium.sides,
        medium.cells,
        *(tuple(column) for column in index_from_world.T.tolist()),
        medium.per_unit,
        settings.scattering,
        settings.anisotropy,
        settings.environment,
        *_light_of(scene),
        settings.max_scatterings,
    )


def _light_of(scene: Scene) -> tuple[Colour, Colour]:
    """Return irradiance and direction towards the light of a scene; no irradiance without one.

    A white diffuse surface that faces a light of intensity 1 has radiance 1.
    """
    if not scene.lights:
        return (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)
    (light,) = scene.lights
    position, focal_point, _ = camera_vectors(scene.camera)
    if light.position is not None and light.type == "scene":
        position, focal_point = light.position, light.focal_point
    towards = np.subtract(position, focal_point)
    towards = towards / np.abs(towards).max()
    x, y, z = (towards / np.linalg.norm(towards)).tolist()
    red, green, blue = (math.pi * light.intensity * part for part in light.color)
    return (red, green, blue), (x, y, z)


def _check_scene(scene: Scene) -> None:
    """Refuse what path tracing does not show.

    Raises
    ------
    SceneError
    """
    if len(scene.volumes) != 1:
        raise SceneError("path tracing shows one volume", where="volumes", found=len(scene.volumes), allowed=1)
    volume = scene.volumes[0]
    untraced: dict[str, tuple[Any, Any]] = {
        **{name: (getattr(scene, name), ()) for name in ("meshes", "lines", "points", "grids", "flows")},
        "clip.planes": (scene.clip.planes, ()),
        "clip.box": (scene.clip.box, None),
        "image.layers": (scene.image.layers, ()),
        "lights": (scene.lights[1:], ()),
        "lights[0].positional": (any(light.positional for light in scene.lights), False),
        "volumes[0].blending": (volume.blending, "composite"),
        "volumes[0].interpolation": (volume.interpolation, "linear"),
        "volumes[0].detail": (volume.detail, "full"),
        "volumes[0].isosurfaces": (volume.isosurfaces, ()),
        "volumes[0].gradient_opacity": (volume.gradient_opacity, ()),
        "volumes[0].transfer_2d": (volume.transfer_2d, None),
        "volumes[0].shader": (volume.shader, None),
    }
    for where, (found, allowed) in untraced.items():
        if found != allowed:
            text = "one light at most" if where == "lights" else "path tracing does not show it"
            raise SceneError(text, where=where, found=_short(found), allowed=allowed or "none")


def _short(found: Any) -> Any:
    return len(found) if isinstance(found, tuple) else found


def _picture(sums: Floats, size: tuple[int, int], samples: int, scene: Scene, held: str) -> TracedPicture:
    """Return the picture of the sums of all rows (groups, rows, w, 8), which are interleaved."""
    width, height = size
    # Row r of group g is row r · groups + g of the picture.
    rows = sums.transpose(1, 0, 2, 3).reshape(-1, width, 8)[:height]
    mean, squares = rows[..., :4] / samples, rows[..., 4:] / samples
    variance = np.maximum(squares - mean * mean, 0.0)
    error = np.sqrt(variance / (samples - 1)) if samples > 1 else np.full(mean.shape, np.inf)
    image = Image(mean.astype(np.float32), background_rgb(scene.image.background))
    return TracedPicture(image, error.astype(np.float32), samples, held)
