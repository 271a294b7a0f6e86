"""Small files of unstructured grids: the cells of `cells.mixed`, in every format."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from data import writers
from data.cells import mixed

from clusterviz.data.unstructured import FACES

GRID = mixed()
TYPES = {"tetra": 10, "pyramid": 14, "wedge": 13, "hexahedron": 12}
NUMBERS = np.array([TYPES[kind] for kind, corners in GRID.cells.items() for _ in corners], np.uint8)
CORNERS = [row for corners in GRID.cells.values() for row in corners]
KIND = GRID.cell_arrays["kind"].astype("i4")
HEAT = GRID.point_arrays["f"].astype("f4")
Arrays = Mapping[str, Mapping[str, Any]]
"""Further arrays of bytes by section, PointData or CellData, and name."""
NO_ARRAYS: Arrays = {}


def streams(path: Path, form: str = "vtu", more: Arrays = NO_ARRAYS) -> Path:
    """The cells as polyhedra; forms are streams of .vtu and .vtk, and VTK's arrays from 9.4 on."""
    faces = [[row[list(face)] for face in FACES[kind]] for kind, rows in GRID.cells.items() for row in rows]
    each = [np.concatenate([[len(some)], *([len(face), *face] for face in some)]) for some in faces]
    flat = [face for some in faces for face in some]
    if form == "vtk":
        return vtk(path, "ASCII", rows=each, types=np.full(4, 42), more=more)
    arrays = {"faces": np.concatenate(each), "faceoffsets": np.cumsum([len(row) for row in each])}
    if form == "new":
        arrays = {"face_connectivity": np.concatenate(flat), "face_offsets": np.cumsum([len(face) for face in flat])}
        arrays["polyhedron_to_faces"] = np.arange(len(flat))
        arrays["polyhedron_offsets"] = np.cumsum([len(some) for some in faces])
    head, tags = '<DataArray type="Int64" format="ascii" Name=', ""
    for name, array in arrays.items():
        tags += f'{head}"{name}">{" ".join(map(str, array.tolist()))}</DataArray>'
    text = vtu(path, more=more).read_text().replace("</Cells>", tags + "</Cells>").replace("10 14 13 12", "42 42 42 42")
    path.write_text(text)
    return path


def vtu(path: Path, form: str = "ascii", rows: tuple[int, ...] = (0, 1, 2, 3), more: Arrays = NO_ARRAYS) -> Path:
    corners = [CORNERS[row] for row in rows]
    connectivity = np.concatenate([np.zeros(0, int), *corners]).astype("<i8")
    offsets = np.cumsum([len(row) for row in corners]).astype("<i4")
    cells = {"connectivity": connectivity, "offsets": offsets, "types": NUMBERS[list(rows)]}
    arrays: dict[str, dict[str, np.ndarray]] = {"Points": {"": GRID.points.astype("f4")}, "Cells": cells}
    arrays |= {"PointData": {"f": HEAT}, "CellData": {"kind": KIND[list(rows)]}}
    for section, each in more.items():
        arrays[section] |= {name: np.array(array, "u1") for name, array in each.items()}
    counts = f'NumberOfPoints="{len(HEAT)}" NumberOfCells="{len(rows)}"'
    return writers.vtk_xml(path, "UnstructuredGrid", counts, arrays, form, form if form.startswith("vtk") else "")


def pvtu(path: Path) -> Path:
    """Two pieces, of which the second repeats a cell of the first as a ghost."""
    vtu(path.with_name("a_0.vtu"), rows=(0, 1))
    vtu(path.with_name("a_1.vtu"), rows=(2, 3, 0), more={"CellData": {"vtkGhostType": [0, 0, 1]}})
    names = "".join(f'<Piece Source="a_{n}.vtu"/>' for n in range(2))
    path.write_text(f'<VTKFile type="PUnstructuredGrid"><PUnstructuredGrid>{names}</PUnstructuredGrid></VTKFile>')
    return path


def pattern(path: Path) -> Path:
    pvtu(path.with_name("a.pvtu"))
    return path


def pvd(path: Path) -> Path:
    """Two time steps, of which the first one's file is missing."""
    pvtu(path.with_name("a.pvtu"))
    steps = ((0.5, "none.vtu"), (1.5, "a_0.vtu"), (1.5, "a_1.vtu"))
    listed = "".join(f'<DataSet timestep="{time}" part="0" file="{name}"/>' for time, name in steps)
    path.write_text(f'<VTKFile type="Collection"><Collection>{listed}</Collection></VTKFile>')
    return path


def series(path: Path) -> Path:
    """As `pvd`, in ParaView's form."""
    pvtu(path.with_name("a.pvtu"))
    files = [{"name": name, "time": time} for name, time in (("a.pvtu", 1.5), ("none.vtu", 0.5))]
    path.write_text(json.dumps({"file-series-version": "1.0", "files": files}))
    return path


def vtk(
    path: Path, form: str = "BINARY", version: int = 5, rows: Any = None, types: Any = NUMBERS, more: Arrays = NO_ARRAYS
) -> Path:
    rows = CORNERS if rows is None else rows
    parts: list[Any] = [f"POINTS {len(HEAT)} float", GRID.points.astype("f4")]
    parts += writers.vtk_cells("CELLS", rows, version)
    parts += [f"CELL_TYPES {len(types)}", types.astype("i4"), f"CELL_DATA {len(NUMBERS)}"]

    def ghosts(section: str) -> list[Any]:
        found = list[Any]()
        for name, bits in more.get(section, {}).items():
            found += [f"FIELD a 1\n{name} 1 {len(bits)} unsigned_char", np.array(bits, "u1")]
        return found

    parts += ["SCALARS kind int 1", "LOOKUP_TABLE default", KIND, *ghosts("CellData"), f"POINT_DATA {len(HEAT)}"]
    parts += ["SCALARS f float 1", "LOOKUP_TABLE default", HEAT, *ghosts("PointData")]
    head = "# vtk DataFile Version 5.1\na title\n{form}\nDATASET UNSTRUCTURED_GRID\n"
    return writers.vtk_parts(path, form, *parts, head=head)


def vtkhdf(path: Path, more: Arrays = NO_ARRAYS) -> Path:
    """Two pieces with points of their own."""
    with h5py.File(path, "w") as file:
        root = file.create_group("VTKHDF")
        root.attrs["Type"] = np.bytes_("UnstructuredGrid")
        pieces = [(0, 1), (2, 3)]
        lengths = [[len(CORNERS[row]) for row in rows] for rows in pieces]
        root["NumberOfPoints"], root["NumberOfCells"] = [len(HEAT)] * 2, [2, 2]
        root["NumberOfConnectivityIds"] = [sum(each) for each in lengths]
        root["Points"] = np.tile(GRID.points.astype("f4"), (2, 1))
        root["Connectivity"], root["Types"] = np.concatenate(CORNERS), NUMBERS
        root["Offsets"] = np.concatenate([np.append(0, np.cumsum(each)) for each in lengths])
        root["PointData/f"], root["CellData/kind"] = np.tile(HEAT, 2), KIND
        for section, each in more.items():
            for name, bits in each.items():
                root[f"{section}/{name}"] = np.tile(np.array(bits, "u1"), 2 if section == "PointData" else 1)
    return path


def cgns(path: Path, mixed: bool = False) -> Path:
    """One zone with a section for each kind, or one of mixed elements, and a surface."""
    numbers = {"tetra": 10, "pyramid": 12, "wedge": 14, "hexahedron": 17}

    def add(parent: Any, name: str, label: str, data: Any = None) -> Any:
        node = parent.create_group(name)
        node.attrs["label"], node.attrs["name"], node.attrs["type"] = np.bytes_(label), np.bytes_(name), np.bytes_("MT")
        if data is not None:
            array = np.frombuffer(data.encode(), "i1") if isinstance(data, str) else np.asarray(data)
            node[" data"] = array
            node.attrs["type"] = np.bytes_({"i1": "C1", "i4": "I4", "i8": "I8", "f8": "R8"}[array.dtype.str[1:]])
        return node

    with h5py.File(path, "w") as file:
        file.attrs["label"] = np.bytes_("Root Node of HDF5 File")
        add(file, "CGNSLibraryVersion", "CGNSLibraryVersion_t", np.float32(4.0).astype("f8"))
        base = add(file, "Base", "CGNSBase_t", np.array([3, 3], "i4"))
        zone = add(base, "Zone", "Zone_t", np.array([[len(HEAT)], [4], [0]], "i4"))
        add(zone, "ZoneType", "ZoneType_t", "Unstructured")
        coordinates = add(zone, "GridCoordinates", "GridCoordinates_t")
        for axis, row in zip("XYZ", GRID.points.T, strict=True):
            add(coordinates, f"Coordinate{axis}", "DataArray_t", row)
        sections = [(number, GRID.cells[kind] + 1) for kind, number in numbers.items()]
        rows = [np.append(number, row) for number, each in sections for row in each]
        if mixed:
            sections = [(20, np.concatenate(rows)[None])]
        first = 1
        for number, corners in [*sections, (5, np.array([[1, 2, 3]]))]:
            last = first + (4 if number == 20 else len(corners)) - 1
            section = add(zone, f"Elements {first}", "Elements_t", np.array([number, 0], "i4"))
            add(section, "ElementRange", "IndexRange_t", np.array([first, last], "i4"))
            add(section, "ElementConnectivity", "DataArray_t", corners.ravel().astype("i4"))
            if number == 20:
                offsets = np.cumsum([0, *map(len, rows)]).astype("i4")
                add(section, "ElementStartOffset", "DataArray_t", offsets)
            first = last + 1
        for place, name, array in (("Vertex", "f", HEAT.astype("f8")), ("CellCenter", "kind", KIND)):
            solution = add(zone, f"Solution{place}", "FlowSolution_t")
            add(solution, "GridLocation", "GridLocation_t", place)
            add(solution, name, "DataArray_t", array)
    return path


def openfoam(path: Path, binary: bool = False) -> Path:
    """Two time steps of the cells' kinds; inner faces come first."""
    of_faces = dict[frozenset[int], list[tuple[int, Any]]]()
    rows = [(kind, row) for kind, each in GRID.cells.items() for row in each]
    for cell, (kind, row) in enumerate(rows):
        for face in FACES[kind]:
            of_faces.setdefault(frozenset(row[list(face)].tolist()), []).append((cell, row[list(face)]))
    found = sorted(of_faces.values(), key=lambda each: -len(each))
    sizes = [len(each[0][1]) for each in found]
    labels, form = np.concatenate([each[0][1] for each in found]), "binary" if binary else "ascii"

    def packed(array: Any) -> bytes:
        if binary:
            return b"%d\n(" % len(array) + array.astype("<f8" if array.dtype.kind == "f" else "<i4").tobytes() + b")\n"
        words = [f"({' '.join(map(str, row))})" if array.ndim > 1 else str(row) for row in array.tolist()]
        return f"{len(array)}\n(\n{chr(10).join(words)}\n)\n".encode()

    def write(name: str, kind: str, body: bytes) -> None:
        file = path.parent / name
        file.parent.mkdir(parents=True, exist_ok=True)
        head = f'FoamFile\n{{\nversion 2.0;\nformat {form};\narch "LSB;label=32;scalar=64";\n'
        head += f"class {kind};\nobject {file.name};\n}}\n// * * * //\n\n"
        file.write_bytes(head.encode() + body + b"\n\n// *** //\n")

    mesh = "constant/polyMesh/"
    write(mesh + "points", "vectorField", packed(GRID.points.astype("f8")))
    write(mesh + "owner", "labelList", packed(np.array([each[0][0] for each in found])))
    write(mesh + "neighbour", "labelList", packed(np.array([each[1][0] for each in found if len(each) > 1])))
    if binary:
        write(mesh + "faces", "faceCompactList", packed(np.cumsum([0, *sizes])) + packed(labels))
    else:
        listed = "".join(f"{len(each[0][1])}({' '.join(map(str, each[0][1]))})\n" for each in found)
        write(mesh + "faces", "faceList", f"{len(found)}\n(\n{listed})\n".encode())
    patch = f"1\n(\nwall\n{{ type wall; nFaces {len(found) - 3}; startFace 3; }}\n)\n"
    write(mesh + "boundary", "polyBoundaryMesh", patch.encode())
    for time in ("0.5", "10"):
        field = b"dimensions [0 0 0 0 0 0 0];\ninternalField nonuniform List<scalar>\n" + packed(KIND.astype("f8"))
        write(f"{time}/kind", "volScalarField", field + b";\nboundaryField { wall { type zeroGradient; } }\n")
    write("10/U", "volVectorField", b"dimensions [0 0 0 0 0 0 0];\ninternalField uniform (1 2 3);\nboundaryField {}\n")
    path.touch()
    return path


def decomposed(path: Path) -> Path:
    """A case of OpenFOAM in a piece and one without cells, as its programs leave it on several ranks."""
    openfoam(path.parent / "processor0" / path.name)
    openfoam(path.parent / "processor1" / path.name)
    for file in (path.parent / "processor1").rglob("*"):
        if file.is_file() and file.suffix != ".foam":
            head, end, body = file.read_bytes().partition(b"// * * * //\n")
            body, lists = body.partition(b"// ***")[0], rb"(?s)(nonuniform List<scalar>\s*|^\s*)\d+\s*\(.*\)"
            empty = re.sub(lists, rb"\g<1>0()", body)
            file.write_bytes(head + end + empty + b"// *** //\n")
    path.touch()
    return path


def exodus(path: Path, form: str = "NETCDF3_CLASSIC") -> Path:
    """A block for each kind, two time steps of f, and kind in all blocks but the first."""
    import netCDF4

    names = {"tetra": "TETRA4", "pyramid": "PYRAMID5", "wedge": "WEDGE6", "hexahedron": "HEX8"}
    with netCDF4.Dataset(path, "w", format=form) as file:
        sizes = {"num_dim": 3, "num_nodes": len(HEAT), "num_el_blk": 4, "len_string": 33, "num_nod_var": 1}
        for name, size in {**sizes, "num_elem_var": 1, "time_step": None}.items():
            file.createDimension(name, size)
        for row, axis in zip(GRID.points.T, "xyz", strict=True):
            file.createVariable(f"coord{axis}", "f8", ("num_nodes",))[:] = row
        file.createVariable("time_whole", "f8", ("time_step",))[:] = [0.5, 1.5]
        for key, size, name in (("name_nod_var", "num_nod_var", b"f"), ("name_elem_var", "num_elem_var", b"kind")):
            file.createVariable(key, "S1", (size, "len_string"))[:] = np.array([[name.ljust(33, b"\0")]]).view("S1")
        value = file.createVariable("vals_nod_var1", "f8", ("time_step", "num_nodes"))
        value[0], value[1] = -HEAT, HEAT
        for n, (kind, corners) in enumerate(GRID.cells.items(), 1):
            file.createDimension(f"num_el_in_blk{n}", len(corners))
            file.createDimension(f"num_nod_per_el{n}", corners.shape[1])
            connect = file.createVariable(f"connect{n}", "i4", (f"num_el_in_blk{n}", f"num_nod_per_el{n}"))
            connect[:], connect.elem_type = corners + 1, names[kind]
            if n > 1:
                own = file.createVariable(f"vals_elem_var1eb{n}", "f8", ("time_step", f"num_el_in_blk{n}"))
                own[0] = own[1] = KIND[n - 1]
    return path


GMSH_TYPES = {"tetra": 4, "pyramid": 7, "wedge": 6, "hexahedron": 5}


def gmsh(path: Path, version: str = "2.2", binary: bool = False, steps: tuple[float, ...] = (0.5, 1.5)) -> Path:
    """Numbers with gaps, in falling order; a vertex and a triangle among the cells; f, negative but at the last step.

    The cells' kinds are data of elements at the last step, in another order.
    """
    nodes, numbers = 10 * np.arange(len(HEAT), 0, -1), 7 + 3 * np.arange(6, 0, -1)
    elements = [("vertex", 15, GRID.cells["tetra"][:1, :1]), ("triangle", 2, GRID.cells["tetra"][:1, :3])]
    elements += [(kind, GMSH_TYPES[kind], corners) for kind, corners in GRID.cells.items()]

    def pack(*parts: Any, size: str = "<i4") -> bytes:
        """Whole numbers of a size, and others, one line of text each or bytes."""
        if not binary:
            return (" ".join(map(str, [each for part in parts for each in np.ravel(part).tolist()])) + "\n").encode()
        arrays = [np.asarray(part) for part in parts]
        return b"".join(a.astype("<f8" if a.dtype.kind == "f" else size).tobytes() for a in arrays)

    def section(name: str, *parts: bytes) -> bytes:
        return b"$%b\n%b%b$End%b\n" % (name.encode(), b"".join(parts), b"\n" * binary, name.encode())

    def data(name: str, key: str, step: int, own: np.ndarray, values: np.ndarray) -> bytes:
        text = f'1\n"{name}"\n1\n{steps[step]}\n3\n{step}\n1\n{len(own)}\n'
        return section(key, text.encode(), *(pack(n, v) for n, v in zip(own, values.astype("f8"), strict=True)))

    one = np.array([1], "<i4").tobytes() + b"\n" if binary else b""
    stated = "4" if version == "4.0" else version  # as Gmsh states it
    body = section("MeshFormat", f"{stated} {int(binary)} 8\n".encode(), one)
    places = zip(nodes, GRID.points, strict=True)
    if version == "2.2":
        body += section("Nodes", b"%d\n" % len(nodes), *(pack(n, place) for n, place in places))
        rows = list[bytes]()
        for n, (_, kind, corners) in zip(numbers, elements, strict=True):
            rows.append(pack([kind, 1, 2]) if binary else b"")
            rows.append(pack([n, *([] if binary else [kind, 2]), 4, 5], nodes[corners[0]]))
        body += section("Elements", b"6\n", *rows)
    else:
        new, size = version == "4.1", "<u8"
        box = [0.0] * 6
        point = pack([9]) + pack(box[: 3 if new else 6]) + pack([0], size=size)
        volume = pack([5]) + pack(box) + pack([1], size=size) + pack([4]) + pack([0], size=size)
        body += section("Entities", pack([1, 0, 0, 1], size=size), point, volume)
        counts = [1, len(nodes), 10, 120] if new else [1, len(nodes)]
        heads = pack(counts, size=size), pack([3, 5, 0] if new else [5, 3, 0]), pack([len(nodes)], size=size)
        each = [pack(nodes, size=size), pack(GRID.points)] if new else [pack(n, place) for n, place in places]
        body += section("Nodes", *heads, *each)
        counts = [6, 6, 1, 99] if new else [6, 6]
        parts = [pack(counts, size=size)]
        for n, (_, kind, corners) in zip(numbers, elements, strict=True):
            parts += [pack([3, 5, kind] if new else [5, 3, kind]), pack([1], size=size)]
            parts.append(pack(n, nodes[corners[0]], size=size if new else "<i4"))
        body += section("Elements", *parts)
    for step in range(len(steps)):
        sign, order = 1 if step == len(steps) - 1 else -1, np.random.default_rng(step).permutation(len(nodes))
        body += data("f", "NodeData", step, nodes[order], sign * HEAT[order])
    body += data("kind", "ElementData", len(steps) - 1, numbers[[4, 2, 5, 3]], KIND[[2, 0, 3, 1]])
    path.write_bytes(body)
    return path


XDMF_KINDS = {"tetra": 6, "pyramid": 7, "wedge": 8, "hexahedron": 9}


class XdmfItems:
    """DataItems of a file, whose numbers are text, datasets of HDF5, or raw files of the other byte order."""

    def __init__(self, path: Path, form: str) -> None:
        self.path, self.form, self.count = path, form, 0

    def __call__(self, array: Any) -> str:
        array = np.asarray(array)
        kind, dims = {"f": "Float", "i": "Int", "u": "UInt"}[array.dtype.kind], " ".join(map(str, array.shape))
        name, self.count = f"{self.path.stem}{self.count}", self.count + 1
        if self.form == "HDF":
            with h5py.File(self.path.with_suffix(".h5"), "w" if self.count == 1 else "a") as file:
                file[f"Mesh/{name}"] = array
            text = f"{self.path.stem}.h5:/Mesh/{name}"
        elif self.form == "Binary":
            text = f"{name}.bin"
            self.path.with_name(text).write_bytes(b"skip" + array.astype(array.dtype.newbyteorder(">")).tobytes())
        else:
            text = " ".join(map(repr, array.ravel().tolist()))
        more = 'Endian="Big" Seek="4"' if self.form == "Binary" else ""
        keys = f'Dimensions="{dims}" NumberType="{kind}" Precision="{array.dtype.itemsize}" Format="{self.form}"'
        return f"<DataItem {keys} {more}>{text}</DataItem>"


def xdmf(path: Path, form: str = "dolfinx", numbers: str = "HDF") -> Path:
    """Two time steps, at 0.5 and 1.5, of f, which is negative at first, and of kind.

    Forms: those of FEniCSx, a mesh and a collection for each function; of FEniCS, a collection whose first step has the
    mesh; and pieces, each with a half of the cells, in a collection of steps.
    """
    item = XdmfItems(path, numbers)

    def mesh(rows: Any = range(4)) -> str:
        kinds = [XDMF_KINDS[kind] for kind in GRID.cells]
        mixed = np.concatenate([np.append(kinds[row], CORNERS[row]) for row in rows]).astype("i8")
        topology = f'<Topology TopologyType="Mixed" NumberOfElements="{len(rows)}">{item(mixed)}</Topology>'
        return f'{topology}<Geometry GeometryType="XYZ">{item(GRID.points)}</Geometry>'

    def array(name: str, values: np.ndarray, center: str) -> str:
        return f'<Attribute Name="{name}" AttributeType="Scalar" Center="{center}">{item(values[:, None])}</Attribute>'

    def collection(steps: list[str], name: str = "", kind: str = "Temporal") -> str:
        return f'<Grid Name="{name}" GridType="Collection" CollectionType="{kind}">{"".join(steps)}</Grid>'

    def grid(*parts: str, name: str = "") -> str:
        return f'<Grid Name="{name}" GridType="Uniform">{"".join(parts)}</Grid>'

    def include(place: str) -> str:
        return f"<xi:include xpointer='xpointer({place}/*[self::Topology or self::Geometry])'/>"

    times = [f'<Time Value="{time}"/>' for time in (0.5, 1.5)]
    heat, cells = [array("f", sign * HEAT, "Node") for sign in (-1, 1)], array("kind", KIND, "Cell")
    if form == "dolfinx":
        place = include("/Xdmf/Domain/Grid[@GridType=&apos;Uniform&apos;][1]")
        of_heat = collection([grid(place, *each) for each in zip(times, heat, strict=True)], "f")
        body = grid(mesh(), name="mesh") + of_heat + collection([grid(place, times[0], cells)], "kind")
    elif form == "dolfin":
        place = include('//Grid[@Name="TimeSeries"]/Grid[1]')
        body = collection([grid(mesh(), times[0], heat[0], cells), grid(place, times[1], heat[1], cells)], "TimeSeries")
    else:
        halves, pieces = ([0, 1], [2, 3]), list[str]()
        for each in heat:
            own = [grid(mesh(rows), each, array("kind", KIND[rows], "Cell")) for rows in halves]
            pieces.append(collection(own, "", "Spatial"))
        listed = f'<Time TimeType="List">{item(np.array([0.5, 1.5]))}</Time>'
        body = collection([listed, *pieces])
    head = '<?xml version="1.0"?><!DOCTYPE Xdmf SYSTEM "Xdmf.dtd" []><Xdmf Version="3.0" '
    path.write_text(f'{head}xmlns:xi="http://www.w3.org/2001/XInclude"><Domain>{body}</Domain></Xdmf>')
    return path


def avs(path: Path) -> Path:
    """Numbers with gaps, in falling order, and data in another one; the cells' kinds are their material too."""
    names = {"tetra": "tet", "pyramid": "pyr", "wedge": "prism", "hexahedron": "hex"}
    places = {"tetra": [0, 1, 3, 2], "pyramid": [4, 0, 1, 2, 3], "wedge": [3, 4, 5, 0, 1, 2]}
    places["hexahedron"] = [4, 5, 6, 7, 0, 1, 2, 3]
    nodes, numbers = 10 * np.arange(len(HEAT), 0, -1), [9, 7, 5, 3]
    lines = ["# a comment", f"{len(HEAT)} 4 4 1 0"]
    lines += [" ".join(map(str, (n, *row))) for n, row in zip(nodes, GRID.points.tolist(), strict=True)]
    for number, (kind, corners), material in zip(numbers, GRID.cells.items(), KIND, strict=True):
        lines.append(" ".join(map(str, (number, material, names[kind], *nodes[corners[0][places[kind]]]))))
    lines += ["2 1 3", "f, K", "the flow, m/s"]
    lines += [f"{nodes[n]} {HEAT[n]} {n} 0 {-n}" for n in np.random.default_rng(1).permutation(len(HEAT))]
    lines += ["1 1", "kind, none", *(f"{numbers[n]} {KIND[n]}" for n in (2, 0, 3, 1))]
    path.write_text("\n".join(lines) + "\n")
    return path


def meshlane(path: Path, *but: str, of_cells: bool = True, **options: Any) -> Path:
    import meshlane as package

    cells = [(kind, np.asarray(corners)) for kind, corners in GRID.cells.items() if kind not in but]
    kind = {"kind": [KIND[n : n + 1] for n in range(4)]} if of_cells else {}
    mesh = package.Mesh(GRID.points, cells, point_data={"f": HEAT.astype("f8")}, cell_data=kind)
    package.write(path, mesh, **options)
    return path


Write = Callable[[Path], Path]
FILES: dict[str, tuple[str, Write]] = {
    "vtu-ascii": ("a.vtu", vtu),
    "vtu-raw": ("a.vtu", lambda path: vtu(path, "")),
    "vtu-zlib": ("a.vtu", lambda path: vtu(path, "vtkZLibDataCompressor")),
    "vtu-streams": ("a.vtu", streams),
    "vtu-polyhedra": ("a.vtu", lambda path: streams(path, "new")),
    "vtk-streams": ("a.vtk", lambda path: streams(path, "vtk")),
    "pvtu": ("a.pvtu", pvtu),
    "pattern": ("a_[0-9].vtu", pattern),
    "pvd": ("a.pvd", pvd),
    "series": ("a.pvtu.series", series),
    "vtk-binary": ("a.vtk", vtk),
    "vtk-ascii": ("a.vtk", lambda path: vtk(path, "ASCII")),
    "vtk-old": ("a.vtk", lambda path: vtk(path, "BINARY", 3)),
    "vtkhdf": ("a.vtkhdf", vtkhdf),
    "openfoam": ("a.foam", openfoam),
    "openfoam-binary": ("a.foam", lambda path: openfoam(path, binary=True)),
    "openfoam-pieces": ("a.foam", decomposed),
    "cgns": ("a.cgns", cgns),
    "cgns-mixed": ("a.cgns", lambda path: cgns(path, mixed=True)),
    "avs": ("a.avs", avs),
    "xdmf-dolfinx": ("a.xdmf", xdmf),
    "xdmf-dolfin": ("a.xdmf", partial(xdmf, form="dolfin", numbers="XML")),
    "xdmf-pieces": ("a.xmf", partial(xdmf, form="pieces", numbers="Binary")),
    **{
        f"gmsh-{version}{'-binary' * binary}": ("a.msh", partial(gmsh, version=version, binary=binary))
        for version in ("2.2", "4.0", "4.1")
        for binary in (False, True)
    },
}
if find_spec("netCDF4"):
    FILES["exodus-3"] = ("a.ex2", exodus)
    FILES["exodus-pieces"] = ("a.e.1.*", lambda path: exodus(path.with_name("a.e.1.0")).with_name(path.name))
    FILES["exodus-4"] = ("a.exo", lambda path: exodus(path, "NETCDF4"))
if find_spec("meshlane"):
    FILES["xdmf"] = ("a.xdmf", lambda path: meshlane(path, data_format="XML"))
    FILES["gmsh-meshlane"] = ("a.msh", lambda path: meshlane(path, file_format="gmsh22", binary=False))
    FILES["gmsh-meshlane-binary"] = ("a.msh", lambda path: meshlane(path, file_format="gmsh22"))
    FILES["abaqus"] = ("a.inp", lambda path: meshlane(path, "pyramid", of_cells=False, file_format="abaqus"))
    FILES["med"] = ("a.med", lambda path: meshlane(path, of_cells=False))
    FILES["tetgen"] = ("a.ele", lambda path: meshlane(path, "pyramid", "wedge", "hexahedron", of_cells=False))
    FILES |= {name: (f"a.{name}", meshlane) for name in ("nas", "mesh", "meshb", "su2", "ugrid")}
