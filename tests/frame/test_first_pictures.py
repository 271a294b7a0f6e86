"""First pictures of data without a scene: slices and surfaces are seen, and geometry has the colours of its arrays."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import meshlane  # noqa: F401 (gmsh files need it)
import netCDF4
import nibabel
import numpy as np
import pytest
from data import writers
from PIL import Image

from clusterviz.annotations.picture import _with_names
from clusterviz.comm import LoopbackChannel
from clusterviz.content.geometry.section import GEOMETRY_SECTIONS
from clusterviz.content.summary import chosen_arrays, legends_of
from clusterviz.data import open_scene, open_volume, read_geometry
from clusterviz.data.geometry import Geometry, Lines, Mesh, Points
from clusterviz.data.memory import ArraySource
from clusterviz.data.vtk_cells import grid_of_cells
from clusterviz.frame import Options, Run, render_frame
from clusterviz.frame.opening import open_content
from clusterviz.scene import Scene
from clusterviz.scene.camera import camera_axes, camera_vectors

Y, X = np.mgrid[:10, :14].astype(np.float32)
FIELD = np.hypot(X, Y) + 1
PLANE = np.stack([X, Y, 0 * X], -1).reshape(-1, 3).astype(np.float64)
CORNERS = np.arange(140).reshape(10, 14)
QUADS = np.stack([CORNERS[:-1, :-1], CORNERS[:-1, 1:], CORNERS[1:, 1:], CORNERS[1:, :-1]], -1).reshape(-1, 4)
TURNED = np.array([[0.6, 0, 0.8, 5], [0.8, 0, -0.6, 6], [0, 1, 0, 7], [0, 0, 0, 1]])


def npy(path: Path) -> None:
    np.save(path, FIELD)


def npy_along_x(path: Path) -> None:
    np.save(path, np.ascontiguousarray(FIELD[:, :, None]))


def picture(path: Path) -> None:
    Image.fromarray((10 * FIELD).astype(np.uint8)).save(path)


def oblique_slice(path: Path) -> None:
    nibabel.save(nibabel.Nifti1Image(FIELD.T[:, :, None], TURNED), path)


def mask(path: Path) -> None:
    nibabel.save(nibabel.Nifti1Image((FIELD > 8).astype(np.uint8).T[:, :, None], np.eye(4)), path)


def lat_lon(path: Path) -> None:
    with netCDF4.Dataset(path, "w") as file:
        for name, values in (("lat", Y[:, 0]), ("lon", X[0])):
            file.createDimension(name, len(values))
            file.createVariable(name, "f8", (name,))[:] = values
        file.createDimension("bounds", 2)
        file.createVariable("lat_bounds", "f8", ("lat", "bounds"))[:] = 0.0
        file.createVariable("sst", "f4", ("lat", "lon"))[:] = FIELD


def image_data(path: Path) -> None:
    extent = "0 13 0 9 0 0"
    image = f'WholeExtent="{extent}" Origin="0 0 0" Spacing="1e-6 1e-6 1"'
    writers.vti(path, {"rho": FIELD[None]}, "ascii", image=image, piece=extent)


def vtu(path: Path, points: Any, cells: Any, kind: int, **arrays: Any) -> None:
    ends, kinds = np.arange(1, len(cells) + 1) * cells.shape[1], np.full(len(cells), kind, "u1")
    held = {"connectivity": cells.ravel(), "offsets": ends, "types": kinds}
    counts = f'NumberOfPoints="{len(points)}" NumberOfCells="{len(cells)}"'
    named = {name: np.asarray(values, float) for name, values in arrays.items()}
    sections = {"Points": {"": points}, "Cells": held, "PointData": named}
    writers.vtk_xml(path, "UnstructuredGrid", counts, sections)


def surface(path: Path) -> None:
    vtu(path, PLANE, QUADS, 9, heat=FIELD.ravel())


def dots(path: Path) -> None:
    vtu(path, PLANE, CORNERS.reshape(-1, 1), 1, heat=FIELD.ravel())


def cube(path: Path, **arrays: Any) -> None:
    z, y, x = (np.array(each) for each in ((0, 0, 0, 0, 1, 1, 1, 1), (0, 0, 1, 1) * 2, (0, 1, 1, 0) * 2))
    vtu(path, np.stack([x, y, z], 1).astype(float), np.arange(8)[None], 12, **arrays)


def cube_of_vectors(path: Path) -> None:
    cube(path, U=np.eye(8)[:, :3])


def gmsh(path: Path) -> None:
    nodes = [f"{n + 1} {x} {y} {z}" for n, (x, y, z) in enumerate(PLANE)]
    cells = [f"{n + 1} 3 2 1 1 {' '.join(str(i + 1) for i in quad)}" for n, quad in enumerate(QUADS)]
    data = ["1", '"heat"', "1", "0.0", "3", "0", "1", str(len(PLANE))]
    data += [f"{n + 1} {value}" for n, value in enumerate(FIELD.ravel().tolist())]
    sections = {"MeshFormat": ["2.2 0 8"], "Nodes": [str(len(nodes)), *nodes], "Elements": [str(len(cells)), *cells]}
    sections |= {"NodeData": data}
    path.write_text("\n".join(f"${name}\n" + "\n".join(rows) + f"\n$End{name}" for name, rows in sections.items()))


FILES: dict[str, tuple[Callable[[Path], None], str, str, float]] = {
    "a.npy": (npy, "volumes", "a", 0.5),
    "x.npy": (npy_along_x, "volumes", "x", 0.5),
    "a.png": (picture, "volumes", "a", 0.5),
    "a.nii": (oblique_slice, "volumes", "a", 0.5),
    "mask.nii": (mask, "volumes", "mask", 0.5),
    "a.nc": (lat_lon, "volumes", "sst", 0.5),
    "a.vti": (image_data, "volumes", "rho", 0.5),
    "a.vtu": (surface, "meshes", "heat", 0.5),
    "a.msh": (gmsh, "meshes", "heat", 0.5),
    "dots.vtu": (dots, "points", "heat", 0.3),
    "bare.vtu": (cube, "meshes", "bare", 0.3),
    "vectors.vtu": (cube_of_vectors, "meshes", "vectors", 0.3),
}
"""By name: what writes the file, its section, the title of its colours, and the least share of the picture."""


def written(name: str, folder: Path) -> str:
    FILES[name][0](folder / name)
    return str(folder / name)


def completed(scene: Scene, given: Any = None) -> tuple[Scene, Any]:
    found, opened, _ = open_content(Run(LoopbackChannel(), Options()), scene, given)
    assert opened is not None
    return found, opened.infos


@pytest.mark.parametrize("name", FILES)
def test_what_a_file_is_shown_as_and_the_title_of_its_colours(name: str, tmp_path: Path) -> None:
    scene = open_scene(written(name, tmp_path))
    assert len(getattr(scene, FILES[name][1])) == 1
    found, infos = completed(scene)
    assert [content.name for content in legends_of(_with_names(found, infos))] == [FILES[name][2]]


@pytest.mark.cover
@pytest.mark.gl
@pytest.mark.parametrize("name", FILES)
def test_the_first_picture_is_not_blank(name: str, tmp_path: Path) -> None:
    options = ["radius=1"] * (FILES[name][1] == "points")
    scene = open_scene(written(name, tmp_path), ["image.size=[28,20]", "annotations.scalar_bar=false", *options])
    image = render_frame(scene, LoopbackChannel()).image
    assert image is not None
    assert float((np.asarray(image)[..., 3] > 0.5).mean()) > FILES[name][3]


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_one_sample_along_an_axis_is_a_layer_around_it(axis: int, tmp_path: Path) -> None:
    shape = [4, 5, 6]
    shape[axis] = 1
    values = np.random.default_rng(0).random(shape)
    np.save(tmp_path / "a.npy", values)
    volume = open_scene(tmp_path / "a.npy", ["spacing=[2,3,4]"]).volumes[0]
    found = open_volume(volume)
    expected = [2.0, 3.0, 4.0]
    expected[2 - axis] = min(expected[:2] if axis == 0 else expected[:1] + expected[2:] if axis == 1 else expected[1:])
    assert found.grid.spacing == tuple(expected)
    np.testing.assert_allclose(found.grid.corners.mean(axis=0)[2 - axis], 0.0, atol=1e-12)
    np.testing.assert_array_equal(found.read((0, 0, 0), found.grid.shape_zyx), np.repeat(values, 2, axis))
    part = found.read((1, 1, 1), (2, 2, 2))
    np.testing.assert_array_equal(part[0, 0, 0], values[tuple(np.minimum(1, np.array(shape) - 1))])


def test_a_picture_has_its_first_row_up_and_an_oblique_slice_is_seen_from_its_front(tmp_path: Path) -> None:
    for name, forward, up in (("a.png", (0, 0, 1), (0, -1, 0)), ("a.nii", TURNED[:3, 2], (0, 0, 1))):
        camera = completed(open_scene(written(name, tmp_path)))[0].camera
        _, found, along = camera_axes(*camera_vectors(camera))
        assert abs(along @ np.array(forward)) == pytest.approx(1)
        np.testing.assert_allclose(found, up, atol=1e-9)


POSITIONS = np.random.default_rng(1).random((6, 3))
TRIANGLES = np.array([[0, 1, 2], [3, 4, 5]])
NUMBERS = np.arange(6.0)
ARRAYS: dict[str, tuple[Geometry, str | None]] = {
    "points": (Geometry(points=Points("a", POSITIONS, {"radius": NUMBERS + 1, "v": POSITIONS, "t": NUMBERS})), "t"),
    "vertices first": (Geometry(Mesh("a", POSITIONS, TRIANGLES, {"p": NUMBERS}, {"c": NUMBERS[:2]})), "p"),
    "cells": (Geometry(Mesh("a", POSITIONS, TRIANGLES, {"vtkGhostType": NUMBERS}, {"c": NUMBERS[:2]})), "c"),
    "colours": (Geometry(Mesh("a", POSITIONS, TRIANGLES, {"p": NUMBERS, "RGB": POSITIONS})), "RGB"),
    "lines": (Geometry(lines=Lines("a", POSITIONS, np.array([0, 6]), {"speed": NUMBERS})), "speed"),
    "lines without": (Geometry(lines=Lines("a", POSITIONS, np.array([0, 6]))), None),
    "nothing finite": (Geometry(Mesh("a", POSITIONS, TRIANGLES, {"p": np.full(6, np.nan)})), None),
}


@pytest.mark.parametrize("name", ARRAYS)
def test_geometry_without_a_colour_has_those_of_its_first_array(name: str) -> None:
    geometry, array = ARRAYS[name]
    key = "meshes" if geometry.mesh else "lines" if geometry.lines else "points"
    scene = Scene(**{key: (GEOMETRY_SECTIONS[key](path="array"),)}, automatic=True)
    found, _ = completed(scene, [geometry])
    section = found.geometry[0]
    assert section.scalars == array
    has_bar = array not in (None, "RGB")
    assert (section.clim is not None, found.annotations.scalar_bar) == (has_bar, has_bar)
    assert [f"its array {array};" in line for line in chosen_arrays(scene, found)] == [True] * (array is not None)
    if name == "lines without":
        assert getattr(section, "color_by", None) == "direction"


def test_a_colour_of_the_scene_and_scenes_of_a_user_are_kept() -> None:
    geometry, _ = ARRAYS["vertices first"]
    for keys, automatic in (({"color": "red"}, True), ({}, False)):
        scene = Scene(meshes=({"path": "array", **keys},), automatic=automatic)  # type: ignore[arg-type]
        found, _ = completed(scene, [geometry])
        assert (found.meshes[0].scalars, found.meshes[0].clim, found.annotations.scalar_bar) == (None, None, False)


def test_the_outside_of_a_grid_is_closed_and_its_front_is_outside(tmp_path: Path) -> None:
    mesh = read_geometry(written("vectors.vtu", tmp_path)).mesh
    assert mesh is not None
    assert (len(mesh.triangles), mesh.edge_counts(), list(mesh.vertex_attributes)) == (12, (0, 0), ["U"])
    a, b, c = (mesh.vertices[corner] for corner in mesh.triangles.T)
    assert np.einsum("mx,mx->m", a, np.cross(b, c)).sum() / 6 == pytest.approx(1.0)


def test_flat_cells_of_every_kind_become_triangles() -> None:
    points = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [1, 1, 0], [2, 1, 0]], float)
    # Triangle, strip, polygon, pixel, quad and one of second order, whose nodes on edges are left out; a line has none.
    cells = {5: [0, 1, 4], 6: [0, 1, 3, 4], 7: [0, 1, 2, 5, 4, 3], 8: [0, 1, 3, 4], 9: [0, 1, 4, 3], 3: [0, 1]}
    cells[22] = [0, 1, 4, 2, 2, 2]
    offsets = np.append(0, np.cumsum([len(each) for each in cells.values()]))
    corners, types = np.concatenate([*cells.values()]), np.array([*cells])
    mesh = grid_of_cells(points, types, offsets, corners, {}, {"kind": types}, "here").surface
    assert mesh is not None
    a, b, c = (points[corner] for corner in mesh.triangles.T)
    areas = np.cross(b - a, c - a)[:, 2] / 2
    found = {kind: areas[mesh.triangle_attributes["kind"] == kind].sum() for kind in cells}
    assert found == {5: 0.5, 6: 1, 7: 2, 8: 1, 9: 1, 3: 0, 22: 0.5}


def test_clim_stays_in_the_range_of_the_data() -> None:
    z, y, x = np.mgrid[-1:1:16j, -1:1:16j, -1:1:16j]
    bytes_of = (255 * np.exp(-6 * (x * x + y * y + z * z))).astype(np.uint8)
    found, infos = completed(Scene(volumes=({"path": "array"},), automatic=True), ArraySource(bytes_of))  # type: ignore[arg-type]
    low, high = found.volumes[0].clim or (np.nan, np.nan)
    assert infos[0].minimum <= low < high <= infos[0].maximum


def test_y_is_up_where_the_format_says_so() -> None:
    mesh = Mesh("a", POSITIONS, TRIANGLES)
    for axes, view, up, forward in (
        ("RSA", "front", (0, 1, 0), (0, 0, -1)),
        ("RSA", "top", (0, 0, -1), (0, -1, 0)),
        ("RSA", None, (-1, 2, -1), (-1, -1, -1)),
        ("", None, (-1, -1, 2), (-1, -1, -1)),
    ):
        scene = Scene(meshes=({"path": "array"},), camera={"view": view}, automatic=True)  # type: ignore[arg-type]
        camera = completed(scene, [Geometry(mesh, axes=axes)])[0].camera
        _, found, along = camera_axes(*camera_vectors(camera))
        np.testing.assert_allclose(found, np.array(up) / np.linalg.norm(up), atol=1e-6)
        np.testing.assert_allclose(along, np.array(forward) / np.linalg.norm(forward), atol=1e-6)
