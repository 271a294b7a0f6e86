"""Entries of meshes, lines and points: facts that complete a scene, layers of a plan, and the primitives of bricks.

Each rank opens the file of an entry, and finds of an equal share of the primitives what can be drawn, and in which
bricks. It sends the numbers of these to the ranks that keep the bricks, asks there for those of its own bricks, and
takes the primitives from the file. So all ranks know the same facts and counts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm import Channel, agree, all_to_all
from clusterviz.content.brick_search import (
    TAG,
    PlacedEntry,
    asked_for,
    brick_boxes,
    flat_of,
    key_of,
    received_members,
    sent_keys,
)
from clusterviz.content.facts import range_around
from clusterviz.content.geometry.section import (
    GeometryInfo,
    GeometrySection,
    LinesSection,
    MeshSection,
    PointsSection,
    is_arrows,
    own_scalars,
)
from clusterviz.data.geometry import Geometry, Lines, Mesh, Points
from clusterviz.data.glyphs import ARROW_TRIANGLES, arrows
from clusterviz.data.primitives import (
    BrickMembers,
    DistinctRows,
    DrawnPrimitives,
    drawn_primitives,
    stored_normals,
    transformed,
    vertex_normals,
)
from clusterviz.data.source import Index
from clusterviz.errors import InputError
from clusterviz.plan.domain import BrickGrid, Placed, world_from_file
from clusterviz.plan.geometry import GeometryLayer, Primitives
from clusterviz.plan.segments import make_segments
from clusterviz.plan.shading import make_geometry_shading
from clusterviz.scene.background import background_rgb
from clusterviz.scene.colormaps import colour_points
from clusterviz.scene.transfer import TransferFunction, opacity_points
from clusterviz.scene.values import Light

Part = Mesh | Lines | Points
Floats = NDArray[np.float64]
Numbers = NDArray[np.uint32]
NOTHING: NDArray[np.float32] = np.empty((0, 3), np.float32)
COMPONENTS = (1, 3, 4)


Normals = tuple[NDArray[np.int64], NDArray[np.float32]]
"""Rows of some vertices, ascending (k,), and their normals in the world, of any length (k, 3)."""
NO_NORMALS: Normals = np.empty(0, np.int64), NOTHING


class KnownGeometry(PlacedEntry[GeometryLayer, Primitives]):
    """Entry of meshes, lines or points.

    Parameters
    ----------
    section, key, channel : as of `PlacedEntry`
    load : reads the geometry

    Raises
    ------
    InputError, DataError
        The file cannot be read, or lacks an array that the section names.
    """

    def __init__(self, section: GeometrySection, key: str, load: Callable[[], Geometry], channel: Channel) -> None:
        super().__init__(section, key, channel)
        self._load = load
        self._last: tuple[object, BrickMembers | None] = None, None
        self._drawn: DrawnPrimitives | None
        self._share: NDArray[np.int64] | None
        rank, ranks = channel.rank, channel.size
        with agree(channel, 0, "open"):
            geometry = load()
            drawn = self._drawn = self._drawn_of(geometry)
            arrays: dict[str, tuple[Literal["vertices", "primitives"], int]] = {}
            self._colour_types: dict[str, np.dtype[Any]] = {}
            for name, array in (*drawn.of_cells.items(), *drawn.of_vertices.items()):
                arrays[name] = "vertices" if name in drawn.of_vertices else "primitives", _width(array)
                self._colour_types[name] = array.dtype
            values, scalars_name = np.empty(0), section.scalars or own_scalars(section, arrays)
            if scalars_name is not None and _channels(section, arrays, key, scalars_name) == 1:
                array = _array(drawn, scalars_name)
                values = array[len(array) * rank // ranks : len(array) * (rank + 1) // ranks]
            finite = values[np.isfinite(values)]
            scalars = (float(finite.min()), float(finite.max())) if finite.size else None
            mine = self._share = drawn.share(rank, ranks)
            found = len(mine), drawn.box(world_from_file(section), mine), scalars, finite.size < values.size
        counts, boxes, ranges, invalid = zip(*channel.allgather(found), strict=True)
        low, high = np.min(boxes, axis=0)[0], np.max(boxes, axis=0)[1]
        known = [one for one in ranges if one]
        self._kind, self._count = drawn.kind, sum(counts)
        self._position_type = np.dtype(drawn.positions.dtype)
        self.info = GeometryInfo(
            np.stack([low, high]) if sum(counts) else np.empty((0, 3)),
            sum(counts) // (ARROW_TRIANGLES if is_arrows(section) else 1),
            drawn.left_out + len(drawn.corners) - sum(counts),
            len(drawn.radii) > 0,
            (min(one[0] for one in known), max(one[1] for one in known)) if known else None,
            any(invalid),
            arrays,
            geometry.axes,
            () if sum(counts) else tuple(n for n in ("mesh", "lines", "points") if getattr(geometry, n)),
        )

    def layer(self, section: GeometrySection, lights: tuple[Light, ...], grid: BrickGrid) -> GeometryLayer:
        """Return the layer of a plan, for a completed section."""
        channels = _channels(section, self.info.arrays, self._key)
        r, g, b = background_rgb(section.color) or (1.0, 1.0, 1.0)
        opacity = section.opacity if isinstance(section.opacity, float) and channels != 1 else 1.0
        transfer = geometry_transfer(section) if channels == 1 else None
        edges = _edges(section, grid.domain.spacing)
        hides = bool((transfer.opacities >= 1).all()) if transfer else opacity >= 1 and channels != 4
        is_direction = isinstance(section, LinesSection) and section.color_by == "direction"
        scalars = "" if is_direction or section.scalars is None else section.scalars
        of: Literal["", "vertices", "primitives"] = ""
        if channels:
            of = "primitives" if is_direction else self.info.arrays[scalars][0]
        return GeometryLayer(
            count=self._count,
            index_from_file=grid.index_from_file(section),
            section=section,
            shading=make_geometry_shading(section, lights, grid.domain.grid) if section.shade else None,
            clim=transfer.domain if transfer else (0.0, 1.0),
            position_type=self._position_type,
            in_bricks=self._counted(section, grid),
            kind=self._kind,
            colour_of=of,
            channels=channels,
            rgba=(*((1.0, 1.0, 1.0) if transfer else (r, g, b)), opacity),
            segments=make_segments(transfer, 1.0) if transfer else None,
            culling=_culled_side(section),
            opaque=hides and not (transfer and self.info.has_invalid) and (edges is None or edges[3] >= 1),
            has_normals=section.shade and (getattr(section, "shading", "") == "smooth" or is_arrows(section)),
            colour_type=self._colour_types.get(scalars, np.dtype(np.float32)),
            edges=edges,
        )

    def _received(
        self, layer: GeometryLayer, grid: BrickGrid, some: Sequence[Index], most: int
    ) -> dict[Index, Primitives]:
        flat, normals = flat_of(some, grid), NO_NORMALS
        members = self._gathered(layer.section, grid, flat)
        if layer.has_normals:
            normals = self._normals(layer.section, grid, members)
        with agree(self._channel, 0, "load"):
            rows = DistinctRows(len(self._opened().positions) if some else 0)
            pairs = zip(some, flat, strict=True)
            return {index: _cropped(members[brick], layer, self._opened(), normals, rows) for index, brick in pairs}

    def _forget(self) -> None:
        self._drawn = self._share = None

    def _opened(self) -> DrawnPrimitives:
        """Return the primitives, which are read if they were forgotten."""
        if self._drawn is None:
            self._drawn = self._drawn_of(self._load())
        return self._drawn

    def _kept_members(self, section: Placed, grid: BrickGrid) -> tuple[DrawnPrimitives, BrickMembers]:
        members = self._members(section, grid)
        return self._opened(), members

    def _members(self, section: Placed, grid: BrickGrid) -> BrickMembers:
        """Return the members of the bricks that this rank keeps; collective if the grid is not the last."""
        key, channel = key_of(section, grid), self._channel
        last, members = self._last
        if members is None or last != key:
            with agree(channel, 0, "plan"):
                if self._share is None:
                    self._share = self._opened().share(channel.rank, channel.size)
                sent = sent_keys(self._opened(), self._share, section, grid, channel.size)
            members = received_members(all_to_all(channel, sent, TAG), grid, channel)
            self._last = key, members
        return members

    def _gathered(self, section: Placed, grid: BrickGrid, bricks: Sequence[int]) -> dict[int, Numbers]:
        """Return the numbers of the primitives of some bricks from the ranks that keep them; collective."""
        members, counts, channel = self._members(section, grid), self._counted(section, grid)[0].ravel(), self._channel
        asked, requests = asked_for(bricks, channel)
        with agree(channel, 0, "load"):
            empty = np.empty(0, np.uint32)
            sent = [
                np.concatenate([empty, *(members.of(one // channel.size) for one in each.tolist())])
                for each in requests
            ]
        received = all_to_all(channel, sent, TAG, [int(counts[each].sum()) for each in asked])
        found: dict[int, Numbers] = {}
        for each, numbers in zip(asked, received, strict=True):
            found |= zip(each.tolist(), np.split(numbers, np.cumsum(counts[each])[:-1]), strict=False)
        return found

    def _drawn_of(self, geometry: Geometry) -> DrawnPrimitives:
        section, part, radius = self._section, part_of(self._section, geometry), None
        if isinstance(section, PointsSection) and isinstance(part, Points):
            has_radius = section.radius in part.attributes or "radius" in section.model_fields_set
            radius = section.radius if has_radius else None
            if section.style == "arrows":
                return arrows(part, section.direction or "", section.length, section.scale, radius, self._key)
        return drawn_primitives(part, radius if isinstance(radius, str) else None, self._key)

    def _normals(self, section: GeometrySection, grid: BrickGrid, members: Mapping[int, Numbers]) -> Normals:
        """Return the normals of all vertices in some bricks; collective.

        The triangles around a vertex are in the brick that the vertex is in, which may be one of another rank.
        """
        boxes = brick_boxes(section, grid, self._channel.size)
        rows = others = np.empty(0, np.int64)
        with agree(self._channel, 0, "load"):
            if members:
                drawn = self._opened()
                is_wanted = np.zeros(len(drawn.positions), bool)
                for numbers in members.values():
                    is_wanted[drawn.corners[numbers]] = True
                rows = np.flatnonzero(is_wanted)
                has_all = len(members) == np.count_nonzero(self._counted(section, grid)[0])
                if stored_normals(drawn) is None and not has_all:
                    others = np.unique(boxes.flat(boxes.clipped(transformed(drawn.positions[rows], boxes.matrix))))
        around = self._gathered(section, grid, [brick for brick in others.tolist() if brick not in members])
        with agree(self._channel, 0, "load"):
            if not members:
                return NO_NORMALS
            is_near = np.zeros(len(drawn.corners), bool)
            for numbers in (*members.values(), *around.values()):
                is_near[numbers] = True
            found = vertex_normals(drawn, world_from_file(section), rows, np.flatnonzero(is_near))
        return rows, found


def part_of(section: GeometrySection, geometry: Geometry) -> Part:
    """Return the part of a file's geometry that a section shows; an empty one if the file has none.

    Of a file without points of its own these are the vertices of its mesh, or the points of its lines.
    """
    mesh, lines, points = geometry.mesh, geometry.lines, geometry.points
    if isinstance(section, MeshSection):
        return mesh or Mesh("", NOTHING, np.empty((0, 3), np.uint32))
    if isinstance(section, LinesSection):
        return lines or Lines("", NOTHING, np.zeros(1, np.int64))
    if points is None and mesh:
        return Points(mesh.name, mesh.vertices, mesh.vertex_attributes)
    if points is None and lines:
        return Points(lines.name, lines.points, lines.point_attributes)
    return points or Points("", NOTHING)


def _culled_side(section: GeometrySection) -> Literal["none", "front", "back"]:
    """Return `GeometryLayer.culling`; a reflection turns the order of the corners that the file's front has."""
    side = section.culling if isinstance(section, MeshSection) else "none"
    mirrors = bool(np.linalg.det(world_from_file(section)[:3, :3]) < 0)
    other: dict[str, Literal["none", "front", "back"]] = {"front": "back", "back": "front"}
    return other.get(side, side) if mirrors else side


def _edges(section: GeometrySection, spacing: float) -> tuple[float, float, float, float, float] | None:
    edges = section.edges if isinstance(section, MeshSection) else None
    if edges is None:
        return None
    return *(background_rgb(edges.color) or (0.0, 0.0, 0.0)), edges.opacity, 0.5 * (edges.width or 0.0) / spacing


def geometry_transfer(section: GeometrySection) -> TransferFunction:
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


def _channels(section: GeometrySection, arrays: Any, key: str, name: str | None = None) -> Literal[0, 1, 3, 4]:
    """Return the components of the colours that primitives have, or of those that an array would give.

    Raises
    ------
    InputError
        There is no such array, or it has neither scalars nor colours.
    """
    if isinstance(section, LinesSection) and section.color_by == "direction":
        return 3
    name, where = name or section.scalars, f"{key}.scalars"
    if name is None or (isinstance(section, LinesSection) and section.color_by == "color"):
        return 0
    if name not in arrays:
        raise InputError("no such array", where=where, found=name, allowed=", ".join(arrays) or "none: there are none")
    width: Any = arrays[name][1]
    if width not in COMPONENTS:
        raise InputError("neither scalars nor colours", where=where, found=f"{width} components", allowed="1, 3 or 4")
    return width  # type: ignore[no-any-return]


def _cropped(
    numbers: Numbers, layer: GeometryLayer, drawn: DrawnPrimitives, normals: Normals, rows_of: DistinctRows
) -> Primitives:
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
    elif layer.colour_of:
        chosen = rows if layer.colour_of == "vertices" else numbers if drawn.cells is None else drawn.cells[numbers]
        colours = _array(drawn, section.scalars)[chosen].reshape(-1, layer.channels)
    along = normals[1][np.searchsorted(normals[0], rows)] if layer.has_normals else NOTHING
    return Primitives(numbers, positions, corners, along, radii, colours)
