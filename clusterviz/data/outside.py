"""Unstructured grids that are shown as a mesh: surfaces, and the outside of those without an array of scalars."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clusterviz.data.faces import NONE, find_neighbours
from clusterviz.data.geometry import Geometry, Mesh, Points
from clusterviz.data.tetrahedra import make_tetrahedra
from clusterviz.data.unstructured import UnstructuredGrid


def has_scalars(grid: UnstructuredGrid) -> bool:
    """Return whether a grid is drawn as a volume: it has cells with a volume, and an array of one number each."""
    arrays = (*grid.point_arrays.values(), *grid.cell_arrays.values())
    return grid.count > 0 and any(array.size == len(array) for array in arrays)


def outside_of(grid: UnstructuredGrid) -> Geometry:
    """Return the surface that a grid is, its points if it has neither faces nor volumes, or the faces around its cells.

    Arrays of points are kept, of a surface those of cells too.
    """
    if not grid.count:
        points = None if grid.surface else Points(grid.name, grid.points, grid.point_arrays)
        return Geometry(mesh=grid.surface, points=points)
    blank = {"any": np.zeros(len(grid.points), np.float32)}
    cut = make_tetrahedra(replace(grid, point_arrays=blank, cell_arrays={}))
    faces = find_neighbours(cut.corners, len(cut.points)).faces()
    corners, sides = faces.corners[faces.is_boundary], faces.sides[faces.is_boundary]
    inward = sides[:, 0] == NONE  # normals point to the second side
    corners[inward] = corners[inward][:, ::-1]
    return Geometry(Mesh(grid.name, cut.points, corners, {n: a[cut.rows] for n, a in grid.point_arrays.items()}))
