"""Cone-beam reconstruction of a volume from its line integrals, by the algorithm of Feldkamp, Davis and Kress.

A source and a flat detector turn about the world's z axis. Views are weighted by the cosine of each ray, and by
Parker's weights if they do not cover the full circle; their rows are filtered by a ramp; then each voxel gathers from
all views, weighted by its distance from the source. The algorithm is exact in the plane of the source only; beside it,
errors grow with the angle of the cone.

Filtering runs on blocks of views, back-projection on blocks of the volume; a block fetches the parts of the views that
it projects to. The order of the sum is that of the views, so the bits do not depend on blocks or ranks.

References
----------
L. A. Feldkamp, L. C. Davis, J. W. Kress: Practical cone-beam algorithm, J. Opt. Soc. Am. A 1(6), 1984.
A. C. Kak, M. Slaney: Principles of Computerized Tomographic Imaging, IEEE Press 1988, 3.3 (kernels) and 3.6.
D. L. Parker: Optimal short scan convolution reconstruction for fan beam CT, Medical Physics 9(2), 1982.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from typing import Annotated, Any, Literal

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, ValidationError, model_validator

from clusterviz.comm import agree
from clusterviz.data import open_source
from clusterviz.data.bricks import Box
from clusterviz.data.source import Grid, Index, Source
from clusterviz.errors import DataError, InputError, SceneError
from clusterviz.jobs.array import DistributedArray
from clusterviz.jobs.cluster import Cluster
from clusterviz.jobs.job import job
from clusterviz.jobs.kernel import kernel
from clusterviz.scene.checks import InvalidValueError, to_builtin
from clusterviz.scene.field_types import LARGEST_SIDE, Number, Positive, Section
from clusterviz.scene.validation_messages import scene_error
from clusterviz.scene.yaml_text import parse_yaml, read_text, yaml_problem

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Pair = tuple[int, int]
Pixels = Annotated[int, Field(strict=True, ge=2, le=LARGEST_SIDE), BeforeValidator(to_builtin)]
Window = Literal["ram-lak", "shepp-logan", "hann"]
WINDOWS: tuple[Window, ...] = ("ram-lak", "shepp-logan", "hann")
CHUNK_BYTES = 8 << 20
"""Bytes of whole views of which a block fetches its part at a time: few of them turn little, so parts are small."""
UNEVEN = 1.5
"""A gap between angles this many times as large as the median is the open part of a circle."""


def _expand(value: Any) -> Any:
    """Return a list of angles for the short form {begin, end, count}; the end is not among them."""
    value = to_builtin(value)
    if not isinstance(value, dict):
        return value
    try:
        begin, end, count = (value[key] for key in ("begin", "end", "count"))
        assert len(value) == 3
        assert isinstance(count, int)
        return [begin + (end - begin) * k / count for k in range(count)]
    except (AssertionError, KeyError, TypeError, ArithmeticError):
        raise InvalidValueError("not angles", "a list of degrees, or {begin, end, count}") from None


def _pair(value: Any) -> Any:
    value = to_builtin(value)
    return value if isinstance(value, (list, tuple)) else (value, value)


class ConeBeam(Section):
    """Geometry of a scan with a cone beam on a circle about the world's z axis.

    At angle 0 the source is on the positive x axis, and angles turn it towards the positive y axis. Rows of the
    detector run along its width, in the direction of growing angles; the first row is the top one (largest z).
    """

    source_to_axis: Positive = Field(description="Distance of the source from the axis, world units.")
    source_to_detector: Positive = Field(description="Distance of the source from the detector, world units.")
    detector: tuple[Pixels, Pixels] = Field(description="Rows and columns of pixels.", examples=[[512, 512]])
    pixel_size: Annotated[tuple[Positive, Positive], BeforeValidator(_pair)] = Field(
        description="Width and height of a pixel of the detector, world units; or one number for both.",
        examples=[[0.4, 0.4]],
    )
    angles: Annotated[tuple[Number, ...], BeforeValidator(_expand)] = Field(
        description="Degrees of each view, or {begin, end, count}, without the end.", examples=[[0, 90, 180, 270]]
    )
    offset: tuple[Number, Number] = Field(
        default=(0.0, 0.0),
        description="Position of the detector's centre from the ray through the axis, along its rows and upwards, "
        "world units.",
        examples=[[0, 0]],
    )
    unattenuated: Positive | None = Field(
        default=None,
        description="Intensity without an object, if the views are intensities I; they become -ln(I / unattenuated).",
    )

    @model_validator(mode="after")
    def _check(self) -> ConeBeam:
        if self.source_to_detector <= self.source_to_axis:
            allowed = f"more than source_to_axis, {self.source_to_axis:g}: the detector is behind the axis"
            raise InvalidValueError("too small", allowed, key="source_to_detector", found=self.source_to_detector)
        if len(self.angles) < 3:
            raise InvalidValueError("too few views", "at least 3", key="angles", found=len(self.angles))
        sizes = [n * size for n, size in zip(self.detector[::-1], self.pixel_size, strict=True)]
        for axis in range(2):
            if abs(self.offset[axis]) >= sizes[axis] / 2:
                allowed = f"less than half of the detector, {sizes[axis] / 2:g}"
                raise InvalidValueError("the ray through the axis misses it", allowed, key="offset", found=self.offset)
        turned = np.unique(np.mod(np.radians(self.angles), 2 * np.pi))
        if len(turned) < len(self.angles):
            raise InvalidValueError("an angle occurs twice", "each once, modulo 360 degrees", key="angles")
        arc, fan = self.arc, self.fan_angle
        if arc is not None and arc < math.pi + 2 * fan:
            least = math.degrees(math.pi + 2 * fan)
            allowed = f"the full circle, or at least {least:.1f} degrees: 180 and the angle of the fan"
            raise InvalidValueError(
                "the views do not go far enough", allowed, key="angles", found=round(math.degrees(arc), 1)
            )
        return self

    @property
    def views(self) -> int:
        """Number of views."""
        return len(self.angles)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Views, rows and columns."""
        return self.views, *self.detector

    @property
    def fan_angle(self) -> float:
        """Largest angle in the plane of the source between a ray and the one through the axis, radians."""
        u, _ = self.pixel_positions
        return math.atan(max(abs(u[0]), abs(u[-1])) / self.source_to_detector)

    @property
    def pixel_positions(self) -> tuple[Floats, Floats]:
        """Positions of columns, and of rows, on the detector from the ray through the axis, world units."""
        (rows, columns), (width, height) = self.detector, self.pixel_size
        across, down = (np.arange(n, dtype=np.float64) - (n - 1) / 2 for n in (columns, rows))
        return self.offset[0] + width * across, self.offset[1] - height * down

    def rays(self, view: int) -> tuple[Floats, Floats]:
        """Return the position of the source (3,), and unit vectors to all pixels (rows, columns, 3)."""
        cosine, sine = math.cos(math.radians(self.angles[view])), math.sin(math.radians(self.angles[view]))
        outwards, (u, v) = np.array([cosine, sine, 0.0]), self.pixel_positions
        ways = u[:, None] * np.array([-sine, cosine, 0]) - self.source_to_detector * outwards
        ways = ways + v[:, None, None] * np.array([0.0, 0, 1])
        return self.source_to_axis * outwards, ways / np.linalg.norm(ways, axis=-1, keepdims=True)

    @property
    def arc(self) -> float | None:
        """Angle between the first and last view of an open circle, radians; None for the full circle."""
        gaps = self._gaps()[1]
        largest = float(gaps.max())
        return None if largest <= UNEVEN * float(np.median(gaps)) else 2 * math.pi - largest

    def _gaps(self) -> tuple[NDArray[np.intp], Floats]:
        """Return the views in the order of their angles, and the angle from each to the next one on the circle."""
        turned = np.mod(np.radians(self.angles), 2 * np.pi)
        order = np.argsort(turned)
        return order, np.diff(turned[order], append=turned[order[0]] + 2 * np.pi)

    def view_weights(self) -> Floats:
        """Return what each pixel column of each view counts, float64 (views, columns).

        It is the angle between views: half of it on the full circle, where each line is seen twice, and times Parker's
        weights on an open one.
        """
        order, gaps = self._gaps()
        arc = self.arc
        found = np.empty((self.views, self.detector[1]))
        if arc is None:
            found[order] = 0.25 * (gaps + np.roll(gaps, 1))[:, None]
            return found
        first = int(np.argmax(gaps)) + 1
        order, gaps = np.roll(order, -first), np.roll(gaps, -first)
        gaps[-1] = 0.0
        angle = np.cumsum(gaps) - gaps
        weights = parker_weights(angle[:, None], -np.arctan(self.pixel_positions[0] / self.source_to_detector), arc)
        found[order] = 0.5 * (gaps + np.roll(gaps, 1))[:, None] * weights
        return found

    def matrices(self, grid: Grid, begin: int, end: int) -> Floats:
        """Return the projections of views [begin, end), float64 (end − begin, 3, 4).

        Each maps (i, j, k, 1) of a voxel to column · w, row · w, w, where w is the distance from the source along the
        ray through the axis, over that of the axis.
        """
        radius, magnification = self.source_to_axis, self.source_to_detector / self.source_to_axis
        (rows, columns), (width, height) = self.detector, self.pixel_size
        found = np.empty((end - begin, 3, 4))
        for matrix, degrees in zip(found, self.angles[begin:end], strict=True):
            cosine, sine = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
            matrix[2] = -cosine / radius, -sine / radius, 0, 1
            matrix[0] = np.array([-sine, cosine, 0, 0]) * (magnification / width)
            matrix[0] += matrix[2] * ((columns - 1) / 2 - self.offset[0] / width)
            matrix[1] = np.array([0, 0, -magnification / height, 0])
            matrix[1] += matrix[2] * ((rows - 1) / 2 + self.offset[1] / height)
        return found @ grid.world_from_index

    def natural_grid(self) -> Grid:
        """Return the grid of voxels as large as pixels at the axis, that holds what all views can see."""
        scale = self.source_to_axis / self.source_to_detector
        u, v = self.pixel_positions
        radius = self.source_to_axis * math.sin(math.atan(min(abs(u[0]), abs(u[-1])) / self.source_to_detector))
        width, height = (size * scale for size in self.pixel_size)
        side, z = 2 * int(radius / width) + 1, 2 * int(scale * min(abs(v[0]), abs(v[-1])) / height) + 1
        first = -(side - 1) / 2 * width
        return Grid((z, side, side), (width, width, height), (first, first, -(z - 1) / 2 * height))


def load_geometry(path: str | os.PathLike[str]) -> ConeBeam:
    """Read the geometry of a scan from a YAML or JSON file with the keys of `ConeBeam`.

    Raises
    ------
    SceneError
        The file cannot be read, a key is unknown or missing, or a value impossible.
    """
    where = os.fspath(path)
    try:
        data = parse_yaml(read_text(where, SceneError))
    except yaml.YAMLError as error:
        raise SceneError(f"not YAML: {yaml_problem(error)}", where=where) from None
    try:
        return ConeBeam.model_validate(data)
    except ValidationError as error:
        raise scene_error(error, where, root=ConeBeam) from None


def parker_weights(angle: Floats, fan: Floats, arc: float) -> Floats:
    """Return the weights of rays of an open circle (Parker 1982): those of the two rays of a line sum to 1.

    Parameters
    ----------
    angle : of the source from the first view, radians
    fan : of the ray from the one through the axis; the same line has fan −fan at angle + π + 2 fan
    arc : angle of the last view, at least π + 2 |fan|, less than 2 π
    """
    reach = (arc - math.pi) / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        rise = np.sin(math.pi / 4 * angle / (reach - fan)) ** 2
        fall = np.sin(math.pi / 4 * (arc - angle) / (reach + fan)) ** 2
    return np.where(angle < 2 * (reach - fan), rise, np.where(angle > math.pi - 2 * fan, fall, 1.0))


def ramp_kernel(columns: int, spacing: float, window: Window) -> Floats:
    """Return the kernel of the ramp filter at 0, 1, …, columns − 1 samples, float64 (columns,).

    Its Fourier transform is |f| below 1 / (2 spacing), times a sinc (Shepp and Logan) or cosine (Hann) window.
    """
    n = np.arange(columns + 1, dtype=np.float64)
    if window == "shepp-logan":
        return (-2 / (math.pi * spacing) ** 2 / (4 * n * n - 1))[:columns]
    ramp: Floats = np.where(n % 2 == 1, -1 / (math.pi * spacing * np.maximum(n, 1)) ** 2, 0.0)
    ramp[0] = 1 / (2 * spacing) ** 2
    if window == "hann":
        return 0.5 * ramp[:-1] + 0.25 * (np.concatenate([ramp[1:2], ramp[:-2]]) + ramp[1:])
    return ramp[:-1]


def filter_views(views: Floats, geometry: ConeBeam, weights: Floats, window: Window) -> Floats32:
    """Weight views and filter their rows, in float64.

    Parameters
    ----------
    views : (views, rows, columns), line integrals
    weights : (views, columns), those of `view_weights`

    Returns
    -------
    filtered : float32 (views, rows, columns); what each view adds to a voxel on the axis
    """
    columns = geometry.detector[1]
    u, v = geometry.pixel_positions
    distance = geometry.source_to_detector
    spacing = geometry.pixel_size[0] * geometry.source_to_axis / distance
    ramp, size = ramp_kernel(columns, spacing, window), 1 << (2 * columns - 1).bit_length()
    response = np.fft.rfft(np.concatenate([ramp, np.zeros(size - 2 * columns + 1), ramp[:0:-1]])).real * spacing
    cosines = distance / np.sqrt(distance**2 + u**2 + v[:, None] ** 2)
    found = np.empty(views.shape, np.float32)
    for view, weight, filtered in zip(views, weights, found, strict=True):
        spectrum = np.fft.rfft(view * (cosines * weight), size)
        filtered[:] = np.fft.irfft(spectrum * response, size)[:, :columns]
    return found


def detector_box(matrices: Floats, box: Box, detector: Pair) -> tuple[Pair, Pair] | None:
    """Return the pixels (row, column), [begin, end), to which a box of voxels projects; None if it misses all."""
    corners = np.array([[x, y, z, 1] for z in (box[0][0], box[1][0] - 1) for y in (box[0][1], box[1][1] - 1)
                        for x in (box[0][2], box[1][2] - 1)], float)  # fmt: skip
    projected = np.einsum("vrc,nc->vnr", matrices, corners)
    places = (projected[..., :2] / projected[..., 2:]).reshape(-1, 2)
    low, high = np.floor(places.min(axis=0)).astype(int) - 1, np.floor(places.max(axis=0)).astype(int) + 3
    (left, right), (top, bottom) = (np.clip([low[a], high[a]], 0, detector[1 - a]).tolist() for a in range(2))
    return None if bottom - top < 2 or right - left < 2 else ((top, left), (bottom, right))


@kernel("backproject.glsl", writes=("volume",), vectors=("matrices", "quads"))
def backproject(
    matrices: Floats32, quads: Floats32, volume: Floats32, first: Index, corner: Pair, detector: Pair
) -> None:
    """Add filtered views to a box of voxels.

    `matrices` (1, views, 3) vectors; `quads` (views, rows, columns) vectors, see `pixel_quads`, of a part of the
    detector that begins with the pixel `corner`; `first`: the first voxel; `detector`: its columns and rows.
    """


def pixel_quads(views: Floats32) -> Floats32:
    """Return each pixel beside its neighbours right, below, and both: one load of a CPU in place of four.

    Parameters
    ----------
    views : (views, rows, columns)

    Returns
    -------
    quads : float32 (views, rows − 1, columns − 1, 4)
    """
    count, rows, columns = views.shape
    found = np.empty((count, rows - 1, columns - 1, 4), np.float32)
    for n in range(4):
        down, right = divmod(n, 2)
        found[..., n] = views[:, down : rows - 1 + down, right : columns - 1 + right]
    return found


def backproject_box(views: Callable[[Box], Floats32], geometry: ConeBeam, grid: Grid, box: Box) -> Floats32:
    """Return a box of the volume, float32 (z, y, x), from filtered views.

    Parameters
    ----------
    views : returns a box of them: views, rows and columns
    box : of voxels of the grid
    """
    shape = tuple(end - begin for begin, end in zip(*box, strict=True))
    found = np.zeros(shape, np.float32)
    step = max(1, CHUNK_BYTES // (4 * math.prod(geometry.detector)))
    for begin in range(0, geometry.views, step):
        end = min(begin + step, geometry.views)
        matrices = geometry.matrices(grid, begin, end)
        if part := detector_box(matrices, box, geometry.detector):
            (row, column), (row_end, column_end) = part
            quads = pixel_quads(views(((begin, row, column), (end, row_end, column_end))))
            rows = matrices.astype(np.float32)[None]
            backproject[shape](rows, quads, found, box[0][::-1], (column, row), geometry.detector[::-1])
    return found


def check_views(views: Source, geometry: ConeBeam) -> None:
    """Check that there is one view of the detector's size for each angle.

    Raises
    ------
    DataError
        There is not.
    """
    found, (count, *detector) = views.grid.shape_zyx, geometry.shape
    if found[0] != count:
        raise DataError("not one view for each angle", where=views.name, found=f"{found[0]} views", allowed=count)
    if list(found[1:]) != detector:
        size = f"{found[1]} rows, {found[2]} columns"
        allowed = f"those of the detector: {detector[0]}, {detector[1]}"
        raise DataError("views of another size", where=views.name, found=size, allowed=allowed)


def line_integrals(values: NDArray[Any], geometry: ConeBeam, first: int, where: str) -> Floats:
    """Return views as line integrals, float64.

    Parameters
    ----------
    values : (views, rows, columns), line integrals or, if the geometry says so, intensities
    first : number of the first of these views, for messages

    Raises
    ------
    DataError
        A pixel is NaN or infinite, or an intensity not positive.
    """
    found = values.astype(np.float64)
    is_wrong = ~np.isfinite(found) if geometry.unattenuated is None else ~(np.isfinite(found) & (found > 0))
    if is_wrong.any():
        view, row, column = (int(n) for n in np.argwhere(is_wrong)[0])
        allowed = "finite numbers" if geometry.unattenuated is None else "intensities of more than 0"
        place, bad = f"{where}: view {first + view}, row {row}, column {column}", found[view, row, column]
        raise DataError("a pixel has no value to reconstruct from", where=place, found=bad, allowed=allowed)
    return found if geometry.unattenuated is None else -np.log(found / geometry.unattenuated)


def reconstruct(
    cluster: Cluster,
    views: Source | str | os.PathLike[str],
    geometry: ConeBeam | str | os.PathLike[str],
    grid: Grid | None = None,
    *,
    window: Window = "ram-lak",
    blocks: int = 64,
) -> tuple[DistributedArray, Grid]:
    """Reconstruct a volume from the views of a cone beam; collective.

    Parameters
    ----------
    views : volume of (views, rows, columns), or its file: line integrals, or intensities if the geometry says so
    geometry : of the scan, or its file; see `load_geometry`
    grid : of the volume; by default `geometry.natural_grid`
    window : of the ramp filter: ram-lak is the sharpest; shepp-logan and hann are smoother, with less noise
    blocks : voxels a side of the blocks

    Returns
    -------
    volume : float32 (z, y, x), attenuation per world unit
    grid : of the volume

    Raises
    ------
    DataError
        Views cannot be read, are missing, of another size, or have pixels that are NaN or infinite.
    SceneError
        The geometry cannot be read, or is impossible.
    InputError
        No such window, or the volume reaches the circle of the source.
    """
    with agree(cluster.channel, None, "reconstruction"):
        geometry = geometry if isinstance(geometry, ConeBeam) else load_geometry(geometry)
        views = open_source(os.fspath(views)) if isinstance(views, str | os.PathLike) else views
        grid = grid or geometry.natural_grid()
        check_views(views, geometry)
        if window not in WINDOWS:
            raise InputError("no such window", where="window", found=window, allowed=", ".join(WINDOWS))
        reach = float(np.hypot(*grid.corners[:, :2].T).max())
        if reach >= geometry.source_to_axis:
            allowed = f"less than source_to_axis, {geometry.source_to_axis:g}, from the axis"
            raise InputError("the volume reaches the circle of the source", where="grid", found=reach, allowed=allowed)
    filtered = cluster.array(geometry.shape, np.float32, (1, *geometry.detector), name="filtered views")
    volume = cluster.array(grid.shape_zyx, np.float32, blocks, name="reconstruction")
    weights = geometry.view_weights()

    @job(reads=lambda index: (filtered, filtered.box(index)))  # where it is written
    def filter_view(index: Index) -> None:
        box = filtered.box(index)
        given = line_integrals(views.read(*box), geometry, box[0][0], views.name)
        filtered.write(box, filter_views(given, geometry, weights[box[0][0] : box[1][0]], window))

    @job(reads=lambda index: (filtered, _fetched(geometry, grid, volume.box(index))))
    def backproject_block(index: Index) -> None:
        box = volume.box(index)
        volume.write(box, backproject_box(filtered.read, geometry, grid, box))

    cluster.run(filter_view, filtered.blocks)
    filtered.sync()
    cluster.run(backproject_block, volume.blocks)
    volume.sync()
    cluster.free(filtered)
    return volume, grid


def _fetched(geometry: ConeBeam, grid: Grid, box: Box) -> Box:
    """Return the box of all views that a box of voxels needs."""
    found = detector_box(geometry.matrices(grid, 0, geometry.views), box, geometry.detector)
    begin, end = found or ((0, 0), (0, 0))
    return (0, *begin), (geometry.views, *end)
