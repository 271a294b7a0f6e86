"""Unstructured grids of a scene: facts that complete it, layers of a plan, and the tetrahedra of bricks.

Each rank reads the file of a grid and cuts its cells into tetrahedra; `brick_search.py` finds those of bricks. After a
rank has read its bricks it forgets the file, which it reads again if bricks are missing later.
"""

from __future__ import annotations

from collections.abc import Callable, Set
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm import Channel, agree
from clusterviz.data.geometry import CHUNK
from clusterviz.data.primitives import NO_RADII, BrickMembers, DistinctRows, DrawnPrimitives, transformed
from clusterviz.data.source import Index
from clusterviz.data.tetrahedra import Tetrahedra, make_tetrahedra
from clusterviz.data.unstructured import UnstructuredGrid
from clusterviz.plan.brick_search import BrickGrid, BrickSearch, world_from_file
from clusterviz.plan.cells import CellBrick, CellLayer
from clusterviz.plan.preintegration import make_preintegrated
from clusterviz.plan.shading import make_geometry_shading
from clusterviz.scene.complete import transfer_function
from clusterviz.scene.grids import GridInfo, GridSection, KBuffer
from clusterviz.scene.values import Light

Floats = NDArray[np.float64]
TINY = float(np.finfo(np.float64).tiny)
LEAST_SHARE = 2.0**-12
"""Share of a tetrahedron's segments in a brick that it just touches."""


class KnownCells:
    """Unstructured grid of a scene; construction, `layer` and `read` are collective.

    Parameters
    ----------
    section : as in the scene file
    load : reads the grid
    channel : to the other ranks

    Attributes
    ----------
    info : facts on it

    Raises
    ------
    DataError
        The file cannot be read, or lacks the array that the section names.
    """

    def __init__(self, section: GridSection, load: Callable[[], UnstructuredGrid], channel: Channel) -> None:
        self._channel = channel
        self._search = BrickSearch(lambda: _drawn(make_tetrahedra(load(), section.array)), channel)
        self._measures: dict[Any, Floats] = {}
        with agree(channel, 0, "open"):
            found = make_tetrahedra(load(), section.array)
            drawn = self._search.drawn = _drawn(found)
            matrix = world_from_file(section)
            box = drawn.box(matrix, np.arange(len(found.corners)))
            cells = int(np.count_nonzero(np.diff(found.cells))) + 1
            volume = _volume(found.points, found.corners, matrix)
            self._on_cells, self._types = found.on_cells, (found.points.dtype, found.values.dtype)
            has_any = len(found.corners) > 0
            self.info = GridInfo(
                box if has_any else np.empty((0, 3)),
                len(found.corners),
                cells if has_any else 0,
                (float(found.values.min()), float(found.values.max())) if has_any else None,
                float(np.cbrt(volume / cells)) if has_any else 0.0,
                found.counts,
            )

    def layer(self, section: GridSection, lights: tuple[Light, ...], grid: BrickGrid) -> tuple[CellLayer, Floats]:
        """Return the layer of a plan, and the expected segments of each brick.

        Parameters
        ----------
        section : completed
        lights : of the scene
        grid : of the plan

        Returns
        -------
        segments : float64 (bz, by, bx), of a ray through each cell of the domain's grid; 0 where all is transparent
        """
        transfer = transfer_function(section)
        in_bricks = self._search.counted(section, grid)
        low, high, segments = self._measured(section, grid)
        layer = CellLayer(
            self.info.count,
            grid.index_from_file(section),
            self._on_cells,
            make_preintegrated(transfer),
            grid.domain.spacing / transfer.unit_distance,
            make_geometry_shading(section, lights, grid.domain.grid) if section.shade else None,
            section.visibility if isinstance(section.visibility, KBuffer) else None,
            section,
            transfer.domain,
            *self._types,
            in_bricks,
        )
        return layer, np.where(transfer.is_transparent(low, high), 0.0, segments)

    def read(self, layer: CellLayer, grid: BrickGrid, wanted: Set[Index]) -> dict[Index, CellBrick]:
        """Return the tetrahedra of bricks by index, and forget the others; bricks without any are left out.

        Parameters
        ----------
        layer, grid : of the plan
        wanted : indices of bricks
        """
        section, search, found = layer.section, self._search, dict[Index, CellBrick]()
        with agree(self._channel, 0, "load"):
            some = sorted(index for index in wanted if layer.in_bricks[0][index])
        if section is not None and self._channel.maximum(len(some)):
            flat = [int(np.ravel_multi_index(index, grid.layout.counts_zyx)) for index in some]
            members = search.gathered(section, grid, flat)
            with agree(self._channel, 0, "load"):
                rows = DistinctRows(len(search.opened().positions)) if some else None
                for index, brick in zip(some, flat, strict=True):
                    assert rows is not None
                    found[index] = _cropped(members[brick], search.opened(), rows)
        search.forget()
        return found

    def _measured(self, section: GridSection, grid: BrickGrid) -> Floats:
        """Return lowest and highest scalar and expected segments of each brick, float64 (3, bz, by, bx).

        The first call for a grid is collective.
        """
        key = grid.domain, grid.layout.brick, grid.reach, section.transform
        if key not in self._measures:
            members = self._search.members(section, grid)
            with agree(self._channel, 0, "plan"):
                mine = self._measured_members(section, grid, members)
            self._measures[key] = self._search.of_all_bricks(mine, grid)
        return self._measures[key]

    def _measured_members(self, section: GridSection, grid: BrickGrid, members: BrickMembers) -> Floats:
        drawn, matrix, brick = self._search.opened(), grid.index_from_file(section), grid.layout.brick
        bricks, ranks = len(members.begins) - 1, self._channel.size
        found = np.repeat([[np.inf], [-np.inf], [0.0]], bricks, axis=1)
        flat = self._channel.rank + np.arange(bricks) * ranks
        x, rest = flat % grid.layout.counts_zyx[2], flat // grid.layout.counts_zyx[2]
        begins = brick * np.stack([x, rest % grid.layout.counts_zyx[1], rest // grid.layout.counts_zyx[1]], axis=1)
        owners = np.repeat(np.arange(bricks), np.diff(members.begins))
        numbers, places = np.unique(members.numbers, return_inverse=True)
        measured = _Measured.of(drawn, numbers, matrix)
        for first in range(0, len(owners), CHUNK):
            some = places[first : first + CHUNK]
            owner, low, high = owners[first : first + CHUNK], measured.low[some], measured.high[some]
            inside = np.minimum(high, begins[owner] + brick) - np.maximum(low, begins[owner])
            shares = (inside.clip(0) / (high - low).clip(TINY)).prod(axis=1).clip(LEAST_SHARE)
            # One after the other, so that sums are the same on any ranks.
            np.add.at(found[2], owner, measured.shadow[some] * shares)
            np.minimum.at(found[0], owner, measured.values[0, some])
            np.maximum.at(found[1], owner, measured.values[1, some])
        return found


@dataclass(frozen=True, eq=False)
class _Measured:
    """Tetrahedra in cells of the domain: corners of boxes float64 (m, 3), mean shadow (m,), extreme scalars (2, m)."""

    low: Floats
    high: Floats
    shadow: Floats
    values: NDArray[Any]

    @classmethod
    def of(cls, drawn: DrawnPrimitives, numbers: NDArray[np.uint32], matrix: Floats) -> _Measured:
        low, high, shadow = np.empty((len(numbers), 3)), np.empty((len(numbers), 3)), np.empty(len(numbers))
        for begin in range(0, len(numbers), CHUNK // 4):
            some = slice(begin, begin + CHUNK // 4)
            placed = [transformed(drawn.positions[corner], matrix) for corner in drawn.corners[numbers[some]].T]
            low[some], high[some] = np.minimum.reduce(placed), np.maximum.reduce(placed)
            u, v, w = (corner - placed[0] for corner in placed[1:])
            pairs = (u, v), (u, w), (v, w), (v - u, w - u)
            # A convex body's mean shadow is a quarter of its surface.
            shadow[some] = sum(_twice_area(*pair) for pair in pairs) / 8
        own = drawn.of_cells[""][numbers, None] if drawn.of_cells else drawn.of_vertices[""][drawn.corners[numbers]]
        return cls(low, high, shadow, np.stack([own.min(axis=1), own.max(axis=1)]))


def _twice_area(u: Floats, v: Floats) -> Floats:
    uu, vv, uv = (np.einsum("mx,mx->m", *pair) for pair in ((u, u), (v, v), (u, v)))
    return np.asarray(np.sqrt((uu * vv - uv * uv).clip(0)))


def _drawn(found: Tetrahedra) -> DrawnPrimitives:
    """Return tetrahedra as primitives, with their scalars as the array ""."""
    of_points, of_cells = ({}, {"": found.values}) if found.on_cells else ({"": found.values}, {})
    return DrawnPrimitives("tetrahedron", found.points, found.corners, NO_RADII, 0, of_points, of_cells)


def _volume(points: NDArray[Any], corners: NDArray[np.uint32], matrix: Floats) -> float:
    """Return the volume of all tetrahedra, mapped by a matrix."""
    found = 0.0
    for begin in range(0, len(corners), CHUNK // 4):
        a, b, c, d = (points[corner].astype(np.float64) for corner in corners[begin : begin + CHUNK // 4].T)
        found += float(np.einsum("mx,mx->m", np.cross(b - a, c - a), d - a).sum())
    return abs(found * float(np.linalg.det(matrix[:3, :3]))) / 6


def _cropped(numbers: NDArray[np.uint32], drawn: DrawnPrimitives, rows_of: DistinctRows) -> CellBrick:
    """Return some tetrahedra with what belongs to them."""
    rows, corners = rows_of.renumber(drawn.corners[numbers])
    values = drawn.of_cells[""][numbers] if drawn.of_cells else drawn.of_vertices[""][rows]
    return CellBrick(numbers, rows.astype(np.uint32), drawn.positions[rows], corners, values)
