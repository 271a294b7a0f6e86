"""Small unstructured grids that tests share."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from clusterviz.data.tetrahedra import Tetrahedra, make_tetrahedra
from clusterviz.data.unstructured import UnstructuredGrid

UNIT = {
    "tetra": [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)],
    "pyramid": [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0.5, 0.25, 1)],
    "wedge": [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (0, 1, 1)],
    "hexahedron": [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)],
}
"""One cell of each kind, in VTK's order of corners."""
VOLUMES = {"tetra": 1 / 6, "pyramid": 1 / 3, "wedge": 1 / 2, "hexahedron": 1.0}
Field = Callable[[np.ndarray], np.ndarray]


def x_plus(points: np.ndarray) -> np.ndarray:
    """A linear field."""
    return points @ [1.0, 2.0, 3.0]


def one_cell(kind: str, field: Field = x_plus) -> UnstructuredGrid:
    points = np.array(UNIT[kind], float)
    return UnstructuredGrid(kind, points, {kind: np.arange(len(points))[None]}, {"f": field(points)})


def lattice(*sides: int, field: Field = x_plus, spacing: float = 1.0) -> UnstructuredGrid:
    """Hexahedra between the samples of a box of (z, y, x) cells, numbered at random."""
    k, j, i = np.indices([side + 1 for side in sides])
    number = np.random.default_rng(3).permutation(k.size).reshape(k.shape)
    points = np.empty((k.size, 3))
    points[number.ravel()] = spacing * np.stack([i, j, k], axis=-1).reshape(-1, 3)
    ends = [(slice(None, -1), slice(1, None))[b] for b in (0, 1)]
    corners = [number[ends[int(z)], ends[int(y)], ends[int(x)]].ravel() for x, y, z in UNIT["hexahedron"]]
    return UnstructuredGrid("box", points, {"hexahedron": np.stack(corners, axis=1)}, {"f": field(points)})


def mixed() -> UnstructuredGrid:
    """A cube of one hexahedron with a wedge, a pyramid and a tetrahedron at its faces, all kinds in one grid."""
    points = np.array([*UNIT["hexahedron"], (2, 0, 0), (2, 0, 1), (0.5, 0.25, 2), (2, 1, 2)], float)
    cells = {
        "hexahedron": np.arange(8)[None],
        "wedge": np.array([[1, 8, 2, 5, 9, 6]]),
        "pyramid": np.array([[4, 5, 6, 7, 10]]),
        "tetra": np.array([[5, 9, 6, 11]]),
    }
    return UnstructuredGrid("mixed", points, cells, {"f": x_plus(points)}, {"kind": np.array([4, 5, 6, 8])})


def volumes(found: Tetrahedra) -> np.ndarray:
    a, b, c, d = (found.points[corner].astype(float) for corner in found.corners.T)
    return np.linalg.det(np.stack([b - a, c - a, d - a], axis=1)) / 6


def tetrahedra(grid: UnstructuredGrid) -> Tetrahedra:
    return make_tetrahedra(grid, "f")
