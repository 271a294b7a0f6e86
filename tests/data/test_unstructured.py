"""Unstructured grids: tetrahedra that fit, curved cells, faces, and what cannot be drawn."""

from __future__ import annotations

import sys
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from data import grid_writers
from data.cells import UNIT, VOLUMES, lattice, mixed, one_cell, tetrahedra, volumes, x_plus
from data.checks import refused
from data.grid_writers import FILES

from clusterviz.data import read_grid
from clusterviz.data.faces import NONE, Faces, find_neighbours
from clusterviz.data.formats import meshlane
from clusterviz.data.predicates import determinant_sign, orientation
from clusterviz.data.tetrahedra import Tetrahedra, make_tetrahedra
from clusterviz.data.unstructured import CORNERS, FACES, SECOND_ORDER, Polyhedra, UnstructuredGrid, linearised
from clusterviz.errors import DataWarning

KINDS = list(FACES)


def faces_of(found: Tetrahedra) -> Faces:
    return find_neighbours(found.corners, len(found.points)).faces()


def check_faces(found: Tetrahedra, crowded: int = 0) -> None:
    """Compare with all half-faces sorted by NumPy, and the sides with the positions of the tetrahedra."""
    topology, faces = find_neighbours(found.corners, len(found.points)), faces_of(found)
    halves = np.sort(np.concatenate([found.corners[:, face] for face in FACES["tetra"]]), axis=1)
    each, counts = np.unique(halves, axis=0, return_counts=True)
    np.testing.assert_array_equal(np.unique(faces.corners, axis=0), each)
    assert topology.crowded == crowded
    assert topology.boundary == faces.is_boundary.sum()
    row, k = np.nonzero(topology.halves != NONE)
    other = topology.halves[row, k]
    np.testing.assert_array_equal(topology.halves[other >> 2, other & 3], 4 * row + k)
    for n in range(0, len(row), 7):
        own, theirs = np.delete(found.corners[row[n]], k[n]), np.delete(found.corners[other[n] >> 2], other[n] & 3)
        assert set(own) == set(theirs)
    assert len(faces.corners) == len(each) + crowded
    assert crowded or faces.is_boundary.sum() == (counts == 1).sum()
    a, b, c = (found.points[corner].astype(float) for corner in faces.corners.T)
    centres = found.points[found.corners].mean(axis=1)
    for side, sign in ((0, -1), (1, 1)):
        there = faces.sides[:, side] != NONE
        beyond = ((centres[faces.sides[there, side]] - a[there]) * np.cross(b - a, c - a)[there]).sum(axis=1)
        assert (sign * beyond > 0).all()
    met = np.bincount(faces.sides[faces.sides != NONE].astype(np.int64), minlength=len(found.corners))
    assert (met == 4).all()


@pytest.mark.parametrize("kind", KINDS)
def test_a_cell_becomes_tetrahedra_of_its_volume(kind: str) -> None:
    """For every order of the numbers of its corners that puts another one first, and its mirror image."""
    for first in range(CORNERS[kind]):
        points = np.roll(np.array(UNIT[kind], np.float32), -first, axis=0)
        corners = np.roll(np.arange(len(points)), first)[None]
        for mirrored in (1, -1):
            grid = UnstructuredGrid(kind, points * np.float32([1, 1, mirrored]), {kind: corners}, {"f": points[:, 0]})
            found = tetrahedra(grid)
            each = volumes(found)
            assert each.min() > 0
            assert each.sum() == pytest.approx(VOLUMES[kind], rel=1e-6)
            assert found.counts["inverted"] == (mirrored < 0 and kind != "wedge")
            np.testing.assert_array_equal(found.values, found.points[:, 0])
            check_faces(found)


@pytest.mark.parametrize("grid", [lattice(2, 3, 4), mixed()], ids=["lattice", "mixed"])
def test_tetrahedra_of_neighbours_fit(grid: UnstructuredGrid) -> None:
    """The only faces on one side alone are those on the surface: their areas have no sum, and that of the surface."""
    found = tetrahedra(grid)
    faces = faces_of(found)
    check_faces(found)
    outer = faces.corners[faces.is_boundary]
    outward = np.where(faces.sides[faces.is_boundary, :1] != NONE, 1, -1)
    a, b, c = (found.points[corner] for corner in outer.T)
    areas = outward * np.cross(b - a, c - a) / 2
    np.testing.assert_allclose(areas.sum(axis=0), 0, atol=1e-12)
    if grid.name == "box":
        assert np.linalg.norm(areas, axis=1).sum() == pytest.approx(2 * (2 * 3 + 2 * 4 + 3 * 4))
        assert len(outer) == 2 * 2 * (2 * 3 + 2 * 4 + 3 * 4)


def test_two_files_cut_the_faces_between_them_alike() -> None:
    """Each half of a lattice has points of its own, in another order, and is cut alone."""
    whole, rng = lattice(3, 3, 4), np.random.default_rng(6)
    hexes = whole.cells["hexahedron"]
    is_left, triangles = whole.points[hexes].mean(axis=1)[:, 0] < 2, []
    for some in (hexes[is_left], hexes[~is_left]):
        used = rng.permutation(np.unique(some))
        number = np.zeros(len(whole.points), np.int64)
        number[used] = np.arange(len(used))
        points = whole.points[used]
        found = tetrahedra(UnstructuredGrid("half", points, {"hexahedron": number[some]}, {"f": points[:, 0]}))
        faces = faces_of(found)
        corners = found.points[faces.corners[faces.is_boundary]]
        between = corners[(corners[:, :, 0] == 2).all(axis=1)]
        triangles.append({frozenset(map(tuple, triangle)) for triangle in between.tolist()})
    assert len(triangles[0]) == 2 * 9
    assert triangles[0] == triangles[1]


def test_faces_do_not_depend_on_threads_and_large_buckets_are_sorted() -> None:
    many = lattice(20, 20, 20)
    found = tetrahedra(many)
    one, two = (find_neighbours(found.corners, len(found.points), threads) for threads in (1, 2))
    np.testing.assert_array_equal(one.halves, two.halves)
    rising = [one.ascending(threads) for threads in (1, 2)]
    np.testing.assert_array_equal(rising[0].halves, rising[1].halves)
    np.testing.assert_array_equal(rising[1].tetrahedra, np.sort(found.corners, axis=1))
    tetrahedron, k = np.nonzero(rising[1].halves != NONE)
    beyond, place = np.divmod(rising[1].halves[tetrahedron, k], 4)
    assert (rising[1].halves[beyond, place] == 4 * tetrahedron + k).all()
    faces = [
        np.where(np.arange(4) == n[:, None], 0, rising[1].tetrahedra[m]) for m, n in ((tetrahedron, k), (beyond, place))
    ]
    np.testing.assert_array_equal(*(np.sort(face, axis=1) for face in faces))
    turn = np.linspace(0, 2 * np.pi, 201)[:-1]
    points = np.concatenate([[(0, 0, -1), (0, 0, 1)], np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)])
    ring = np.arange(200)
    fan = np.stack([0 * ring, 1 + 0 * ring, 2 + ring, 2 + (ring + 1) % 200], axis=1)
    check_faces(tetrahedra(UnstructuredGrid("fan", points, {"tetra": fan}, {"f": points[:, 0]})))


def test_tetrahedra_on_one_side_of_a_face_have_faces_of_their_own() -> None:
    points = np.array([*UNIT["tetra"], (0.2, 0.2, 2.0), (0.3, 0.3, -1.0)])
    cells = np.array([[0, 1, 2, 3], [0, 1, 2, 4], [0, 1, 2, 5]])
    found = tetrahedra(UnstructuredGrid("crowded", points, {"tetra": cells}, {"f": points[:, 0]}))
    faces = faces_of(found)
    assert len(faces.corners) == 11
    check_faces(found, crowded=1)


@pytest.mark.parametrize("kind", SECOND_ORDER)
def test_curved_cells_are_cut_at_their_nodes(kind: str) -> None:
    """Straight ones keep their volume and a linear field; the stated difference is that of a parabola."""
    linear, order = kind.rstrip("0123456789"), SECOND_ORDER[kind]
    nodes = np.array([np.array(UNIT[linear], float)[list(node)].mean(axis=0) for node in order.stored])
    fields = {"f": x_plus(nodes), "square": nodes[:, 0] ** 2}
    grid = linearised(nodes, [(kind, np.arange(len(nodes))[None])], fields, {"cell": np.array([7])}, kind)
    found = tetrahedra(grid)
    assert volumes(found).min() > 0
    assert volumes(found).sum() == pytest.approx(VOLUMES[linear])
    np.testing.assert_allclose(found.values, x_plus(found.points), atol=1e-14)
    assert set(grid.cell_arrays["cell"]) == {7}
    assert grid.curved[""] == pytest.approx(0, abs=1e-15)
    assert grid.curved["square"] == pytest.approx(1 / 16)  # x² and its two chords on an edge of length 1
    check_faces(found)


def test_two_curved_cells_share_the_nodes_that_files_lack() -> None:
    """Two hexahedra of 20 nodes side by side have no face between them left open."""
    order, unit = SECOND_ORDER["hexahedron20"], np.array(UNIT["hexahedron"], float)
    nodes = np.array([unit[list(node)].mean(axis=0) for node in order.stored])
    both = np.concatenate([nodes, nodes + np.array([1, 0, 0])])
    both += 0.1 * np.sin(3 * both)
    grid = linearised(both, [("hexahedron20", np.arange(40).reshape(2, 20))], {"f": both[:, 0]}, {}, "two")
    found = tetrahedra(grid)
    faces = faces_of(found)
    assert faces.is_boundary.sum() == 10 * 4 * 2
    assert grid.curved[""] > 0


def test_polyhedra_are_cut_around_their_centres() -> None:
    """Some of a lattice's cells are polyhedra, and one has a corner of its neighbours' edges; faces fit."""
    whole = lattice(3, 2, 2)
    hexes, found = whole.cells["hexahedron"], polyhedra(whole.cells["hexahedron"][::2])
    rows = np.concatenate([np.arange(1, 12, 2), np.arange(0, 12, 2)])
    blocks = [("hexahedron", hexes[1::2]), ("polyhedron", found)]
    fields = {"f": whole.points[:, 0], "number": np.arange(len(whole.points))}
    grid = linearised(whole.points, blocks, fields, {"cell": rows}, "a")
    cut = tetrahedra(grid)
    assert volumes(cut).min() > 0
    assert volumes(cut).sum() == pytest.approx(12)
    assert len(cut.corners) == 6 * 6 + 6 * 12
    np.testing.assert_allclose(cut.values, cut.points[:, 0], atol=1e-12)
    assert cut.counts["inverted"] == cut.counts["duplicates"] == 0
    faces = faces_of(cut)
    check_faces(cut)
    assert faces.is_boundary.sum() == 2 * 2 * (6 + 6 + 4)
    of_tetrahedra = grid.cell_arrays["cell"][cut.cells]
    inside = cut.points[cut.corners].mean(axis=1)[:, None] > whole.points[hexes[of_tetrahedra]].min(axis=1)[:, None]
    assert inside.all()


def polyhedra(hexes: np.ndarray) -> Polyhedra:
    streams = [[6, *(n for face in FACES["hexahedron"] for n in (4, *corners[list(face)]))] for corners in hexes]
    begins = np.cumsum([0, *map(len, streams[:-1])])
    return Polyhedra.of_streams(np.concatenate(streams), begins)


def broken(**changes: Any) -> UnstructuredGrid:
    """A lattice of two cells."""
    whole = lattice(1, 1, 2)
    parts = {name: getattr(whole, name) for name in ("name", "points", "cells", "point_arrays", "cell_arrays")}
    return UnstructuredGrid(**(parts | changes))


def test_what_cannot_be_drawn_is_counted() -> None:
    points, hexes = broken().points.copy(), broken().cells["hexahedron"]
    alone = np.setdiff1d(hexes[0], hexes[1])[0]
    values = points[:, 0].copy()
    values[alone] = np.nan
    found = tetrahedra(broken(point_arrays={"f": values}))
    assert (len(found.corners), found.counts["invalid"], found.cells[0]) == (6, 1, 1)
    moved = points.copy()
    moved[alone] = np.inf
    found = tetrahedra(broken(points=moved))
    assert (len(found.corners), found.counts["misplaced"]) == (6, 1)
    flat = points.copy()
    flat[hexes[0]] *= [1, 1, 0]
    found = tetrahedra(broken(points=flat))
    assert found.counts["flat"] == 1
    assert (volumes(found) > 0).all()
    found = tetrahedra(broken(points=points * [1, 1, 1e-7]))
    assert len(found.corners) == 12  # slivers have a volume
    twice = np.concatenate([points[hexes[0]], points[hexes[1]], points[:3]])
    cells = {"hexahedron": np.arange(16).reshape(2, 8)}
    found = tetrahedra(broken(points=twice, cells=cells, point_arrays={"f": twice[:, 0]}))
    assert (found.counts["duplicates"], found.counts["unused"], len(found.points)) == (7, 3, 12)
    check_faces(found)
    jump = np.arange(19.0)
    found = tetrahedra(broken(points=twice, cells=cells, point_arrays={"f": jump}))
    assert len(found.points) == 16  # the field is not the same on both sides
    check_faces(found)


def test_a_hexahedron_with_corners_in_one_place_is_cut_like_the_wedge_that_it_is() -> None:
    points = np.array(UNIT["wedge"], float)
    found = tetrahedra(
        UnstructuredGrid("a", points, {"hexahedron": np.array([[0, 1, 2, 2, 3, 4, 5, 5]])}, {"f": points[:, 0]})
    )
    assert volumes(found).sum() == pytest.approx(0.5)
    assert (len(found.corners), found.counts["flat"], found.counts["folded"]) == (3, 0, 0)


@pytest.mark.parametrize("count", [0, 1])
def test_few_cells(count: int) -> None:
    grid = one_cell("tetra")
    found = tetrahedra(UnstructuredGrid("few", grid.points, {"tetra": grid.cells["tetra"][:count]}, grid.point_arrays))
    assert len(found.corners) == count
    assert (found.bounds is None) == (count == 0)
    assert len(faces_of(found).corners) == 4 * count


def test_arrays_of_points_and_of_cells() -> None:
    grid = mixed()
    found = make_tetrahedra(grid, "kind")
    assert found.on_cells
    np.testing.assert_array_equal(found.values, np.array([4, 5, 6, 8], np.float64)[found.cells])
    np.testing.assert_array_equal(np.unique(found.cells, return_counts=True)[1], [1, 2, 3, 6])


REFUSED: list[tuple[dict[str, Any], str | None, str]] = [
    ({}, "Temp", "no such array; found Temp; allowed f"),
    ({"point_arrays": {}}, None, "no such array; found no array; allowed none"),
    ({"point_arrays": {"u": np.zeros((12, 3))}}, "u", r"not one number each; found \(12, 3\)"),
    ({"cell_arrays": {"g": np.zeros(2)}}, None, "several arrays: name one; found f, g"),
    ({"point_arrays": {"f": np.zeros(2)}}, "f", "the array f does not fit; .*; allowed numbers, 12 points"),
    ({"cell_arrays": {"f": np.zeros(12)}}, "f", "the array f does not fit; .*; allowed numbers, 2 cells"),
    ({"cells": {"hexahedron": np.full((1, 8), 12)}}, "f", "out of range; found 12; allowed 0 to 11"),
    ({"cells": {"tetra": np.full((1, 4), 2**31 + 5)}}, "f", f"out of range; found {2**31 + 5}"),
    ({"cells": {"tetra": np.full((1, 4), -1)}}, "f", "out of range; found -1"),
    ({"cells": {"tetra": np.zeros((1, 8), int)}}, "f", "not cells"),
    ({"cells": {"tetra": np.zeros((1, 4))}}, "f", "not indices; found float64"),
]


@pytest.mark.parametrize(("changes", "array", "said"), REFUSED)
def test_what_does_not_fit_is_refused(changes: dict[str, Any], array: str | None, said: str) -> None:
    refused(lambda: make_tetrahedra(broken(**changes), array), said)


def test_kinds_of_cells() -> None:
    points = np.zeros((12, 3))
    flat = linearised(points, [("triangle", np.zeros((2, 3), int)), ("tetra", np.zeros((1, 4), int))], {}, {}, "a")
    assert (flat.ignored, flat.count) == (2, 1)
    only = linearised(points, [("triangle", np.zeros((2, 3), int))], {}, {}, "a")
    refused(lambda: make_tetrahedra(only), "no cells with a volume; found 2 others")
    refused(lambda: linearised(points, [("polyhedron9", np.zeros((2, 9), int))], {}, {}, "a"), "unsupported kind")


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9, 1e-120, 1e120])
def test_signs_of_volumes_are_exact(scale: float) -> None:
    """Points at the distance of a rounding from a plane, against fractions."""
    rng = np.random.default_rng(5)
    a, b, c = (scale * rng.integers(-8, 9, (400, 3)).astype(float) for _ in range(3))
    d = a + (b - a) * rng.integers(0, 3, (400, 1)) / 2 + (c - a) * rng.integers(0, 3, (400, 1)) / 2
    d = np.nextafter(d, d + rng.integers(-1, 2, d.shape))
    found = orientation(a, b, c, d)

    def exact(*corners: np.ndarray) -> int:
        p, q, r, s = ([Fraction(x) for x in corner.tolist()] for corner in corners)
        u, v, w = ([x - y for x, y in zip(end, p, strict=True)] for end in (q, r, s))
        volume = sum(u[i] * (v[(i + 1) % 3] * w[(i + 2) % 3] - v[(i + 2) % 3] * w[(i + 1) % 3]) for i in range(3))
        return (volume > 0) - (volume < 0)

    expected = [exact(*each) for each in zip(a, b, c, d, strict=True)]
    np.testing.assert_array_equal(found, expected)
    assert {-1, 0, 1} == set(expected)
    np.testing.assert_array_equal(determinant_sign((b, c, d), (a, a, a)), expected)


WITHOUT_F = ("abaqus", "nas", "mesh", "meshb", "su2", "tetgen", "ugrid")
WITHOUT_KIND = (*WITHOUT_F, "med")
"""Formats whose files have no such arrays, or where meshlane does not write them."""


def check_grid(found: UnstructuredGrid, name: str) -> None:
    """Compare with the cells of `mixed`, in whatever order a file has the points."""
    expected = mixed()
    if name.endswith(("streams", "polyhedra")) or name.startswith("openfoam"):
        cut = make_tetrahedra(found, "kind")
        each = np.bincount(cut.values.astype(int), volumes(cut))
        parts = make_tetrahedra(expected, "kind")
        np.testing.assert_allclose(each, np.bincount(parts.values.astype(int), volumes(parts)), rtol=1e-6)
        assert volumes(cut).sum() == pytest.approx(volumes(tetrahedra(expected)).sum(), rel=1e-6)
        check_faces(cut)
        return
    assert len(found.cells) == {"abaqus": 3, "tetgen": 1}.get(name, 4)
    for kind, corners in found.cells.items():
        np.testing.assert_allclose(found.points[corners], expected.points[expected.cells[kind]], atol=1e-6)
    if name not in WITHOUT_F:
        np.testing.assert_allclose(found.array("f")[0], x_plus(found.points), atol=1e-5)
    if name not in WITHOUT_KIND:
        assert found.array("kind")[0][1:].tolist() == [5, 6, 8]


@pytest.mark.parametrize("name", FILES)
def test_every_format_is_read(name: str, tmp_path: Path) -> None:
    file, write = FILES[name]
    check_grid(read_grid(write(tmp_path / file)), name)


@pytest.mark.parametrize(
    ("section", "name", "bits", "left"),
    [
        ("CellData", "vtkGhostType", [0, 32, 0, 0], [4, 6, 8]),
        ("CellData", "vtkGhostType", [8, 2, 1, 4], [5, 8]),
        ("CellData", "vtkGhostLevels", [0, 0, 0, 2], [4, 5, 6]),
        ("PointData", "vtkGhostType", [1, *[0] * 9, 2, 1], [4, 6, 8]),
    ],
)
@pytest.mark.parametrize("name_of_file", ["vtu-ascii", "vtu-streams", "vtk-binary", "vtk-streams", "vtkhdf"])
def test_ghost_cells_and_cells_with_a_hidden_point_are_left_out(
    name_of_file: str, section: str, name: str, bits: list[int], left: list[int], tmp_path: Path
) -> None:
    file, _ = FILES[name_of_file]
    kind, _, form = name_of_file.partition("-")
    write = getattr(grid_writers, "streams" if form == "streams" else kind)
    grid = read_grid(
        write(tmp_path / file, **({"form": kind} if form == "streams" else {}), more={section: {name: bits}})
    )
    assert np.unique(grid.array("kind")[0]).tolist() == left
    assert {*grid.point_arrays, *grid.cell_arrays} == {"f", "kind"}


@pytest.mark.parametrize("form", ["ascii", "", "vtkZLibDataCompressor"])
@pytest.mark.parametrize("file", ["a.pvtu", "a_[0-9].vtu", "a.pvd"])
def test_pieces_without_cells_are_read(file: str, form: str, tmp_path: Path) -> None:
    """With points and without, as programs write them on more ranks than there are cells."""
    grid_writers.vtu(tmp_path / "a_0.vtu", form)
    grid_writers.vtu(tmp_path / "a_1.vtu", form, rows=(), more={"CellData": {"vtkGhostType": []}})
    (tmp_path / "a_2.vtu").write_text(
        '<VTKFile type="UnstructuredGrid"><UnstructuredGrid><Piece NumberOfPoints="0" NumberOfCells="0"/>'
        "</UnstructuredGrid></VTKFile>"
    )
    names = [f"a_{n}.vtu" for n in (1, 0, 2)]
    pieces = "".join(f'<Piece Source="{name}"/>' for name in names)
    (tmp_path / "a.pvtu").write_text(
        f'<VTKFile type="PUnstructuredGrid"><PUnstructuredGrid>{pieces}</PUnstructuredGrid></VTKFile>'
    )
    sets = "".join(f'<DataSet timestep="0" part="{n}" file="{name}"/>' for n, name in enumerate(names))
    (tmp_path / "a.pvd").write_text(f'<VTKFile type="Collection"><Collection>{sets}</Collection></VTKFile>')
    check_grid(read_grid(tmp_path / file), "vtu")


def test_legacy_files_without_cells_are_read(tmp_path: Path) -> None:
    grid_writers.vtk(tmp_path / "a_0.vtk")
    head = "# vtk DataFile Version 5.1\na title\nASCII\nDATASET UNSTRUCTURED_GRID\n"
    (tmp_path / "a_1.vtk").write_text(head + "POINTS 0 double\n\n")
    check_grid(read_grid(tmp_path / "a_?.vtk"), "vtk")
    (tmp_path / "a_1.vtk").write_text(head + "POINTS 0 double\nCELL_TYPES 0\n")
    refused(lambda: read_grid(tmp_path / "a_1.vtk"), "no cells; allowed CELLS and CELL_TYPES")


STEPPED = ("exodus-3", "gmsh-2.2", "xdmf-dolfinx", "xdmf-dolfin", "xdmf-pieces")


@pytest.mark.parametrize("name", [name for name in STEPPED if name in FILES])
def test_a_time_step_is_taken_by_its_number_or_time(name: str, tmp_path: Path) -> None:
    file, write = FILES[name]
    path = write(tmp_path / file)
    with pytest.warns(DataWarning, match="the last time step is taken; found 2 from 0.5 to 1.5"):
        check_grid(read_grid(path), name)
    for time, sign in ((0, -1), (0.5, -1), (1, 1), (1.5, 1)):
        grid = read_grid(path, time)
        np.testing.assert_allclose(grid.array("f")[0], sign * x_plus(grid.points))
        assert grid.array("kind")[0][1:].tolist() == [5, 6, 8]  # also of a function with a step less
    for other in (2, -1, 1.0):
        refused(lambda other=other: read_grid(path, other), "no such time step; .*; allowed 0 to 1, or a time from 0.5")
    if name == "exodus-3":
        assert np.isnan(grid.array("kind")[0][0])
        assert make_tetrahedra(grid, "kind").counts["invalid"] == 1


def test_times_that_are_equal_are_told_apart_by_their_numbers_and_other_files_have_none(tmp_path: Path) -> None:
    path = grid_writers.gmsh(tmp_path / "a.msh", steps=(7.0, 7.0))
    np.testing.assert_allclose(read_grid(path, 0.0).array("f")[0], -x_plus(read_grid(path, 0.0).points))
    formats = "a file of exodus, openfoam, xdmf, gmsh, .pvd or .series"
    refused(lambda: read_grid(grid_writers.vtu(tmp_path / "a.vtu"), 1), "no time steps", formats)


def test_a_piece_of_exodus_may_have_no_nodes(tmp_path: Path) -> None:
    netcdf = pytest.importorskip("netCDF4")
    grid_writers.exodus(tmp_path / "a.e.2.0")
    with netcdf.Dataset(tmp_path / "a.e.2.1", "w", format="NETCDF3_CLASSIC") as file:
        file.createDimension("num_dim", 3)
        file.createDimension("time_step", None)
        file.createVariable("time_whole", "f8", ("time_step",))[:] = [0.5, 1.5]
    with pytest.warns(DataWarning) as caught:
        check_grid(read_grid(tmp_path / "a.e.2.*"), "exodus")
    said = "the last time step is taken; found 2 from 0.5 to 1.5; allowed time: a number, or a time"
    assert {str(one.message) for one in caught} == {said}  # of both pieces, which Python shows once


def test_gmsh_4_1_that_is_called_4(tmp_path: Path) -> None:
    path = grid_writers.gmsh(tmp_path / "a.msh", "4.1")
    path.write_text(path.read_text().replace("4.1 0 8", "4 0 8"))
    check_grid(read_grid(path, 1.5), "gmsh")


def test_data_of_gmsh_has_gaps_and_is_named(tmp_path: Path) -> None:
    path = grid_writers.gmsh(tmp_path / "a.msh", "4.1", steps=(0.0,))
    head, key, rest = path.read_text().partition("$NodeData")
    other = f"{key}{rest[: rest.index('$End')]}".replace(key, "$ElementNodeData") + "$EndElementNodeData\n"
    path.write_text(head + key + rest.replace("\n100 ", "\n101 ") + other)
    with pytest.warns(DataWarning) as caught:
        grid = read_grid(path)
    said = [str(one.message).partition(": ")[2] for one in caught]
    assert said == [
        "not read; found $ElementNodeData",
        "values of $NodeData are left out; found 1 with unknown numbers",
    ]
    assert np.flatnonzero(np.isnan(grid.array("f")[0])).tolist() == [2]
    assert grid.array("gmsh:physical")[0].tolist() == [4] * 4
    assert grid.array("gmsh:geometrical")[0].tolist() == [5] * 4


@pytest.mark.parametrize("kind", ["tetra10", "pyramid13", "wedge15", "hexahedron20", "hexahedron27"])
def test_gmsh_has_nodes_of_second_order_in_its_own_order(kind: str, tmp_path: Path) -> None:
    package = pytest.importorskip("meshlane")
    order = SECOND_ORDER[kind]
    linear = np.array(UNIT[kind.rstrip("0123456789")])
    points = np.array([linear[list(node)].mean(axis=0) for node in order.stored])
    blocks = [(kind, np.arange(len(points))[None])]
    package.write(tmp_path / "a.msh", package.Mesh(points, blocks), file_format="gmsh22")
    found, expected = read_grid(tmp_path / "a.msh"), linearised(points, blocks, {}, {}, "a")
    np.testing.assert_allclose(found.points, expected.points)
    for part, corners in expected.cells.items():
        np.testing.assert_array_equal(found.cells[part], corners)


TETRA = "0 0 0 1 0 0 0 1 0 0 0 1"
XDMF = """<Xdmf Version="2.0"><Domain><Grid><Topology Type="Tetrahedron"><DataItem Dimensions="1 4" DataType="Int">
{corners}</DataItem></Topology>{geometry}{more}</Grid></Domain></Xdmf>"""
XYZ = f'<Geometry Type="XYZ"><DataItem Dimensions="4 3">{TETRA}</DataItem></Geometry>'
COLUMNS = "".join(f'<DataItem Dimensions="4">{row}</DataItem>' for row in ("0 1 0 0", "0 0 1 0", "0 0 0 1"))
SLAB = """<Attribute Name="f" Center="Node"><DataItem ItemType="HyperSlab" Dimensions="4"><DataItem Dimensions="3 2"
NumberType="Int">0 1 1 1 4 1</DataItem><DataItem Dimensions="4 2">9 0 9 1 9 2 9 3</DataItem></DataItem></Attribute>"""
FUNCTION = """<Attribute ItemType="FiniteElementFunction" Name="g" Center="Other"><DataItem Dimensions="1">0</DataItem>
</Attribute><Attribute Name="h" Center="Face"><DataItem Dimensions="1">0</DataItem></Attribute>"""


def test_parts_of_xdmf(tmp_path: Path) -> None:
    """Geometry in columns, a part of an array, numbers by reference, and arrays that are not read."""
    path = tmp_path / "a.xdmf"
    path.write_text(XDMF.format(corners="0 1 2 3", geometry=XYZ, more=""))
    expected = read_grid(path)
    columns = f'<Geometry Type="X_Y_Z">{COLUMNS}</Geometry>'
    path.write_text(XDMF.format(corners="0 1 2 3", geometry=columns, more=SLAB + FUNCTION))
    with pytest.warns(DataWarning, match="not read; found FiniteElementFunction g, Center=Face h"):
        found = read_grid(path)
    np.testing.assert_array_equal(found.points, expected.points)
    assert found.array("f")[0].tolist() == [0, 1, 2, 3]
    reference = '<DataItem Reference="XML">/Xdmf/Domain/Grid/Geometry/DataItem</DataItem>'
    path.write_text(XDMF.format(corners="0 1 2 3", geometry=XYZ, more=f'<Attribute Name="g">{reference}</Attribute>'))
    np.testing.assert_array_equal(read_grid(path).point_arrays["g"], expected.points)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("Tetrahedron", "3DCoRectMesh", "an unsupported topology; found 3DCoRectMesh; allowed Polyvertex, "),
        ('Type="XYZ"', 'Type="ORIGIN_DXDYDZ"', "an unsupported geometry; found ORIGIN_DXDYDZ, 1 DataItem; allowed XYZ"),
        ("0 1 2 3<", "0 1 2 4<", "out of range; found 4; allowed 0 to 3"),
        ('Dimensions="1 4"', 'Dimensions="2 4"', "lies about its size; found 4 numbers; allowed 8"),
        ("<Grid>", '<Grid GridType="Subset"><Grid/>', "unsupported type; found subset"),
        ("</Grid>", '<Attribute Name="f"><DataItem>1 2 3</DataItem></Attribute></Grid>', "f: an array does not fit"),
        ('<DataItem Dimensions="1 4" DataType="Int">', '<DataItem Format="HDF">b.h5:/a', "b.h5.*: no such file"),
        ('DataType="Int"', 'DataType="Complex"', "an unknown type of numbers; found complex"),
        ("</Domain>", "", "truncated or damaged XML"),
        ("Domain>", "Range>", "not XDMF; found <Xdmf>"),
    ],
)
def test_xdmf_that_is_not_read(old: str, new: str, said: str, tmp_path: Path) -> None:
    text = XDMF.format(corners="0 1 2 3", geometry=XYZ, more="").replace("\n", "")
    assert old in text
    (tmp_path / "a.xdmf").write_text(text.replace(old, new))
    refused(lambda: read_grid(tmp_path / "a.xdmf"), said)


def test_avs_has_data_of_nodes_and_of_cells(tmp_path: Path) -> None:
    path = grid_writers.avs(tmp_path / "a.avs")
    grid = read_grid(path)
    assert grid.array("kind")[0].tolist() == grid.array("avsucd:material")[0].tolist() == [4, 5, 6, 8]
    np.testing.assert_array_equal(grid.point_arrays["the_flow"], np.arange(12)[:, None] * [1, 0, -1])
    for old, new, said in (
        ("\n9 4 tet", "\n9 4 tot", "not a cell; found 9 4 tot .*; allowed number, material, pt, line, "),
        ("\n9 4 tet 70", "\n9 4 tet 71", "unknown numbers of nodes; found 71"),
        ("\n9 4 tet", "\n7 4 tet", "unknown numbers of cells; found 9"),
        ("\n9 4 tet", "\n9 x tet", "not a whole number"),
        ("\n9 4 tet 70", "\n9 4 tet x", "not a whole number"),
        ("12 4 4 1 0", "12 4 4 1", "not AVS-UCD; .*; allowed text that begins with five counts"),
        ("12 4 4 1 0", "13 4 4 1 0", "not a number"),
        ("\n3 8\n", "\n", "truncated; found 36 lines; allowed 37"),
    ):
        text = grid_writers.avs(path).read_text()
        assert old in text, text
        path.write_text(text.replace(old, new))
        refused(lambda: read_grid(path), said)


def test_time_steps_of_openfoam(tmp_path: Path) -> None:
    path = grid_writers.openfoam(tmp_path / "a.foam")
    for time, arrays in ((None, {"kind", "U"}), (1, {"kind", "U"}), (0.5, {"kind"}), (10.0, {"kind", "U"})):
        assert set(read_grid(path, time).cell_arrays) == arrays
    refused(lambda: read_grid(path, 2), "no such time step; found 2; allowed 0 to 1, or a time from 0.5 to 10")


@pytest.mark.parametrize("write", [grid_writers.pvd, grid_writers.series])
def test_time_steps_in_files_of_their_own(write: grid_writers.Write, tmp_path: Path) -> None:
    path = write(tmp_path / FILES[write.__name__][0])
    for time in (None, 1, 1.5):
        check_grid(read_grid(path, time), "vtu")
    for time in (0, 0.5):
        refused(lambda time=time: read_grid(path, time), "none.vtu: no such file")
    refused(lambda: read_grid(path, 2), "no such time step; found 2; allowed 0 to 1, or a time from 0.5 to 1.5")


@pytest.mark.parametrize(
    ("file", "old", "new", "said"),
    [
        ("constant/polyMesh/points", b"FoamFile", b"File", "polyMesh/points: not a file of OpenFOAM"),
        ("constant/polyMesh/faces", b"4(", b"5(", "the faces of polyhedra are wrong"),
        ("constant/polyMesh/faces", b"(0 ", b"(99 ", "out of range; found 99; allowed 0 to 11"),
        ("constant/polyMesh/owner", b"17\n(", b"18\n(", "owner: truncated; found 17 numbers; allowed 18"),
        ("10/kind", b"4\n(", b"5\n(", "10/kind: truncated; found 4 numbers; allowed 5"),
    ],
)
def test_a_damaged_case_of_openfoam_is_refused(file: str, old: bytes, new: bytes, said: str, tmp_path: Path) -> None:
    path = grid_writers.openfoam(tmp_path / "a.foam")
    content = (tmp_path / file).read_bytes()
    assert old in content
    (tmp_path / file).write_bytes(content.replace(old, new, 1))
    refused(lambda: read_grid(path), said)


FOAM_FIELDS: dict[str, tuple[bytes, Any]] = {  # fields of cells as text, and their values in the order of kinds
    "equal": (b"internalField nonuniform List<scalar> 4{7};", 7),
    "macro": (b'#include "../init"\ninternalField uniform $T0; // $none', 5),
    "braces": (b"T0 3;\ninternalField uniform ${T0};\n", 3),
    "whole": (b"$none is here a comment;\ninside uniform 9;\ninternalField $inside;", 9),
    "one line": (b"internalField nonuniform 4(4 5 6 8);", None),
    "own class": (b"value nonuniform List<scalar> 4(4 5 6 8);", None),
}


def foam_field(folder: Path, body: bytes, kind: str = "volScalarField", form: str = "ascii") -> Path:
    path = grid_writers.openfoam(folder / "a.foam")
    (folder / "init").write_bytes(b"/* T0 4; */\nT0 $base;\nbase 5; // K\n")
    head = f'FoamFile\n{{\nversion 2.0;\nformat {form};\narch "LSB;label=32;scalar=64";\nclass {kind};\nobject T;\n}}\n'
    more = b"\nboundaryField\n{\nwall { type fixedValue; value uniform 99; }\n}\n"
    (folder / "10/kind").write_bytes(head.encode() + b"dimensions [0 0 0 0 0 0 0];\n" + body + more)
    return path


@pytest.mark.parametrize("name", FOAM_FIELDS)
def test_fields_of_openfoam(name: str, tmp_path: Path) -> None:
    body, value = FOAM_FIELDS[name]
    path = foam_field(tmp_path, body, "volScalarField::Internal" if name == "own class" else "volScalarField")
    found = np.unique(read_grid(path, 10.0).array("kind")[0]).tolist()
    assert found == ([4, 5, 6, 8] if value is None else [value])


def test_equal_entries_of_binary_openfoam_and_fields_that_are_not_read(tmp_path: Path) -> None:
    body = b"internalField nonuniform List<vector> 4{" + np.array([1.0, 2, 3]).tobytes() + b"};"
    path = foam_field(tmp_path, body, "volVectorField", "binary")
    assert np.unique(read_grid(path, 10.0).cell_arrays["kind"], axis=0).tolist() == [[1, 2, 3]]
    with pytest.warns(DataWarning, match=r"10/kind: a field that is computed is not read; found #calc"):
        grid = read_grid(foam_field(tmp_path, b'internalField #calc "1 + 1";'), 10.0)
    assert set(grid.cell_arrays) == {"U"}
    for body, said in (
        (b"internalField uniform $T1;", r"10/kind: no such entry; found \$T1; allowed entries of this file"),
        (b'#include "none"\ninternalField uniform $T1;', "none: no such file"),
        (b"internalField uniform (1 2 3);", r"not a field; found uniform 1 2 3; allowed uniform and 1 numbers"),
        (b"internalField nonuniform List<scalar> 4{1 2};", "truncated; found 2 numbers; allowed 1"),
        (b"internalField nonuniform List<scalar> 99999999999{1};", "too large"),
        (b"internalField nonuniform List<scalar> 5{1};", "does not fit; found float64 .5,.; allowed numbers, 4 cells"),
        (b"internalField nonuniform List<scalar> 5;", r"no list; allowed N \( … \) or N \{ … \}"),
    ):
        path = foam_field(tmp_path, body)
        refused(lambda path=path: read_grid(path, 10.0), said)


def test_reading_that_does_not_end_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("meshlane")
    monkeypatch.setattr(meshlane, "SECONDS", 0.2)
    (tmp_path / "a.nas").write_text("BEGIN BULK\n")  # the library waits for a line
    refused(lambda: read_grid(tmp_path / "a.nas"), "damaged: reading does not end")


def test_names_and_libraries(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.case"
    path.write_text("FORMAT\ntype: ensight gold\n")
    refused(lambda: read_grid(path), "EnSight is not read; allowed what ParaView saves it as: .vtu")
    refused(lambda: read_grid(path.rename(tmp_path / "a.what")), "unknown extension; found .what", r"\.vtu")
    refused(lambda: read_grid(tmp_path / "b_*.vtu"), r"b_\*.vtu: no file matches")
    for package, name in (("netCDF4", "a.exo"), ("meshlane", "a.su2")):
        monkeypatch.setitem(sys.modules, package, None)
        (tmp_path / name).write_bytes(b"CDF\1")
        refused(lambda name=name: read_grid(tmp_path / name), f"needs the {package} package", r"\.\[grids\]")
