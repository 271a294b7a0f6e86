"""Tetrahedra of a box of bricks in the arrays that shaders read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.faces import NONE, Faces, find_neighbours
from clusterviz.plan.cells import CellBrick, CellLayer, join_bricks
from clusterviz.plan.content import Content
from clusterviz.plan.segments import BUCKETS

OUTWARD = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
"""Corners of the face without corner k, counter-clockwise seen from outside."""
GRID = np.dtype(
    [
        ("buckets", "f4", 4),  # as in the frame's block
        ("optics", "f4", 4),  # a cell's side of the domain in opacity unit distances; tetrahedra of all grids; 1 if lit
        ("last_segment", "i4"),
        ("first_bucket", "i4"),
        ("further_starts", "i4"),
        ("first_value", "i4"),  # word of the value of tetrahedron 0, in the table; `NO_VALUES`: points have them
        ("reflects", "f4", 4),  # material, as in `Shading`
    ]
)
WORDS = 8
"""Of a tetrahedron in the table."""
NO_VALUES = -0x7FFFFFFF
"""As in run.glsl."""


@dataclass(frozen=True, eq=False)
class LocalGrid:
    """Tetrahedra of one grid in a box.

    Attributes
    ----------
    points : float32 or float64 (n, 3), in the coordinates of the file
    scalars : float32 (n,), in units of clim; zeros if tetrahedra have them
    values : float32 (m,), of tetrahedra; or (0,)
    corners : int32 (m, 4), rows of points, ascending
    following : int32 (m, 4), `Neighbours.halves`, negative at the boundary
    faces : int32 (b, 4), corners of the faces at the boundary, counter-clockwise seen from outside in the domain, and
        the half-face, which is four times the tetrahedron and the place of its corner that is not on the face; for a
        k-buffer corners of all faces, and their marks
    """

    points: NDArray[Any]
    scalars: NDArray[np.float32]
    values: NDArray[np.float32]
    corners: NDArray[np.int32]
    following: NDArray[np.int32]
    faces: NDArray[np.int32]


def make_local_grid(layer: CellLayer, bricks: Sequence[CellBrick], threads: int = 1) -> LocalGrid:
    """Return the tetrahedra of some bricks, each once.

    Parameters
    ----------
    threads : find neighbours
    """
    whole = join_bricks([layer.no_cells(), *bricks], layer.on_cells)
    corners, values = whole.corners, layer.shader_values(whole.values)
    neighbours = find_neighbours(corners, len(whole.rows), threads)
    scalars, of_cells = (np.zeros(len(whole.rows), np.float32), values) if layer.on_cells else (values, values[:0])
    reflects = bool(np.linalg.det(layer.index_from_file[:, :3]) < 0)
    if layer.kbuffer:
        none = np.zeros((0, 4), np.int32)
        return LocalGrid(whole.points, scalars, of_cells, none, none, marked_faces(neighbours.faces(), reflects))
    tetrahedron, k = np.nonzero(neighbours.halves == NONE)
    own = corners[tetrahedron].astype(np.int64)
    place = (own < np.take_along_axis(own, k[:, None], 1)).sum(axis=1)
    faces = np.take_along_axis(own, OUTWARD[k], 1)
    if reflects:
        faces = faces[:, ::-1]
    ascending = neighbours.ascending(threads)
    return LocalGrid(
        whole.points,
        scalars,
        of_cells,
        ascending.tetrahedra.astype(np.int32),
        ascending.halves.view(np.int32),
        np.column_stack([faces, 4 * tetrahedron + place]).astype(np.int32),
    )


def marked_faces(faces: Faces, reflects: bool) -> NDArray[np.int32]:
    """Return corners of faces and marks, int32 (f, 4).

    A mark is four times the exclusive or of the numbers of the tetrahedra on both sides, from 1, with 0 for outside;
    plus 1 if outside is where corners are counter-clockwise seen from in the domain, and 2 if it is on the other side.
    """
    outside = (faces.sides == NONE) @ np.array([1, 2] if reflects else [2, 1], np.uint32)
    numbers = faces.sides + np.uint32(1)
    return np.column_stack([faces.corners, (numbers[:, 0] ^ numbers[:, 1]) << 2 | outside]).astype(np.int32)


@dataclass(frozen=True, eq=False)
class CellTable:
    """Tetrahedra of all grids of a scene in a box.

    Attributes
    ----------
    tetrahedra : number of all
    words : int32 (k,), for each tetrahedron its corners, which are rows of the A-buffer's vertices, ascending, and the
        half-faces behind its faces, negative at the boundary; then the bits of the float32 values of the tetrahedra of
        grids whose tetrahedra have them
    first_values : for each grid, word of the value of tetrahedron 0 of all, as if it were of that grid; or `NO_VALUES`
    """

    tetrahedra: int
    words: NDArray[np.int32]
    first_values: tuple[int, ...]


def make_cell_table(grids: Sequence[LocalGrid], vertices: int) -> tuple[CellTable, list[NDArray[np.int32]]]:
    """Return the table of grids whose points are behind other vertices, and their boundary faces with all rows."""
    words, boundaries = (list[NDArray[np.int32]]() for _ in range(2))
    first_values, tetrahedra, word = list[int](), 0, WORDS * sum(len(grid.corners) for grid in grids)
    for grid in grids:
        following = np.where(grid.following < 0, -1, grid.following + 4 * tetrahedra)
        words.append(np.hstack([grid.corners + vertices, following]).astype(np.int32).ravel())
        boundaries.append((grid.faces + np.array([vertices, vertices, vertices, 4 * tetrahedra])).astype(np.int32))
        first_values.append(word - tetrahedra if len(grid.values) else NO_VALUES)
        vertices, tetrahedra, word = (
            vertices + len(grid.points),
            tetrahedra + len(grid.corners),
            word + len(grid.values),
        )
    words += [grid.values.view(np.int32) for grid in grids]
    return CellTable(tetrahedra, np.concatenate(words), tuple(first_values)), boundaries


def walk_planes(content: Content) -> int:
    """Return the numbers that OpenGL keeps of the walks of each pixel, as in walks_kept.glsl."""
    return 2 + 4 * len(content.cells) if content.cells else 0


def grids_block(content: Content, table: CellTable) -> NDArray[np.void]:
    """Return the block of all grids, `GRID` (n,); segments of the volumes come before theirs."""
    blocks = np.zeros(len(content.cells), GRID)
    first = sum(len(layer.segments.records) for layer in content.volume_layers)
    for number, (block, layer) in enumerate(zip(blocks, content.cells, strict=True), len(content.volume_layers)):
        segments = layer.segments
        block["buckets"] = segments.low, segments.per_unit, BUCKETS - 1, segments.transparent_below
        block["optics"][:3] = layer.units, table.tetrahedra, layer.shading is not None
        block["reflects"] = layer.shading.material if layer.shading else 0
        first += len(segments.records)
        block["last_segment"], block["first_bucket"] = first - 1, BUCKETS * number
        block["further_starts"] = segments.further_starts
    blocks["first_value"] = table.first_values
    return blocks
