"""Primitives of a box of bricks in the arrays that shaders read, each once, by ascending numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm.placement import kernel_threads
from clusterviz.plan.cells import CellLayer
from clusterviz.plan.geometry import GeometryLayer, Layer, Members, Primitives
from clusterviz.render.cells.table import CellTable, make_cell_table, make_local_grid

T = TypeVar("T")

KINDS = {"triangle": 0, "tube": 1, "sphere": 2, "entry": 3, "face": 4}
NONE = -0x7FFFFFFF
"""Place of normals that there are not, as in primitives.glsl."""
LAYER = np.dtype(
    [
        ("rgba", "f4", 4),
        ("table", "u4", 4),
        ("words", "i4", 4),
        ("material", "f4", 4),
        ("edge", "f4", 4),
        ("half", "f4", 4),
    ]
)
"""As `Layer` in primitives.glsl."""


@dataclass(frozen=True, eq=False)
class PrimitiveTable:
    """Primitives of a box.

    Attributes
    ----------
    positions : float32 or float64 (n, 3) for each layer, in the coordinates of its file
    radii : float32 (n,) for each layer, or (0,); scalars of grids
    corners : int32 (m, 4), rows of all positions; of a triangle the last is its flags, as in primitives.glsl; of a face
        of a grid as `LocalGrid.faces`
    layers : LAYER (layers,), of geometry, then of grids
    attributes : float32 (k,), normals, colours and segments
    cells : of unstructured grids; None without any
    """

    positions: tuple[NDArray[Any], ...]
    radii: tuple[NDArray[np.float32], ...]
    corners: NDArray[np.int32]
    layers: NDArray[np.void]
    attributes: NDArray[np.float32]
    cells: CellTable | None = None

    @property
    def vertices(self) -> int:
        """Number of positions."""
        return sum(map(len, self.positions))


class TableCache:
    """Tables of boxes of bricks, while these and the layers stay."""

    def __init__(self) -> None:
        self._layers: Sequence[Layer] = ()
        self._tables: dict[bytes, PrimitiveTable] = {}

    def table(
        self,
        layers: Sequence[Layer],
        bricks: NDArray[np.int64],
        members: Callable[[NDArray[np.int64]], Iterable[Sequence[Members | None]]],
    ) -> PrimitiveTable | None:
        """Return the table of bricks (m, 3), given the function that finds what they hold of each layer; or None."""
        if len(layers) != len(self._layers) or any(a is not b for a, b in zip(self._layers, layers, strict=True)):
            self._layers, self._tables = layers, {}
        if layers and (key := bricks.tobytes()) not in self._tables:
            self._tables[key] = make_table(layers, members(bricks))
        return self._tables[key] if layers else None


def make_table(layers: Sequence[Layer], bricks: Iterable[Sequence[Members | None]]) -> PrimitiveTable:
    """Return the primitives and tetrahedra of some bricks.

    Parameters
    ----------
    layers : of geometry, then of unstructured grids
    bricks : what each brick holds of each layer
    """
    geometry = [layer for layer in layers if isinstance(layer, GeometryLayer)]
    grids = [layer for layer in layers if isinstance(layer, CellLayer)]
    each: list[list[Any]] = _by_layer(len(layers), bricks)
    records = np.zeros(len(layers), LAYER)
    positions, radii, corners = list[NDArray[Any]](), list[NDArray[np.float32]](), list[NDArray[np.int32]]()
    attributes: list[NDArray[Any]] = [np.zeros(1)]
    first_row = first_vertex = 0
    words = 1
    for layer, record, parts in zip(geometry, records, each, strict=False):
        table, own, has_normals = _joined(layer, parts)
        positions.append(own.positions)
        radii.append(own.radii)
        rows, vertices = len(table), len(own.positions)
        table[:, : 3 if layer.kind == "triangle" else 4] += first_vertex
        corners.append(table)
        record["rgba"], record["material"] = layer.rgba, layer.shading.material if layer.shading else 0
        record["table"] = first_row, KINDS[layer.kind], layer.channels, (layer.shading is not None) + 2 * layer.opaque
        if layer.edges:
            record["edge"], record["half"] = layer.edges[:4], layer.edges[4]
        of_vertices = layer.colour_of == "vertices"
        record["words"] = NONE, 0, of_vertices, 0
        if has_normals:
            record["words"][0] = words - 3 * first_vertex
            attributes.append(own.normals.ravel())
            words += own.normals.size
        if layer.channels:
            record["words"][1] = words - layer.channels * (first_vertex if of_vertices else first_row)
            attributes.append(layer.shader_colours(own.colours).ravel())
            words += own.colours.size
        if layer.segments is not None:
            record["words"][3] = words
            segments = layer.segments.records.view(np.float32)
            attributes += [np.array([len(layer.segments.records)]), segments]
            words += 1 + segments.size
        first_row, first_vertex = first_row + rows, first_vertex + vertices
    found = None
    if grids:
        threads = kernel_threads()
        local = [make_local_grid(*one, threads) for one in zip(grids, each[len(geometry) :], strict=True)]
        found, boundaries = make_cell_table(local, first_vertex)
        for own_layer, record, grid, boundary in zip(grids, records[len(geometry) :], local, boundaries, strict=True):
            positions.append(grid.points)
            radii.append(grid.scalars)
            corners.append(boundary)
            record["table"] = first_row, KINDS["face" if own_layer.kbuffer else "entry"], len(grid.values), 0
            first_row += len(boundary)
    all_corners = np.concatenate([np.zeros((0, 4), np.int32), *corners])
    values = np.concatenate(attributes).astype(np.float32)
    for data in (all_corners, records, values, *([found.words] if found else [])):
        data.setflags(write=False)  # they stay on a device
    return PrimitiveTable(tuple(positions), tuple(radii), all_corners, records, values, found)


def _by_layer(count: int, bricks: Iterable[Sequence[T | None]]) -> list[list[T]]:
    """Return, for each layer, what it has in each brick."""
    found: list[list[T]] = [[] for _ in range(count)]
    for brick in bricks:
        for own, one in zip(found, brick, strict=False):
            own += [one] if one is not None else []
    return found


def _joined(layer: GeometryLayer, parts: Sequence[Primitives]) -> tuple[NDArray[np.int32], Primitives, bool]:
    """Return the corners of primitives, each once, int32 (m, 4); arrays that they refer to; and whether it has normals.

    Corners of triangles are in the order of their positions, so that equal triangles are met at equal depths.
    """
    if not parts:
        none = np.zeros((0, 3), np.float32)
        empty = Primitives(
            np.zeros(0, np.uint32),
            none,
            np.zeros((0, 1), np.uint32),
            none,
            none[:, 0],
            np.zeros((0, layer.channels), "f4"),
        )
        return np.zeros((0, 4), np.int32), empty, False
    numbers = np.concatenate([part.numbers for part in parts])
    numbers, chosen = np.unique(numbers, return_index=True)
    begins = np.cumsum([0, *(len(part.positions) for part in parts)])
    given = np.concatenate([part.corners + begin for part, begin in zip(parts, begins, strict=False)])[chosen]
    positions = np.concatenate([part.positions for part in parts])
    colours = np.concatenate([part.colours for part in parts])
    if layer.colour_of == "primitives":
        colours = colours[chosen]
    normals = np.concatenate([part.normals for part in parts])
    corners = np.zeros((len(given), 4), np.int32)
    corners[:, : given.shape[1]] = given
    if layer.kind == "triangle":
        corners[:, :3], turned = _sorted(corners[:, :3], positions)
        corners[:, 3] = turned + {"none": 0, "front": 2, "back": 4}[layer.culling]
    radii = np.concatenate([part.radii for part in parts])
    return corners, Primitives(numbers, positions, given, normals, radii, colours), len(normals) > 0


def _sorted(corners: NDArray[np.int32], positions: NDArray[Any]) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """Return corners by ascending positions, and where that turns a triangle round."""
    corners, turned = corners.copy(), np.zeros(len(corners), bool)
    for a, b in ((0, 1), (1, 2), (0, 1)):
        p, q = positions[corners[:, a]], positions[corners[:, b]]
        after = np.where(
            p[:, 0] != q[:, 0], p[:, 0] > q[:, 0], np.where(p[:, 1] != q[:, 1], p[:, 1] > q[:, 1], p[:, 2] > q[:, 2])
        )
        corners[after, a], corners[after, b] = corners[after, b], corners[after, a]
        turned ^= after
    return corners, turned
