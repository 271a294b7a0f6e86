"""What single formats have of their own: placement, arrays by name, data files beside a header, packings."""

from __future__ import annotations

import bz2
import gzip
import re
import warnings
import zipfile
import zlib
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import h5py
import nibabel
import numpy as np
import pytest
import tifffile
from data import writers
from data.checks import check_placed, check_source, cut, refused, values
from data.writers import SHORTS
from PIL import Image

from clusterviz.data import open_source, open_volume, read_geometry, read_grid
from clusterviz.data.axes import Subset
from clusterviz.data.files import AMREX, GADGET, UNREAD
from clusterviz.data.formats import EXTENSIONS, GRID_EXTENSIONS, MESH_EXTENSIONS
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid
from clusterviz.errors import DataError, DataWarning, guard
from clusterviz.scene import Volume

ROOT = Path(__file__).parents[2]
TURNED = "0 1 0 -1 0 0 0 0 1"  # x of the volume is y of the world
COORDINATES = {"level": np.array([10.0, 30, 50]), "lat": np.array([4.0, 2, 0, -2]), "lon": np.arange(5) * 0.5}


def affine(rows: str) -> np.ndarray:
    """Three rows of numbers, above 0 0 0 1."""
    return np.array([[float(word) for word in row.split()] for row in (*rows.split(","), "0 0 0 1")])


SCALED = affine("2 0 0 5, 0 3 0 6, 0 0 4 7")
STEPS = np.array([[0, 2, 0], [-3, 0, 0.5], [0, 0, 0.5]])
PYNRRD = {"by": writers.pynrrd, "space": "LPS", "space directions": STEPS, "space origin": [1, 2, 3]}
IMAGEJ = {"imagej": True, "resolution": (4, 2), "metadata": {"spacing": 3.5, "unit": "um", "axes": "ZYX"}}
OME = {"axes": "ZYX", "PhysicalSizeX": 0.1, "PhysicalSizeY": 0.2, "PhysicalSizeZ": 0.5}
NANOMETRES = {**OME, "PhysicalSizeX": 200.0, "PhysicalSizeY": 200.0, "PhysicalSizeZ": 1.0}
NANOMETRES |= {"PhysicalSizeXUnit": "nm", "PhysicalSizeYUnit": "nm", "PhysicalSizeZUnit": "µm"}
IMAGEJ_MIXED = {**IMAGEJ, "metadata": {**IMAGEJ["metadata"], "unit": "nm", "yunit": "nm", "zunit": "micron"}}
ENDS = {"axis mins": "0 0 0", "axis maxs": "14 18 20"}
CELLS, EXTENT = "0 7 0 6 0 5", "2 8 -1 4 3 7"
VTI = 'Origin="10 20 30" Spacing="2 3 4" WholeExtent='
PLACED: list[tuple[str, dict[str, Any], str]] = [
    (
        "a.raw",
        {"spacing": [2, 3, 0.5], "origin": [1, 2, 3], "direction": [0, -1, 0, 1, 0, 0, 0, 0, 1]},
        "0 -3 0 1, 2 0 0 2, 0 0 .5 3",
    ),
    ("a.mha", {"TransformMatrix": TURNED, "Offset": "7 8 9", "ElementSpacing": "2 3 4"}, "0 -3 0 7, 2 0 0 8, 0 0 4 9"),
    ("a.mha", {"Rotation": TURNED, "Position": "7 8 9", "ElementSize": "2 3 4"}, "0 -3 0 7, 2 0 0 8, 0 0 4 9"),
    ("a.mrc", {"w4": 10, "w5": -20, "w6": 30}, "2 0 0 20, 0 3 0 -60, 0 0 4 120"),
    ("a.mrc", {"w49": 7.0, "w50": 8.0, "w51": 9.0}, "2 0 0 7, 0 3 0 8, 0 0 4 9"),
    ("a.mrc", {"w10": 0.0, "w11": 0.0, "w12": 0.0}, "1 0 0 0, 0 1 0 0, 0 0 1 0"),
    ("a.mrc", {"w15": 120.0}, f"2 -1.5 0 0, 0 {1.5 * 3**0.5} 0 0, 0 0 4 0"),
    ("a.h5", {"attributes": {"spacing": [2.0, 3, 4], "origin": [5, 6, 7]}}, "2 0 0 5, 0 3 0 6, 0 0 4 7"),
    ("a.h5", {"attributes": {"element_size_um": [4.0, 3, 2]}}, "2 0 0 0, 0 3 0 0, 0 0 4 0"),
    ("a.nrrd", PYNRRD, "0 -3 0 1, 2 0 0 2, 0 .5 .5 3"),
    ("a.nrrd", {"spacings": "2 3 4", "axis mins": "5 6 7"}, "2 0 0 5, 0 3 0 6, 0 0 4 7"),
    ("a.nrrd", {**ENDS, "centerings": "cell cell cell"}, "2 0 0 1, 0 3 0 1.5, 0 0 4 2"),
    ("a.nrrd", {**ENDS, "centers": "cell cell cell"}, "2 0 0 1, 0 3 0 1.5, 0 0 4 2"),
    ("a.nrrd", ENDS, "2 0 0 1, 0 3 0 1.5, 0 0 4 2"),
    (
        "a.nrrd",
        {"axismins": "0 0 20", "axismaxs": "12 15 4", "centers": "node node node"},
        "2 0 0 0, 0 3 0 0, 0 0 -4 20",
    ),
    (
        "a.nrrd",
        {"spacings": "2 3 4", "axis mins": "5 6 nan", "axis maxs": "nan nan 20", "centers": "cell node cell"},
        "2 0 0 6, 0 3 0 6, 0 0 4 2",
    ),
    ("a.nrrd", {"spacings": "200 200 1", "units": '"nm" "nm" "um"'}, "200 0 0 0, 0 200 0 0, 0 0 1000 0"),
    ("a.nrrd", {**PYNRRD, "space units": ["mm", "mm", "cm"]}, "0 -3 0 1, 2 0 0 2, 0 5 5 30"),
    ("a.nrrd", {"spacings": "2 nan 4"}, "2 0 0 0, 0 1 0 0, 0 0 4 0"),
    ("a.vti", {"where": "CellData", "image": f'{VTI}"{CELLS}"', "piece": CELLS}, "2 0 0 11, 0 3 0 21.5, 0 0 4 32"),
    (
        "a.vti",
        {"image": f'{VTI}"{EXTENT}" Direction="0 -1 0 1 0 0 0 0 1"', "piece": EXTENT},
        "0 -3 0 13, 2 0 0 24, 0 0 4 42",
    ),
    ("a.vtk", {}, "2 0 0 1, 0 3 0 2, 0 0 4 3"),
    ("a.tif", IMAGEJ, ".25 0 0 0, 0 .5 0 0, 0 0 3.5 0"),
    ("a.ome.tif", {"ome": True, "metadata": OME}, ".1 0 0 0, 0 .2 0 0, 0 0 .5 0"),
    ("a.ome.tif", {"ome": True, "metadata": NANOMETRES}, "200 0 0 0, 0 200 0 0, 0 0 1000 0"),
    ("a.ome.tif", {"ome": True, "metadata": {"axes": "ZYX", "PhysicalSizeZ": 0.5}}, "1 0 0 0, 0 1 0 0, 0 0 .5 0"),
    ("a.tif", IMAGEJ_MIXED, ".25 0 0 0, 0 .5 0 0, 0 0 3500 0"),
    ("a.tif", {}, "1 0 0 0, 0 1 0 0, 0 0 1 0"),
]


@pytest.mark.parametrize(("name", "options", "expected"), PLACED)
def test_the_header_places_the_volume(name: str, options: dict[str, Any], expected: str, tmp_path: Path) -> None:
    source = open_source(writers.write(tmp_path / name, **options))
    check_source(source, SHORTS)
    check_placed(source, affine(expected))


def test_units_that_differ_and_are_not_known_are_told(tmp_path: Path) -> None:
    metadata = {**NANOMETRES, "PhysicalSizeZUnit": "pixel"}
    path = writers.write(tmp_path / "a.ome.tif", ome=True, metadata=metadata)
    with pytest.warns(
        DataWarning, match="a.ome.tif: the axes have different units.* found nm, nm, pixel; allowed spacing"
    ):
        assert open_source(path).grid.spacing == (200, 200, 1)


def test_a_scene_places_its_volume_where_it_says(tmp_path: Path) -> None:
    path, turned = tmp_path / "a.raw", [[0, -0.7071, 0.7071], [1, 0, 0], [0, 0.7071, 0.7071]]
    steps = values("<i2", (3, 2, 4, 5, 6))
    writers.raw(path, steps, spacing=[1, 2, 4], origin=[7, 8, 9])
    part = {"path": str(path), "time": 2, "channel": 1}
    check_placed(open_volume(Volume.model_validate(part)), affine("1 0 0 7, 0 2 0 8, 0 0 4 9"))
    moved = open_volume(Volume.model_validate({**part, "direction": turned, "origin": [1, 2, 3]}))
    check_source(moved, steps[2, 1])
    half = 0.5**0.5
    check_placed(moved, affine(f"0 {-2 * half} {4 * half} 1, 1 0 0 2, 0 {2 * half} {4 * half} 3"))
    spaced = open_volume(Volume.model_validate({**part, "spacing": [0.1, 0.2, 0.3]}))
    assert spaced.grid.spacing == pytest.approx((0.1, 0.2, 0.3))
    assert spaced.grid.origin == (7, 8, 9)


@pytest.mark.parametrize(
    ("name", "fields", "orientation", "modality"),
    [
        ("a.nrrd", {"space": "left-posterior-superior"}, "LPS", ""),
        ("a.nrrd", {"space": "RAS"}, "RAS", ""),
        ("a.nrrd", {"space": "left-anterior-superior-time"}, "LAS", ""),
        ("a.nrrd", {"space": "scanner-xyz"}, "", ""),
        ("a.mha", {"AnatomicalOrientation": "RAI", "Modality": "MET_MOD_UNKNOWN"}, "LPS", ""),
        ("a.mha", {"Modality": "MET_MOD_CT"}, "", "CT"),
        ("a.nii", {"intent_code": 1002}, "RAS", "labels"),
        ("a.nii", {}, "RAS", ""),
        ("a.mrc", {}, "", "density"),
        ("a.tif", {}, "", "microscopy"),
    ],
)
def test_orientation_and_modality_are_what_the_header_says(
    name: str, fields: dict[str, Any], orientation: str, modality: str, tmp_path: Path
) -> None:
    grid = open_source(writers.write(tmp_path / name, **fields)).grid
    assert (grid.orientation, grid.modality) == (orientation, modality)


def test_names(tmp_path: Path) -> None:
    for name in ("a.xyz", "noextension", "a.gz"):
        (tmp_path / name).write_bytes(b"hello")
        refused(lambda name=name: open_source(tmp_path / name), "unknown extension", r"\.npy", r"\.nii\.gz", r"\.vti")
    refused(lambda: open_source(tmp_path / "gone.xyz"), "no such file")
    refused(lambda: open_source(tmp_path), "a directory without slices", r"\.tif .*\.png")
    # Scenes of examples name samples without a folder.
    refused(lambda: open_source(tmp_path / "mni152.nii.gz"), "no such file", "clusterviz samples mni152")
    for name in ("B.NPY", "head.v2.npy", "t1.nii.npy"):
        with (tmp_path / name).open("wb") as file:
            np.save(file, SHORTS)
        source = open_source(str(tmp_path / name))
        np.testing.assert_array_equal(source.read((0, 0, 0), (5, 6, 7)), SHORTS)
        assert source.name == str(tmp_path / name)


@pytest.mark.parametrize(
    ("array", "part"),
    [
        (np.zeros((2, 2, 2), complex), "not a scalar volume"),
        (np.zeros((2, 2, 2), np.longdouble), "not a scalar volume"),
        (np.zeros((2, 2, 2), [("a", "f4")]), "not a scalar volume"),
        (np.zeros((2, 2, 2), "U3"), "not a scalar volume"),
        (np.zeros((2, 2, 2, 2)), "several time steps"),
        (np.zeros((2, 2, 2, 2, 2, 2)), "6 axes"),
        (np.zeros(5), "1 axes"),
        (np.zeros((2, 0, 2)), "no samples"),
    ],
)
def test_arrays_that_are_no_volumes(tmp_path: Path, array: np.ndarray, part: str) -> None:
    np.save(tmp_path / "a.npy", array)
    refused(lambda: open_source(tmp_path / "a.npy"), part, "a.npy")


@pytest.mark.parametrize("name", ["a.npy", "a.raw", "a.mrc", "a.nrrd", "a.nii"])
def test_formats_of_one_array_have_none_by_name(name: str, tmp_path: Path) -> None:
    writers.write(tmp_path / name)
    refused(lambda: open_source(tmp_path / name, "density"), "no such array", "density")


def test_arrays_in_memory() -> None:
    array = values("f4", (10, 12, 14))
    check_source(ArraySource(array[::2, ::-2, 3:].T), array[::2, ::-2, 3:].T)
    check_source(ArraySource(array[0]), array[:1])
    ArraySource(array).read((0, 0, 0), array.shape)[:] = 0  # a copy
    np.testing.assert_array_equal(array, values("f4", (10, 12, 14)))
    grid = Grid((5, 6, 7), spacing=(2, 3, 4))
    assert ArraySource(values("u1"), grid).grid is grid
    refused(lambda: ArraySource(values("u1"), Grid((7, 6, 5))), "does not fit", "7, 6, 5", "5, 6, 7")
    refused(lambda: ArraySource(np.zeros((2, 2, 2, 3))), "4 axes", "array")
    refused(lambda: ArraySource(np.zeros((2, 2, 2), object), name="mine"), "not a scalar volume", "mine")


def test_npy(tmp_path: Path) -> None:
    path, array = tmp_path / "a.npy", values("f8", (2, 3, 2000))
    np.save(path, array)
    source = open_source(path)  # rows far apart are read one by one
    np.testing.assert_array_equal(source.read((0, 1, 1990), (2, 3, 1995)), array[:, 1:, 1990:1995])
    np.testing.assert_array_equal(source.read((1, 0, 5), (2, 3, 8)), array[1:, :, 5:8])
    path.write_bytes(path.read_bytes() + b"more.")
    refused(lambda: open_source(path), "longer than the header says")


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_npz(tmp_path: Path, save: Any) -> None:
    path, steps = tmp_path / "a.npz", values("<i2", (3, 4, 5, 6))
    save(path, line=np.arange(5), steps=np.asfortranarray(steps))
    check_source(open_source(path, subset=Subset(time=2)), steps[2])
    assert open_source(path, subset=Subset(time=2)).name == f"{path}:steps:time=2"
    refused(lambda: open_source(path), "several time steps", "3 time steps")
    refused(lambda: open_source(path, "line"), "1 axes")
    refused(lambda: open_source(path, "gone"), "no such array", "gone", r"line \(5,\), steps \(3, 4, 5, 6\)")
    save(path, one=steps[0], two=steps[1])
    refused(lambda: open_source(path), "several arrays", "one .*two")
    check_source(open_source(path, "two"), steps[1])
    save(path, a=np.arange(5), b=np.arange(4))
    refused(lambda: open_source(path), "no volume", "a .5,.")


def test_archives_of_other_things(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.save(tmp_path / "a.npy", values("u1"))
    whole = (tmp_path / "a.npy").read_bytes()
    for content, kind, part in (
        (whole[:-1], zipfile.ZIP_STORED, "a.npz:a.*truncated"),
        (whole[:-1], zipfile.ZIP_DEFLATED, "a.npz:a.*truncated"),
        (whole + b"!", zipfile.ZIP_STORED, "a.npz:a.*longer than the header says"),
        (whole + b"!", zipfile.ZIP_DEFLATED, "a.npz:a.*longer than the header says"),
        (whole, zipfile.ZIP_LZMA, "unsupported compression"),
        (b"hello", zipfile.ZIP_STORED, "a.npz:a.*header cannot be read"),
    ):
        with zipfile.ZipFile(path, "w", kind) as archive:
            archive.writestr("a.npy", content)
        refused(lambda: open_source(path), part)


def test_datasets_of_hdf5(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file["one"] = values("f4")
        file["group/two"] = SHORTS
        file["mask"] = SHORTS > 100
        file["line"] = np.arange(5)
        file["number"] = 5.0
        file["vectors"] = np.zeros((2, 3, 4, 3))
        file["colours"] = np.zeros((2, 3, 4), [("r", "u1"), ("g", "u1")])
        file["waves"] = np.zeros((2, 3, 4), complex)
        file["picture"] = np.arange(12.0).reshape(3, 4)
        file["none"] = np.zeros((2, 0, 3))
        file["bad"] = SHORTS
        file["bad"].attrs["spacing"] = [0.0, 1, 1]
    check_source(open_source(f"{path}:/group/two"), SHORTS)
    check_source(open_source(path, "/one"), values("f4"))
    check_source(open_source(path, "group/two"), SHORTS)
    check_source(open_source(f"{path}:/mask"), (SHORTS > 100).astype(np.uint8))
    check_source(open_source(f"{path}:/picture"), np.arange(12.0).reshape(1, 3, 4))
    assert open_source(f"{path}:/group/two").name == f"{path}:/group/two"
    refused(lambda: open_source(path), "several volumes", "/one", "/group/two")
    refused(lambda: open_source(f"{path}:/gone"), "no such array", "/gone", "/group/two")
    refused(lambda: open_source(f"{path}:/one", "/mask"), "two arrays")
    for name, *parts in (
        ("group", "no such array"),
        ("vectors", "several time steps", "2 time steps", "/vectors"),
        ("line", "1 axes"),
        ("number", "not a volume", "0 axes"),
        ("colours", "not a scalar volume"),
        ("waves", "not a scalar volume"),
        ("none", "no samples"),
        ("bad", "singular placement"),
    ):
        refused(lambda name=name: open_source(path, name), *parts)
    h5py.File(tmp_path / "b.h5", "w").close()
    refused(lambda: open_source(tmp_path / "b.h5"), "no 3-D dataset", "holds no dataset")


def test_time_members_and_dimensions_without_coordinates(tmp_path: Path) -> None:
    array = values("f4", (2, 6, 3, 4, 5))
    path = writers.netcdf(tmp_path / "a.nc4", array, {"when": np.arange(2.0), "member": 6, "z": 3, "y": 4, "x": 5})
    check_source(open_source(path, subset=Subset(time=1, channel=4)), array[1, 4])
    assert open_source(path, subset=Subset(time=1, channel=4)).grid.spacing == (1, 1, 1)
    refused(lambda: open_source(path, subset=Subset(channel=4)), "several time steps", "2 time steps")
    refused(lambda: open_source(path, subset=Subset(time=0)), "several channels", "6 channels")
    lines = {"time": 2, "lat": COORDINATES["lat"], "lon": COORDINATES["lon"]}
    flat = writers.netcdf(tmp_path / "b.nc", array[:, 0, 0], lines)
    check_source(open_source(flat, subset=Subset(time=1)), array[1:, 0, 0])


def test_missing_values_are_nan_and_packed_ones_are_unpacked(tmp_path: Path) -> None:
    array = np.arange(60, dtype=">i2").reshape(3, 4, 5)
    expected = array * 0.5 + 100
    expected[(array == 7) | (array == 8) | (array < 2) | (array > 50)] = np.nan
    attributes = {"_FillValue": np.int16(7), "missing_value": np.array([8], "i2"), "scale_factor": 0.5}
    attributes |= {"add_offset": 100.0, "valid_range": np.array([2, 50], "i2")}
    path = writers.netcdf(tmp_path / "a.nc", array, COORDINATES, **attributes)
    check_source(open_source(path), expected.astype("f4"))
    wide = array.astype("f8")
    path = writers.netcdf(tmp_path / "b.nc", wide, COORDINATES, _FillValue=9.0, valid_min=1.0, valid_max=40.0)
    check_source(open_source(path), np.where((wide == 9) | (wide < 1) | (wide > 40), np.nan, wide))
    path = writers.netcdf(tmp_path / "c.nc", wide, COORDINATES, scale_factor="half")
    refused(lambda: open_source(path), "impossible scale_factor")


def test_metaimage_detached_as_text_and_lying(tmp_path: Path) -> None:
    packed = zlib.compress(SHORTS.tobytes())
    (tmp_path / "a.zraw").write_bytes(packed)
    fields = {"CompressedData": "True", "CompressedDataSize": str(len(packed))}
    path = writers.metaimage(tmp_path / "a.mhd", b"", "a.zraw", **fields)
    check_source(open_source(path), SHORTS)
    refused(lambda: open_source(cut(tmp_path / "a.zraw", 9) and path), "truncated", "a.zraw")
    lying = writers.metaimage(tmp_path / "b.mha", packed, **{**fields, "DimSize": "6000 5000 4000"})
    refused(lambda: open_source(lying), "lies about its size", "b.mha")
    text = " ".join(map(str, SHORTS.ravel())).encode()
    check_source(open_source(writers.metaimage(tmp_path / "c.mha", text, BinaryData="False")), SHORTS)
    short = writers.metaimage(tmp_path / "d.mha", text[:900], BinaryData="False")
    refused(lambda: open_source(short).read((0, 0, 0), (1, 1, 1)), "lies about its size", "210")
    early = cut(writers.write(tmp_path / "f.mha", by=writers.packed_metaimage, CompressedDataSize=""), 9)
    refused(lambda: open_source(early).read((0, 0, 0), SHORTS.shape), "the file ends early", "f.mha")
    flat = writers.metaimage(tmp_path / "e.mha", SHORTS[0], Offset="1 2")
    check_source(open_source(flat), SHORTS[:1])
    assert open_source(flat).grid.origin == (1, 2, 0)


@pytest.mark.parametrize("kind", ["mhd", "nhdr"])
def test_several_data_files(kind: str, tmp_path: Path) -> None:
    path = tmp_path / f"a.{kind}"

    def write(entry: str, listed: bytes = b"", **fields: str) -> Path:
        if kind == "mhd":
            return writers.metaimage(path, listed, entry, **fields)
        fields = {"sizes": fields["DimSize"]} if "DimSize" in fields else {}
        content = writers.nrrd(path, b"", **fields, **{"data file": entry}).read_bytes()
        path.write_bytes(content[:-1] + listed if listed else content)  # the list ends the header
        return path

    for z, layer in enumerate(SHORTS):
        (tmp_path / f"s{z:02d}.raw").write_bytes(layer.tobytes())
    check_source(open_source(write("s%02d.raw 0 4 1")), SHORTS)
    if kind == "nhdr":
        check_source(open_source(write("s%02d.raw 0 4 1 2")), SHORTS)
    check_source(open_source(write("s%02d.raw 4 0 -1")), SHORTS[::-1])
    refused(lambda: open_source(write("s%02d.raw 0 5 1", DimSize="7 6 6")), "no such file")
    check_source(open_source(write("LIST", b"s03.raw\ns00.raw\n", DimSize="7 6 2")), SHORTS[[3, 0]])
    cut(tmp_path / "s03.raw", 1)
    refused(lambda: open_source(path), "truncated", "s03.raw")
    if kind == "nhdr":
        refused(lambda: open_source(writers.nrrd(path, b"")), "needs a data file")
        return
    refused(lambda: open_source(write("LIST", b"s00.raw\ns01.raw\n", CompressedData="True")), "several data files")
    for z, layer in enumerate(SHORTS):
        (tmp_path / f"s{z:02d}.raw").write_bytes(b"head" + layer.tobytes())
    for skip in ("-1", "4"):
        check_source(open_source(write("s%02d.raw 0 4 1", HeaderSize=skip)), SHORTS)


def test_nrrd_skips(tmp_path: Path) -> None:
    head, data = b"first line\nsecond\n", SHORTS.tobytes()
    (tmp_path / "d.raw").write_bytes(head + bz2.compress(data))
    for name, content, fields in (
        ("a.nrrd", head + b"123" + data, {"line skip": "2", "byte skip": "3"}),
        ("b.nrrd", b"anything" + data, {"byte skip": "-1"}),
        ("c.nrrd", head + gzip.compress(b"123" + data), {"encoding": "gz", "line skip": "2", "byte skip": "3"}),
        ("d.nhdr", b"", {"encoding": "bz2", "line skip": "2", "data file": "d.raw"}),
    ):
        check_source(open_source(writers.nrrd(tmp_path / name, content, **fields)), SHORTS)


def test_nrrd_of_two_and_four_axes(tmp_path: Path) -> None:
    picture = open_source(writers.nrrd(tmp_path / "a.nrrd", SHORTS[0], spacings="2 3"))
    check_source(picture, SHORTS[:1])
    assert picture.grid.spacing == (2, 3, 1)
    fields = {"space dimension": "3", "space directions": "none (2,0,0) (0,3,0) (0,0,4)"}
    one = open_source(writers.nrrd(tmp_path / "b.nrrd", SHORTS[..., None], **fields))
    check_source(one, SHORTS)
    assert one.grid.spacing == (2, 3, 4)
    # Time is in a space of four dimensions, as ITK writes it.
    fields = {"space dimension": "4", "space directions": "(2,0,0,0) (0,3,0,0) (0,0,4,0) (0,0,0,1)"}
    fields |= {"space origin": "(5,6,7,0)", "kinds": "domain domain domain domain"}
    steps = np.stack([SHORTS, -SHORTS])
    source = open_source(writers.nrrd(tmp_path / "c.nrrd", steps, **fields), subset=Subset(time=1))
    check_source(source, steps[1])
    check_placed(source, SCALED)


@pytest.mark.parametrize(
    ("name", "content", "part"),
    [
        ("a.nrrd", b"NRRD0005\nnonsense\n\n", "header cannot be read"),
        ("a.nrrd", b"P5 7 6 255\n", "wrong magic.*NRRD"),
        ("a.map.gz", bytes(2000), "wrong magic"),
        ("a.mrc", bytes(2000), "wrong magic.*MAP"),
        ("a.h5", b"not hdf5 at all", "wrong magic"),
        ("a.vti", b"<html></html>", "not a VTK file of type ImageData"),
        ("a.raw", b"1234", "needs a sidecar.*a.raw.yaml"),
        ("a.nc", b"CDF\1" + bytes(100), "no 3-D dataset"),
        ("a.nc", b"CDF\3" + bytes(100), r"found version b'\\x03'.*1, 2, 5"),
        ("a.nc", b"CDF\1" + bytes(3), "lies about its size"),
        ("a.npz", b"PK\3\4" + bytes(100), "truncated or damaged"),
        ("a.npz", b"\x89PNG", "wrong magic"),
    ],
)
def test_what_is_no_such_file(name: str, content: bytes, part: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    refused(lambda: open_source(tmp_path / name), name, part)


@pytest.mark.parametrize(
    ("data", "fields", "parts"),
    [
        (b"1 2 3" + b" " * 300, {"encoding": "ascii"}, ["lies about its size", "3 numbers", "210"]),
        (b"70000 " * 210, {"encoding": "ascii"}, ["not a number of type int16"]),
        (b"", {"data file": "gone.raw"}, ["no such file", "gone.raw"]),
    ],
)
def test_nrrd_of_other_data(data: bytes, fields: dict[str, str], parts: list[str], tmp_path: Path) -> None:
    path = writers.nrrd(tmp_path / "a.nrrd", data, **fields)
    refused(lambda: open_source(path).read((0, 0, 0), (1, 1, 1)), *parts)


@pytest.mark.parametrize("name", ["a.nii", "a.nii.gz"])
def test_nifti_slope_and_intercept(tmp_path: Path, name: str) -> None:
    path = writers.nifti(tmp_path / name, SHORTS, scl_slope=0.25, scl_inter=-3)
    source = open_source(path)
    check_source(source, (SHORTS * 0.25 - 3).astype(np.float32))
    theirs = nibabel.load(path).get_fdata().T
    np.testing.assert_array_equal(source.read((0, 0, 0), SHORTS.shape), theirs.astype(np.float32))


def test_nifti_steps_colours_and_damaged_headers(tmp_path: Path) -> None:
    path = writers.nifti(tmp_path / "a.nii", SHORTS[None])  # one time step needs no name
    check_source(open_source(path), SHORTS)
    check_source(open_source(path, subset=Subset(time=0)), SHORTS)
    for array, part in (
        (np.zeros((2, 3, 4), [("R", "u1"), ("G", "u1"), ("B", "u1")]), "not a scalar volume"),
        (values("f4").astype("c8"), "not a scalar"),
        (values("f4", (3, 1, 2, 3, 4)), "several channels"),
    ):
        refused(lambda array=array: open_source(writers.nifti(path, array)), part)
    whole = writers.nifti(path, values("f4", (40, 50, 60))).read_bytes()
    for name, content, *parts in (
        ("a.nii", whole[:100], "a.nii"),
        ("b.nii.gz", whole, "wrong magic", "gzip"),
        ("c.nii.gz", gzip.compress(whole[:-5]), "truncated", "when decompressed"),
    ):
        (tmp_path / name).write_bytes(content)
        refused(lambda name=name: open_source(tmp_path / name).read((39, 0, 0), (40, 50, 60)), *parts)


def test_mrc_bytes_of_imod_are_unsigned(tmp_path: Path) -> None:
    array = values("i1")
    for unsigned, expected in ((0, array.view("u1")), (1, array)):
        check_source(open_source(writers.mrc(tmp_path / "a.mrc", array, w38=1146047817, w39=unsigned)), expected)


@pytest.mark.parametrize("name", ["a.ccp4", "a.map.gz"])
@pytest.mark.parametrize("order", [(1, 2, 3), (2, 1, 3), (3, 2, 1), (2, 3, 1), (3, 1, 2), (1, 3, 2)])
def test_mrc_columns_rows_and_sections_may_be_any_axes(tmp_path: Path, order: tuple[int, int, int], name: str) -> None:
    volume = values("f4")
    axes = [3 - axis for axis in order[::-1]]  # of sections, rows, columns in the volume
    starts = {f"w{4 + i}": (11, 12, 13)[axis - 1] for i, axis in enumerate(order)}
    cell = {"w7": 7, "w8": 6, "w9": 5, "w10": 14.0, "w11": 18.0, "w12": 20.0}
    stored = np.ascontiguousarray(volume.transpose(axes))
    path = writers.mrc(tmp_path / name, stored, w16=order[0], w17=order[1], w18=order[2], **starts, **cell)
    source = open_source(path)
    check_source(source, volume)
    check_placed(source, affine("2 0 0 22, 0 3 0 36, 0 0 4 52"))


def test_old_mrc_files_leave_axes_and_intervals_blank(tmp_path: Path) -> None:
    blank = dict.fromkeys(("w7", "w8", "w9", "w16", "w17", "w18"), 0)
    path = writers.mrc(tmp_path / "a.mrc", SHORTS, **blank)
    check_source(open_source(path), SHORTS)
    check_placed(open_source(path), affine("2 0 0 0, 0 3 0 0, 0 0 4 0"))
    writers.mrc(path, SHORTS, **blank, w10=0.0, w11=0.0, w12=0.0)
    check_placed(open_source(path), np.eye(4))


def test_a_singular_sform_gives_way_to_a_good_qform(tmp_path: Path) -> None:
    turned = {"qform_code": 1, "pixdim": [1, 2, 3, 4, 1, 1, 1, 1], "quatern_d": 1.0, "qoffset_x": 5.0}
    path = writers.nifti(tmp_path / "a.nii", SHORTS, np.zeros((4, 4)), **turned)
    with pytest.warns(DataWarning, match="a.nii: the sform is singular: the qform is used"):
        check_placed(open_source(path), affine("-2 0 0 5, 0 -3 0 0, 0 0 4 0"))
    for changes in ({"quatern_b": 5.0}, {"qform_code": 0}):
        path = writers.nifti(tmp_path / "a.nii", SHORTS, np.zeros((4, 4)), **turned | changes)
        refused(lambda path=path: open_source(path), "singular placement")


@pytest.mark.parametrize(
    ("tag", "code", "found"), [(259, 50000, "ZSTD, predictor 2"), (259, 7, "JPEG"), (317, 3, "predictor 3")]
)
@pytest.mark.skipif(find_spec("imagecodecs") is not None, reason="imagecodecs decodes them")
def test_codecs_of_tiff_that_are_not_installed(tag: int, code: int, found: str, tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, SHORTS, photometric="minisblack", compression="zlib", predictor=2)
    content = bytearray(path.read_bytes())
    with tifffile.TiffFile(path) as file:
        for page in file.pages:
            content[page.tags[tag].valueoffset : page.tags[tag].valueoffset + 2] = code.to_bytes(2, "little")
    path.write_bytes(content)
    refused(lambda: open_source(path), "needs the imagecodecs package", f"found .*{found}", "pip install imagecodecs")


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (ImportError("No module named 'snappy'"), "needs a package that is not installed: ImportError: No module"),
        (NotImplementedError("v7"), "holds what is not supported"),
        (OSError(5, "Input/output error"), "input/output error"),
        (OSError("no such codec"), "the file cannot be read: OSError: no such codec"),
        (TypeError("unhashable"), "damaged, or a fault of the reader: TypeError: unhashable"),
        (EOFError(), "damaged, or not a file of its kind"),
        (ValueError("no number"), "damaged, or not a file of its kind: ValueError: no number"),
    ],
)
def test_files_are_called_damaged_only_where_they_may_be(error: Exception, said: str) -> None:
    def failing() -> None:
        with guard(DataError, "a.xyz"):
            raise error

    refused(failing, f"^a.xyz: {said}")


@pytest.mark.parametrize("packed", [None, "zlib"])
@pytest.mark.parametrize("big", [False, True])
def test_tiff_pages_tiles_and_big_files(tmp_path: Path, packed: str | None, big: bool) -> None:
    array = values("u2", (4, 40, 50))
    with tifffile.TiffWriter(tmp_path / "a.tiff", bigtiff=big) as file:
        for layer in array:
            file.write(layer, tile=(16, 32), compression=packed, metadata=None, photometric="minisblack")
    check_source(open_source(tmp_path / "a.tiff"), array, brick=16)


def test_tiff_pictures_series_and_colours(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, values("u1", (9, 8)))
    check_source(open_source(path), values("u1", (9, 8))[None])
    tifffile.imwrite(path, values("u1", (3, 1, 5)), photometric="minisblack", metadata={"axes": "ZYX"})
    check_source(open_source(path), values("u1", (3, 1, 5)))
    one, two = values("u2"), values("f4", (3, 8, 9))
    with tifffile.TiffWriter(path) as file:
        file.write(one, photometric="minisblack")
        file.write(two, photometric="minisblack")
    check_source(open_source(path), one)
    check_source(open_source(path, "1"), two)
    refused(lambda: open_source(path, "2"), "no such array", "0: .*1: ")
    tifffile.imwrite(path, np.zeros((4, 5, 3), np.uint8), photometric="rgb")
    refused(lambda: open_source(path), "several channels", "red, green, blue")
    tifffile.imwrite(path, np.zeros((3, 4, 5), np.complex64), photometric="minisblack")
    refused(lambda: open_source(path), "not a scalar volume")


@pytest.mark.parametrize("packed", [None, "zlib"])
def test_tiff_that_ends_in_its_last_page(tmp_path: Path, packed: str | None) -> None:
    path, array = tmp_path / "a.tif", values("u2", (9, 20, 30))
    tifffile.imwrite(path, array, compression=packed, photometric="minisblack")
    with tifffile.TiffFile(path) as file:
        last_sample = file.pages[-1].dataoffsets[-1] + file.pages[-1].databytecounts[-1] - 1
    path.write_bytes(path.read_bytes()[:last_sample])
    refused(lambda: open_source(path).read((0, 0, 0), array.shape), "a.tif")


@pytest.mark.parametrize("header", ["u4", "u8"])
@pytest.mark.parametrize("form", ["binary", "base64"])
def test_vti_header_in_base64_of_its_own(tmp_path: Path, form: str, header: str) -> None:
    path = writers.vti(tmp_path / "a.vti", SHORTS, form, header=header)
    number, data = np.array([SHORTS.nbytes], f"<{header}").tobytes(), SHORTS.tobytes()
    together, apart = writers.b64encode(number + data), writers.b64encode(number) + writers.b64encode(data)
    assert together in path.read_bytes()
    path.write_bytes(path.read_bytes().replace(together, apart))
    check_source(open_source(path), SHORTS)


@pytest.mark.parametrize("header", ["u4", "u8"])
@pytest.mark.parametrize("form", ["binary", "base64"])
def test_vti_arrays_of_a_few_bytes_in_base64(tmp_path: Path, form: str, header: str) -> None:
    """One byte behind a header of four ends its text like that of a header alone."""
    for count in range(1, 8):
        array = np.arange(1, 1 + count, dtype=np.uint8).reshape(1, 1, count)
        check_source(open_source(writers.vti(tmp_path / "a.vti", array, form, header=header)), array)


@pytest.mark.parametrize("form", writers.VTI_FORMS)
def test_vti_arrays_by_name_active_or_alone(tmp_path: Path, form: str) -> None:
    one, two = values("f4"), values("<i2", seed=2)
    path = writers.vti(tmp_path / "a.vti", {"one": one, "two": two}, form)
    check_source(open_source(path, "one"), one)
    check_source(open_source(path, "two"), two)
    refused(lambda: open_source(path), "several arrays", "one \\(points\\), two \\(points\\)")
    refused(lambda: open_source(path, "three"), "no such scalar array", "three", "one \\(points\\)")
    check_source(open_source(writers.vti(path, {"one": one, "two": two}, form, scalars="two")), two)
    refused(lambda: open_source(writers.vti(path, {}, form)), "no scalar volume")


def test_vti_text_that_is_no_number(tmp_path: Path) -> None:
    path = writers.vti(tmp_path / "a.vti", SHORTS, "ascii")
    for old, new, *parts in (
        (b"</DataArray>", b" 5</DataArray>", "lies about its size", "211 numbers", "210"),
        (b"\n 5</DataArray>", b"x</DataArray>", "not a number"),
    ):
        path.write_bytes(path.read_bytes().replace(old, new))
        refused(lambda: open_source(path).read((0, 0, 0), (1, 1, 1)), *parts)
    content = writers.vti(path, SHORTS, "binary").read_bytes()
    middle = content.index(b'format="binary">') + 200
    path.write_bytes(content[:middle] + b"****" + content[middle + 4 :])
    refused(lambda: open_source(path).read((0, 0, 0), (5, 6, 7)), "damaged base64")


@pytest.mark.parametrize("form", ["ASCII", "BINARY"])
def test_vtk_arrays_of_every_kind_and_what_stands_between_them(tmp_path: Path, form: str) -> None:
    one, two, cells = values("f4"), values("i2", seed=2), values("u1", (4, 5, 6))
    vectors = values("f8", (5, 6, 7, 3))
    path = writers.vtk_parts(
        tmp_path / "a.vtk",
        form,
        *("FIELD FieldData 2", "TimeValue 1 1 double", np.array([0.5])),
        *("who 1 2 string", "x%20y\nz" if form == "ASCII" else np.frombuffer(b"\xc3x y\xc1z", "u1")),
        *("CELL_DATA 120", "SCALARS cells unsigned_char 1", "LOOKUP_TABLE default", cells),
        *("POINT_DATA 210", "SCALARS one float 1", "LOOKUP_TABLE ramp", one),
        *("LOOKUP_TABLE ramp 2", np.zeros(8, "u1") if form == "BINARY" else np.zeros(8)),
        *("METADATA", "INFORMATION 1", "NAME UNITS LOCATION vtkDataArray", "", "VECTORS wind double", vectors),
        *("FIELD FieldData 2", "the%20second 1 210 short", two, "METADATA", "INFORMATION 0", ""),
        *("pair 2 210 float", np.stack([one, one / 2], -1)),
        head=writers.VTK_HEAD.replace("DATASET", "METADATA\nINFORMATION 0\n\nDATASET"),
    )
    check_source(open_source(path), one)
    check_source(open_source(path, "the second"), two)
    check_source(open_source(path, subset=Subset("wind", channel=2)), vectors[..., 2])
    check_source(open_source(path, subset=Subset("pair", channel=1)), one / 2)
    source = open_source(path, "cells")
    check_source(source, cells)
    assert source.grid.origin == (2, 3.5, 5)
    refused(lambda: open_source(path, "wind"), "several channels", "channel: 0 to 2")
    refused(lambda: open_source(path, "gone"), "no such array", r"one \(points\)", r"cells \(cells\)")


@pytest.mark.parametrize("form", ["ASCII", "BINARY"])
def test_vtk_of_several_arrays_that_ends_early(tmp_path: Path, form: str) -> None:
    lines = ("POINT_DATA 210", "FIELD data 2", "one 1 210 short", SHORTS, "two 1 210 short", SHORTS)
    path = writers.vtk_parts(tmp_path / "a.vtk", form, *lines)
    refused(lambda: open_source(path), "several arrays", "one .points., two .points.")
    whole = path.read_bytes()
    for length in (20, 50, 150, len(whole) // 2, len(whole) - 20):
        path.write_bytes(whole[:length])
        refused(lambda: open_source(path, "two"), "a.vtk")
    writers.vtk_parts(path, form, "POINT_DATA 210", "SCALARS s short", SHORTS)  # and no table
    if form == "BINARY":
        refused(lambda: open_source(cut(path, 2)), "truncated")
        return
    path.write_bytes(path.read_bytes().replace(b"\n", b"\nx", 13))
    refused(lambda: open_source(path).read((0, 0, 0), (1, 1, 1)), "a.vtk")


def fill(folder: Path, layers: np.ndarray, extension: str) -> Path:
    """Write slices whose names do not sort as text."""
    folder.mkdir()
    for z, layer in enumerate(layers):
        path = folder / f"slice {z + 7}{extension}"
        if extension == ".tif":
            tifffile.imwrite(path, layer, photometric="minisblack", resolution=(4, 2), imagej=True)
        else:
            Image.fromarray(layer).save(path)
    return folder


@pytest.mark.parametrize(
    ("extension", "dtype"),
    [(".tif", "u1"), (".tif", "u2"), (".tif", "f4"), (".png", "u1"), (".png", "u2"), (".bmp", "u1"), (".pgm", "u1")],
)
def test_slices_in_the_order_of_their_numbers(tmp_path: Path, extension: str, dtype: str) -> None:
    layers = values(dtype)
    folder = fill(tmp_path / "stack", layers, extension)
    (folder / ".hidden.png").write_bytes(b"")
    (folder / "notes.txt").write_text("not a slice")
    source = open_source(folder)
    check_source(source, layers)
    assert source.grid.spacing == ((0.25, 0.5, 1) if extension == ".tif" else (1, 1, 1))
    assert source.name == str(folder)


def test_masks_palettes_and_colours(tmp_path: Path) -> None:
    mask, indices, colours = values("u1")[0] > 99, values("u1")[1] % 8, values("u1", (3, 4, 5, 3))
    Image.fromarray(mask).save(tmp_path / "mask.png")
    check_source(open_source(tmp_path / "mask.png"), mask.astype("u1")[None])
    painted = Image.fromarray(indices)
    painted.putpalette(bytes(reversed(range(24))))
    folder = tmp_path / "painted"
    folder.mkdir()
    for name in "ab":
        painted.save(folder / f"{name}.png")
    grey = np.asarray(painted.convert("L"))
    for path, count in ((folder / "a.png", 1), (folder, 2)):
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            check_source(open_source(path), np.stack([grey] * count))
        assert ["a.png: a picture with a palette: the luminance" in str(each.message) for each in told] == [True]
        check_source(open_source(path, subset=Subset(channel="index")), np.stack([indices] * count))
    folder = fill(tmp_path / "stack", colours, ".png")
    check_source(open_source(folder, subset=Subset(channel="green")), colours[..., 1])
    refused(lambda: open_source(folder), "several channels", "red, green, blue")


def test_folders_that_are_no_stack(tmp_path: Path) -> None:
    layers = values("u1")
    folder = fill(tmp_path / "stack", layers, ".png")
    Image.fromarray(layers[0, :, :3]).save(folder / "slice 9.png")
    source = open_source(folder)
    refused(lambda: source.read((0, 0, 0), (5, 6, 7)), "not of one size and type", "slice 9.png", "3 x 6", "7 x 6")
    np.testing.assert_array_equal(source.read((0, 0, 0), (2, 6, 7)), layers[:2])
    Image.fromarray(layers[0]).save(folder / "slice 8.bmp")
    refused(lambda: open_source(folder), "slices of several kinds", r"5 \.png", r"1 \.bmp")
    (tmp_path / "series").mkdir()
    (tmp_path / "series" / "IM0001").write_bytes(bytes(128) + b"DICM" + bytes(99))
    refused(lambda: open_source(tmp_path / "series"), "IM0001", "no picture")
    (tmp_path / "stacks").mkdir()
    tifffile.imwrite(tmp_path / "stacks" / "a.tif", layers, photometric="minisblack")
    refused(lambda: open_source(tmp_path / "stacks"), "not a slice", "5 layers")


def test_truncated_damaged_and_lying_pictures(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    Image.fromarray(values("u1", (200, 300))).save(path)
    source = open_source(cut(path, path.stat().st_size // 2))
    refused(lambda: source.read((0, 0, 0), (1, 200, 300)), "cannot be decoded", "a.png")
    path.write_bytes(b"P5 7 6 255\n")
    refused(lambda: open_source(path).read((0, 0, 0), (1, 6, 7)), "a.png")
    path.with_suffix(".pgm").write_bytes(b"P5 9000 9000 255\n")
    refused(lambda: open_source(path.with_suffix(".pgm")), "lies about its size", "a.pgm")
    path.write_bytes(b"GIF? no")
    refused(lambda: open_source(path), "wrong magic", "a.png")


def test_formats_that_are_not_read_are_named(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "reference" / "data-formats.md").read_text()
    read = {*EXTENSIONS, *MESH_EXTENSIONS, *GRID_EXTENSIONS}
    for each in UNREAD:
        assert each.name in page
        for extension in each.extensions:
            assert extension not in read
            path = tmp_path / f"a{extension.upper()}"
            refused(lambda path=path: open_source(path), "no such file")
            path.write_text("anything")
            for function in (open_source, read_geometry, read_grid):
                refused(
                    lambda path=path, function=function: function(path),
                    f"{each.name} is not read",
                    re.escape(each.remedy),
                )
    for name in (AMREX, GADGET):
        assert name in page


def test_simulations_that_are_not_read_are_named(tmp_path: Path) -> None:
    (tmp_path / "plt00010").mkdir()
    (tmp_path / "plt00010" / "Header").write_text("HyperCLaw-V1.1\n1\n")
    refused(lambda: open_source(tmp_path / "plt00010"), "AMReX's plotfile is not read", "yt")
    with h5py.File(tmp_path / "snapshot_010.hdf5", "w") as file:
        file["PartType0/Coordinates"] = np.zeros((9, 3))
    refused(lambda: open_source(tmp_path / "snapshot_010.hdf5"), "Gadget is not read", "columns x, y and z")
