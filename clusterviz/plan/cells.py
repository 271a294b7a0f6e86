"""Unstructured grids of a scene as the renderer needs them, and the tetrahedra that a brick of the domain holds.

A ray walks through the tetrahedra of a rank's bricks, and integrates in the slabs whose midpoints lie in these bricks.
So a brick holds all tetrahedra that come within half a slab of it, and a tetrahedron may be in several bricks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.content.grid.section import GridSection, KBuffer
from clusterviz.plan.encoding import FAR, in_units_of_clim
from clusterviz.plan.segments import Segments
from clusterviz.plan.shading import Shading

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CellBrick:
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

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays."""
        return sum(array.nbytes for array in vars(self).values())


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


@dataclass(frozen=True, eq=False)
class CellLayer:
    """One of a scene's unstructured grids, in its order; the same on every rank.

    Attributes
    ----------
    count : number of its tetrahedra
    index_from_file : float64 (3, 4), maps (x, y, z, 1) of the file to cells of the domain; may reflect
    on_cells : whether scalars are those of tetrahedra
    segments : the transfer function, pre-integrated; scalars are in units of clim
    units : opacity unit distances in a cell's side of the domain
    shading : lights and material, for gradients in the world; None: not lit
    kbuffer : brings faces in order; None: exact
    integrals : as `make_integration_table`; None: segments are integrated exactly
    section : completed
    clim : scalars that are 0 and 1 in the shader
    point_type, value_type : of the arrays of `CellBrick`
    in_bricks : int64 (2, bz, by, bx), tetrahedra and points that each brick holds
    """

    count: int
    index_from_file: Floats
    on_cells: bool
    segments: Segments
    units: float
    shading: Shading | None = None
    kbuffer: KBuffer | None = None
    integrals: NDArray[np.float32] | None = None
    section: GridSection | None = None
    clim: tuple[float, float] = (0.0, 1.0)
    point_type: np.dtype[Any] = field(default_factory=lambda: np.dtype(np.float32))
    value_type: np.dtype[Any] = field(default_factory=lambda: np.dtype(np.float32))
    in_bricks: NDArray[np.int64] = field(default_factory=lambda: np.zeros((2, 1, 1, 1), np.int64))

    @property
    def nbytes(self) -> NDArray[np.int64]:
        """Bytes of the tetrahedra of each brick, int64 (bz, by, bx)."""
        forms = self.forms(1, 0).values(), self.forms(0, 1).values()
        each = [sum(int(np.prod(shape)) * dtype.itemsize for shape, dtype in some) for some in forms]
        found: NDArray[np.int64] = self.in_bricks[0] * each[0] + self.in_bricks[1] * each[1]
        return found

    @property
    def table_bytes(self) -> NDArray[np.int64]:
        """Bytes that each brick adds to what is drawn, at most, int64 (bz, by, bx).

        These are corners and neighbours of tetrahedra, and points as in the file, with scalars, and in two more forms.
        """
        each = 32 + (4 if self.on_cells else 0), 3 * self.point_type.itemsize + 4 + 2 * 16
        found: NDArray[np.int64] = self.in_bricks[0] * each[0] + self.in_bricks[1] * each[1]
        return found

    def forms(self, tetrahedra: int, points: int) -> dict[str, tuple[tuple[int, ...], np.dtype[Any]]]:
        """Return shape and type of each array of `CellBrick`, by name, for given numbers of both."""
        whole = np.dtype(np.uint32)
        return {
            "numbers": ((tetrahedra,), whole),
            "rows": ((points,), whole),
            "points": ((points, 3), self.point_type),
            "corners": ((tetrahedra, 4), whole),
            "values": ((tetrahedra if self.on_cells else points,), self.value_type),
        }

    def no_cells(self) -> CellBrick:
        """Return a brick without tetrahedra."""
        return CellBrick(**{name: np.zeros(shape, dtype) for name, (shape, dtype) in self.forms(0, 0).items()})

    def shader_values(self, values: NDArray[Any]) -> NDArray[np.float32]:
        """Return scalars in units of clim, float32 of the same shape."""
        return np.clip(in_units_of_clim(values, *self.clim), -FAR, FAR).astype(np.float32)
