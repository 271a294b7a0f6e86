"""One small valid file for each reader, made by code, and how it is read from end to end: a line of `READERS` each."""

from __future__ import annotations

import base64
import gzip
import json
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import nibabel
import nrrd
import numpy as np
import tifffile
from PIL import Image

from clusterviz.data import open_source
from clusterviz.data.axes import Subset
from clusterviz.scene import load_scene
from clusterviz.scene.animation import load_path
from clusterviz.scene.transfer_2d import read_table

SAMPLES = np.arange(4 * 5 * 6, dtype="<i2").reshape(4, 5, 6)
MOST_BYTES = 1 << 26  # no file of these can hold more, however well it is packed


def read_data(path: Path, subset: Subset | None = None) -> None:
    """All samples; of a volume that is too large to be true, which is allowed to HDF5 alone, both ends."""
    source = open_source(path, subset=subset)
    z, y, x = source.grid.shape_zyx
    if z * y * x * source.dtype.itemsize <= MOST_BYTES:
        source.read((0, 0, 0), (z, y, x))
        return
    source.read((0, 0, 0), (1, 1, 1))
    source.read((z - 1, y - 1, x - 1), (z, y, x))
    assert path.suffix in SPARSE, f"{z} x {y} x {x} samples in {path.stat().st_size} bytes"


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


def _raw(path: Path) -> None:
    path.write_bytes(bytes(32) + SAMPLES.tobytes())
    path.with_name(path.name + ".yaml").write_text(SIDECAR)


def _nrrd(encoding: str) -> Callable[[Path], object]:
    directions = {"space directions": np.diag([1.0, 2.0, 3.0]), "space origin": [1.0, 2.0, 3.0], "space": "LPS"}
    return lambda path: nrrd.write(str(path), SAMPLES, {"encoding": encoding, **directions}, index_order="C")


def _nhdr(path: Path) -> None:
    for z, layer in enumerate(SAMPLES):
        path.with_name(f"s{z:02d}.raw").write_bytes(layer.tobytes())
    path.write_text(NHDR)


def _nifti(path: Path) -> None:
    image = nibabel.Nifti1Image(np.stack([SAMPLES.T] * 2, 3)[..., :1], np.diag([1.0, 2.0, 3.0, 1.0]), dtype="<i2")
    image.header.set_slope_inter(2.0, 1.0)
    nibabel.save(image, path)


def _mrc(path: Path) -> None:
    words = np.zeros(256, "<i4")
    words[[0, 1, 2, 3, 7, 8, 9, 16, 17, 18]] = [6, 5, 4, 1, 6, 5, 4, 1, 2, 3]
    words[10:16] = np.array([6, 10, 12, 90, 80, 90], "<f4").view("<i4")
    words[52:54] = np.frombuffer(b"MAP \x44\x44\0\0", "<i4")
    content = words.tobytes() + SAMPLES.tobytes()
    path.write_bytes(gzip.compress(content) if path.suffix == ".gz" else content)


def _tiff(**options: Any) -> Callable[[Path], object]:
    return lambda path: tifffile.imwrite(path, SAMPLES, photometric="minisblack", **options)


def _vti(form: str, compressor: str = "") -> Callable[[Path], object]:
    data = SAMPLES.tobytes()
    packed = np.array([len(data)], "<u4").tobytes() + data
    if compressor:
        blocks = [zlib.compress(data[begin : begin + 100]) for begin in range(0, len(data), 100)]
        packed = b"".join(blocks)
        head = np.array([len(blocks), 100, len(data) % 100, *map(len, blocks)], "<u4").tobytes()
    inline = {"ascii": b" ".join(b"%d" % n for n in SAMPLES.flat), "binary": base64.b64encode(packed)}.get(form, b"")
    appended = b""
    if compressor:
        inline = base64.b64encode(head) + base64.b64encode(packed) if inline else b""
        packed = head + packed
    if not inline:
        appended = b'<AppendedData encoding="raw">_' + packed + b"</AppendedData>"
    return lambda path: path.write_bytes(VTI % (compressor.encode(), form.encode(), inline) + appended + b"</VTKFile>")


def _vtk(binary: bool) -> Callable[[Path], object]:
    text = " ".join(str(n) for n in SAMPLES.flat).encode()
    return lambda path: path.write_bytes(
        VTK % (b"BINARY" if binary else b"ASCII") + (SAMPLES.astype(">i2").tobytes() if binary else text) + b"\n"
    )


def _metaimage(**fields: str) -> Callable[[Path], object]:
    text = META + "".join(f"{key} = {value}\n" for key, value in fields.items()) + "ElementDataFile = "
    if fields.get("CompressedData"):
        return lambda path: path.write_bytes(f"{text}LOCAL\n".encode() + zlib.compress(SAMPLES.tobytes()))

    def make(path: Path) -> None:
        for z, layer in enumerate(SAMPLES):
            path.with_name(f"s{z:02d}.raw").write_bytes(layer.tobytes())
        path.write_text(f"{text}s%02d.raw 0 3 1\n")

    return make


def _netcdf(path: Path) -> None:
    with h5py.File(path, "w") as file:
        data = file.create_dataset("t", data=SAMPLES, chunks=(2, 3, 4), compression="gzip")
        data.attrs.update(_FillValue=np.int16(7), scale_factor=0.5, valid_range=np.array([1, 90], "i2"))
        for axis, name in enumerate(("time", "lat", "lon")):
            file[name] = np.arange(SAMPLES.shape[axis]) * 2.0
            file[name].make_scale(name)
            data.dims[axis].attach_scale(file[name])
        file["time"].attrs["units"] = "days since 2000-01-01"


def _slices(path: Path) -> None:
    for z, layer in enumerate(SAMPLES):
        Image.fromarray(layer.astype("u1")).save(path.with_name(f"s{z}.png"))


def _hdf5(libver: str = "earliest", **options: Any) -> Callable[[Path], object]:
    def make(path: Path) -> None:
        with h5py.File(path, "w", libver=libver) as file:
            data = file.create_dataset("group/one", data=SAMPLES, **options)
            data.attrs["spacing"] = [1.0, 2.0, 3.0]
            file["other"] = np.arange(3)

    return make


def _preset(path: Path) -> None:
    points = [0.0, 0.0, 0.0, 0.0, 0.5, 1.0, 0.5, 0.0, 1.0, 1.0, 1.0, 1.0]
    preset = {"Name": "a", "ColorSpace": "Lab", "RGBPoints": points, "Points": [0.0, 0.0, 0.5, 0.0, 1.0, 1.0, 0.5, 0.0]}
    path.write_text(json.dumps([preset]))
    path.with_name("scene.yaml").write_text("volumes: [{path: 'field:marschner-lobb:9', cmap: a.json}]")


SIDECAR = """shape: [4, 5, 6]
dtype: int16
byte_order: little
header_bytes: 32
spacing: [1.0, 1.0, 2.0]
origin: [0.0, 0.0, 0.0]
direction: [1, 0, 0, 0, 1, 0, 0, 0, 1]
"""
NHDR = """NRRD0005
type: short
dimension: 3
sizes: 6 5 4
spacings: 1 2 3
endian: little
encoding: raw
data file: s%02d.raw 0 3 1

"""
VTK = b"""# vtk DataFile Version 3.0
a title
%s
DATASET STRUCTURED_POINTS
DIMENSIONS 6 5 4
SPACING 1 1 2
ORIGIN 0 0 0
POINT_DATA 120
SCALARS s short 1
LOOKUP_TABLE default
"""
META = """ObjectType = Image
NDims = 3
TransformMatrix = 1 0 0 0 1 0 0 0 1
Offset = 1 2 3
ElementSpacing = 1 1 2
DimSize = 6 5 4
ElementType = MET_SHORT
"""
VTI = b"""<?xml version="1.0"?>
<VTKFile type="ImageData" version="1.0" byte_order="LittleEndian" header_type="UInt32" compressor="%s">
<ImageData WholeExtent="0 5 0 4 0 3" Origin="0 0 0" Spacing="1 1 2"><Piece Extent="0 5 0 4 0 3">
<PointData Scalars="s"><DataArray type="Int16" Name="s" format="%s" offset="0">%s</DataArray></PointData>
</Piece></ImageData>
"""
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
SPARSE = {".h5", ".nc"}

READERS = {
    "npy": Reader("a.npy", lambda path: np.save(path, SAMPLES)),
    "npz": Reader("a.npz", lambda path: np.savez(path, one=SAMPLES)),
    "npz-packed": Reader("a.npz", lambda path: np.savez_compressed(path, one=SAMPLES)),
    "raw": Reader("a.raw", _raw, damaged="a.raw.yaml"),
    "nrrd": Reader("a.nrrd", _nrrd("raw")),
    "nrrd-gzip": Reader("a.nrrd", _nrrd("gzip")),
    "nrrd-bzip2": Reader("a.nrrd", _nrrd("bzip2")),
    "nrrd-ascii": Reader("a.nrrd", _nrrd("ascii")),
    "nrrd-files": Reader("a.nhdr", _nhdr),
    "nifti": Reader("a.nii", _nifti),
    "nifti-gzip": Reader("a.nii.gz", _nifti, packed=True),
    "mrc": Reader("a.mrc", _mrc),
    "mrc-gzip": Reader("a.mrc.gz", _mrc, packed=True),
    "tiff": Reader("a.tif", _tiff()),
    "tiff-zlib": Reader("a.tif", _tiff(compression="zlib", rowsperstrip=2)),
    "tiff-imagej": Reader("a.tif", _tiff(imagej=True, resolution=(4, 2), metadata={"spacing": 3.5, "axes": "ZYX"})),
    "tiff-ome": Reader("a.ome.tif", _tiff(ome=True, metadata={"axes": "ZYX", "PhysicalSizeX": 0.1})),
    "metaimage-zlib": Reader("a.mha", _metaimage(CompressedData="True")),
    "metaimage-files": Reader("a.mhd", _metaimage()),
    "vtk-ascii": Reader("a.vtk", _vtk(False)),
    "vtk-binary": Reader("a.vtk", _vtk(True)),
    "slices": Reader("s0.png", _slices, lambda path: read_data(path.parent), damaged="s2.png"),
    "vti-ascii": Reader("a.vti", _vti("ascii")),
    "vti-binary": Reader("a.vti", _vti("binary", "vtkZLibDataCompressor")),
    "vti-raw": Reader("a.vti", _vti("appended")),
    "vti-appended": Reader("a.vti", _vti("appended", "vtkZLibDataCompressor")),
    "hdf5": Reader("a.h5", _hdf5()),
    "hdf5-chunked": Reader("a.h5", _hdf5(chunks=(2, 3, 4), compression="gzip", shuffle=True, fletcher32=True)),
    "netcdf": Reader("a.nc", _netcdf, lambda path: read_data(path, Subset(time=1))),
    "hdf5-latest": Reader("a.h5", _hdf5("latest", chunks=(2, 3, 4), compression="lzf", fletcher32=True)),
    "hdf5-packed": Reader("a.h5", _hdf5("latest", chunks=(4, 5, 6), maxshape=(None, 5, 6), scaleoffset=0)),
    "scene-yaml": Reader("a.yaml", _text(SCENE), load_scene),
    "scene-json": Reader("a.json", lambda path: path.write_text(json.dumps(_yaml(SCENE))), load_scene),
    "path": Reader("a.yaml", _text(KEYS), read_keys),
    "preset": Reader("scene.yaml", lambda path: _preset(path.with_name("a.json")), load_scene, damaged="a.json"),
    "table": Reader("a.npy", lambda path: np.save(path, np.linspace(0, 1, 12).reshape(3, 4)), read_table),
}


def _yaml(text: str) -> Any:
    import yaml

    return yaml.safe_load(text)
