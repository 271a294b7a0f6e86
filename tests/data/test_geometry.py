"""Meshes, lines and points: every format, files that end early, and what cannot be drawn."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from data import mesh_writers as mw
from data import writers
from data.checks import refused
from data.mesh_writers import FILES, HEAT, LABEL, OFFSETS, PATH, TRIANGLES, VERTICES

from clusterviz.data import open_source, read_geometry
from clusterviz.data.formats import mesh_format_of
from clusterviz.data.geometry import (
    Geometry,
    Lines,
    Mesh,
    Points,
    as_geometry,
    merge_equal,
    triangulate,
    triangulate_strips,
)
from clusterviz.errors import DataWarning
from clusterviz.plan.geometry import GeometryLayer

ROOT = Path(__file__).parents[2]
MOVED = np.array([1, 2, 3])
SECOND = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [3, 1, 2]])  # with the strip's triangles


def write(name: str, folder: Path) -> Path:
    file, make = FILES[name]
    return make(folder / file)


def read(name: str, folder: Path) -> Geometry:
    return read_geometry(write(name, folder))


def check_mesh(mesh: Mesh | None, triangles: np.ndarray = TRIANGLES, moved: Any = 0) -> None:
    """Check the corners of the triangles, which are the same in whatever order a file has its vertices."""
    assert mesh is not None
    np.testing.assert_array_equal(mesh.vertices[mesh.triangles], VERTICES[triangles] + moved)
    assert mesh.drawable.all()


MESHES: dict[str, tuple[dict[str, np.ndarray], dict[str, np.ndarray]]] = {
    "ply-ascii": ({"heat": HEAT}, {"label": LABEL}),
    "ply-little": ({"heat": HEAT}, {"label": LABEL}),
    "stl-ascii": ({}, {}),
    "stl-binary": ({}, {"stl": LABEL}),
    "obj": ({}, {}),
    "off": ({"RGBA": np.array([[0.5, 0.25, 1, 1]] * 4)}, {}),
    "gifti": ({"heat": HEAT}, {}),
    "gifti-gzip": ({"heat": HEAT}, {}),
    "freesurfer": ({}, {}),
    "npz-mesh": ({"heat": HEAT, "label": np.stack([LABEL, LABEL], axis=1)}, {}),
    "npz-napari": ({"values": HEAT}, {}),
    **dict.fromkeys(("vtk-binary", "vtk-ascii", "vtk-old", "vtk-old-ascii"), ({}, {"label": np.arange(2, 6)})),
}


@pytest.mark.parametrize("name", MESHES)
def test_a_mesh_is_read_with_its_arrays(name: str, tmp_path: Path) -> None:
    mesh = read(name, tmp_path).mesh
    check_mesh(mesh)
    for found, expected in zip((mesh.vertex_attributes, mesh.triangle_attributes), MESHES[name], strict=True):
        assert found.keys() == expected.keys()
        for key, array in expected.items():
            np.testing.assert_array_equal(found[key], array)
    assert mesh.edge_counts() == (0, 0)
    assert mesh.bounds == ((0, 0, 0), (2, 3, 4))


@pytest.mark.parametrize("name", ["ply-big-lists", "ply-ascii-lists"])
def test_polygons_become_fans(name: str, tmp_path: Path) -> None:
    mesh = read(name, tmp_path).mesh
    np.testing.assert_array_equal(mesh.triangles, [[3, 0, 2], [3, 2, 1], *TRIANGLES[1:]])
    np.testing.assert_array_equal(mesh.triangle_attributes["label"], LABEL[[0, 0, 1, 2, 3]])
    triangles, polygon = triangulate(np.array([0, 2, 2, 7, 10]), np.arange(10))
    np.testing.assert_array_equal(triangles, [[2, 3, 4], [2, 4, 5], [2, 5, 6], [7, 8, 9]])
    np.testing.assert_array_equal(polygon, [2, 2, 2, 3])
    triangles, strip = triangulate_strips(np.array([0, 5, 8]), np.arange(8))
    np.testing.assert_array_equal(triangles, [[0, 1, 2], [1, 3, 2], [2, 3, 4], [5, 6, 7]])
    np.testing.assert_array_equal(strip, [0, 0, 0, 1])


@pytest.mark.parametrize("name", ["vtp-ascii", "vtp-raw", "vtp-zlib"])
def test_vtp_holds_polygons_strips_lines_and_vertices(name: str, tmp_path: Path) -> None:
    found = read(name, tmp_path)
    check_mesh(found.mesh, SECOND)
    np.testing.assert_array_equal(found.mesh.triangle_attributes["label"], [4, 5, 6, 6])
    np.testing.assert_array_equal(found.mesh.vertex_attributes["heat"], np.arange(9))
    np.testing.assert_array_equal(found.lines.points, PATH)
    np.testing.assert_array_equal(found.lines.offsets, OFFSETS)
    np.testing.assert_array_equal(found.lines.line_attributes["label"], [2, 3])
    np.testing.assert_array_equal(found.lines.point_attributes["heat"], np.arange(4, 9))
    np.testing.assert_array_equal(found.points.positions, [VERTICES[3], PATH[0]])
    np.testing.assert_array_equal(found.points.attributes["heat"], [3, 4])


def test_pieces_of_vtp_are_joined(tmp_path: Path) -> None:
    path = write("vtp-ascii", tmp_path)
    text = path.read_text()
    begin, end = text.index("<Piece"), text.index("</Piece>") + len("</Piece>")
    path.write_text(text[:end] + text[begin:])
    found = read_geometry(path)
    np.testing.assert_array_equal(
        found.mesh.vertices[found.mesh.triangles], VERTICES[[*SECOND[:2], *SECOND[:2], *SECOND[2:], *SECOND[2:]]]
    )
    np.testing.assert_array_equal(found.mesh.triangle_attributes["label"], [4, 5, 4, 5, 6, 6, 6, 6])
    np.testing.assert_array_equal(found.lines.points, [*PATH, *PATH])
    np.testing.assert_array_equal(found.lines.line_attributes["label"], [2, 3, 2, 3])
    np.testing.assert_array_equal(found.lines.offsets, [0, 3, 5, 8, 10])


CORNERS = ("0 0 0", "1 0 0", "0 1 0")
PLY_HEAD = "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n"
PLY_LIST = "property list uchar int vertex_indices\n"
PLY_OF_COLOURS = PLY_HEAD.format(3) + "{vertex}element face 1\n" + PLY_LIST + "{face}end_header\n{rows}3 0 1 2{last}\n"


def coloured(kind: str, colours: list[str]) -> tuple[str, str]:
    """The name and text of a triangle in a kind of file, with colours of its corners or its own."""
    rows = "".join(f"{corner} {colour}\n" for corner, colour in zip(CORNERS, colours * 3, strict=False))
    plain = "".join(f"{corner}\n" for corner in CORNERS)
    if kind in ("COFF", "OFF"):
        ends = (rows, "") if kind == "COFF" else (plain, f" {colours[0]}")
        return "a.off", f"{kind}\n3 1 0\n{ends[0]}3 0 1 2{ends[1]}\n"
    if kind == "OBJ":
        return "a.obj", "".join(f"v {row}\n" for row in rows.splitlines()) + "f 1 2 3\n"
    number, _, of = kind.partition(" ")
    names = "".join(
        f"property {number} {name}\n" for name in ("red", "green", "blue", "alpha")[: len(colours[0].split())]
    )
    head = {"vertex": "", "face": names, "rows": plain, "last": f" {colours[0]}"}
    return "a.ply", PLY_OF_COLOURS.format(**(head if of else {"vertex": names, "face": "", "rows": rows, "last": ""}))


@pytest.mark.parametrize(
    ("kind", "colours", "expected"),
    [
        ("COFF", ["128 0 0 255"], [128 / 255, 0, 0, 1]),
        ("COFF", ["0.5 0 0 1", "1.25 0 0 1"], [0.5, 0, 0, 1]),  # a little beyond 1
        ("COFF", ["32768 0 0 65535"], [32768 / 65535, 0, 0, 1]),
        ("COFF", ["128 0 0 1"], [128 / 255, 0, 0, 1]),
        ("OFF", ["128 0 255"], [128 / 255, 0, 1]),
        ("OFF", ["0.5 0 0 0.25"], [0.5, 0, 0, 0.25]),
        ("OBJ", ["128 0 0", "0 1 0"], [128 / 255, 0, 0]),
        ("OBJ", ["0.5 0 0"], [0.5, 0, 0]),
        ("uchar", ["128 0 1"], [128, 0, 1]),
        ("uchar face", ["128 0 1"], [128, 0, 1]),
        ("ushort", ["32768 0 0 65535"], [32768 / 65535, 0, 0, 1]),
        ("ushort face", ["32768 0 0"], [32768 / 65535, 0, 0]),
        ("int", ["128 0 0"], [128 / 255, 0, 0]),
        ("float", ["128 0 0 255"], [128 / 255, 0, 0, 1]),
        ("double face", ["0.5 0 0"], [0.5, 0, 0]),
    ],
)
def test_colours_are_bytes_or_shares(kind: str, colours: list[str], expected: list[float], tmp_path: Path) -> None:
    name, text = coloured(kind, colours)
    (tmp_path / name).write_text(text)
    mesh = read_geometry(tmp_path / name).mesh
    of_faces = "face" in kind or kind == "OFF"
    (found,) = (mesh.triangle_attributes if of_faces else mesh.vertex_attributes).values()
    np.testing.assert_allclose(found[0], expected, rtol=1e-7)
    assert (found.dtype == np.uint8) == kind.startswith("uchar")


def test_colours_of_some_polygons_are_named(tmp_path: Path) -> None:
    with pytest.warns(DataWarning, match=r"a.off: the colours of polygons are not read; found 0, 3 numbers behind"):
        write("off", tmp_path) and read_geometry(tmp_path / "a.off")


def test_colours_of_16_bits_are_full_at_their_largest_number() -> None:
    of_bits = {"u1": 255, "u2": 65535}
    for kind, full in of_bits.items():
        layer = SimpleNamespace(channels=3)
        found = GeometryLayer.shader_colours(layer, np.array([[full, 0, full // 5]], kind))
        np.testing.assert_allclose(found, [[1, 0, 0.2]], rtol=1e-6)


POLYDATA_GHOSTS = {  # bits of the cells or points: the labels of the triangles, lines and vertices that are left
    "CellData": ([0, 1, 32, 0, 8, 0, 2], [5, 6, 6], [3], [0]),
    "PointData": ([0, 0, 2, 0, 0, 0, 0, 1, 0], [5], [2, 3], [0, 1]),
}


@pytest.mark.parametrize("section", POLYDATA_GHOSTS)
def test_ghosts_of_polygonal_data_are_left_out(section: str, tmp_path: Path) -> None:
    bits, triangles, lines, vertices = POLYDATA_GHOSTS[section]
    path = write("vtp-ascii", tmp_path)
    array = f'<DataArray type="UInt8" Name="vtkGhostType" format="ascii">{" ".join(map(str, bits))}</DataArray>'
    path.write_text(path.read_text().replace(f"</{section}>", f"{array}</{section}>"))
    found = read_geometry(path)
    assert found.mesh.triangle_attributes["label"].tolist() == triangles
    assert found.lines.line_attributes["label"].tolist() == lines
    assert found.points.attributes["label"].tolist() == vertices
    assert "vtkGhostType" not in {*found.mesh.vertex_attributes, *found.mesh.triangle_attributes}


def test_ghosts_of_legacy_polygonal_data_and_of_points_alone_are_left_out(tmp_path: Path) -> None:
    path = write("vtk-ascii", tmp_path)
    path.write_text(path.read_text() + "FIELD a 1\nvtkGhostType 1 6 unsigned_char\n1 0 0 32 0 8\n")
    found = read_geometry(path)
    assert found.lines.line_attributes["label"].tolist() == [1]
    assert found.mesh.triangle_attributes["label"].tolist() == [2, 4]
    head = "# vtk DataFile Version 3.0\na title\nASCII\nDATASET POLYDATA\nPOINTS 3 float\n0 0 0 1 0 0 2 0 0\n"
    bits = "POINT_DATA 3\nSCALARS vtkGhostType unsigned_char 1\nLOOKUP_TABLE default\n0 1 2\n"
    (tmp_path / "b.vtk").write_text(head + bits)
    assert read_geometry(tmp_path / "b.vtk").points.positions.tolist() == [[0, 0, 0]]


@pytest.mark.parametrize("name", ["gltf", "glb"])
def test_gltf_is_placed_by_its_nodes(name: str, tmp_path: Path) -> None:
    found = read(name, tmp_path)
    check_mesh(found.mesh, moved=MOVED)
    np.testing.assert_array_equal(found.mesh.vertex_attributes["_HEAT"], HEAT)
    np.testing.assert_array_equal(found.lines.points, PATH + MOVED)
    np.testing.assert_array_equal(found.points.positions, PATH + MOVED)


@pytest.mark.parametrize(
    ("node", "expected"),
    [
        ({"matrix": [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 5, 6, 7, 1]}, [[0, -1, 0], [1, 0, 0], [0, 0, 1]]),
        ({"rotation": [0, 0, 0.5**0.5, 0.5**0.5], "translation": [5, 6, 7]}, [[0, -1, 0], [1, 0, 0], [0, 0, 1]]),
        ({"scale": [-1, 1, 1], "translation": [5, 6, 7]}, np.diag([-1, 1, 1])),
    ],
)
def test_nodes_turn_scale_and_mirror(node: dict[str, Any], expected: Any, tmp_path: Path) -> None:
    mesh = read_geometry(mw.gltf(tmp_path / "a.glb", nodes=[{"mesh": 0} | node])).mesh
    np.testing.assert_allclose(mesh.vertices, VERTICES / 2 @ np.array(expected).T + [5, 6, 7], atol=1e-6)
    corners = mesh.vertices[mesh.triangles].astype(np.float64)
    outward = corners.mean(axis=1) - mesh.vertices.mean(axis=0)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert ((normals * outward).sum(axis=1) > 0).all()  # a mirror turns the triangles round


def changed_gltf(path: Path, change: Callable[[dict[str, Any]], object]) -> Geometry:
    """What is read of the tetrahedron of `mesh_writers` alone, without a place, after a change of the document."""
    document = json.loads(mw.gltf(path, nodes=[{"mesh": 0}]).read_text())
    change(document)
    path.write_text(json.dumps(document))
    return read_geometry(path)


SPARSE = {"count": 2, "indices": {"bufferView": 1, "componentType": 5123}, "values": {"bufferView": 2}}
MORPHS = {  # weights of the mesh and of the node, and the change of `VERTICES`
    "mesh": ([0.5], None, VERTICES / 4),
    "node": ([0.5, 0.25], [-1, 0], -VERTICES / 2),
    "sparse": ([0, 2], None, 2 * np.array([PATH[0], [0, 0, 0], PATH[1], [0, 0, 0]])),
}


@pytest.mark.parametrize("name", MORPHS)
def test_meshes_are_morphed_by_their_weights(name: str, tmp_path: Path) -> None:
    of_mesh, of_node, moved = MORPHS[name]

    def change(document: dict[str, Any]) -> None:
        document["meshes"][0]["weights"] = of_mesh
        document["meshes"][0]["primitives"][0]["targets"] = [{"POSITION": 0}, {"POSITION": 4}]
        document["nodes"][0] |= {"weights": of_node} if of_node else {}
        document["accessors"].append({"componentType": 5126, "type": "VEC3", "count": 4, "sparse": SPARSE})

    mesh = changed_gltf(tmp_path / "a.gltf", change).mesh
    np.testing.assert_allclose(mesh.vertices, VERTICES / 2 + moved, rtol=1e-6)


def test_meshes_are_repeated_by_instances(tmp_path: Path) -> None:
    def change(document: dict[str, Any]) -> None:
        document["extensionsRequired"] = ["EXT_mesh_gpu_instancing"]
        instances = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 2, "SCALE": 2}}}
        document["nodes"][0] |= {"scale": [2, 2, 2], "extensions": instances}

    mesh = changed_gltf(tmp_path / "a.gltf", change).mesh
    expected = 2 * (PATH[:, None] * VERTICES[TRIANGLES].reshape(1, -1, 3) / 2 + PATH[:, None])
    np.testing.assert_allclose(mesh.vertices[mesh.triangles].reshape(expected.shape), expected, rtol=1e-6)


def test_what_is_not_read_of_a_file_is_named_once(tmp_path: Path) -> None:
    with pytest.warns(DataWarning) as caught:
        changed_gltf(tmp_path / "a.gltf", lambda document: document.update(skins=[{}], textures=[{}]))
    assert [str(one.message).partition(": ")[2] for one in caught] == ["not read; found textures, skins"]
    (tmp_path / "a.obj").write_text("mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\nusemtl b\nf 1 2 3\n")
    with pytest.warns(DataWarning) as caught:
        read_geometry(tmp_path / "a.obj")
    assert [str(one.message).partition(": ")[2] for one in caught] == ["not read; found materials"]


LINES = ("obj", "vtk-binary", "vtk-ascii", "vtk-old", "trk", "tck", "csv", "tsv")


@pytest.mark.parametrize("name", LINES)
def test_lines_are_read_with_their_arrays(name: str, tmp_path: Path) -> None:
    lines = read(name, tmp_path).lines
    if name == "obj":
        np.testing.assert_array_equal(lines.points, VERTICES[[0, 1, 2, 3, 0]])
    else:
        np.testing.assert_allclose(lines.points, PATH, atol=1e-6)
    np.testing.assert_array_equal(lines.offsets, OFFSETS)
    expected = {"trk": [0, 1, 2, 0, 1], "csv": range(5), "tsv": range(5)}.get(name)
    assert list(lines.point_attributes.get("heat", [])) == list(expected or [])
    assert list(lines.line_attributes.get("label", [])) == ([0, 1] if "vtk" in name else [])


@pytest.mark.parametrize("name", ["npy-fields", "xyz"])
def test_tables_of_points(name: str, tmp_path: Path) -> None:
    points = read(name, tmp_path).points
    np.testing.assert_array_equal(points.positions, PATH)
    np.testing.assert_array_equal(points.attributes["heat" if name == "npy-fields" else "column 3"], range(5))
    plain = mw.npy(tmp_path / "b.npy", structured=False)
    np.testing.assert_array_equal(read_geometry(plain).points.positions, PATH)
    assert mesh_format_of(plain) is None  # a volume of one layer, unless it is asked for as points
    assert open_source(plain).grid.shape_zyx == (1, 5, 4)


def test_columns_of_a_table_are_vectors(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("x,y,z,v:0,v:1,v:2,u_x,u_y,u_z,w_x\n1,2,3,4,5,6,7,8,9,0\n")
    found = read_geometry(tmp_path / "a.csv").points.attributes
    assert {name: array.tolist() for name, array in found.items()} == {"v": [[4, 5, 6]], "u": [[7, 8, 9]], "w_x": [0]}


@pytest.mark.parametrize("name", ["a.csv", "a.tsv", "semicolons.txt"])
def test_quotes_and_empty_fields_of_tables(name: str, tmp_path: Path) -> None:
    text = '"name #1, of all",x,"y",z,"heat, K",no\n"a, b",1,2,3,,\n,4,"5",6,7.5, \n"c #2",7,8,9,-1e3,x # a comment\n'
    for mark in {"a.csv": ",", "a.tsv": "\t"}.get(name, ";"):
        (tmp_path / name).write_text(text.replace(",", mark))
        points = read_geometry(tmp_path / name).points
        np.testing.assert_array_equal(points.positions, [[1, 2, 3], [4, 5, 6], [7, 8, 9]])
        assert list(points.attributes) == [f"heat{mark} K"]
        np.testing.assert_array_equal(points.attributes[f"heat{mark} K"], [np.nan, 7.5, -1e3])


XYZ = "4\nEnergy=-1.5 # of a program\nN 0 0 0 0.1\n6 1 1 0 0.2\no 2.0 1 5e-1 0.3\nFe 5 5 5 0.4\n"


def test_atoms_of_xyz_files(tmp_path: Path) -> None:
    pytest.importorskip("gemmi")
    path = tmp_path / "a.xyz"
    path.write_text(XYZ)
    atoms = read_geometry(path).points
    np.testing.assert_array_equal(atoms.positions, PATH[:4])
    assert atoms.attributes["element"].tolist() == [7, 6, 8, 26]
    assert atoms.attributes["RGB"].tolist() == [[48, 80, 248], [144, 144, 144], [255, 13, 13], [224, 102, 51]]
    assert atoms.attributes["radius"][:3] == pytest.approx([1.55, 1.7, 1.52])
    path.write_text(XYZ + XYZ)
    with pytest.warns(DataWarning, match="of several frames the first one is read"):
        assert len(read_geometry(path).points.positions) == 4
    path.write_text(XYZ.replace("Fe 5 5 5 0.4", "Fe five 5 5"))
    refused(lambda: read_geometry(path), "not an atom", "found Fe five 5 5", "allowed an element, x, y and z")
    path.write_text("9" + XYZ[1:])
    refused(lambda: read_geometry(path), "truncated", "found 4 atoms")


@pytest.mark.parametrize("kind", ["Float32LE", "Float32BE", "Float64LE", "Float64BE"])
@pytest.mark.parametrize("marked", [True, False])
def test_every_type_of_tck(kind: str, marked: bool, tmp_path: Path) -> None:
    dtype = np.dtype(f"{'<' if kind.endswith('LE') else '>'}f{int(kind[5:7]) // 8}")
    points = (PATH.astype(float) + 0.1).astype(dtype)
    gap, end = np.full((1, 3), np.nan, dtype), np.full((1, 3), np.inf, dtype)
    rows = [points[:3], gap, points[3:], *([gap] if marked else []), end]
    head = f"mrtrix tracks\ncount: 2\ndatatype: {kind}\nfile: . 80\nEND\n".encode().ljust(80)
    path = tmp_path / "a.tck"
    path.write_bytes(head + b"".join(row.tobytes() for row in rows))
    lines = read_geometry(path).lines
    np.testing.assert_array_equal(lines.points, points)
    assert (lines.points.dtype, lines.offsets.tolist()) == (dtype.newbyteorder("="), [0, 3, 5])
    path.write_bytes(head + points.tobytes())
    refused(lambda: read_geometry(path), "truncated: no end mark")
    path.write_bytes(head + end.tobytes())
    refused(lambda: read_geometry(path), "the header lies", "found 0 lines", "allowed 2")
    path.write_bytes(head.replace(b"count: 2", b"count: 0") + end.tobytes())
    assert read_geometry(path).lines.offsets.tolist() == [0]


@pytest.mark.parametrize("name", ["pdb", "cif"])
def test_atoms_have_radii_and_colours(name: str, tmp_path: Path) -> None:
    pytest.importorskip("gemmi")
    atoms = read(name, tmp_path).points
    np.testing.assert_allclose(atoms.positions, PATH[:4], atol=1e-6)
    found = {key: array.tolist() for key, array in atoms.attributes.items()}
    assert found["element"] == [7, 6, 8, 26]
    assert found["RGB"] == [[48, 80, 248], [144, 144, 144], [255, 13, 13], [224, 102, 51]]
    assert found["radius"][:3] == pytest.approx([1.55, 1.7, 1.52])
    assert (found["residue"], found["chain"]) == ([0, 0, 1, 2], [0, 0, 0, 1])
    assert found["b_factor"] == [0, 10, 20, 30]


def test_a_molecule_needs_its_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "gemmi", None)
    refused(lambda: read("pdb", tmp_path), "needs the gemmi package", r"\.\[molecules\]", "a.pdb")


def test_points_alone_and_the_world_of_freesurfer(tmp_path: Path) -> None:
    points = read("ply-points", tmp_path).points
    np.testing.assert_array_equal(points.positions, VERTICES)
    np.testing.assert_array_equal(points.attributes["heat"], HEAT)
    check_mesh(read_geometry(mw.freesurfer(tmp_path / "rh.any", (1, 2, 3))).mesh, moved=MOVED)
    assert mesh_format_of(tmp_path / "rh.any").name == "freesurfer"


EMPTY: dict[str, tuple[str, str | bytes]] = {
    "stl": ("a.stl", bytes(84)),
    "vtp": ("a.vtp", '<VTKFile type="PolyData"><PolyData><Piece NumberOfPoints="0"/></PolyData></VTKFile>'),
    "off": ("a.off", "OFF\n0 0 0\n"),
    "ply": ("a.ply", PLY_HEAD.format(0) + "element face 0\n" + PLY_LIST + "end_header\n"),
    "csv": ("a.csv", "x,y,z\n"),
    "gltf": ("a.gltf", '{"asset": {"version": "2.0"}}'),
    "vtk": ("a.vtk", "# vtk DataFile Version 5.1\nt\nASCII\nDATASET POLYDATA\nPOINTS 0 float\nPOLYGONS 0 0\n"),
}


@pytest.mark.parametrize("name", EMPTY)
def test_an_empty_file_of_its_kind_is_read(name: str, tmp_path: Path) -> None:
    file, content = EMPTY[name]
    (tmp_path / file).write_bytes(content.encode() if isinstance(content, str) else content)
    found = read_geometry(tmp_path / file)
    for part in (found.mesh, found.lines, found.points):
        assert part is None or part.bounds is None
    assert found.mesh is None or found.mesh.edge_counts() == (0, 0)


def test_other_names_and_other_contents(tmp_path: Path) -> None:
    (tmp_path / "a.blend").write_bytes(b"hello")
    refused(lambda: read_geometry(tmp_path / "a.blend"), "unknown extension", r"\.ply", r"\.trk")
    writers.write(tmp_path / "a.vtk")
    refused(lambda: read_geometry(tmp_path / "a.vtk"), "not polygonal data", "STRUCTURED_POINTS")
    refused(lambda: open_source(write("vtk-ascii", tmp_path)), "not image data", "POLYDATA")


def test_what_cannot_be_drawn_is_counted() -> None:
    nan, huge = np.nan, 1e200
    vertices = np.array(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0], [nan, 0, 0], [huge, 0, 0], [0, huge, 0], [0, 1e-200, 0]]
    )
    triangles = np.array([[0, 1, 2], [0, 1, 3], [0, 1, 1], [0, 1, 4], [0, 5, 6], [0, 1, 7], [2, 2, 2]])
    mesh = Mesh("m", vertices, triangles)
    assert mesh.drawable.tolist() == [True, False, False, False, True, True, False]
    assert mesh.finite.sum() == 7
    assert mesh.bounds == ((0, 0, 0), (huge, huge, 0))
    tiny = Mesh("m", VERTICES * 1e-30, TRIANGLES)
    assert tiny.drawable.all()


def test_open_crowded_and_unmerged_meshes() -> None:
    assert Mesh("m", VERTICES, TRIANGLES[:3]).edge_counts() == (3, 0)
    fan = np.array([[0, 1, 2], [0, 1, 3], [1, 0, 2], [0, 1, 3]])
    assert Mesh("m", VERTICES, fan).edge_counts()[1] == 1  # four triangles at one edge
    soup = VERTICES[TRIANGLES].reshape(-1, 3)
    soup[soup == 0] = -0.0
    assert Mesh("m", soup, np.arange(12).reshape(4, 3)).edge_counts() == (0, 0)


@pytest.mark.parametrize("dtype", ["f4", "f8"])
def test_equal_positions_are_found(dtype: str, monkeypatch: pytest.MonkeyPatch) -> None:
    positions = np.random.default_rng(1).integers(0, 6, (500, 3)).astype(dtype)
    expected = np.unique(positions, axis=0)
    first, group = merge_equal(positions)
    assert len(first) == len(expected)
    np.testing.assert_array_equal(positions[first][group], positions)
    # Where hashes collide, rows are compared.
    unique = np.unique
    monkeypatch.setattr(np, "unique", lambda keys, **options: unique(keys if keys.ndim > 1 else keys % 7, **options))
    first, group = merge_equal(positions)
    assert len(first) == len(expected)
    np.testing.assert_array_equal(positions[first][group], positions)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Mesh("m", VERTICES[:, :2], TRIANGLES), "not positions"),
        (lambda: Mesh("m", VERTICES.astype(int), TRIANGLES), "not positions"),
        (lambda: Mesh("m", VERTICES, TRIANGLES[:, :2]), "not triangles"),
        (lambda: Mesh("m", VERTICES, TRIANGLES * 1.0), "not triangles"),
        (lambda: Mesh("m", VERTICES, TRIANGLES + 1), "out of range; found 4"),
        (lambda: Mesh("m", VERTICES[:0], TRIANGLES), "there are no vertices"),
        (lambda: Mesh("m", VERTICES, TRIANGLES, {"a": HEAT[:3]}), "the array a does not fit; .*4 vertices"),
        (lambda: Mesh("m", VERTICES, TRIANGLES, {}, {"a": np.array(["x"] * 4)}), "the array a does not fit"),
        (lambda: Lines("m", PATH, np.array([0, 3])), "offsets are wrong"),
        (lambda: Lines("m", PATH, np.array([0, 4, 3, 5])), "offsets are wrong"),
        (lambda: Lines("m", PATH, OFFSETS, {}, {"a": np.zeros(3)}), "2 lines"),
        (lambda: Points("m", PATH, {"a": np.zeros((4, 2))}), "5 points"),
    ],
)
def test_arrays_that_do_not_fit(make: Callable[[], object], said: str) -> None:
    refused(make, f"m: .*{said}")


def test_a_tree_of_nodes_may_be_deep(tmp_path: Path) -> None:
    nodes = [{"children": [n + 1], "translation": [0, 0, 1]} for n in range(2000)]
    mesh = read_geometry(mw.gltf(tmp_path / "a.glb", nodes=[*nodes, {"mesh": 0}])).mesh
    assert mesh.bounds[0] == (0, 0, 2000)
    ring = json.dumps({"asset": {"version": "2.0"}, "nodes": [{"children": [1]}, {"children": [0]}]})
    (tmp_path / "a.gltf").write_text(ring)
    refused(lambda: read_geometry(tmp_path / "a.gltf"), "no tree", "each is a child")


def test_objects_of_other_libraries_are_geometry() -> None:
    """pyvista's cells are lists with their lengths in front, and its arrays follow the cut of polygons."""
    heat, of_cells = np.arange(4.0), np.array([7, 8])
    polygons = SimpleNamespace(
        points=VERTICES,
        faces=np.array([4, 0, 1, 2, 3, 3, 0, 2, 3]),
        lines=np.array([2, 0, 3, 3, 1, 1, 2]),
        point_data={"heat": heat, "names": np.array(["a"] * 4)},
        cell_data={"label": of_cells},
    )
    mesh, path = as_geometry(polygons, "meshes", "m").mesh, as_geometry(polygons, "lines", "l").lines
    assert mesh is not None
    assert path is not None
    assert mesh.triangles.tolist() == [[0, 1, 2], [0, 2, 3], [0, 2, 3]]
    assert mesh.triangle_attributes["label"].tolist() == [7, 7, 8]
    assert list(mesh.vertex_attributes) == ["heat"]
    np.testing.assert_array_equal(path.points, VERTICES[[0, 3, 1, 1, 2]])
    assert path.offsets.tolist() == [0, 2, 5]
    assert path.point_attributes["heat"].tolist() == [0, 3, 1, 1, 2]
    loose = as_geometry([VERTICES[:2], VERTICES[1:]], "lines", "l").lines
    assert loose is not None
    assert loose.offsets.tolist() == [0, 2, 5]
    for given in (VERTICES.tolist(), polygons, Points("p", VERTICES)):
        points = as_geometry(given, "points", "p").points
        assert points is not None
        np.testing.assert_array_equal(points.positions, VERTICES)
    whole = Geometry(mesh=mesh)
    assert as_geometry(whole, "meshes", "m") is whole


@pytest.mark.parametrize("owner", ["vertex", "face", "texture"])
def test_colours_of_trimesh_are_arrays(owner: str) -> None:
    """They lie apart from the other arrays, and only those of vertices or of faces have been given."""
    colours = np.arange(16, dtype=np.uint8).reshape(4, 4)
    visual = SimpleNamespace(kind=owner, vertex_colors=colours, face_colors=colours)
    mesh = as_geometry(SimpleNamespace(vertices=VERTICES, faces=TRIANGLES, visual=visual), "meshes", "m").mesh
    assert mesh is not None
    found = {"vertex": mesh.vertex_attributes, "face": mesh.triangle_attributes}
    assert {name for name, arrays in found.items() if "RGBA" in arrays} == {owner} - {"texture"}


@pytest.mark.parametrize(
    ("given", "section", "said"),
    [
        (3, "meshes", "not geometry; found int; allowed Mesh"),
        ("bone", "points", "not geometry; found str"),
        ((VERTICES, TRIANGLES + 1), "meshes", "out of range"),
        (SimpleNamespace(points=VERTICES, lines=np.array([2, 0, 9])), "lines", "out of range; found 9"),
        (SimpleNamespace(points=VERTICES, faces=np.array([3, 0, 1])), "meshes", "not geometry"),
        (VERTICES.ravel()[:-1], "points", "not geometry; found ndarray"),
    ],
)
def test_objects_that_are_no_geometry(given: Any, section: str, said: str) -> None:
    refused(lambda: as_geometry(given, section, "m"), f"m: .*{said}")
