"""One small valid file for each reader, made by code, and how it is read from end to end: a line of `READERS` each."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from data import grid_writers, mesh_writers, writers
from PIL import Image

from clusterviz.content.volume.section import Scattered
from clusterviz.data import open_source, read_geometry, read_grid
from clusterviz.data.axes import Subset
from clusterviz.data.memory import ArraySource
from clusterviz.data.store.shards import BrickCodec
from clusterviz.data.store.writer import write_store
from clusterviz.data.tetrahedra import make_tetrahedra
from clusterviz.scene import load_scene
from clusterviz.scene.animation import load_path
from clusterviz.scene.transfer_2d import read_table

FOAM = "constant/polyMesh/faces"
PIECES = {"openfoam": FOAM, "openfoam-binary": FOAM, "openfoam-pieces": f"processor0/{FOAM}"}
PIECES |= {"pattern": "a_1.vtu", "exodus-pieces": "a.e.1.0"}
"""File of several that is damaged."""
SAMPLES = np.arange(4 * 5 * 6, dtype="<i2").reshape(4, 5, 6)
MOST_BYTES = 1 << 26  # no file of these can hold more, however well it is packed


def read_scattered(path: Path) -> None:
    """Points of a file, on a small grid."""
    read_data(path, Subset("v", scattered=Scattered(size=(8,))))


def read_data(path: Path, subset: Subset | None = None) -> None:
    """All samples; both ends of a volume that is too large to be true: allowed to HDF5 and uneven coordinates."""
    source = open_source(path, subset=subset)
    z, y, x = source.grid.shape_zyx
    if z * y * x * source.dtype.itemsize <= MOST_BYTES:
        source.read((0, 0, 0), (z, y, x))
        return
    source.read((0, 0, 0), (1, 1, 1))
    source.read((z - 1, y - 1, x - 1), (z, y, x))
    assert path.suffix in SPARSE, f"{z} x {y} x {x} samples in {path.stat().st_size} bytes"


def read_mesh(path: Path) -> None:
    """All that the file holds, and what `info` computes of it."""
    found = read_geometry(path)
    for part in (found.mesh, found.lines, found.points):
        assert part is None or part.bounds != ()
    if found.mesh:
        found.mesh.edge_counts()


def read_cells(path: Path) -> None:
    """The tetrahedra of the first array of scalars, if there is one."""
    grid = read_grid(path)
    for name, array in [*grid.point_arrays.items(), *grid.cell_arrays.items()]:
        if array.ndim == 1:
            make_tetrahedra(grid, name)
            return


def read_keys(path: Path) -> None:
    load_path(path).frames(25.0, str(path))


@dataclass(frozen=True)
class Reader:
    """How a file of `name` is made, and what reads it.

    Attributes
    ----------
    make : writes the file at a path, and others beside it
    read : raises nothing but an `InputError`
    damaged : the file that is damaged, where it is another
    packed : the damage is done to what is inside of gzip
    """

    name: str
    make: Callable[[Path], object]
    read: Callable[[Path], object] = read_data
    damaged: str = ""
    packed: bool = False


def _text(text: str) -> Callable[[Path], object]:
    return lambda path: path.write_text(text, encoding="utf-8")


def _data(name: str, packed: bool = False, **options: Any) -> Reader:
    return Reader(name, lambda path: writers.write(path, SAMPLES, **options), packed=packed)


def _layers(path: Path) -> None:
    """The data files of a header."""
    for z, layer in enumerate(SAMPLES):
        path.with_name(f"s{z:02d}.raw").write_bytes(layer.tobytes())


def _nhdr(path: Path) -> None:
    _layers(path)
    writers.nrrd(path, b"", sizes="6 5 4", spacings="1 2 3", **{"data file": "s%02d.raw 0 3 1"})


def _mhd(path: Path) -> None:
    _layers(path)
    writers.metaimage(path, b"", "s%02d.raw 0 3 1", DimSize="6 5 4", **META)


def _netcdf(path: Path) -> None:
    lines = {"when": np.arange(4) * 2.0, "lat": np.arange(5) * 2.0, "lon": np.arange(6) * 2.0}
    attributes = {"_FillValue": np.int16(7), "scale_factor": 0.5, "valid_range": np.array([1, 90], "i2")}
    writers.netcdf(path, SAMPLES, lines, **attributes)


def _classic_netcdf(path: Path) -> None:
    """Of records, which netCDF4 writes; uneven along one axis."""
    import netCDF4

    lines = {"time": np.arange(4.0), "lat": np.array([0.0, 1, 2, 3, 5]), "lon": np.arange(6) * 2.0}
    with netCDF4.Dataset(path, "w", format="NETCDF3_CLASSIC") as file:
        for name, line in lines.items():
            file.createDimension(name, None if name == "time" else len(line))
            file.createVariable(name, "f8", (name,))[:] = line
        variable = file.createVariable("t", "i2", tuple(lines), fill_value=7)
        variable[:] = SAMPLES
        variable.scale_factor = 0.5


def _slices(path: Path) -> None:
    for z, layer in enumerate(SAMPLES):
        Image.fromarray(layer.astype("u1")).save(path.with_name(f"s{z}.png"))


def _dicom(path: Path, **elements: Any) -> None:
    for z, layer in enumerate(SAMPLES):
        made = writers.dicom(layer, np.array([2.5 * z, 0, 0]), RescaleSlope=0.5, RescaleIntercept=1, **elements)
        writers.save_dicom(made, path.with_name(f"{z}.dcm"))


def _pieces(path: Path) -> None:
    """An image in two pieces that overlap."""
    tags = ""
    for name, begin, end in (("a.vti", 0, 2), ("b.vti", 2, 3)):
        extent = f"0 5 0 4 {begin} {end}"
        writers.vti(path.with_name(name), SAMPLES[begin : end + 1], image='WholeExtent="0 5 0 4 0 3"', piece=extent)
        tags += f'<Piece Extent="{extent}" Source="{name}"/>'
    tags = f'<PImageData WholeExtent="0 5 0 4 0 3" Spacing="1 2 3">{tags}</PImageData>'
    path.write_text(f'<VTKFile type="PImageData">{tags}</VTKFile>')


def _vtr(path: Path) -> None:
    writers.vti(path, SAMPLES, "ascii")
    lines = ("0 1 2 3 4 5.5", "0 1 2 3 4", "0 1 2 8")
    arrays = "".join(f'<DataArray type="Float64" format="ascii">{line}</DataArray>' for line in lines)
    text = path.read_text().replace("ImageData", "RectilinearGrid")
    path.write_text(text.replace("</Piece>", f"<Coordinates>{arrays}</Coordinates></Piece>"))


def _preset(path: Path) -> None:
    points = [0.0, 0.0, 0.0, 0.0, 0.5, 1.0, 0.5, 0.0, 1.0, 1.0, 1.0, 1.0]
    preset = {"Name": "a", "ColorSpace": "Lab", "RGBPoints": points, "Points": [0.0, 0.0, 0.5, 0.0, 1.0, 1.0, 0.5, 0.0]}
    path.write_text(json.dumps([preset]))
    path.with_name("scene.yaml").write_text("volumes: [{path: 'field:marschner-lobb:9', cmap: a.json}]")


def _store(path: Path) -> None:
    write_store(ArraySource(SAMPLES), path, BrickCodec())


TURNED = [1, 0, 0, 0, 1, 0, 0, 0, 1]
SIDECAR = {"byte_order": "little", "header_bytes": 32, "spacing": [1.0, 1.0, 2.0], "origin": [0.0] * 3}
SIDECAR["direction"] = TURNED
META = {"ObjectType": "Image", "TransformMatrix": "1 0 0 0 1 0 0 0 1", "Offset": "1 2 3", "ElementSpacing": "1 1 2"}
SPACE = {"space": "LPS", "space directions": np.diag([1.0, 2.0, 3.0]), "space origin": [1.0, 2.0, 3.0]}
SHEARED = {"w10": 6.0, "w11": 10.0, "w12": 12.0, "w14": 80.0}
NIFTI = {"affine": np.diag([1.0, 2.0, 3.0, 1.0]), "scl_slope": 2.0, "scl_inter": 1.0}
IMAGEJ = {"imagej": True, "resolution": (4, 2), "metadata": {"spacing": 3.5, "axes": "ZYX"}}
ZLIB = {"compressor": "vtkZLibDataCompressor", "header": "u4"}
CHUNKED = {"chunks": (2, 3, 4), "fletcher32": True, "attributes": {"spacing": [1.0, 2.0, 3.0]}}
SCENE = """volumes:
  - path: 'field:marschner-lobb:9'
    cmap: bone
    clim: [20, 200.5]
    opacity: [[20, 0.0], [90, 0.05], [200, 0.6]]
    isosurfaces: [[100, 0.5]]
    shade: true
    gradient_opacity: [[0, 0], [10, 1]]
  - {path: 'field:marschner-lobb:9', cmap: [[0, 0, 0, 0], [1, 1, 1, 1]], opacity: linear}
camera: {position: [1, 2, 300], focal_point: [1.5, 2, 3], view_up: [0, 1, 0], view_angle: 30}
lights: [{type: scene, position: [1, 2, 3], color: [1, 1, 1]}]
image: {size: [64, 48], background: '#102030'}
quality: {step: 0.5, classification: post, filter: exact}
cluster: {mode: auto, codec: active+lz4, brick: 32}
"""
KEYS = """camera:
  - {time: 0, position: [1, 2, 3], focal_point: [0, 0, 0], view_up: [0, 1, 0], view_angle: 30}
  - {time: 2.5, position: [3, 2, 1]}
transfer:
  - {time: 0, cmap: bone, clim: [0, 1], opacity: [[0, 0], [1, 1]]}
  - {time: 2, clim: [0, 2], opacity: [[0, 0.5], [1, 1]]}
"""
NRRD = {"": "raw", "-gzip": "gzip", "-bzip2": "bzip2", "-ascii": "ascii"}
SPARSE = {".h5", ".nc", ".vtkhdf", ".vtr"}

READERS = {
    "npy": _data("a.npy"),
    "npz": _data("a.npz"),
    "npz-packed": _data("a.npz", save=np.savez_compressed),
    "raw": Reader("a.raw", lambda path: writers.raw(path, SAMPLES, **SIDECAR), damaged="a.raw.yaml"),
    **{
        f"nrrd{kind}": _data("a.nrrd", by=writers.pynrrd, encoding=encoding, **SPACE) for kind, encoding in NRRD.items()
    },
    "nrrd-files": Reader("a.nhdr", _nhdr),
    "nifti": _data("a.nii", **NIFTI),
    "nifti-gzip": _data("a.nii.gz", packed=True, **NIFTI),
    "mrc": _data("a.mrc", **SHEARED),
    "mrc-gzip": _data("a.mrc.gz", packed=True, **SHEARED),
    "tiff": _data("a.tif"),
    "tiff-zlib": _data("a.tif", compression="zlib", rowsperstrip=2),
    "tiff-imagej": _data("a.tif", **IMAGEJ),
    "tiff-ome": _data("a.ome.tif", ome=True, metadata={"axes": "ZYX", "PhysicalSizeX": 0.1}),
    "metaimage-zlib": _data("a.mha", by=writers.packed_metaimage, **META),
    "metaimage-files": Reader("a.mhd", _mhd),
    "vtk-ascii": _data("a.vtk", form="ASCII"),
    "vtk-binary": _data("a.vtk", form="BINARY"),
    **({"dicom": Reader("2.dcm", _dicom)} if find_spec("pydicom") else {}),
    "slices": Reader("s0.png", _slices, lambda path: read_data(path.parent), damaged="s2.png"),
    "vtkhdf": Reader("a.vtkhdf", lambda path: writers.vtkhdf(path, {"f": SAMPLES[None]}, steps=[0])),
    "amr": Reader(
        "a.vtkhdf", lambda path: writers.amr(path, [(2.0, {(0, 0, 0): SAMPLES}), (1.0, {(2, 0, 2): SAMPLES})])
    ),
    "pvti": Reader("a.pvti", _pieces),
    "vtr": Reader("a.vtr", _vtr),
    "vti-ascii": _data("a.vti", form="ascii"),
    "vti-binary": _data("a.vti", form="binary", **ZLIB),
    "vti-raw": _data("a.vti"),
    "vti-appended": _data("a.vti", **ZLIB),
    "hdf5": _data("a.h5", attributes={"spacing": [1.0, 2.0, 3.0]}),
    "hdf5-chunked": _data("a.h5", compression="gzip", shuffle=True, **CHUNKED),
    "netcdf": Reader("a.nc", _netcdf, lambda path: read_data(path, Subset(time=1))),
    **(
        {"netcdf-classic": Reader("a.nc", _classic_netcdf, lambda path: read_data(path, Subset(time=1)))}
        if find_spec("netCDF4")
        else {}
    ),
    "hdf5-latest": _data("a.h5", libver="latest", compression="lzf", **CHUNKED),
    "hdf5-packed": _data("a.h5", libver="latest", chunks=(4, 5, 6), maxshape=(None, 5, 6), scaleoffset=0),
    "scene-yaml": Reader("a.yaml", _text(SCENE), load_scene),
    "scene-json": Reader("a.json", lambda path: path.write_text(json.dumps(yaml.safe_load(SCENE))), load_scene),
    "path": Reader("a.yaml", _text(KEYS), read_keys),
    **{
        f"store-{name.replace('/', '-')}": Reader("a.zarr", _store, damaged=f"a.zarr/{name}")
        for name in ("zarr.json", "0/zarr.json", "0/c/0/0/0")
    },
    "preset": Reader("scene.yaml", lambda path: _preset(path.with_name("a.json")), load_scene, damaged="a.json"),
    "scattered": Reader("a.csv", _text("x,y,v\n0,0,1\n3,1,2\n1,5,4\n"), read_scattered),
    "table": Reader("a.npy", lambda path: np.save(path, np.linspace(0, 1, 12).reshape(3, 4)), read_table),
    **{
        f"mesh-{kind}": Reader(name, make, read_mesh, packed=name.endswith(".gz"))
        for kind, (name, make) in mesh_writers.FILES.items()
        if kind not in ("pdb", "cif") or find_spec("gemmi")
    },
    **{
        f"grid-{kind}": Reader(name, make, read_cells, PIECES.get(kind, ""))
        for kind, (name, make) in grid_writers.FILES.items()
    },
}
