"""What depends on the gradient of a volume, as the shader reads it: lighting, gradient opacity and 2-D tables.

Lighting takes the volume's material, the lights, and the map from gradients to normals. Extinction may be multiplied by
a piecewise-linear function of the magnitude (gradient opacity), or colour and opacity come from a table over scalars
and magnitudes. In the shader scalars are in units of clim, and magnitudes in units of clim over the smallest spacing,
so that no unit of length or of data leaves float32.

References
----------
M. Levoy: Display of surfaces from volume data, IEEE CG&A 8(3), 1988. G. Kindlmann, J. Durkin: Semi-automatic generation
of transfer functions for direct volume rendering, IEEE VolVis 1998.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from clusterviz.content.geometry.section import GeometrySection
from clusterviz.content.grid.section import GridSection
from clusterviz.data.source import Grid
from clusterviz.errors import InputError
from clusterviz.plan.encoding import in_units_of_clim
from clusterviz.scene.camera import difference
from clusterviz.scene.transfer_2d import load_table
from clusterviz.scene.values import Light, Volume

if TYPE_CHECKING:
    from clusterviz.spmd.look import Look

Floats = NDArray[np.float64]
Triple = tuple[float, float, float]
LARGEST_OCCLUSION = 8
"""Voxels around a sample whose opacity may darken its ambient light; steps are a quarter as long."""
HEADLIGHT = Light(type="headlight")
CAP_UNITS = 4.0
"""Depth behind a cut face, in opacity unit distances, at which the weight of the face's normal has fallen to 0."""
CAP_STEEP, FACE_STEEP = 1 / 4, 1 / 128
"""Gradients, in units of clim per smallest spacing, above which the normal behind a clipping plane, and behind a face
of the volume, is that of the gradient alone; below, it is blended with the normal of the face."""
UP = np.array([0.0, 0.0, 1.0])  # axis of a light whose position is its focal point
FAR = float(np.finfo(np.float32).max)


@dataclass(frozen=True)
class Lamp:
    """A light.

    `direction`: unit vector towards it, in the world; None for a headlight; for a light with a place, opposite to the
    axis of its cone. `attenuation`: coefficients of the polynomial in the distance by which its light is divided.
    """

    direction: Triple | None
    strength: Triple  # (r, g, b), colour times intensity
    place: Triple | None = None  # (x, y, z) in index space; None for a directional light
    edge: float = -2.0  # cosine of the angle from the cone's axis to its edge; −2 without a cone
    exponent: float = 0.0  # exponent of the cosine of the angle from the axis
    attenuation: Triple = (1.0, 0.0, 0.0)


@dataclass(frozen=True)
class Shading:
    """Material and lights of a volume.

    Attributes
    ----------
    normal_from_gradient : its inverse transpose, which maps gradients to the world, scaled likewise
    caps : float64 (n, 8), for each plane that cuts the volume, its own faces included: the unit normal in the world; a
        factor that maps the length of a normal to a share of `CAP_STEEP`, or of `FACE_STEEP`; and a plane equation
        that maps (x, y, z, 1) in index space to the depth behind the plane as a share of `CAP_UNITS`
    """

    material: tuple[float, float, float, float]  # ambient, diffuse and specular share, and the highlight's power
    lights: tuple[Lamp, ...]  # one or more
    world_from_index: tuple[Triple, ...]  # 3 × 3, row by row, times a factor that makes its largest entry 1
    normal_from_gradient: tuple[Triple, ...]
    caps: NDArray[np.float64]
    occlusion: NDArray[np.float64]  # float64 (n, 4), rows of ambient_occlusion.glsl; none without ambient occlusion

    @property
    def has_places(self) -> bool:
        """True if any light has a place."""
        return any(light.place is not None for light in self.lights)

    @property
    def light_rows(self) -> int:
        """Rows of the block for each light."""
        return 5 if self.has_places else 2

    def block(self) -> NDArray[np.float32]:
        """Return the block of lights.glsl, (7 + light_rows · lights + 2 · caps + occlusion, 4).

        It holds both matrices by columns, the material, the lights, the caps and the rows of ambient occlusion.
        """
        first = 7 + self.light_rows * len(self.lights)
        caps = self.caps.reshape(-1, 4)
        rows = np.concatenate([np.zeros((first, 4)), caps, self.occlusion])
        rows[:3, :3] = np.transpose(self.world_from_index)
        rows[3:6, :3] = np.transpose(self.normal_from_gradient)
        rows[3, 3] = self.caps[:, 3].min(initial=FAR)
        rows[6] = self.material
        for number, light in enumerate(self.lights):
            first = 7 + self.light_rows * number
            rows[first] = (0, 0, 0, 1) if light.direction is None else (*light.direction, 2 if light.place else 0)
            rows[first + 1] = (*light.strength, light.exponent)
            if light.place is not None:
                # In two parts, so that a place in a volume of 10⁶ voxels keeps its digits.
                whole = np.round(light.place)
                rows[first + 2] = (*whole, light.edge)
                rows[first + 3, :3] = np.array(light.place) - whole
                rows[first + 4, :3] = light.attenuation
        block: NDArray[np.float32] = np.clip(rows, -FAR, FAR).astype(np.float32)
        return block


def make_shading(
    volume: Volume, lights: Sequence[Light], grid: Grid, unit: float, planes: Floats, caps: bool
) -> Shading:
    """Return the lighting of a volume; a scene without lights has a headlight, as in PyVista and ParaView.

    `unit`: its opacity unit distance. `planes`: float64 (n, 4), clipping planes in index space, see `clip_planes`.
    `caps`: cut faces are lit by their normals.
    """
    world_from_index = grid.world_from_index[:3, :3]
    normals = np.linalg.inv(world_from_index / np.abs(world_from_index).max()).T
    if volume.vector_unit is not None:  # the vectors, by which it is lit, are those of the world
        normals, caps = np.eye(3), False
    scale = np.abs(normals).max() * (min(grid.spacing) / np.abs(world_from_index).max())
    return Shading(
        _material(volume),
        tuple(_lamp(light, grid) for light in lights or (HEADLIGHT,)),
        _rows(world_from_index),
        _rows(normals),
        _caps(grid, planes, CAP_UNITS * unit, scale) if caps else np.zeros((0, 8)),
        _occlusion(volume, grid, unit, planes),
    )


def make_geometry_shading(section: GeometrySection | GridSection, lights: Sequence[Light], grid: Grid) -> Shading:
    """Return the lighting of geometry by normals, or of unstructured grids by gradients, in the world.

    `grid`: of the domain, in whose index space lights have places.
    """
    lamps = tuple(_lamp(light, grid) for light in lights or (HEADLIGHT,))
    return Shading(_material(section), lamps, _rows(np.eye(3)), _rows(np.eye(3)), np.zeros((0, 8)), np.zeros((0, 4)))


def _material(section: Volume | GeometrySection | GridSection) -> tuple[float, float, float, float]:
    return section.ambient, section.diffuse, section.specular, section.specular_power


def occlusion_reach(volume: Volume, grid: Grid) -> int:
    """Return the voxels around a sample whose opacity darkens its ambient light.

    Raises InputError: the radius exceeds `LARGEST_OCCLUSION` voxels, as bricks would hold mostly what their neighbours
    hold.
    """
    if volume.ambient_occlusion is None:
        return 0
    radius, index_from_world = volume.ambient_occlusion.radius, np.linalg.inv(grid.world_from_index[:3, :3])
    voxels = radius * float(np.linalg.norm(index_from_world, axis=1).max())
    if voxels > LARGEST_OCCLUSION:
        raise InputError(
            "too many voxels around each sample",
            where=f"{volume.path}: ambient_occlusion.radius",
            found=f"{radius:g}, which is {voxels:.1f} voxels",
            allowed=f"at most {radius * LARGEST_OCCLUSION / voxels:.4g}, which is {LARGEST_OCCLUSION} voxels",
        )
    return int(np.ceil(voxels - 1e-6))


def _occlusion(volume: Volume, grid: Grid, unit: float, planes: Floats) -> Floats:
    if volume.ambient_occlusion is None:
        return np.zeros((0, 4))
    step, index_from_world = volume.ambient_occlusion.radius / 4, np.linalg.inv(grid.world_from_index[:3, :3])
    rows = np.zeros((4, 4))
    rows[:3, :3], rows[:2, 3] = step * index_from_world.T, (volume.ambient_occlusion.strength, step / unit)
    rows[3, :3] = 1 / (step * np.linalg.norm(index_from_world, axis=1))
    lengths = np.linalg.norm(planes[:, :3] @ index_from_world, axis=1, keepdims=True)
    return np.concatenate([rows, planes / (lengths * step)])


def _caps(grid: Grid, planes: Floats, depth: float, scale: float) -> Floats:
    """Return the rows of the planes and of the volume's own faces."""
    last = np.array(grid.shape_zyx[::-1], np.float64) - 1
    faces = np.concatenate([np.eye(3, 4), np.column_stack([-np.eye(3), last])])
    all_planes = np.concatenate([planes, faces])
    normals = all_planes[:, :3] @ np.linalg.inv(grid.world_from_index[:3, :3])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    steepness = scale / np.repeat([CAP_STEEP, FACE_STEEP], [len(planes), len(faces)])
    return np.column_stack([normals / lengths, steepness, all_planes / (lengths * depth)])


def _lamp(light: Light, grid: Grid) -> Lamp:
    r, g, b = (channel * light.intensity for channel in light.color)
    if light.type == "headlight" or light.position is None:
        return Lamp(None, (r, g, b))
    toward = np.array(difference(light.position, light.focal_point)) if light.position != light.focal_point else UP
    x, y, z = (toward / np.linalg.norm(toward)).tolist()
    if not light.positional:
        return Lamp((x, y, z), (r, g, b))
    matrix = grid.world_from_index[:3, :3]
    place = np.linalg.solve(matrix, np.array(light.position) - np.array(grid.origin))
    edge = float(np.cos(np.radians(light.cone_angle))) if light.has_cone else -2.0
    # The shader's unit of length is that of the scaled matrix.
    attenuation = np.array(light.attenuation) * np.abs(matrix).max() ** np.arange(3.0)
    exponent = light.exponent if light.has_cone else 0.0
    return Lamp((x, y, z), (r, g, b), _triple(place), edge, exponent, _triple(attenuation))


def _triple(numbers: NDArray[np.float64]) -> Triple:
    x, y, z = numbers.tolist()
    return x, y, z


def _rows(matrix: NDArray[np.float64]) -> tuple[Triple, ...]:
    scaled = matrix / np.abs(matrix).max()
    return tuple((float(x), float(y), float(z)) for x, y, z in scaled)


Table = Literal["", "opacity", "colour and opacity"]


@dataclass(frozen=True, eq=False)
class Grading:
    """Dependence of opacity on the gradient's magnitude.

    Attributes
    ----------
    magnitude_from_gradient : float64 (3, 3); maps a gradient in units of clim per voxel to a vector whose length is
        the magnitude
    first : gradient opacity up to the first piece; with a table (scalar, columns, magnitude, rows): scalar and
        magnitude of its first entry, and columns and rows per unit
    table : float32 (rows, columns, 4), straight colour and opacity; None for gradient opacity
    units : float64 (7, 4), in its block, see look.glsl: columns of the matrix from gradients to data values per world
        unit, with the factor and the offset of values; columns of the matrix from index space; the world's origin
    """

    magnitude_from_gradient: Floats
    pieces: Floats  # float64 (n, 4): start, 1 / length, rise and end of each piece of gradient opacity
    first: tuple[float, ...]
    table: NDArray[np.float32] | None = None
    table_holds: Table = ""  # the part of the table that is read
    look: Look | None = None  # a user's look; None without one
    units: Floats | None = None

    @property
    def fading(self) -> int:
        """Number of pieces."""
        return len(self.pieces)

    def block(self) -> NDArray[np.float32]:
        """Return the block of magnitude.glsl: float32 (4 + fading, 4), columns of the matrix, `first`, the pieces.

        With a look (4 + fading + `LOOK_ROWS`, 4), and then `units`.
        """
        rows = np.zeros((4 + self.fading, 4))
        rows[:3, :3] = self.magnitude_from_gradient.T
        rows[3, : len(self.first)] = self.first
        rows[4:] = self.pieces
        if self.units is not None:
            rows = np.concatenate([rows, self.units])
        return np.clip(rows, -FAR, FAR).astype(np.float32)


def make_grading(volume: Volume, clim: tuple[float, float], grid: Grid) -> Grading:
    """Return the grading of a completed volume that has one."""
    length, values_clim = min(grid.spacing), clim
    matrix = np.linalg.inv(grid.world_from_index[:3, :3] / length).T.astype(np.float64)

    def units(magnitudes: Floats) -> Floats:
        # In halves, as the range of clim may overflow.
        with np.errstate(over="ignore"):
            found = magnitudes * (length / 2 / (clim[1] / 2 - clim[0] / 2))
        return np.minimum(found, FAR)

    if volume.vector_unit is not None:  # of vectors in the world
        matrix, length, clim = np.eye(3), 1.0, (0.0, volume.vector_unit)
    look, rows = None, None
    if volume.shader is not None:
        # Few scenes need it.
        from clusterviz.plan.look_files import read_look

        look, rows = read_look(volume.shader), _look_units(clim, grid)
    if volume.transfer_2d is None:
        magnitudes, factors = np.array(volume.gradient_opacity or [(0.0, 1.0)], np.float64).T
        pieces = _pieces(units(magnitudes), factors) if volume.gradient_opacity else np.zeros((0, 4))
        return Grading(matrix, pieces, (float(factors[0]),), look=look, units=rows)
    table = load_table(volume.transfer_2d)
    opacities, colours = table.opacities, table.colours
    rgba = np.zeros((*opacities.shape, 4), np.float32)
    rgba[..., 3] = opacities
    if colours is not None:
        rgba[..., :3] = colours
    along = _axis(in_units_of_clim(table.values, *values_clim), opacities.shape[1])
    across = _axis(units(np.array(table.magnitudes)), opacities.shape[0])
    holds: Table = "opacity" if colours is None else "colour and opacity"
    return Grading(matrix, np.zeros((0, 4)), along + across, rgba, holds)


LOOK_ROWS = 7


def _look_units(clim: tuple[float, float], grid: Grid) -> Floats:
    matrix = grid.world_from_index[:3, :3].astype(np.float64)
    with np.errstate(over="ignore"):
        width = np.float64(clim[1]) - clim[0]
        rows = np.zeros((LOOK_ROWS, 4))
        rows[:3, :3] = np.linalg.inv(matrix) * width
    rows[0, 3], rows[1, 3] = width, clim[0]
    rows[3:6, :3] = matrix.T
    rows[6, :3] = grid.origin
    return rows


def _pieces(places: Floats, factors: Floats) -> Floats:
    """Return the pieces between points, (n, 4); a single point is a constant piece."""
    places, factors = np.append(places, places[-1]), np.append(factors, factors[-1])
    lengths = np.diff(places)
    per_unit = np.where(lengths > 0, 1 / np.maximum(lengths, 1 / FAR), 0)
    pieces = np.stack([places[:-1], per_unit, np.diff(factors), places[1:]], axis=1)
    return pieces[: max(1, len(pieces) - 1)]


def _axis(ends: Floats, count: int) -> tuple[float, float]:
    """Return the position of the first entry, and entries per unit."""
    width = float(ends[1] - ends[0])
    return float(ends[0]), (count - 1) / width if width > 0 else 0.0
