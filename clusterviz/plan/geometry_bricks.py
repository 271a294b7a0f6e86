"""Entries of meshes, lines and points: facts that complete a scene, layers of a plan, and the primitives of bricks.

The file of an entry is read as a whole on every rank, when the scene is opened. All ranks then find the same primitives
in each brick, and so the same costs. After a rank has read its bricks it forgets the rest; the file is read again only
if bricks are missing later.
"""

from __future__ import annotations

from collections.abc import Callable, Set
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.bricks import BrickLayout
from clusterviz.data.geometry import Geometry, Lines, Mesh, Points
from clusterviz.data.primitives import (
    BrickMembers,
    DistinctRows,
    DrawnPrimitives,
    Kind,
    brick_members,
    drawn_primitives,
    vertex_normals,
)
from clusterviz.data.source import Index
from clusterviz.errors import InputError
from clusterviz.plan.domain import Domain
from clusterviz.plan.geometry import GeometryLayer, Primitives
from clusterviz.plan.segments import make_segments
from clusterviz.plan.shading import make_geometry_shading
from clusterviz.scene.background import background_rgb
from clusterviz.scene.colormaps import colour_points
from clusterviz.scene.complete import range_around
from clusterviz.scene.geometry import GeometryInfo, GeometrySection, LinesSection, MeshSection, PointsSection
from clusterviz.scene.transfer import TransferFunction, opacity_points
from clusterviz.scene.values import Light

Part = Mesh | Lines | Points
Floats = NDArray[np.float64]
KINDS: dict[type[GeometrySection], Kind] = {MeshSection: "triangle", LinesSection: "tube", PointsSection: "sphere"}
COMPONENTS = (1, 3, 4)


@dataclass(frozen=True, eq=False)
class BrickGrid:
    """Bricks in which primitives are looked for.

    Attributes
    ----------
    domain, layout : of a plan
    reach : cells beyond its own in which a brick has primitives
    """

    domain: Domain
    layout: BrickLayout
    reach: int

    def index_from_file(self, section: GeometrySection) -> Floats:
        """Return the map from an entry's coordinates to cells of the domain, float64 (3, 4)."""
        matrix = world_from_file(section)[:3].copy()
        matrix[:, 3] -= self.domain.origin
        return matrix / self.domain.spacing


@dataclass(eq=False)
class _InMemory:
    """Geometry of an entry, and the primitives of bricks that have been found."""

    part: Part
    drawn: DrawnPrimitives
    members: dict[Any, BrickMembers] = field(default_factory=dict)


class KnownGeometry:
    """Entry of meshes, lines or points.

    Parameters
    ----------
    section : as in the scene file
    key : of the entry, such as meshes[0], for errors
    load : reads the geometry

    Attributes
    ----------
    info : facts on it

    Raises
    ------
    InputError, DataError
        The file cannot be read, or lacks an array that the section names.
    """

    def __init__(self, section: GeometrySection, key: str, load: Callable[[], Geometry]) -> None:
        self._type, self._key, self._load = type(section), key, load
        self._radii = section.radius if isinstance(section, PointsSection) else None
        geometry = load()
        held = self._in_memory(geometry, "radius" in section.model_fields_set)
        self._held: _InMemory | None = held
        drawn = held.drawn
        self._position_type = np.dtype(drawn.positions.dtype)
        self._colour_types = {
            name: array.dtype for name, array in (*drawn.of_cells.items(), *drawn.of_vertices.items())
        }
        arrays: dict[str, tuple[Literal["vertices", "primitives"], int]] = {}
        for name, array in (*drawn.of_cells.items(), *drawn.of_vertices.items()):
            arrays[name] = "vertices" if name in drawn.of_vertices else "primitives", _width(array)
        values = np.empty(0)
        if section.scalars is not None and _channels(section, arrays, key) == 1:
            values = _array(drawn, section.scalars)
        finite = values[np.isfinite(values)]
        self.info = GeometryInfo(
            drawn.box(world_from_file(section)),
            len(drawn.corners),
            drawn.left_out,
            len(drawn.radii) > 0,
            (float(finite.min()), float(finite.max())) if finite.size else None,
            finite.size < values.size,
            arrays,
            () if len(drawn.corners) else tuple(n for n in ("mesh", "lines", "points") if getattr(geometry, n)),
        )
        self._counts: dict[Any, NDArray[np.int64]] = {}

    def layer(self, section: GeometrySection, lights: tuple[Light, ...], grid: BrickGrid) -> GeometryLayer:
        """Return the layer of a plan.

        Parameters
        ----------
        section : completed
        lights : of the scene
        grid : of the plan
        """
        channels = _channels(section, self.info.arrays, self._key)
        r, g, b = background_rgb(section.color) or (1.0, 1.0, 1.0)
        opacity = section.opacity if isinstance(section.opacity, float) and channels != 1 else 1.0
        transfer = surface_transfer(section) if channels == 1 else None
        edges = _edges(section, grid.domain.spacing)
        hides = bool((transfer.opacities >= 1).all()) if transfer else opacity >= 1 and channels != 4
        is_direction = isinstance(section, LinesSection) and section.color_by == "direction"
        scalars = "" if is_direction or section.scalars is None else section.scalars
        of = "" if not channels else "primitives" if is_direction else self.info.arrays[scalars][0]
        return GeometryLayer(
            KINDS[type(section)],
            self.info.count,
            grid.index_from_file(section),
            of,
            channels,
            (*((1.0, 1.0, 1.0) if transfer else (r, g, b)), opacity),
            make_segments(transfer, 1.0) if transfer else None,
            make_geometry_shading(section, lights, grid.domain.grid) if section.shade else None,
            section.culling if isinstance(section, MeshSection) else "none",
            hides and not self.info.has_invalid and (edges is None or edges[3] >= 1),
            section,
            self._position_type,
            section.shade and isinstance(section, MeshSection) and section.shading == "smooth",
            self._colour_types.get(scalars, np.dtype(np.float32)),
            transfer.domain if transfer else (0.0, 1.0),
            edges,
            self._counted(section, grid),
        )

    def read(self, layer: GeometryLayer, grid: BrickGrid, wanted: Set[Index]) -> dict[Index, Primitives]:
        """Return the primitives of bricks by index, and forget the others; bricks without primitives are left out.

        Parameters
        ----------
        layer, grid : of the plan
        wanted : indices of bricks
        """
        section, found = layer.section, dict[Index, Primitives]()
        some = sorted(index for index in wanted if layer.in_bricks[0][index])
        if section is None or not some:
            self._held = None
            return found
        members, held = self._members(section, grid), self._opened()
        rows = DistinctRows(len(held.drawn.positions))
        normals = np.empty((0, 3), np.float32)
        if layer.has_normals and isinstance(held.part, Mesh):
            needed = np.zeros(len(held.drawn.positions), bool)
            for index in some:
                needed[held.drawn.corners[members.of(index)]] = True
            normals = vertex_normals(held.part, held.drawn, world_from_file(section), needed)
        for index in some:
            found[index] = _cropped(members.of(index), layer, held.drawn, normals, rows)
        self._held = None
        return found

    def _in_memory(self, geometry: Geometry, needs_radii: bool = True) -> _InMemory:
        part = part_of(self._type, geometry)
        radii = self._radii if isinstance(self._radii, str) else None
        if isinstance(part, Points) and not needs_radii and radii not in part.attributes:
            self._radii = radii = None
        return _InMemory(part, drawn_primitives(part, radii, self._key))

    def _opened(self) -> _InMemory:
        if self._held is None:
            self._held = self._in_memory(self._load())
        return self._held

    def _counted(self, section: GeometrySection, grid: BrickGrid) -> NDArray[np.int64]:
        """Return the primitives and positions of each brick, which are kept when the geometry is forgotten."""
        key = _key_of(section, grid)
        if key not in self._counts:
            self._counts[key] = self._members(section, grid).counted(self._opened().drawn)
        return self._counts[key]

    def _members(self, section: GeometrySection, grid: BrickGrid) -> BrickMembers:
        held, key = self._opened(), _key_of(section, grid)
        if key not in held.members:
            radius = getattr(section, "radius", 1.0)
            factor = (radius if isinstance(radius, float) else 1.0) / grid.domain.spacing
            place = grid.index_from_file(section), factor, grid.layout.brick, grid.layout.counts_zyx, grid.reach
            held.members[key] = brick_members(held.drawn, *place)
        return held.members[key]


NOTHING = np.empty((0, 3), np.float32)
EMPTY: dict[type[GeometrySection], Part] = {
    MeshSection: Mesh("", NOTHING, np.empty((0, 3), np.uint32)),
    LinesSection: Lines("", NOTHING, np.zeros(1, np.int64)),
    PointsSection: Points("", NOTHING),
}


def part_of(kind: GeometrySection | type[GeometrySection], geometry: Geometry) -> Part:
    """Return the part of a file's geometry that a section shows; an empty one if the file has none."""
    kind = kind if isinstance(kind, type) else type(kind)
    found: Part | None = geometry.mesh
    if kind is not MeshSection:
        found = geometry.lines if kind is LinesSection else geometry.points
    return EMPTY[kind] if found is None else found


def _key_of(section: GeometrySection, grid: BrickGrid) -> tuple[object, ...]:
    return grid.domain, grid.layout.brick, grid.reach, getattr(section, "radius", None), section.transform


def world_from_file(section: GeometrySection) -> Floats:
    """Return the entry's transform, float64 (4, 4)."""
    return np.array(section.transform or np.eye(4), np.float64)


def _edges(section: GeometrySection, spacing: float) -> tuple[float, float, float, float, float] | None:
    """Return `GeometryLayer.edges` of a completed section."""
    edges = section.edges if isinstance(section, MeshSection) else None
    if edges is None:
        return None
    return *(background_rgb(edges.color) or (0.0, 0.0, 0.0)), edges.opacity, 0.5 * (edges.width or 0.0) / spacing


def surface_transfer(section: GeometrySection) -> TransferFunction:
    """Return the transfer function of a completed section's scalars."""
    clim = section.clim or (0.0, 1.0)
    domain = clim if clim[0] < clim[1] else range_around(clim[0])
    return TransferFunction(
        *colour_points(section.cmap, clim), *opacity_points(section.opacity, clim), unit_distance=1.0, domain=domain
    )


def _width(array: NDArray[Any]) -> int:
    return 1 if array.ndim == 1 else array.shape[1]


def _array(drawn: DrawnPrimitives, name: str) -> NDArray[Any]:
    return np.asarray(drawn.of_vertices.get(name, drawn.of_cells.get(name)))


def _channels(section: GeometrySection, arrays: Any, key: str) -> Literal[0, 1, 3, 4]:
    """Return the components of the colours that primitives have.

    Raises
    ------
    InputError
        There is no such array, or it has neither scalars nor colours.
    """
    if isinstance(section, LinesSection) and section.color_by == "direction":
        return 3
    if section.scalars is None or (isinstance(section, LinesSection) and section.color_by == "color"):
        return 0
    name, where = section.scalars, f"{key}.scalars"
    if name not in arrays:
        raise InputError("no such array", where=where, found=name, allowed=", ".join(arrays) or "none: there are none")
    width: Any = arrays[name][1]
    if width not in COMPONENTS:
        raise InputError("neither scalars nor colours", where=where, found=f"{width} components", allowed="1, 3 or 4")
    return width  # type: ignore[no-any-return]


def _cropped(
    numbers: NDArray[np.uint32],
    layer: GeometryLayer,
    drawn: DrawnPrimitives,
    normals: NDArray[np.float32],
    rows_of: DistinctRows,
) -> Primitives:
    """Return some primitives with what belongs to them."""
    rows, corners = rows_of.renumber(drawn.corners[numbers])
    positions, section = drawn.positions[rows], layer.section
    radii = np.empty(0, np.float32)
    if layer.kind != "triangle":
        radius = getattr(section, "radius", 0.0)
        radii = drawn.radii[rows] if len(drawn.radii) else np.full(len(rows), radius, np.float32)
    colours = np.empty((0, layer.channels), np.float32)
    if isinstance(section, LinesSection) and section.color_by == "direction":
        linear = world_from_file(section)[:3, :3]
        begin, end = (positions[corner].astype(np.float64) for corner in corners[:, 1:3].T)
        way = (end - begin) @ linear.T
        colours = np.abs(way / np.linalg.norm(way, axis=1, keepdims=True)).astype(np.float32)
    elif layer.colour_of and section is not None and section.scalars is not None:
        chosen = rows if layer.colour_of == "vertices" else drawn.cells[numbers]
        colours = _array(drawn, section.scalars)[chosen].reshape(-1, layer.channels)
    return Primitives(numbers, positions, corners, normals[rows] if len(normals) else normals, radii, colours)
