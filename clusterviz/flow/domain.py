"""What particles move through, as the kernel of `trace_kernel.py` takes it: a block of a grid, or an exact formula."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.field import VECTOR_FIELDS, VectorField
from clusterviz.data.source import Grid, Index
from clusterviz.data.vectors import VectorSource, index_from_world, index_from_world_vectors, world_from_index
from clusterviz.errors import DataError
from clusterviz.flow.cells import Cells
from clusterviz.flow.state import CELLS, FORMULA_NAMES, FORMULAS, GRID

Positions = NDArray[np.float64]
EVERYWHERE = 1 << 40
"""Cells beyond those of any grid."""
_NO_CELLS = (np.empty(0), *(np.empty(0, np.int64) for _ in range(4)))


@dataclass(frozen=True)
class Domain:
    """Vectors that this rank has, in the kernel's form.

    Attributes
    ----------
    kind : of the kernel's vectors
    unit : world length of a voxel, in which steps are given
    metric : float64 (6,), of the world: xx, yy, zz, xy, xz, yz
    samples, begin, shape : of the grid; of the block the first sample, and its samples; x, y, z
    first_cell, end_cell : of the cells in which this rank advances particles; x, y, z
    load : function of a time step that returns float32 (4 · n,)
    from_world, to_world : functions of positions (n, 3)
    mesh : arrays of tetrahedra
    bins : the corner of their bins, and 1 by the bins' sides
    on_cells : whether the vectors are those of tetrahedra
    """

    kind: int
    unit: float
    metric: NDArray[np.float64]
    load: Callable[[int], NDArray[np.float32]]
    from_world: Callable[[Positions], Positions]
    to_world: Callable[[Positions], Positions]
    samples: tuple[int, ...] = (1, 1, 1)
    begin: tuple[int, ...] = (0, 0, 0)
    shape: tuple[int, ...] = (1, 1, 1)
    first_cell: tuple[int, ...] = (-EVERYWHERE,) * 3
    end_cell: tuple[int, ...] = (EVERYWHERE,) * 3
    mesh: tuple[NDArray[Any], ...] = _NO_CELLS
    bins: NDArray[np.float64] = field(default_factory=lambda: np.zeros(6))
    on_cells: bool = False

    def contains(self, positions: Positions) -> NDArray[np.bool_]:
        """Return which positions of the kernel lie in the box of the data, bool (n,)."""
        if self.kind == GRID:
            last = np.array(self.samples) - 1
            low, high = np.where(last > 0, 0.0, -0.5), np.where(last > 0, last, 0.5)
        elif self.kind == CELLS:
            low, high = self.bins[:3], self.bins[:3] + np.array(self.samples) / self.bins[3:]
        else:
            low, high = np.full(3, -1.0), np.full(3, 1.0)
        found: NDArray[np.bool_] = np.all((positions >= low) & (positions <= high), axis=1)
        return found


def split_box(sides: Sequence[int], parts: int) -> list[tuple[Index, Index]]:
    """Return boxes, begin and end, that share out one from 0 to `sides`; some may be empty.

    The box is halved along its longest axis again and again, as evenly as the number of parts can be.
    """

    def halves(begin: Index, end: Index, count: int) -> Iterator[tuple[Index, Index]]:
        if count == 1:
            yield begin, end
            return
        axis = int(np.argmax(np.subtract(end, begin)))
        cut = begin[axis] + (end[axis] - begin[axis]) * (count // 2) // count
        yield from halves(begin, _replaced(end, axis, cut), count // 2)
        yield from halves(_replaced(begin, axis, cut), end, count - count // 2)

    return list(halves((0, 0, 0), _index(sides), parts))


def _replaced(place: Index, axis: int, number: int) -> Index:
    return _index([number if n == axis else other for n, other in enumerate(place)])


def metric_of(grid: Grid) -> NDArray[np.float64]:
    """Return the products of the steps between samples, float64 (6,): xx, yy, zz, xy, xz, yz."""
    matrix = grid.world_from_index[:3, :3]
    product = matrix.T @ matrix
    return product[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]


def grid_domain(
    vectors: VectorSource,
    cells: tuple[tuple[int, ...], tuple[int, ...]] | None = None,
    halo: int = 0,
) -> Domain:
    """Return the domain of vectors on a regular grid.

    Parameters
    ----------
    cells : first cell and end of the cells that are advanced, x, y, z; None: all
    halo : cells around them that are held too
    """
    grid = vectors.grid
    samples = np.array(grid.shape_zyx[::-1])
    whole = np.maximum(samples - 1, 1)
    first, end = (np.zeros(3, int), whole) if cells is None else (np.array(cells[0]), np.array(cells[1]))
    begin, stop = np.maximum(first - halo, 0), np.minimum(end + halo + 1, samples)

    def load(step: int) -> NDArray[np.float32]:
        source = vectors.at_time(step) if vectors.times else vectors
        z, y, x = (stop - begin)[::-1].tolist()
        found = np.zeros((z, y, x, 4), np.float32)
        read = source.read(_index(begin[::-1]), _index(stop[::-1]))
        for layer, vectors_of_layer in zip(found, read, strict=True):
            layer[..., :3] = index_from_world_vectors(vectors_of_layer, grid)
        return found.reshape(-1)

    return Domain(
        GRID,
        min(grid.spacing),
        metric_of(grid),
        load,
        lambda points: index_from_world(points, grid),
        lambda points: world_from_index(points, grid),
        tuple(samples.tolist()),
        tuple(begin.tolist()),
        tuple((stop - begin).tolist()),
        tuple(np.where(first == 0, -EVERYWHERE, first).tolist()),
        tuple(np.where(end == whole, EVERYWHERE, end).tolist()),
    )


def _index(numbers: Iterable[int]) -> Index:
    a, b, c = map(int, numbers)
    return a, b, c


def formula_domain(vectors: VectorSource) -> Domain:
    """Return the domain of a steady formula, which is not sampled on a grid.

    Raises
    ------
    DataError
        The vectors are no such formula.
    """
    names = {VECTOR_FIELDS[name]: number for number, name in enumerate(FORMULA_NAMES)}
    number = names.get(vectors.formula) if isinstance(vectors, VectorField) else None
    if number is None or getattr(vectors, "scale", 1.0) != 1:
        raise DataError("no exact formula", where=vectors.name, allowed=", ".join(f"field:{n}" for n in FORMULA_NAMES))
    return Domain(
        FORMULAS + number,
        min(vectors.grid.spacing),
        np.array([1.0, 1, 1, 0, 0, 0]),
        lambda step: np.empty(0, np.float32),
        lambda points: points,
        lambda points: points,
    )


def cells_domain(cells: Cells) -> Domain:
    """Return the domain of vectors in tetrahedra."""
    return Domain(
        CELLS,
        cells.size,
        np.array([1.0, 1, 1, 0, 0, 0]),
        lambda step: cells.vectors,
        lambda points: points,
        lambda points: points,
        samples=cells.bins,
        mesh=(cells.places, cells.corners, cells.neighbours, cells.begins, cells.members),
        bins=np.concatenate([cells.low, 1 / cells.sides]),
        on_cells=cells.on_cells,
    )
