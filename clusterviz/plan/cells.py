"""Unstructured grids of a scene as the renderer needs them, and the tetrahedra that a brick of the domain holds.

A ray walks through the tetrahedra of a rank's bricks, and integrates in the slabs whose midpoints lie in these bricks.
So a brick holds all tetrahedra that come within half a slab of it, and a tetrahedron may be in several bricks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.content.grid.section import KBuffer
from clusterviz.plan.encoding import FAR, in_units_of_clim
from clusterviz.plan.geometry import WHOLE, Floats, Forms, Layer, Members
from clusterviz.plan.segments import Segments

SEGMENT_COST = 2.0
"""Cost of a ray's segment in a tetrahedron, in cells of a volume: 40 ns beside 20 ns in alternated frames of both.

Nearly all of it is the walk: a segment without opacity costs 0.93 times as much.
"""


@dataclass(frozen=True, eq=False)
class CellBrick(Members):
    """Some tetrahedra of one grid of a scene.

    Points are in the coordinates and the type of the file, so that those which tetrahedra share have the same digits in
    every brick; `CellLayer.index_from_file` places them. Bricks are joined by the numbers of tetrahedra and points.

    Attributes
    ----------
    numbers : uint32 (m,), ascending: number of each tetrahedron in its grid
    rows : uint32 (n,): number of each point in its grid
    points : float32 or float64 (n, 3)
    corners : uint32 (m, 4), rows of `points`; the first three are counter-clockwise seen from the fourth, in the file
    values : scalars of points (n,) or of tetrahedra (m,), as `CellLayer.on_cells` says, in the type of the file
    """

    numbers: NDArray[np.uint32]
    rows: NDArray[np.uint32]
    points: NDArray[Any]
    corners: NDArray[np.uint32]
    values: NDArray[Any]


def join_bricks(bricks: Sequence[CellBrick], on_cells: bool) -> CellBrick:
    """Return the tetrahedra of at least one brick, each once, and their points, by ascending numbers."""
    numbers, chosen = np.unique(np.concatenate([brick.numbers for brick in bricks]), return_index=True)
    rows, first, places = np.unique(
        np.concatenate([brick.rows for brick in bricks]), return_index=True, return_inverse=True
    )
    begins = np.cumsum([0, *(len(brick.rows) for brick in bricks)])
    given = np.concatenate([brick.corners + np.uint32(begin) for brick, begin in zip(bricks, begins, strict=False)])
    corners = places.reshape(-1).astype(np.uint32)[given[chosen]]
    values = np.concatenate([brick.values for brick in bricks])[chosen if on_cells else first]
    return CellBrick(numbers, rows, np.concatenate([brick.points for brick in bricks])[first], corners, values)


@dataclass(frozen=True, eq=False, kw_only=True)
class CellLayer(Layer):
    """One of a scene's unstructured grids, in its order.

    Attributes
    ----------
    on_cells : whether scalars are those of tetrahedra
    segments : the transfer function, pre-integrated; scalars are in units of clim
    units : opacity unit distances in a cell's side of the domain
    kbuffer : brings faces in order; None: exact
    integrals : as `make_integration_table`; None: segments are integrated exactly
    value_type : of the scalars in the file
    crossings : float64 (bz, by, bx), expected segments of a ray through each cell of the domain's grid; 0 where all is
        transparent
    """

    on_cells: bool
    segments: Segments
    units: float
    kbuffer: KBuffer | None
    integrals: NDArray[np.float32] | None
    value_type: np.dtype[Any]
    crossings: Floats

    holds = CellBrick

    @property
    def cost(self) -> Floats:
        """Cost of drawing each brick, float64 (bz, by, bx), in cells of a volume."""
        return SEGMENT_COST * self.crossings

    @property
    def table_bytes(self) -> NDArray[np.int64]:
        """Bytes that each brick adds to what is drawn, at most, int64 (bz, by, bx).

        These are corners and neighbours of tetrahedra, and points as in the file, with scalars, and in two more forms.
        """
        return self._bytes(32 + (4 if self.on_cells else 0), 3 * self.position_type.itemsize + 4 + 2 * 16)

    def forms(self, members: int, positions: int) -> Forms:
        """Return shape and type of each array of `CellBrick`, by name, for given numbers of both."""
        return {
            "numbers": ((members,), WHOLE),
            "rows": ((positions,), WHOLE),
            "points": ((positions, 3), self.position_type),
            "corners": ((members, 4), WHOLE),
            "values": ((members if self.on_cells else positions,), self.value_type),
        }

    def no_cells(self) -> CellBrick:
        """Return a brick without tetrahedra."""
        return CellBrick(**{name: np.zeros(shape, dtype) for name, (shape, dtype) in self.forms(0, 0).items()})

    def shader_values(self, values: NDArray[Any]) -> NDArray[np.float32]:
        """Return scalars in units of clim, float32 of the same shape."""
        return np.clip(in_units_of_clim(values, *self.clim), -FAR, FAR).astype(np.float32)
