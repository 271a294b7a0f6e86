"""What every format does alike: sample types, steps, files larger than memory, impossible headers; byte storages."""

from __future__ import annotations

import gzip
import os
import zipfile
import zlib
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import h5py
import nibabel
import numpy as np
import pytest
import tifffile
from data import writers
from data.checks import DTYPES, check_source, cut, refused, values
from data.writers import SHORTS, write

from clusterviz.data import open_source
from clusterviz.data.axes import Subset, first_parts
from clusterviz.data.formats.metaimage import TYPES as META_TYPES
from clusterviz.data.memory import ArraySource
from clusterviz.data.storage import CHUNK, FileBytes, FileRange, LoadedBytes, StreamBytes
from clusterviz.errors import DataError

ROOT = Path(__file__).parents[2]
SHEARED = np.array([[-2, 0.5, 0, 10], [0, 3, 0.1, -20], [0.2, 0, 0.5, 30], [0, 0, 0, 1.0]])
ALL_BUT_F2 = [dtype for dtype in DTYPES if dtype != "f2"]


def ascii_nrrd(path: Path, array: np.ndarray) -> None:
    lines = "\n".join(map(repr, array.ravel().tolist())).encode()
    kind = {"f4": "float", "f8": "double"}.get(array.dtype.str[1:], array.dtype.name)
    writers.nrrd(path, lines, encoding="ascii", type=kind, endian="-")


# A file's name, the types that the format has, and how a file of them is written.
TYPED: list[tuple[str, Iterable[str], dict[str, Any]]] = [
    ("a.npy", DTYPES, {}),
    ("stored.npz", DTYPES, {}),
    ("packed.npz", DTYPES, {"save": np.savez_compressed}),
    ("a.h5", DTYPES, {"chunks": (2, 3, 4), "compression": "gzip"}),
    ("a.raw", DTYPES, {"header_bytes": 13}),
    ("plain.tif", DTYPES, {}),
    ("packed.tif", DTYPES, {"compression": "zlib"}),
    ("a.nii", ALL_BUT_F2, {"affine": SHEARED}),
    ("a.nii.gz", ALL_BUT_F2, {"affine": SHEARED}),
    ("2.nii", ["i2"], {"affine": SHEARED, "version": 2}),
    *(("a.mha", [code], {"ElementType": kind}) for kind, code in META_TYPES.items()),
    *((f"a.{name}", writers.MRC_MODES, {"extended": b"symmetry" * 10}) for name in ("mrc", "map", "ccp4", "map.gz")),
    ("a.nrrd", ALL_BUT_F2, {}),
    *((f"{how}.nrrd", ALL_BUT_F2, {"by": writers.pynrrd, "encoding": how}) for how in ("raw", "gzip", "bzip2")),
    ("ascii.nrrd", ["i8", "u8", "u1", "f4", "f8"], {"by": ascii_nrrd}),
    *((f"{form}.vtk", writers.VTK_NAMES, {"form": form}) for form in ("ASCII", "BINARY")),
    *((f"{form}.vti", writers.VTI_NAMES, {"form": form, "header": "u4"}) for form in writers.VTI_FORMS),
]


@pytest.mark.cover
@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize(
    ("name", "dtype", "options"), [(name, dtype, options) for name, dtypes, options in TYPED for dtype in dtypes]
)
def test_every_type_in_either_byte_order(
    name: str, dtype: str, options: dict[str, Any], order: str, tmp_path: Path
) -> None:
    array = values(order + dtype)
    source = open_source(write(tmp_path / name, array, **options))
    check_source(source, array)
    if "affine" in options:
        np.testing.assert_allclose(source.grid.world_from_index, SHEARED, rtol=1e-6)


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("dtype", DTYPES)
def test_every_type_of_arrays(dtype: str, order: str) -> None:
    check_source(ArraySource(values(order + dtype)), values(order + dtype))


@pytest.mark.parametrize("form", writers.VTI_FORMS[1:])
@pytest.mark.parametrize("header", ["<u4", "<u8", ">u4", ">u8"])
@pytest.mark.parametrize("compressor", writers.COMPRESSORS)
def test_every_packing_of_vti(tmp_path: Path, compressor: str, header: str, form: str) -> None:
    for array in (values(header[0] + "i2"), values(header[0] + "i2", (4, 5, 10))):  # the last fills its blocks
        check_source(open_source(writers.vti(tmp_path / "a.vti", array, form, compressor, header[1:])), array)


ARRAY = values("<i2", (3, 2, 4, 5, 6))  # time, channel, z, y, x
LAST = np.moveaxis(ARRAY, 1, -1)  # channels last


def interleaved_tiff(path: Path) -> None:
    array = LAST.astype("u2")
    array = np.concatenate([array, array[..., :1]], axis=-1)
    tifffile.imwrite(path, array, photometric="rgb", metadata={"axes": "TZYXS"})


def labelled_hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file.create_dataset("a", data=np.moveaxis(ARRAY, 0, 2), chunks=True)
        for axis, label in zip(file["a"].dims, "cztyx", strict=True):
            axis.label = label


def ome_tiff(path: Path) -> None:
    metadata = {"axes": "TCZYX", "Channel": {"Name": ["DAPI", "GFP"]}}
    tifffile.imwrite(path, ARRAY, ome=True, compression="zlib", photometric="minisblack", metadata=metadata)


def nibabel_write(path: Path) -> None:
    nibabel.save(nibabel.Nifti1Image(np.moveaxis(ARRAY, 1, 0).T, np.eye(4), dtype="<i2"), path)


FOUR_AXES = {"NDims": "4", "DimSize": "6 5 4 3", "ElementNumberOfChannels": "2"}
BIG: dict[str, Any] = {"byteorder": ">", "metadata": {"axes": "TZCYX"}}
WITH_AXES: dict[str, Callable[[Path], object]] = {
    "a.npy": lambda path: np.save(path, ARRAY),
    "fortran.npy": lambda path: np.save(path, np.asfortranarray(ARRAY)),
    "a.raw": lambda path: writers.raw(path, ARRAY),
    "a.nrrd": lambda path: writers.pynrrd(path, LAST, encoding="gzip", kinds=["vector", *["domain"] * 3, "time"]),
    "a.mha": lambda path: writers.packed_metaimage(path, LAST, **FOUR_AXES),
    "a.nii": nibabel_write,
    "a.nii.gz": nibabel_write,
    "a.tif": lambda path: tifffile.imwrite(path, np.moveaxis(ARRAY, 1, 2), imagej=True, **BIG),
    "a.ome.tif": ome_tiff,
    "rgb.tif": interleaved_tiff,
    "a.h5": labelled_hdf5,
}


@pytest.mark.parametrize("name", WITH_AXES)
def test_each_step_and_channel_of_every_format(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    WITH_AXES[name](path)
    expected, channels = (ARRAY.astype("u2"), 3) if name == "rgb.tif" else (ARRAY, 2)
    for time, channel in ((0, 0), (2, 1), (1, 1)):
        source = open_source(path, subset=Subset(time=time, channel=channel))
        check_source(source, expected[time, channel])
        assert f"time={time}" in source.name
    first, subset, choices = first_parts(lambda part: open_source(path, subset=part), Subset())
    assert (subset.time, len(choices)) == (0, 2)
    np.testing.assert_array_equal(first.read((3, 4, 0), (4, 5, 6)), expected[0, 0, 3:, 4:])
    for subset, parts in (
        (Subset(channel=0), ("several time steps", "3 time steps", "time: 0 to 2")),
        (Subset(time=0), ("several channels", f"{channels} channels", f"channel: 0 to {channels - 1}")),
        (Subset(time=3, channel=0), ("no such time step", "3, and 3 time steps")),
        (Subset(time=0, channel="far"), ("no such channel", "far")),
    ):
        refused(lambda subset=subset: open_source(path, subset=subset), *parts)


def test_channels_by_name(tmp_path: Path) -> None:
    ome_tiff(tmp_path / "a.ome.tif")
    source = open_source(tmp_path / "a.ome.tif", subset=Subset(time=1, channel="GFP"))
    check_source(source, ARRAY[1, 1])
    assert source.name.endswith(":time=1:channel=GFP")
    refused(lambda: open_source(tmp_path / "a.ome.tif", subset=Subset(time=1, channel="gfp")), "DAPI, GFP")
    interleaved_tiff(tmp_path / "b.tif")
    check_source(open_source(tmp_path / "b.tif", subset=Subset(time=2, channel="green")), ARRAY.astype("u2")[2, 1])


@pytest.mark.parametrize("name", ["a.npy", "a.raw", "a.nii"])
def test_every_step_is_counted_in_the_size(tmp_path: Path, name: str) -> None:
    WITH_AXES[name](tmp_path / name)
    refused(lambda: open_source(cut(tmp_path / name, 1), subset=Subset(time=0, channel=0)), "truncated", name)


def test_four_axes_three_and_two(tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    np.save(path, ARRAY[:, 0])
    check_source(open_source(path, subset=Subset(time=2)), ARRAY[2, 0])
    check_source(open_source(path, subset=Subset(channel=1)), ARRAY[1, 0])
    np.save(path, ARRAY[0, 0])
    check_source(open_source(path, subset=Subset(time=0, channel=0)), ARRAY[0, 0])
    refused(lambda: open_source(path, subset=Subset(time=1)), "no such time step", "1 time step")
    refused(lambda: open_source(path, subset=Subset(channel="red")), "no such channel", "channel: 0")
    # Pictures over time are a stack unless a time is named.
    tifffile.imwrite(tmp_path / "a.tif", ARRAY[:, 0, 0], imagej=True, metadata={"axes": "TYX"})
    check_source(open_source(tmp_path / "a.tif"), ARRAY[:, 0, 0])
    check_source(open_source(tmp_path / "a.tif", subset=Subset(time=1)), ARRAY[1:2, 0, 0])
    for number, array in enumerate((ARRAY[0, 0, 0], ARRAY[0, 0, 0] > 0, np.full((1, 1, 1), 7, np.int16))):
        np.save(tmp_path / f"{number}.npy", array)
        expected = array.astype(np.uint8) if array.dtype == bool else array  # a mask is uint8
        check_source(open_source(tmp_path / f"{number}.npy"), expected.reshape(-1, *array.shape[-2:]))


HUGE = (2500, 2000, 2000)  # 20 GB of holes
HUGE_XYZ, HUGE_EXTENT = "2000 2000 2500", "0 1999 0 1999 0 2499"
HUGE_LINES = "POINT_DATA 10000000000", "SCALARS s short 1"


def huge_vti(path: Path, array: np.ndarray) -> None:
    writers.vti(path, SHORTS, image=f'WholeExtent="{HUGE_EXTENT}"', piece=HUGE_EXTENT)
    begin = path.read_bytes().index(b"_", path.read_bytes().index(b"Appended")) + 1
    path.write_bytes(path.read_bytes()[:begin] + np.array([2 * np.prod(HUGE)], "<u8").tobytes())


# What makes the header of a file without samples that of HUGE little-endian shorts.
HEADS: dict[str, dict[str, Any]] = {
    "a.npy": {"by": lambda path, array: np.lib.format.open_memmap(path, "w+", "<i2", HUGE).flush()},
    "a.raw": {"shape": list(HUGE)},
    "a.nrrd": {"dimension": "3", "sizes": HUGE_XYZ},
    "a.mha": {"DimSize": HUGE_XYZ},
    "a.mrc": {"w0": 2000, "w1": 2000, "w2": 2500, "w7": 2000, "w8": 2000, "w9": 2500, "w10": 1.0},
    "a.nii": {"version": 2, "dim": [3, 2000, 2000, 2500, 1, 1, 1, 1]},
    "a.vtk": {"by": lambda path, array: writers.vtk_parts(path, "BINARY", *HUGE_LINES, size=HUGE_XYZ)},
    "a.vti": {"by": huge_vti},
}


@pytest.mark.parametrize("name", HEADS)
def test_a_file_larger_than_memory_is_read_by_the_box(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path / name, np.zeros((1, 1, 0), "<i2"), **HEADS[name])
    order = ">" if name == "a.vtk" else "<"
    patch, begin = values(order + "i2", (1, 1, 5)), 128 if name == "a.npy" else (tmp_path / name).stat().st_size
    with (tmp_path / name).open("r+b") as file:
        file.truncate(begin + 2 * int(np.prod(HUGE)))
        file.seek(begin + 2 * int(np.ravel_multi_index((2400, 1000, 3), HUGE)))
        file.write(patch.tobytes())
    counts, pread = [], os.pread
    monkeypatch.setattr(os, "pread", lambda file, count, at: counts.append(count) or pread(file, count, at))
    source = open_source(tmp_path / name)
    np.testing.assert_array_equal(source.read((2400, 1000, 3), (2401, 1001, 8)), patch)
    assert 10 <= sum(counts) < 50_000
    assert not source.read((2499, 0, 0), (2500, 10, 2000)).any()


def test_a_dataset_larger_than_memory_is_read_by_the_box(tmp_path: Path) -> None:
    patch = values("u2", (1, 1, 5))
    with h5py.File(tmp_path / "a.h5", "w") as file:
        big = file.create_dataset("big", HUGE, "u2", chunks=(16, 64, 64))
        big[2400, 1000, 3:8] = patch[0, 0]
    source = open_source(tmp_path / "a.h5")
    np.testing.assert_array_equal(source.read((2400, 1000, 3), (2401, 1001, 8)), patch)


def test_an_archive_larger_than_memory_is_read_by_the_box(tmp_path: Path) -> None:
    path, patch = tmp_path / "a.npz", values("u1", (1, 1, 9))
    shape = (1000, 1000, 1000)
    np.savez(path, a=np.zeros((1, 1, 1), "u1"))
    with zipfile.ZipFile(path) as archive:
        entry = archive.infolist()[0]
    with path.open("r+b") as file:
        begin = entry.header_offset + 30 + len("a.npy") + 20  # savez writes ZIP64 fields of 20 bytes
        file.seek(begin)
        np.lib.format.write_array_header_1_0(file, {"shape": shape, "fortran_order": False, "descr": "|u1"})
        header_bytes = file.tell() - begin
        file.seek(10**9 - 9, 1)
        file.write(patch.tobytes())
        end = file.tell()
    entry.file_size = entry.compress_size = header_bytes + 10**9
    with zipfile.ZipFile(path, "a") as archive:
        archive.fp.seek(end)
        archive.start_dir, archive.filelist, archive._didModify = end, [entry], True
    np.testing.assert_array_equal(open_source(path).read((999, 999, 991), shape), patch)


# Changes to a header, with what is said of them.
IMPOSSIBLE: list[tuple[Any, ...]] = [
    ("a.mha", {"NDims": ""}, "wrong magic"),
    ("a.mha", {"NDims": "5", "DimSize": "7 6 5 1 1"}, "2 to 4 axes"),
    ("a.mha", {"ObjectType": "Scene"}, "ObjectType Scene"),
    ("a.mha", {"DimSize": "7 6"}, "impossible DimSize"),
    ("a.mha", {"DimSize": "7 6 x"}, "7 6 x"),
    ("a.mha", {"DimSize": "7 0 5"}, "no samples"),
    ("a.mha", {"DimSize": "7 6 4"}, "longer than the header says"),
    ("a.mha", {"DimSize": "7 6 6"}, "truncated"),
    ("a.mha", {"ElementType": "MET_STRING"}, "ElementType MET_STRING"),
    ("a.mha", {"ElementNumberOfChannels": "3", "DimSize": "7 5 2"}, "several channels"),
    ("a.mha", {"ElementSpacing": "1 0 1"}, "singular placement"),
    ("a.mha", {"ElementSpacing": "1 nan 1"}, "impossible ElementSpacing"),
    ("a.mha", {"TransformMatrix": "1 0 0 1"}, "impossible TransformMatrix"),
    ("a.mha", {"HeaderSize": "-1", "CompressedData": "True"}, "impossible HeaderSize"),
    ("a.mrc", {"w3": 4}, "unsupported mode", "4"),
    ("a.mrc", {"w0": 0}, "no samples"),
    ("a.mrc", {"w0": -7}, "no samples"),
    ("a.mrc", {"w2": 6}, "truncated", "1444 bytes", "1528"),
    ("a.mrc", {"w16": 2}, "impossible axis order"),
    ("a.mrc", {"w7": 0}, "impossible grid intervals"),
    ("a.mrc", {"w10": float("nan")}, "singular placement"),
    ("a.mrc", {"w13": 10.0, "w14": 10.0, "w15": 170.0}, "singular placement"),
    ("a.nrrd", {"type": "block"}, "type block"),
    ("a.nrrd", {"dimension": "4", "sizes": "3 7 5 2"}, "several time steps"),
    ("a.nrrd", {"dimension": "4", "sizes": "3 7 5 2", "kinds": "RGB-color domain domain domain"}, "several channels"),
    ("a.nrrd", {"dimension": "5", "sizes": "3 7 5 2 2", "kinds": " ".join(["domain"] * 5)}, "5 axes"),
    ("a.nrrd", {"sizes": "7 6"}, "do not match"),
    ("a.nrrd", {"sizes": "7 0 5"}, "no samples"),
    ("a.nrrd", {"encoding": "hex"}, "unsupported encoding"),
    ("a.nrrd", {"endian": "-"}, "byte order"),
    ("a.nrrd", {"sizes": "-"}, "missing"),
    ("a.nrrd", {"sizes": "7 6 6"}, "truncated"),
    ("a.nrrd", {"sizes": "7 6 4"}, "longer than the header"),
    ("a.nrrd", {"space dimension": "3", "space directions": "(1,0,0) (2,0,0) (0,0,1)"}, "singular placement"),
    ("a.raw", {"colour": 1}, "unknown key", "colour", "header_bytes"),
    ("a.raw", {"dtype": "uint7"}, "impossible dtype", "uint7"),
    ("a.raw", {"dtype": "complex64"}, "not a scalar volume"),
    ("a.raw", {"byte_order": "middle"}, "impossible byte_order", "middle", "little, big"),
    ("a.raw", {"shape": [5, 6, -7]}, "impossible shape"),
    ("a.raw", {"shape": "big"}, "impossible shape"),
    ("a.raw", {"shape": [5, 0, 7]}, "no samples"),
    ("a.raw", {"shape": [5, 6, 7, 1]}, "several time steps", "time: 0 to 4"),
    ("a.raw", {"shape": [2, 3, 4, 5, 6, 7]}, "6 axes"),
    ("a.raw", {"header_bytes": -1}, "impossible header_bytes"),
    ("a.raw", {"spacing": [1, 1]}, "three finite numbers"),
    ("a.raw", {"spacing": [1, 0, 1]}, "singular placement"),
    ("a.raw", {"origin": ["a", 0, 0]}, "three finite numbers"),
    ("a.raw", {"direction": [1, 0, 0, 1, 0, 0, 0, 0, 1]}, "singular placement"),
    ("a.raw", {"direction": [1, 2]}, "impossible direction"),
    ("a.raw", {"shape": [5, 6, 8]}, "truncated", "420 bytes", "480"),
    ("a.raw", {"shape": [5, 6, 6]}, "longer than the header says"),
    ("a.nii", {"affine": np.diag([1, 1, 0, 1])}, "singular placement"),
    ("a.nii", {"dim": [3, 7, 0, 5, 1, 1, 1, 1]}, "no samples"),
    ("a.vti", {"extra": 'NumberOfComponents="3"'}, "no scalar volume"),
    ("a.vti", {"image": 'WholeExtent="0 6 0 5 0 4" Spacing="1 0 1"'}, "singular placement"),
    ("a.vti", {"image": 'WholeExtent="0 6 0 5 0 4" Spacing="1 1"'}, "impossible Spacing", "3 numbers"),
    ("a.vti", {"image": 'WholeExtent="0 6 0 5 0 4" Spacing="1 far 1"'}, "impossible Spacing"),
    ("a.vti", {"image": 'WholeExtent="0 6 0 5 0 9"'}, "piece is not the whole"),
    ("a.vti", {"image": " ", "piece": "0 6 0 5 0 -1"}, "no samples"),
    ("a.vti", {"image": " ", "piece": "0 6 0 5 0 9"}, "size is not the dataset's", "420 bytes", "840"),
    ("a.vti", {"image": " ", "piece": "0 6"}, "impossible Extent"),
]
PACKED_VTI = {"compressor": "vtkZLibDataCompressor"}
IMPOSSIBLE += [("packed.vti", changes | PACKED_VTI, *parts) for name, changes, *parts in IMPOSSIBLE if name == "a.vti"]


@pytest.mark.parametrize(("name", "changes", "parts"), [(name, changes, parts) for name, changes, *parts in IMPOSSIBLE])
def test_a_header_that_cannot_be(name: str, changes: dict[str, Any], parts: list[str], tmp_path: Path) -> None:
    write(tmp_path / name, **changes)
    refused(lambda: open_source(tmp_path / name), name, *parts)


# What is replaced in a file or in its sidecar, and what is said of it.
DAMAGED_TEXT = {
    "a.vti": [
        ('type="ImageData"', 'type="UnstructuredGrid"', "not a VTK file of type ImageData"),
        ('type="Int16"', 'type="String"', "not numbers"),
        ('"UInt64"', '"Int8"', "impossible header_type"),
        ("LittleEndian", "PDP11", "impossible byte_order"),
        ("vtkZLibDataCompressor", "vtkSomeCompressor", "unsupported compressor"),
        ('format="appended"', 'format="telepathic"', "unknown format"),
        ('encoding="raw"', 'encoding="rot13"', "no such appended data"),
        ('offset="0"', 'offset="far"', "impossible offset"),
        ('offset="0"', 'offset="99999"', "ends"),
        ("<Piece ", "<Piece Extent='0 6 0 5 0 4'/><Piece ", "2 pieces"),
        ("<ImageData", "<Image<Data", "XML"),
    ],
    "a.vtk": [
        ("# vtk", "# vtc", "wrong magic"),
        ("BINARY", "MORSE", "neither text nor binary"),
        ("STRUCTURED_POINTS", "POLYDATA", "DATASET POLYDATA"),
        ("DIMENSIONS 7 6 5", "DIMENSIONS 7 6 4", "longer than the header says"),
        ("DIMENSIONS 7 6 5", "DIMENSIONS 7 6 0", "no samples"),
        ("DIMENSIONS 7 6 5\n", "", "no DIMENSIONS"),
        ("DIMENSIONS 7 6 5", "DIMENSIONS 7 6", "3 numbers"),
        ("SPACING 2 3 4", "SPACING 2 0 4", "singular placement"),
        ("SPACING 2 3 4", "SPACING 2 far 4", "2 far 4"),
        ("short", "bits", "unknown type"),
        ("POINT_DATA 210", "POINT_DATA 99999999999", "truncated"),
        ("POINT_DATA 210", "POINT_DATA many", "not a number"),
        ("SCALARS s short 1\nLOOKUP_TABLE default\n", "", "truncated, or not understood|no array"),
    ],
    "a.raw.yaml": [
        ("dtype:", "[1", "not YAML"),
        (None, "- 1", "keys and values"),
        (None, "dtype: uint8", "missing key"),
        (None, "", "empty"),
    ],
}


@pytest.mark.parametrize(
    ("name", "old", "new", "part"), [(name, *row) for name, rows in DAMAGED_TEXT.items() for row in rows]
)
def test_damaged_text(name: str, old: str | None, new: str, part: str, tmp_path: Path) -> None:
    write(tmp_path / name.removesuffix(".yaml"), **(PACKED_VTI if name == "a.vti" else {}))
    content = (tmp_path / name).read_bytes()
    assert old is None or old.encode() in content
    (tmp_path / name).write_bytes(content.replace(old.encode(), new.encode(), 1) if old else new.encode())
    refused(lambda: open_source(tmp_path / name.removesuffix(".yaml")), part, name)


def read_all(path: Path) -> np.ndarray:
    source = open_source(path)
    return source.read((0, 0, 0), source.grid.shape_zyx)


@pytest.mark.parametrize("name", dict.fromkeys(name for name, _, _ in TYPED))
def test_a_file_that_ends_early(name: str, tmp_path: Path) -> None:
    dtypes, options = next((set(dtypes), options) for each, dtypes, options in TYPED if each == name)
    write(tmp_path / name, values("<i2" if "i2" in dtypes else "<i8" if "i8" in dtypes else "i1"), **options)
    whole = (tmp_path / name).read_bytes()
    for count in (len(whole) - 80, len(whole) // 2, len(whole) // 3, 40, 9):
        (tmp_path / name).write_bytes(whole[:count])
        refused(lambda: read_all(tmp_path / name), name)
    (tmp_path / name).write_bytes(whole[:-80])
    refused(lambda: read_all(tmp_path / name), "truncated|lies about its size|wrong magic or damaged| early")
    if name in ("a.npy", "a.raw", "a.nii", "a.mha", "a.mrc", "a.nrrd"):  # the last sample ends the file
        (tmp_path / name).write_bytes(whole[:-1])
        refused(lambda: open_source(tmp_path / name), r"truncated.* found \d+ bytes; allowed \d+")


# Packed files, and what is said where bytes near their end are others.
PACKED: dict[str, tuple[dict[str, Any], str]] = {
    "a.npz": ({"save": np.savez_compressed}, "damaged or truncated: wrong checksum"),
    "a.nii.gz": ({}, "truncated|damaged"),
    "a.mrc.gz": ({}, "truncated|damaged"),
    "gzip.nrrd": ({"by": writers.pynrrd, "encoding": "gzip"}, "truncated|damaged"),
    "bzip2.nrrd": ({"by": writers.pynrrd, "encoding": "bzip2"}, "truncated|damaged"),
    "zlib.mha": ({"by": writers.packed_metaimage, "pack": zlib.compress}, "damaged or truncated"),
    "gzip.mha": ({"by": writers.packed_metaimage, "pack": gzip.compress}, "damaged or truncated"),
    "a.h5": ({"chunks": (20, 30, 40), "compression": "gzip"}, "a.h5:/density.*cannot be read"),
    "a.tif": ({"compression": "zlib"}, r"page \d+: the page cannot be decoded"),
    "raw.vti": (PACKED_VTI, r"block \d+ is damaged"),
    "binary.vti": (PACKED_VTI | {"form": "binary"}, r"block \d+ is damaged"),
}


@pytest.mark.parametrize("name", PACKED)
def test_damage_in_packed_samples_is_found_when_they_are_read(name: str, tmp_path: Path) -> None:
    options, part = PACKED[name]
    array = values("<u2", (20, 30, 40)) % 50
    path = write(tmp_path / name, array, **options)
    check_source(open_source(path), array, brick=16)
    whole = path.read_bytes()
    place = len(whole) - 400
    path.write_bytes(whole[:place] + (b"A" if name == "binary.vti" else b"\xff") * 60 + whole[place + 60 :])
    refused(lambda: read_all(path), name, part)
    if "vti" in name or "tif" in name:  # blocks of their own
        np.testing.assert_array_equal(open_source(path).read((0, 0, 0), (1, 30, 40)), array[:1])


@pytest.fixture
def packed(tmp_path: Path) -> tuple[Path, bytes]:
    content = np.random.default_rng(0).integers(0, 50, 5 * CHUNK + 77, np.uint8).tobytes()
    path = tmp_path / "a.gz"
    path.write_bytes(gzip.compress(content, 1))
    return path, content


class Opened:
    """Decoder that counts how often a stream is opened."""

    def __init__(self) -> None:
        self.times = 0

    def __call__(self, file: Any) -> Any:
        self.times += 1
        return gzip.open(file)


def test_a_stream_is_passed_once_in_order_and_again_only_when_asked_back(packed: tuple[Path, bytes]) -> None:
    path, content = packed
    opened = Opened()
    stream = StreamBytes(path, opened, keep=1000)
    for begin in range(0, len(content) - 10_000, 9_000):  # each overlaps the last by 1000
        assert stream.read_at(begin, 10_000) == content[begin : begin + 10_000]
    assert opened.times == 1
    assert stream.read_at(3, 10) == content[3:13]
    assert opened.times == 2
    with pytest.raises(DataError, match="truncated"):
        stream.read_at(len(content) - 1, 2)


def test_a_stream_holds_little(packed: tuple[Path, bytes]) -> None:
    path, content = packed
    stream = StreamBytes(path, Opened(), keep=1000)
    stream.read_at(len(content) - 10, 10)
    assert sum(map(len, stream._chunks)) <= 2 * CHUNK


def test_pieces_of_files_follow_one_another(tmp_path: Path) -> None:
    for name, content in (("a", b"..12345"), ("b", b"67890.."), ("c", b"AB")):
        (tmp_path / name).write_bytes(content)
    pieces = [FileRange(tmp_path / "a", 2, 5), FileRange(tmp_path / "b", 0, 5), FileRange(tmp_path / "c", 0, 2)]
    storage = FileBytes(pieces)
    for begin in range(12):
        for count in range(12 - begin):
            assert storage.read_at(begin, count) == b"1234567890AB"[begin : begin + count]
    with pytest.raises(DataError, match="ends 1 bytes early"):
        storage.read_at(11, 2)


def test_a_file_that_shrank_or_went_since_it_was_opened(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"12345")
    storage = FileBytes([FileRange(path, 0, 5)])
    assert storage.read_at(0, 5) == b"12345"
    path.write_bytes(b"12")
    with pytest.raises(DataError, match="ends 3 bytes early"):
        storage.read_at(0, 5)
    path.unlink()
    with pytest.raises(DataError, match="no such file"):
        FileBytes([FileRange(path, 0, 5)]).read_at(0, 1)


def test_loaded_bytes_are_made_once_and_end() -> None:
    calls: list[int] = []
    storage = LoadedBytes(lambda: calls.append(1) or b"12345", "here")  # type: ignore[func-returns-value]
    assert bytes(storage.read_at(1, 2)) == b"23"
    assert bytes(storage.read_at(4, 1)) == b"5"
    assert calls == [1]
    with pytest.raises(DataError, match="here: the data ends early"):
        storage.read_at(4, 2)
