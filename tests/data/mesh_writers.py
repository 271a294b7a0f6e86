"""Small files of meshes, lines and points in every format: `FILES` has one function a kind, which writes it to a path.

They hold the same mesh, a tetrahedron, and the same lines and points where the format has them.
"""

from __future__ import annotations

import gzip
import json
import struct
from base64 import b64encode
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import nibabel
import numpy as np
from data import writers

VERTICES = np.array([[0, 0, 0], [2, 0, 0], [0, 3, 0], [0, 0, 4]], np.float32)
TRIANGLES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
HEAT = np.array([1.5, 2.5, 3.5, 4.5], np.float32)
LABEL = np.array([7, 8, 9, 10], np.int32)
PATH = np.array([[0, 0, 0], [1, 1, 0], [2, 1, 0.5], [5, 5, 5], [6, 5, 5]], np.float32)
OFFSETS = np.array([0, 3, 5])

PLY_HEAD = "ply\nformat {form} 1.0\ncomment by hand\nelement vertex 4\n"
PLY_HEAD += "".join(f"property float {name}\n" for name in ("x", "y", "z", "heat"))
PLY_HEAD += "element face {faces}\nproperty list uchar int vertex_indices\n{label}end_header\n"


def ply(path: Path, form: str = "ascii", quads: bool = False, points: bool = False) -> Path:
    """A quad is the first two triangles in one, so that lists differ in length."""
    faces = [[0, 2, 1], *TRIANGLES[1:].tolist()]
    faces = [] if points else [[3, 0, 2, 1], *TRIANGLES[1:].tolist()] if quads else faces
    order = ">" if "big" in form else "<"
    head = PLY_HEAD.format(form=form, faces=len(faces), label="property int label\n" if not points else "")
    rows = [(*vertex, heat) for vertex, heat in zip(VERTICES.tolist(), HEAT.tolist(), strict=True)]
    if form == "ascii":
        lines = [" ".join(map(repr, row)) for row in rows]
        lines += [" ".join(map(str, (len(face), *face, label))) for face, label in zip(faces, LABEL, strict=False)]
        path.write_text(head + "\n".join(lines) + "\n")
        return path
    data = b"".join(struct.pack(f"{order}4f", *row) for row in rows)
    for face, label in zip(faces, LABEL, strict=False):
        data += struct.pack(f"{order}B{len(face)}ii", len(face), *face, label)
    path.write_bytes(head.encode() + data)
    return path


def stl(path: Path, text: bool = False) -> Path:
    corners = VERTICES[TRIANGLES]
    if text:
        facets = [
            "facet normal 0 0 0\n outer loop\n"
            + "".join(f"  vertex {x!r} {y!r} {z!r}\n" for x, y, z in facet)
            + " endloop\nendfacet\n"
            for facet in corners.tolist()
        ]
        path.write_text("solid vertex\n" + "".join(facets) + "endsolid vertex\n")
        return path
    facets = [
        struct.pack("<12fH", *[0] * 3, *facet.ravel(), label) for facet, label in zip(corners, LABEL, strict=True)
    ]
    path.write_bytes(b"solid, though binary".ljust(80) + struct.pack("<I", len(facets)) + b"".join(facets))
    return path


def obj(path: Path) -> Path:
    text = "# by hand\n" + "".join("v {} {} {}\n".format(*vertex) for vertex in VERTICES)
    text += "vn 0 0 1\nf 1//1 3//1 2//1\nf 1/1/1 2/1/1 4/1/1\nf -4 -1 -2\nf 2 \\\n3 4\nl 1 2 3\nl 4 1\n"
    path.write_text(text)
    return path


def off(path: Path, head: str = "COFF") -> Path:
    rows = [f"{x} {y} {z}" + " 0.5 0.25 1 1" * (head == "COFF") for x, y, z in VERTICES]
    faces = [f"3 {a} {b} {c}" for a, b, c in TRIANGLES]
    faces[0] += " 1 0 0"  # a colour
    path.write_text("\n".join([f"{head} # a comment", "4 4 6", "", *rows, *faces]) + "\n")
    return path


def gltf(path: Path, **changes: Any) -> Path:
    """The mesh below two nodes, of which one moves and one scales; lines and points in the same mesh."""
    parts = [(VERTICES / 2).tobytes(), TRIANGLES.astype("<u2").tobytes(), PATH.tobytes(), HEAT.tobytes()]
    begins = np.cumsum([0, *map(len, parts)]).tolist()
    types = [(5126, "VEC3", 4), (5123, "SCALAR", 12), (5126, "VEC3", 5), (5126, "SCALAR", 4)]
    document: dict[str, Any] = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}]}
    nodes = [{"translation": [1, 2, 3], "children": [1, 2]}, {"scale": [2, 2, 2], "mesh": 0}, {"mesh": 1}]
    mesh = [{"attributes": {"POSITION": 0, "_HEAT": 3}, "indices": 1}]
    rest = [{"attributes": {"POSITION": 2}, "mode": mode} for mode in (3, 0)]
    keys = ("bufferView", "componentType", "type", "count")
    accessors = [dict(zip(keys, (n, *each), strict=True)) for n, each in enumerate(types)]
    spans = zip(begins, map(len, parts), strict=False)
    views = [{"buffer": 0, "byteOffset": begin, "byteLength": count} for begin, count in spans]
    document |= {"nodes": nodes, "meshes": [{"primitives": mesh}, {"primitives": rest}], "accessors": accessors}
    document |= {"bufferViews": views, "buffers": [{"byteLength": begins[-1]}], **changes}
    data = b"".join(parts)
    if path.suffix == ".gltf":
        document["buffers"][0]["uri"] = "data:application/octet-stream;base64," + b64encode(data).decode()
        path.write_text(json.dumps(document))
        return path
    text, data = json.dumps(document).encode(), data + bytes(-len(data) % 4)
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
    path.write_bytes(struct.pack("<4s2I", b"glTF", 2, 12 + len(chunks)) + chunks)
    return path


def vtp(path: Path, form: str = "ascii", compressor: str = "") -> Path:
    """Two vertices, two lines, two triangles and a strip of two: the cells are numbered in this order."""
    strip = [0, 3, 2, 1]  # the triangles 0 3 2 and 3 1 2
    cells = {"Verts": ([1, 2], [3, 4]), "Lines": (OFFSETS[1:], np.arange(4, 9))}
    cells |= {"Polys": ([3, 6], TRIANGLES[:2].ravel()), "Strips": ([4], strip)}
    arrays = {"Points": {"": np.concatenate([VERTICES, PATH])}, "PointData": {"heat": np.arange(9, dtype="f8")}}
    arrays["CellData"] = {"label": np.arange(7)}
    for name, (ends, along) in cells.items():
        arrays[name] = {"offsets": np.array(ends, "<i4"), "connectivity": np.array(along, "<i8")}
    counts = 'NumberOfPoints="9" NumberOfVerts="2" NumberOfLines="2" NumberOfPolys="2" NumberOfStrips="1"'
    return writers.vtk_xml(path, "PolyData", counts, arrays, form, compressor)


def vtk(path: Path, form: str = "BINARY", version: int = 5) -> Path:
    parts: list[Any] = ["POINTS 9 float", np.concatenate([VERTICES, PATH])]
    for key, cells in (("LINES", [[4, 5, 6], [7, 8]]), ("POLYGONS", TRIANGLES.tolist())):
        parts += writers.vtk_cells(key, cells, version)
    parts += ["CELL_DATA 6", "SCALARS label int 1", "LOOKUP_TABLE default", np.arange(6, dtype="i4")]
    head = "# vtk DataFile Version 5.1\na title\n{form}\nDATASET POLYDATA\n"
    return writers.vtk_parts(path, form, *parts, head=head)


def gifti(path: Path) -> Path:
    of = nibabel.gifti.GiftiDataArray
    triangles = of(TRIANGLES.astype("i4"), "NIFTI_INTENT_TRIANGLE", "NIFTI_TYPE_INT32")
    heat = of(HEAT, "NIFTI_INTENT_SHAPE", "NIFTI_TYPE_FLOAT32", meta={"Name": "heat"})
    arrays = [of(VERTICES, "NIFTI_INTENT_POINTSET", "NIFTI_TYPE_FLOAT32"), triangles, heat]
    content = nibabel.GiftiImage(darrays=arrays).to_bytes()
    path.write_bytes(gzip.compress(content) if path.suffix == ".gz" else content)
    return path


def freesurfer(path: Path, centre: tuple[float, ...] = (0, 0, 0)) -> Path:
    volume = {"head": [2, 0, 20], "valid": "1", "filename": "a.mgz", "volume": [4, 4, 4], "voxelsize": np.ones(3)}
    volume |= {"xras": np.eye(3)[0], "yras": np.eye(3)[1], "zras": np.eye(3)[2], "cras": np.array(centre)}
    nibabel.freesurfer.write_geometry(path, VERTICES, TRIANGLES, create_stamp="by hand", volume_info=volume)
    return path


def streamlines(path: Path) -> Path:
    lines = [PATH[a:b] for a, b in pairwise(OFFSETS)]
    heat = {"heat": [np.arange(len(line), dtype="f4")[:, None] for line in lines]} if path.suffix == ".trk" else None
    nibabel.streamlines.save(nibabel.streamlines.Tractogram(lines, None, heat, np.eye(4)), path)
    return path


def csv(path: Path, separator: str = ",", head: str = "x,y,z,name,line,heat") -> Path:
    lines = np.repeat([3, 8], np.diff(OFFSETS))
    rows = [f"{x},{y},{z},a b,{line},{n}" for n, ((x, y, z), line) in enumerate(zip(PATH, lines, strict=True))]
    path.write_text("\n".join(["# a comment", head, *rows]).replace(",", separator) + "\n")
    return path


def xyz(path: Path) -> Path:
    path.write_text("".join(f"{x} {y} {z} {n}\n" for n, (x, y, z) in enumerate(PATH)))
    return path


def npy(path: Path, structured: bool = True) -> Path:
    table = np.concatenate([PATH, np.arange(5, dtype="f4")[:, None]], axis=1)
    if structured:
        table = table.view([(name, "f4") for name in ("x", "y", "z", "heat")])[:, 0]
    np.save(path, table)
    return path


def npz(path: Path, napari: bool = False) -> Path:
    if napari:
        np.savez(path, VERTICES[:, ::-1], TRIANGLES[:, ::-1], HEAT)
    else:
        np.savez(path, vertices=VERTICES, faces=TRIANGLES, heat=HEAT, label=np.stack([LABEL, LABEL], axis=1)[:4])
    return path


ATOM = "{:6}{:5} {:^4} {:3} {}{:4}    {:8.3f}{:8.3f}{:8.3f}  1.00{:6.2f}          {:>2}\n"
ATOMS = [  # kind, number, name, residue, chain, number of the residue, position, B factor, element
    ("ATOM", 1, "N", "GLY", "A", 1, *PATH[0].tolist(), 0.0, "N"),
    ("ATOM", 2, "CA", "GLY", "A", 1, *PATH[1].tolist(), 10.0, "C"),
    ("ATOM", 3, "O", "GLY", "A", 2, *PATH[2].tolist(), 20.0, "O"),
    ("HETATM", 4, "FE", "HEM", "B", 9, *PATH[3].tolist(), 30.0, "FE"),
]


def pdb(path: Path) -> Path:
    path.write_text("".join(ATOM.format(*atom) for atom in ATOMS) + "END\n")
    return path


def cif(path: Path) -> Path:
    keys = "group_PDB id label_atom_id label_comp_id label_asym_id label_seq_id Cartn_x Cartn_y Cartn_z B_iso_or_equiv"
    keys += " type_symbol label_alt_id occupancy"
    rows = [" ".join(map(str, (*atom, ".", 1.0))) for atom in ATOMS]
    path.write_text("\n".join(["data_a", "loop_", *(f"_atom_site.{key}" for key in keys.split()), *rows, "#"]) + "\n")
    return path


Write = Callable[[Path], Path]
ZLIB = "vtkZLibDataCompressor"
FILES: dict[str, tuple[str, Write]] = {
    "ply-ascii": ("a.ply", ply),
    "ply-little": ("a.ply", lambda path: ply(path, "binary_little_endian")),
    "ply-big-lists": ("a.ply", lambda path: ply(path, "binary_big_endian", quads=True)),
    "ply-ascii-lists": ("a.ply", lambda path: ply(path, quads=True)),
    "ply-points": ("a.ply", lambda path: ply(path, "binary_little_endian", points=True)),
    "stl-ascii": ("a.stl", lambda path: stl(path, text=True)),
    "stl-binary": ("a.stl", stl),
    "obj": ("a.obj", obj),
    "off": ("a.off", off),
    "gltf": ("a.gltf", gltf),
    "glb": ("a.glb", gltf),
    "vtp-ascii": ("a.vtp", vtp),
    "vtp-raw": ("a.vtp", lambda path: vtp(path, "raw")),
    "vtp-zlib": ("a.vtp", lambda path: vtp(path, "raw", ZLIB)),
    "vtk-binary": ("a.vtk", vtk),
    "vtk-ascii": ("a.vtk", lambda path: vtk(path, "ASCII")),
    "vtk-old": ("a.vtk", lambda path: vtk(path, "BINARY", 3)),
    "vtk-old-ascii": ("a.vtk", lambda path: vtk(path, "ASCII", 3)),
    "gifti": ("a.gii", gifti),
    "gifti-gzip": ("a.gii.gz", gifti),
    "freesurfer": ("lh.pial", freesurfer),
    "trk": ("a.trk", streamlines),
    "tck": ("a.tck", streamlines),
    "csv": ("a.csv", csv),
    "tsv": ("a.tsv", lambda path: csv(path, "\t", "Points:0,Points:1,Points:2,name,line,heat")),
    "xyz": ("a.xyz", xyz),
    "npy-fields": ("a.npy", npy),
    "npz-mesh": ("a.npz", npz),
    "npz-napari": ("a.npz", lambda path: npz(path, napari=True)),
    "pdb": ("a.pdb", pdb),
    "cif": ("a.cif", cif),
}
