"""Files of meshes, lines, points and grids that are damaged, and what is no file of any format."""

from __future__ import annotations

import gzip
import os
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from data import grid_writers, mesh_writers
from data.checks import refused

from clusterviz.data import open_source, read_geometry, read_grid
from clusterviz.data.formats import EXTENSIONS, GRID_EXTENSIONS, MESH_EXTENSIONS
from clusterviz.data.formats.raw import KEYS
from clusterviz.errors import DataError

ROOT = Path(__file__).parents[2]
KINDS: dict[str, tuple[dict[str, tuple[str, Callable[[Path], Path]]], Callable[[Path], object]]] = {
    "mesh": (mesh_writers.FILES, read_geometry),
    "grid": (grid_writers.FILES, read_grid),
}
"""Files by name, and what reads them."""
OPENERS: dict[str, Callable[[Path], object]] = {
    **dict.fromkeys(EXTENSIONS, open_source),
    **{f"{extension} as a mesh": read_geometry for extension in MESH_EXTENSIONS},
}


@pytest.mark.parametrize("name", sorted(OPENERS))
def test_what_is_no_file_of_any_format(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, read = tmp_path / f"a{name.partition(' ')[0]}", OPENERS[name]
    path.with_name(path.name + ".yaml").write_text("{shape: [2, 2, 2], dtype: uint8}")  # for raw files
    refused(lambda: read(path), "no such file", path.name)
    path.mkdir()
    refused(lambda: read(path), "a directory", path.name)
    path.rmdir()
    path.touch()
    refused(lambda: read(path), "the file is empty", path.name)
    path.write_bytes(b"hello")
    refused(lambda: read(path), path.name)

    def refuse(*_: object, **__: object) -> int:
        raise PermissionError(13, "Permission denied")

    with monkeypatch.context() as patched:
        patched.setattr(os, "open", refuse)
        refused(lambda: read(path), "cannot be read: Permission denied", path.name)
    path.unlink()
    os.mkfifo(path)
    writer = os.open(path, os.O_RDWR)  # else opening would wait for one
    refused(lambda: read(path), "not a regular file", path.name)
    os.close(writer)


def test_the_page_on_formats_has_every_extension_and_key_of_the_sidecar() -> None:
    page = (ROOT / "docs/reference/data-formats.md").read_text()
    words = (*EXTENSIONS, *MESH_EXTENSIONS, *GRID_EXTENSIONS, *KEYS)
    assert [word for word in words if f"`{word}`" not in page] == []


UNCOUNTED = {"obj", "csv", "tsv", "xyz", "pdb", "cif"}  # which do not say how much they hold
LAST_BYTES = {"freesurfer": b"valid", "stl-ascii": b"endsolid"}
"""What follows the data; in a file of other names nothing does, but the end of appended data."""
ENDING = [("mesh", name) for name in mesh_writers.FILES]
ENDING += [("grid", name) for name in grid_writers.FILES if name.startswith(("vtu", "vtk", "exodus-3"))]


@pytest.mark.cover
@pytest.mark.parametrize(("kind", "name"), ENDING)
def test_a_file_that_ends_early_is_refused(kind: str, name: str, tmp_path: Path) -> None:
    if name in ("pdb", "cif"):
        pytest.importorskip("gemmi")
    files, read = KINDS[kind]
    file, write = files[name]
    path = write(tmp_path / file)
    content = path.read_bytes()
    whole = gzip.decompress(content) if path.suffix == ".gz" else content
    last = b"\n</Appended" if b"</Appended" in whole else LAST_BYTES.get(name)
    end = whole.rindex(last) - 12 * (name == "freesurfer") if last else len(whole.rstrip())
    taken = []
    for count in range(0, end, max(1, end // 40)):
        if whole.isascii():  # the end of a word, since a part of a number is a number
            count = next((n for n in range(count, 0, -1) if whole[n - 1 : n].isspace()), 0)
        path.write_bytes(gzip.compress(whole[:count]) if path.suffix == ".gz" else whole[:count])
        try:
            read(path)
        except DataError as error:
            taken += [] if path.name in str(error) else [f"{error} names no file"]
        else:
            # The sections of legacy VTK are all optional.
            optional = rb"\s*(LINES|POLYGONS|CELLS|CELL_DATA|POINT_DATA|SCALARS)"
            if not re.match(optional, whole[count:]) or not name.startswith("vtk"):
                taken.append(f"{count} of {end} bytes")
    assert name in UNCOUNTED or taken == []


# What is replaced in a file, and what is said of it.
DAMAGED: dict[str, list[tuple[str, bytes, bytes, str]]] = {
    "mesh": [
        ("ply-ascii", b"3 0 2 1", b"3 0 2 4", "out of range; found 4; allowed 0 to 3"),
        ("ply-ascii", b"3 0 2 1", b"3 0 2 -1", "out of range"),
        ("ply-ascii", b"element vertex 4", b"element vertex 400000000", "lies about its size"),
        ("ply-ascii", b"element vertex 4", b"element vertex 3", "lies|longer|out of range|whole|not a number"),
        ("ply-ascii", b"property float x", b"property float w", "no vertices"),
        ("ply-ascii", b"ascii", b"morse", "the header is not understood"),
        ("ply-ascii", b"property float heat", b"property float x", "a property has two entries"),
        ("ply-ascii", b"end_header", b"end_heading", "the header has no end"),
        ("ply-little", b"element face 4", b"element face 9", "truncated, or the header lies"),
        ("ply-big-lists", b"element face 4", b"element face 99999999999", "truncated, or the header lies"),
        ("stl-ascii", b"endfacet", b"", "truncated or damaged"),
        ("stl-ascii", b"vertex 2.0 0.0 0.0", b"vertex 2.0 zero 0.0", "not a number"),
        ("stl-binary", b"\4\0\0\0", b"\5\0\0\0", "truncated or damaged|its header lies"),
        ("obj", b"f -4 -1 -2", b"f -5 -1 -2", "out of range"),
        ("obj", b"f -4 -1 -2", b"f 5 1 2", "out of range; found 4"),
        ("obj", b"f -4 -1 -2", b"f 0 1 2", "indices from 1"),
        ("obj", b"f -4 -1 -2", b"f 1 2", "at least 3 indices"),
        ("off", b"4 4 6", b"4 5 6", "4 vertices and 5 polygons"),
        ("off", b"4 4 6", b"400000000 4 6", "lies about its size"),
        ("off", b"COFF", b"STOFF", "unsupported variant"),
        ("off", b"3 0 2 1", b"9 0 2 1", "fewer corners"),
        ("off", b"3 0 2 1", b"3 0 2 7", "out of range"),
        ("gltf", b'"children": [1, 2]', b'"children": [1, 0]', "no tree; found node 0 is reached twice"),
        ("gltf", b'"children": [1, 2]', b'"children": [1, 1]', "no tree; found node 1"),
        ("gltf", b'"children": [1, 2]', b'"children": [1, 3]', "no such entry of nodes; found 3"),
        ("gltf", b'"count": 12', b'"count": 99', "lies about its size"),
        ("gltf", b'"mode": 3', b'"mode": 7', "unknown mode; found 7"),
        ("gltf", b'"version": "2.0"', b'"version": "1.0"', "not glTF 2.0"),
        ("gltf", b'"indices": 1', b'"indices": 3', "out of range|complete"),
        ("gltf", b'"scene": 0', b'"extensionsRequired": ["KHR_draco_mesh_compression"], "scene": 0', "KHR_draco"),
        ("gltf", b"data:application", b"data:,application", "damaged|lies"),
        ("vtp-ascii", b"PolyData", b"UnstructuredGrid", "not a VTK file of type PolyData"),
        ("vtp-ascii", b'NumberOfPolys="2"', b'NumberOfPolys="3"', "lies about its size"),
        ("vtp-ascii", b'NumberOfPoints="9"', b'NumberOfPoints="many"', "impossible NumberOfPoints"),
        ("vtp-ascii", b"\n3 6\n", b"\n6 3\n", "lies about its size|offsets"),
        ("vtp-ascii", b"0 2 1 0 1 3", b"0 2 1 0 1 9", "out of range; found 9"),
        ("vtp-raw", b'NumberOfPolys="2"', b'NumberOfPolys="9"', "size is not the dataset's"),
        ("vtk-ascii", b"POLYGONS 5 12", b"POLYGONS 5 99999999999", "lies about its size"),
        ("vtk-old-ascii", b"3 0 2 1 3", b"9 0 2 1 3", "a cell has an impossible length|out of range|offsets"),
        ("vtk-old-ascii", b"3 0 2 1 3", b"3 0 2 99 3", "out of range"),
        ("gifti", b'Dimensionality="2"', b'Dimensionality="4294967296"', "impossible Dimensionality"),
        ("gifti", b"NIFTI_INTENT_TRIANGLE", b"NIFTI_INTENT_SHAPE", "no surface"),
        ("freesurfer", b"\xff\xff\xfe", b"\xff\xff\xfd", "wrong magic"),
        ("freesurfer", b"\0\0\0\4\0\0\0\4", b"\x7f\0\0\4\0\0\0\4", "lies about its size"),
        ("freesurfer", b"\0\0\0\4\0\0\0\4", b"\xff\0\0\4\0\0\0\4", "impossible counts"),
        ("trk", b"\3\0\0\0\0\0\0?", b"\3\0\0\x70\0\0\0?", "lies about its size"),
        ("tck", b"count: 0000000002", b"count: 0000000003", "the header lies; found 2 lines; allowed 3"),
        ("tck", b"Float32", b"Float99", "damaged"),
        ("glb", b"\2\0\0\0", b"\1\0\0\0", "not glTF 2.0; found version 1"),
        ("glb", b"JSON", b"\xff\xff\xff\xff", "damaged|lies about its size|not glTF"),
        ("npz-mesh", b"PK", b"PQ", "wrong magic"),
        ("pdb", b"   1.000", b"   x.000", "no position in line 2; found '   x.000"),
        ("cif", b"_atom_site.Cartn_x", b"_atom_site.Cartn_w", "no atoms"),
        ("csv", b"x,y,z", b"x,v,w", "no positions"),
        ("csv", b"5.0,5.0,5.0,a b", b"5.0,5.0", "damaged"),
        ("csv", b"x,y,z,name", b"x,y,z", "rows of different lengths"),
        ("npy-fields", b"'x'", b"'w'", "1 axes|not a scalar volume|no positions"),
    ],
    "grid": [
        ("vtu-ascii", b"types", b"kinds", "Cells lack an array"),
        ("vtu-ascii", b"10 14 13 12", b"10 14 13 42", "Cells lack an array"),
        ("vtu-streams", b"4 3 5 6 9", b"4 2 5 6 9", "the faces of polyhedra are wrong"),
        ("vtu-streams", b"4 3 5 6 9", b"4 3 5 66 9", "out of range; found 66"),
        ("vtu-polyhedra", b'Name="face_offsets"', b'Name="faces"', "Cells lack an array"),
        ("vtu-ascii", b"10 14 13 12", b"10 14 13 99", "unsupported kind; found VTK's type 99"),
        (
            "vtu-ascii",
            b"10 14 13 12",
            b"10 14 13 25",
            "impossible length; found a hexahedron20 of 8 points; allowed 20",
        ),
        ("vtu-ascii", b"10 14 13 12", b"5 5 5 5", "no cells with a volume; found 4 others"),
        ("vtu-ascii", b"4 9 15 23", b"4 3 15 23", "offsets are wrong"),
        ("vtu-ascii", b"5 9 6 11", b"5 9 6 12", "out of range; found 12; allowed 0 to 11"),
        ("vtu-ascii", b"5 9 6 11", b"5 9 6 99999999999", "out of range; found 99999999999"),
        ("vtu-ascii", b'NumberOfCells="4"', b'NumberOfCells="400000000"', "lies about its size"),
        ("vtu-ascii", b'type="UnstructuredGrid"', b'type="PolyData"', "not a VTK file of type UnstructuredGrid"),
        ("vtu-raw", b'NumberOfPoints="12"', b'NumberOfPoints="13"', "size is not the dataset's"),
        ("pvtu", b"a_1.vtu", b"b_1.vtu", "b_1.vtu: no such file"),
        ("pvtu", b"PUnstructuredGrid", b"PPolyData", "not a VTK file of this type; .*; allowed PUnstructuredGrid"),
        ("pvtu", b"Source", b"Target", "no pieces"),
        ("pvd", b'timestep="1.5"', b'timestep="late"', "not a time and a file; found late, a_0.vtu"),
        ("pvd", b"DataSet", b"Set", "lists no files"),
        ("series", b'"time"', b'"step"', "not a list of a file series"),
        ("series", b'"none.vtu"', b"7", "not a time and a file; found 0.5, 7"),
        ("gmsh-2.2", b"NodeData\n1\n", b"NodeData\n999999999\n", r"\$NodeData: truncated; found no further line"),
        ("gmsh-2.2", b"$Nodes\n12\n", b"$Nodes\n13\n", r"\$Nodes: truncated, or the header lies about its size"),
        ("gmsh-2.2", b"2.2 0 8", b"3 0 8", r"\$MeshFormat: an unknown format; found 3 0 8; allowed version 2, "),
        ("gmsh-2.2", b"$EndElements", b"$Elements", r"truncated: no \$EndElements"),
        ("gmsh-2.2", b" 15 2 4 5 ", b" 77 2 4 5 ", "elements of an unknown type; found 77"),
        ("gmsh-2.2", b"\n10 2.0 1.0 2.0\n", b"\n11 2.0 1.0 2.0\n", "an element has an unknown node; found 10"),
        ("gmsh-2.2", b" 15 2 4 5 ", b" 15 2 4 x ", r"\$Elements: not a whole number"),
        ("gmsh-4.1", b"$Elements\n6 ", b"$Elements\n7 ", r"\$Elements: truncated, or the header lies"),
        ("vtk-ascii", b"CELL_TYPES 4", b"CELL_TYPES 99999999999", "lies about its size"),
        ("vtk-ascii", b"UNSTRUCTURED_GRID", b"POLYDATA", "not an unstructured grid; found DATASET POLYDATA"),
    ],
}


@pytest.mark.parametrize(
    ("kind", "name", "old", "new", "said"), [(kind, *row) for kind, rows in DAMAGED.items() for row in rows]
)
def test_what_cannot_be_is_refused(kind: str, name: str, old: bytes, new: bytes, said: str, tmp_path: Path) -> None:
    if name in ("pdb", "cif"):
        pytest.importorskip("gemmi")
    files, read = KINDS[kind]
    file, write = files[name]
    path = write(tmp_path / file)
    content = path.read_bytes()
    assert old in content
    path.write_bytes(content.replace(old, new, 1 if kind == "mesh" else -1))
    refused(lambda: read(path), said, *([path.name] if kind == "mesh" else []))
