"""Unstructured grids of a scene: facts that complete it, layers of a plan, and the tetrahedra of bricks.

Each rank reads some of a grid's files, or takes a share of the cells of the only one, and cuts cells into tetrahedra.
Tetrahedra and points are numbered through all ranks; points of several ranks with the same position and scalar get one
number. Each rank sends its tetrahedra to the ranks i mod n that keep the bricks i that these meet, each once to each,
and a rank that reads bricks asks there. Then all is forgotten; files are read again if bricks are missing later.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm import Channel, agree, all_to_all
from clusterviz.content.brick_search import (
    TAG,
    PlacedEntry,
    asked_for,
    flat_of,
    key_of,
    received_members,
    sent_keys,
)
from clusterviz.content.grid.section import GridInfo, GridSection, KBuffer
from clusterviz.content.transfer import transfer_function
from clusterviz.data.axes import Choice, Subset, first_parts, warn_of_choices
from clusterviz.data.faces import find_neighbours
from clusterviz.data.geometry import CHUNK, STEP, hashes, merge_equal
from clusterviz.data.grid_files import GridFile
from clusterviz.data.primitives import NO_RADII, BrickMembers, DistinctRows, DrawnPrimitives, transformed
from clusterviz.data.source import Index
from clusterviz.data.tetrahedra import MOST, Tetrahedra, groups_with_values, make_tetrahedra
from clusterviz.data.unstructured import UnstructuredGrid
from clusterviz.errors import DataError, SceneError
from clusterviz.plan.cells import CellBrick, CellLayer, join_bricks
from clusterviz.plan.domain import BrickGrid, world_from_file
from clusterviz.plan.integration_table import make_integration_table
from clusterviz.plan.preintegration import make_preintegrated
from clusterviz.plan.shading import make_geometry_shading
from clusterviz.scene.transfer import TransferFunction
from clusterviz.scene.values import Light

Floats = NDArray[np.float64]
TINY = float(np.finfo(np.float64).tiny)
LEAST_SHARE = 2.0**-12
"""Share of a tetrahedron's segments in a brick that it just touches."""
FIELDS = [field.name for field in fields(CellBrick)]
AT_ONCE = 16
"""Bricks that a rank receives at the same time, which are in memory twice."""

LONGEST = 4.0
"""Length of a segment in mean cells, up to which a table has its integral."""


class KnownCells(PlacedEntry[CellLayer, CellBrick]):
    """Unstructured grid of a scene.

    Parameters
    ----------
    section, key, channel : as of `PlacedEntry`
    find : returns the files of the grid; called on rank 0
    load : reads a file

    Raises
    ------
    DataError
        A file cannot be read, lacks the array that the section names, or does not fit the others.
    """

    def __init__(
        self,
        section: GridSection,
        key: str,
        find: Callable[[], Sequence[GridFile]],
        load: Callable[[GridFile], UnstructuredGrid],
        channel: Channel,
    ) -> None:
        super().__init__(section, key, channel)
        self._find, self._load = find, load
        self._own: CellBrick | None = None
        self._kept: tuple[object, CellBrick, BrickMembers] | None = None
        self._table: tuple[GridSection, NDArray[np.float32]] | None = None
        self._opened()

    def layer(self, section: GridSection, lights: tuple[Light, ...], grid: BrickGrid) -> CellLayer:
        """Return the layer of a plan, for a completed section."""
        if section.shade and self._on_cells:
            text, found = "values of cells have no gradient to light", "true, and values of cells"
            raise SceneError(text, where=f"{self._key}.shade", found=found, allowed="false, or values of points")
        transfer = transfer_function(section)
        in_bricks = self._counted(section, grid)
        low, high, segments = self._in_all_bricks("measures", section, grid, partial(self._measured, section, grid))
        kbuffer = section.visibility if isinstance(section.visibility, KBuffer) else None
        return CellLayer(
            count=self.info.count,
            index_from_file=grid.index_from_file(section),
            section=section,
            shading=make_geometry_shading(section, lights, grid.domain.grid) if section.shade else None,
            clim=transfer.domain,
            position_type=self._types[0],
            in_bricks=in_bricks,
            on_cells=self._on_cells,
            segments=make_preintegrated(transfer),
            units=grid.domain.spacing / transfer.unit_distance,
            kbuffer=kbuffer,
            integrals=self._integrals(section, transfer) if kbuffer and kbuffer.integration == "table" else None,
            value_type=self._types[1],
            crossings=np.where(transfer.is_transparent(low, high), 0.0, segments),
        )

    def _integrals(self, section: GridSection, transfer: TransferFunction) -> NDArray[np.float32]:
        if self._table is None or self._table[0] != section:
            longest = LONGEST * self.info.cell_size / transfer.unit_distance or 1.0
            self._table = section, make_integration_table(transfer, longest)
        return self._table[1]

    def _received(self, layer: CellLayer, grid: BrickGrid, some: Sequence[Index], most: int) -> dict[Index, CellBrick]:
        found: dict[Index, CellBrick] = {}
        for begin in range(0, most, AT_ONCE):
            found |= self._some_received(layer, grid, some[begin : begin + AT_ONCE])
        return found

    def _forget(self) -> None:
        self._own = self._kept = None

    def _opened(self) -> CellBrick:
        """Return the tetrahedra of this rank's share, which is read if it was forgotten; collective."""
        if self._own is not None:
            return self._own
        channel, section = self._channel, self._section
        with agree(channel, 0, "open"):
            listed = [(file, file.size) for file in self._find()] if channel.rank == 0 else []
        files, sizes = zip(*channel.broadcast(listed), strict=True)
        with agree(channel, 0, "open"):
            parts, matrix = self._cut(files, sizes), world_from_file(section)
            mine = [_Part.of(part, choices, matrix) for part, choices in parts]
        each = channel.allgather(mine)
        with agree(channel, 0, "open"):
            known = [part for of_rank in each for part in of_rank]
            self._on_cells, self._types = _check_alike(known)
            self.info = _info(known)
            if known and known[0].choices and channel.rank == 0:
                warn_of_choices(section.path, known[0].choices)
            points = sum(part.points for part in known)
            if max(points, self.info.count) > MOST:
                found = f"{points} points, {self.info.count} tetrahedra"
                raise DataError("too large", where=section.path, found=found, allowed=f"at most {MOST} of each")
            before = [part for of_rank in each[: channel.rank] for part in of_rank]
            own = _stacked([part for part, _ in parts], before, self._types)
            if len(files) == 1:
                own = replace(own, rows=parts[0][0].rows)
            del parts
        if len(files) > 1:
            rows = _numbered(own, self._on_cells, channel)
            with agree(channel, 0, "open"):
                own = join_bricks([replace(own, rows=rows)], self._on_cells)
        self._own = own
        return own

    def _cut(self, files: Sequence[GridFile], sizes: Sequence[int]) -> list[tuple[Tetrahedra, list[Choice]]]:
        """Return the tetrahedra of each of the files that this rank reads, or of its share of the only one.

        Where no array is named, it is the first one; the choices say so.
        """
        rank, ranks, array = self._channel.rank, self._channel.size, self._section.array
        if len(files) == 1:
            return [_tetrahedra(self._load(files[0]).part(rank, ranks), array)]
        # The rank of a file's middle, of equal shares of all bytes.
        middles = np.cumsum(sizes) - np.array(sizes) / 2
        mine = np.flatnonzero((ranks * middles / sum(sizes)).astype(int) == rank)
        grids = (self._load(files[n]) for n in mine.tolist())
        return [_tetrahedra(grid, array) for grid in grids if grid.count]

    def _members(self, section: GridSection, grid: BrickGrid) -> tuple[CellBrick, BrickMembers]:
        """Return the tetrahedra in the bricks r, r + n, … on rank r of n, and those of each brick, as rows of them.

        Collective, unless the grid of bricks is the last one and nothing was forgotten.
        """
        key, channel = key_of(section, grid), self._channel
        if self._kept is None or self._kept[0] != key:
            self._kept, own = None, self._opened()
            with agree(channel, 0, "plan"):
                drawn, rows = _drawn(own, self._on_cells), DistinctRows(len(own.rows))
                keys = sent_keys(drawn, np.arange(len(own.numbers)), section, grid, channel.size)
                sent = [own]
                if channel.size > 1:
                    renumbered = [_renumbered(each, len(own.numbers)) for each in keys]
                    sent = [_cropped(each, own, rows, self._on_cells) for each, _ in renumbered]
                    keys = [each for _, each in renumbered]
            received, keys = _exchanged(sent, channel), all_to_all(channel, keys, TAG)
            with agree(channel, 0, "plan"):
                # Ranks, and so the numbers of their tetrahedra, are in order.
                begins = np.cumsum([0, *(len(brick.numbers) for brick in received)]).astype(np.uint64)
                keys = [each + begin for each, begin in zip(keys, begins, strict=False)]
                kept = join_bricks(received, self._on_cells) if channel.size > 1 else own
            self._kept = key, kept, received_members(keys, grid, channel)
            if not self._of_bricks:
                with agree(channel, 0, "plan"):
                    crowded = find_neighbours(kept.corners, len(kept.rows)).crowded
                self.info = replace(self.info, overlaps=channel.maximum(crowded) > 0)
        return self._kept[1:]

    def _kept_members(self, section: GridSection, grid: BrickGrid) -> tuple[DrawnPrimitives, BrickMembers]:
        kept, members = self._members(section, grid)
        return _drawn(kept, self._on_cells), members

    def _some_received(self, layer: CellLayer, grid: BrickGrid, some: Sequence[Index]) -> dict[Index, CellBrick]:
        channel, (kept, members), flat = self._channel, self._members(layer.section, grid), flat_of(some, grid)
        found, (asked, requests) = dict[Index, CellBrick](), asked_for(flat, channel)
        with agree(channel, 0, "load"):
            empty, rows = layer.no_cells(), DistinctRows(len(kept.rows))
            sent = [
                [_cropped(members.of(brick // channel.size), kept, rows, self._on_cells) for brick in each.tolist()]
                for each in requests
            ]
            joined = [
                CellBrick(*(np.concatenate([getattr(one, name) for one in [empty, *each]]) for name in FIELDS))
                for each in sent
            ]
        indices = dict(zip(flat, some, strict=True))
        for each, brick in zip(asked, _exchanged(joined, channel), strict=True):
            ends = np.cumsum(layer.in_bricks.reshape(2, -1)[:, each], axis=1)[:, :-1]
            of = {"numbers": 0, "rows": 1, "points": 1, "corners": 0, "values": 0 if self._on_cells else 1}
            cut = [np.split(getattr(brick, name), ends[of[name]]) for name in FIELDS]
            for one, *arrays in zip(each.tolist(), *cut, strict=False):
                found[indices[one]] = CellBrick(*(array.copy() for array in arrays))
        return found

    def _measured(self, section: GridSection, grid: BrickGrid, drawn: DrawnPrimitives, members: BrickMembers) -> Floats:
        """Return lowest and highest scalar, and expected segments, of the bricks that are kept here, float64 (3, k)."""
        matrix, brick = grid.index_from_file(section), grid.layout.brick
        bricks, ranks = len(members.begins) - 1, self._channel.size
        found = np.repeat([[np.inf], [-np.inf], [0.0]], bricks, axis=1)
        flat = self._channel.rank + np.arange(bricks) * ranks
        x, rest = flat % grid.layout.counts_zyx[2], flat // grid.layout.counts_zyx[2]
        begins = brick * np.stack([x, rest % grid.layout.counts_zyx[1], rest // grid.layout.counts_zyx[1]], axis=1)
        owners = np.repeat(np.arange(bricks), np.diff(members.begins))
        numbers, places = np.unique(members.numbers, return_inverse=True)
        measured = _Measured.of(drawn, numbers, matrix)
        for first in range(0, len(owners), STEP):
            some = places[first : first + STEP]
            owner, low, high = owners[first : first + STEP], measured.low[some], measured.high[some]
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
        for begin in range(0, len(numbers), STEP):
            some = slice(begin, begin + STEP)
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


@dataclass(frozen=True)
class _Part:
    """Facts on the tetrahedra of one file, or of one rank's share of it; as in `GridInfo`."""

    name: str
    array: str
    on_cells: bool
    types: tuple[str, str]  # of points and values
    points: int
    tetrahedra: int
    cells: int
    box: Floats
    scalars: tuple[float, float]
    volume: float
    sides: float  # of boxes around all tetrahedra, summed
    counts: Mapping[str, int]
    choices: Sequence[Choice]

    @classmethod
    def of(cls, found: Tetrahedra, choices: Sequence[Choice], matrix: Floats) -> _Part:
        count, values = len(found.corners), found.values
        return cls(
            found.name,
            found.array,
            found.on_cells,
            (found.points.dtype.name, values.dtype.name),
            len(found.points),
            count,
            int(np.count_nonzero(np.diff(found.cells))) + (count > 0),
            _bounds(found.points, matrix),
            (float(values.min(initial=np.inf)), float(values.max(initial=-np.inf))),
            *_volume_and_sides(found.points, found.corners, matrix),
            {name: n for name, n in found.counts.items() if name not in ("duplicates", "unused")},
            choices,
        )


def _tetrahedra(grid: UnstructuredGrid, array: str | None) -> tuple[Tetrahedra, list[Choice]]:
    found, _, choices = first_parts(lambda part: make_tetrahedra(grid, part.array), Subset(array))
    return found, choices


def _check_alike(parts: Sequence[_Part]) -> tuple[bool, tuple[np.dtype[Any], np.dtype[Any]]]:
    kinds = [(part.array, part.on_cells, part.types) for part in parts] or [("", False, ("float32", "float32"))]
    words = [f"{array} of {('points', 'cells')[on]}, {types[1]}, points {types[0]}" for array, on, types in kinds]
    for part, kind, word in zip(parts, kinds, words, strict=False):
        if kind != kinds[0]:
            allowed = f"{words[0]}, as in {parts[0].name}"
            raise DataError("a piece is unlike the others", where=part.name, found=word, allowed=allowed)
    points, values = kinds[0][2]
    return kinds[0][1], (np.dtype(points), np.dtype(values))


def _info(parts: Sequence[_Part]) -> GridInfo:
    some = [part for part in parts if part.tetrahedra]
    counts = {name: sum(part.counts[name] for part in parts) for name in (parts[0].counts if parts else ())}
    if not some:
        return GridInfo(np.empty((0, 3)), 0, counts=counts)
    cells, boxes = sum(part.cells for part in some), np.stack([part.box for part in some])
    tetrahedra = sum(part.tetrahedra for part in some)
    return GridInfo(
        np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)]),
        tetrahedra,
        cells,
        (min(part.scalars[0] for part in some), max(part.scalars[1] for part in some)),
        float(np.cbrt(math.fsum(part.volume for part in some) / cells)),
        counts,
        side=_rounded(math.fsum(part.sides for part in some) / tetrahedra),
        array=some[0].array,
    )


def _rounded(value: float) -> float:
    """Return a number to 20 bits, so that it is the same however many ranks have summed it."""
    share, exponent = math.frexp(value)
    return math.ldexp(round(math.ldexp(share, 20)), exponent - 20)


def _stacked(
    parts: Sequence[Tetrahedra], before: Sequence[_Part], types: tuple[np.dtype[Any], np.dtype[Any]]
) -> CellBrick:
    """Return the tetrahedra of some parts of a grid, numbered after those of others; points are not merged."""
    tetrahedra, points = sum(part.tetrahedra for part in before), sum(part.points for part in before)
    begins = np.cumsum([0, *(len(part.points) for part in parts)]).astype(np.uint32)
    corners = [part.corners + begin for part, begin in zip(parts, begins, strict=False)]
    return CellBrick(
        tetrahedra + np.arange(sum(map(len, corners)), dtype=np.uint32),
        points + np.arange(begins[-1], dtype=np.uint32),
        np.concatenate([np.empty((0, 3), types[0]), *(part.points for part in parts)]),
        np.concatenate([np.empty((0, 4), np.uint32), *corners]),
        np.concatenate([np.empty(0, types[1]), *(part.values for part in parts)]),
    )


def _numbered(own: CellBrick, on_cells: bool, channel: Channel) -> NDArray[np.uint32]:
    """Return the smallest number of the points of all ranks that are equal to each point, uint32 (n,); collective."""
    with agree(channel, 0, "open"):
        ranks = (hashes(own.points) % np.uint64(channel.size)).astype(np.int64)
        order, ends = np.argsort(ranks, kind="stable"), np.cumsum(np.bincount(ranks, minlength=channel.size))[:-1]
        columns = [own.rows, own.points, *([] if on_cells else [own.values])]
        sent = [[np.ascontiguousarray(each) for each in np.split(column[order], ends)] for column in columns]
    numbers, points, *values = (_to_all(column, channel) for column in sent)
    with agree(channel, 0, "open"):
        group = merge_equal(np.concatenate(points))[1]
        if values:
            group = groups_with_values(group, np.concatenate(values[0]))
        smallest, every = np.full(len(group), MOST, np.uint32), np.concatenate(numbers)
        np.minimum.at(smallest, group, every)
        answers = np.split(smallest[group], np.cumsum([len(each) for each in numbers])[:-1])
    received = _to_all(answers, channel)
    found = np.empty(len(order), np.uint32)
    found[order] = np.concatenate(received)
    return found


def _renumbered(keys: NDArray[np.uint64], count: int) -> tuple[NDArray[np.uint32], NDArray[np.uint64]]:
    """Return the different numbers, of `count`, in the lower halves of keys, and keys with their places among these."""
    numbers, is_used = keys.astype(np.uint32), np.zeros(count, bool)
    is_used[numbers] = True
    place = np.cumsum(is_used, dtype=np.uint32) - np.uint32(1)
    return np.flatnonzero(is_used).astype(np.uint32), keys - numbers + place[numbers]


def _exchanged(sent: Sequence[CellBrick], channel: Channel) -> list[CellBrick]:
    columns = [_to_all([getattr(each, name) for each in sent], channel) for name in FIELDS]
    return [CellBrick(*each) for each in zip(*columns, strict=True)]


def _to_all(sent: Sequence[NDArray[Any]], channel: Channel) -> list[NDArray[Any]]:
    shape = sent[0].shape[1:]
    return [each.reshape(-1, *shape) for each in all_to_all(channel, [each.ravel() for each in sent], TAG)]


def _drawn(found: CellBrick, on_cells: bool) -> DrawnPrimitives:
    of_points, of_cells = ({}, {"": found.values}) if on_cells else ({"": found.values}, {})
    return DrawnPrimitives("tetrahedron", found.points, found.corners, NO_RADII, 0, of_points, of_cells)


def _bounds(points: NDArray[Any], matrix: Floats) -> Floats:
    placed = [transformed(points[begin : begin + CHUNK], matrix) for begin in range(0, len(points), CHUNK)]
    low = [each.min(axis=0) for each in placed]
    high = [each.max(axis=0) for each in placed]
    return np.stack([np.min([np.full(3, np.inf), *low], axis=0), np.max([np.full(3, -np.inf), *high], axis=0)])


def _volume_and_sides(points: NDArray[Any], corners: NDArray[np.uint32], matrix: Floats) -> tuple[float, float]:
    """Return the volume of all tetrahedra, and the mean sides of their boxes, summed; mapped by a matrix."""
    volume, sides, scale = 0.0, 0.0, abs(float(np.linalg.det(matrix[:3, :3])))
    for begin in range(0, len(corners), STEP):
        a, b, c, d = (points[corner].astype(np.float64) for corner in corners[begin : begin + STEP].T)
        volume += float(np.einsum("mx,mx->m", np.cross(b - a, c - a), d - a).sum())
        sides += float((np.maximum.reduce([a, b, c, d]) - np.minimum.reduce([a, b, c, d])).sum()) / 3
    return abs(volume) * scale / 6, sides * float(np.cbrt(scale))


def _cropped(members: NDArray[np.uint32], own: CellBrick, rows_of: DistinctRows, on_cells: bool) -> CellBrick:
    rows, corners = rows_of.renumber(own.corners[members])
    values = own.values[members if on_cells else rows]
    return CellBrick(own.numbers[members], own.rows[rows], own.points[rows], corners, values)
