"""Polygonal data in VTK files, XML or legacy: vertices, lines, polygons and strips over one array of points."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.geometry import (
    Attributes,
    Geometry,
    Lines,
    Mesh,
    Points,
    check_attributes,
    check_indices,
    triangulate,
    triangulate_strips,
)
from clusterviz.data.vtk_ghosts import UNDRAWN_POINTS, drawn_cells, some_cells, split_ghosts
from clusterviz.errors import DataError

SECTIONS = ("Verts", "Lines", "Polys", "Strips")
"""Kinds of cells, in the order of their numbers."""
Cells = tuple[NDArray[np.int64], NDArray[np.int64]]
"""Offsets (k + 1,), and indices of points: cell i has those at [offsets[i], offsets[i + 1])."""


def polydata(
    points: NDArray[np.floating], cells: Mapping[str, Cells], of_points: Attributes, of_cells: Attributes, where: str
) -> Geometry:
    """Return the geometry of polygonal data; a dataset without cells is points.

    Parameters
    ----------
    of_points, of_cells : arrays by name; cells are numbered in the order of `SECTIONS`
    """
    points = points.astype(np.promote_types(points.dtype, np.float32), copy=False)
    check_attributes(of_points, len(points), "points", where)
    of_points, point_bits = split_ghosts(of_points, len(points))
    empty = np.zeros(1, np.int64), np.zeros(0, np.int64)
    numbers, begin = {}, 0
    for section in SECTIONS:
        offsets, indices = cells.get(section, empty)
        if offsets[0] != 0 or offsets[-1] != len(indices) or (np.diff(offsets) < 0).any():
            allowed = f"offsets that rise from 0 to {len(indices)}"
            raise DataError(f"the offsets of {section} are wrong", where=where, found=offsets[[0, -1]], allowed=allowed)
        check_indices(indices, len(points), where)
        numbers[section] = np.arange(begin, begin + len(offsets) - 1)
        begin += len(offsets) - 1
    for name, array in of_cells.items():
        if len(array) != begin:
            raise DataError(f"the array {name} does not fit", where=where, found=len(array), allowed=f"{begin} cells")
    if not begin:
        is_drawn = point_bits & UNDRAWN_POINTS == 0
        return Geometry(points=Points(where, points[is_drawn], {n: a[is_drawn] for n, a in of_points.items()}))
    of_cells, bits = split_ghosts(of_cells, begin)
    if point_bits.any() or bits.any():
        cells = dict(cells)
        for section in cells:
            is_drawn = drawn_cells(*cells[section], bits[numbers[section]], point_bits)
            cells[section], numbers[section] = some_cells(*cells[section], is_drawn), numbers[section][is_drawn]
    found = []
    for section, cut in (("Polys", triangulate), ("Strips", triangulate_strips)):
        triangles, cell = cut(*cells.get(section, empty))
        found.append((triangles, numbers[section][cell]))
    triangles, cell = (np.concatenate(parts) for parts in zip(*found, strict=True))
    mesh = Mesh(where, points, triangles, of_points, {name: array[cell] for name, array in of_cells.items()})
    offsets, along = cells.get("Lines", empty)
    on_lines = {name: array[numbers["Lines"]] for name, array in of_cells.items()}
    lines = Lines(where, points[along], offsets, {name: array[along] for name, array in of_points.items()}, on_lines)
    begins, dots = cells.get("Verts", empty)
    cell = np.repeat(numbers["Verts"], np.diff(begins))
    on_dots = {name: array[cell] for name, array in of_cells.items()}
    verts = Points(where, points[dots], on_dots | {name: array[dots] for name, array in of_points.items()})
    has_polygons = len(numbers["Polys"]) + len(numbers["Strips"]) > 0
    return Geometry(
        mesh if has_polygons else None,
        lines if len(numbers["Lines"]) else None,
        verts if len(numbers["Verts"]) else None,
    )
