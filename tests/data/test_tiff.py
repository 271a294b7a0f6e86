from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile
from data.checks import DTYPES, check_source, refused, values

from clusterviz.data import open_source


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("packed", [None, "zlib"])
@pytest.mark.parametrize("dtype", DTYPES)
def test_every_type_in_either_byte_order(tmp_path: Path, dtype: str, packed: str | None, order: str) -> None:
    array = values(dtype)
    tifffile.imwrite(tmp_path / "a.tif", array, compression=packed, byteorder=order, photometric="minisblack")
    check_source(open_source(tmp_path / "a.tif"), array)


@pytest.mark.parametrize("packed", [None, "zlib"])
@pytest.mark.parametrize("big", [False, True])
def test_plain_pages_tiles_and_big_tiff(tmp_path: Path, packed: str | None, big: bool) -> None:
    array = values("u2", (4, 40, 50))
    with tifffile.TiffWriter(tmp_path / "a.tiff", bigtiff=big) as file:
        for layer in array:
            file.write(layer, tile=(16, 32), compression=packed, metadata=None, photometric="minisblack")
    check_source(open_source(tmp_path / "a.tiff"), array, brick=16)


def test_a_picture_is_one_layer(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "a.tif", values("u1", (9, 8)))
    check_source(open_source(tmp_path / "a.tif"), values("u1", (9, 8))[None])


def test_a_one_voxel_wide_stack(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "a.tif", values("u1", (3, 1, 5)), photometric="minisblack", metadata={"axes": "ZYX"})
    check_source(open_source(tmp_path / "a.tif"), values("u1", (3, 1, 5)))


def test_spacing_of_imagej_and_ome(tmp_path: Path) -> None:
    array = values("u2")
    metadata = {"spacing": 3.5, "unit": "um", "axes": "ZYX"}
    tifffile.imwrite(tmp_path / "a.tif", array, imagej=True, resolution=(4, 2), metadata=metadata)
    check_source(open_source(tmp_path / "a.tif"), array)
    assert open_source(tmp_path / "a.tif").grid.spacing == (0.25, 0.5, 3.5)
    metadata = {"axes": "ZYX", "PhysicalSizeX": 0.1, "PhysicalSizeY": 0.2, "PhysicalSizeZ": 0.5}
    tifffile.imwrite(tmp_path / "a.ome.tif", array, ome=True, metadata=metadata, photometric="minisblack")
    check_source(open_source(tmp_path / "a.ome.tif"), array)
    assert open_source(tmp_path / "a.ome.tif").grid.spacing == (0.1, 0.2, 0.5)
    tifffile.imwrite(tmp_path / "b.tif", array, photometric="minisblack")
    assert open_source(tmp_path / "b.tif").grid.spacing == (1, 1, 1)


def test_series_are_arrays(tmp_path: Path) -> None:
    one, two = values("u2"), values("f4", (3, 8, 9))
    with tifffile.TiffWriter(tmp_path / "a.tif") as file:
        file.write(one, photometric="minisblack")
        file.write(two, photometric="minisblack")
    check_source(open_source(tmp_path / "a.tif"), one)
    check_source(open_source(tmp_path / "a.tif", "1"), two)
    refused(lambda: open_source(tmp_path / "a.tif", "2"), "no such array", "0: .*1: ")


def test_colours_channels_and_complex_numbers(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "a.tif", np.zeros((4, 5, 3), np.uint8), photometric="rgb")
    refused(lambda: open_source(tmp_path / "a.tif"), "several channels", "red, green, blue")
    tifffile.imwrite(tmp_path / "b.tif", np.zeros((3, 2, 4, 5), np.uint8), imagej=True, metadata={"axes": "ZCYX"})
    refused(lambda: open_source(tmp_path / "b.tif"), "several channels", "channel: 0 to 1")
    tifffile.imwrite(tmp_path / "c.tif", np.zeros((3, 4, 5), np.complex64), photometric="minisblack")
    refused(lambda: open_source(tmp_path / "c.tif"), "not a scalar volume")


@pytest.mark.parametrize("packed", [None, "zlib"])
def test_truncated(tmp_path: Path, packed: str | None) -> None:
    path, array = tmp_path / "a.tif", values("u2", (9, 20, 30))
    tifffile.imwrite(path, array, compression=packed, photometric="minisblack")
    with tifffile.TiffFile(path) as file:
        last_sample = file.pages[-1].dataoffsets[-1] + file.pages[-1].databytecounts[-1] - 1
    whole = path.read_bytes()
    for length in (9, last_sample // 3, last_sample // 2, last_sample):
        path.write_bytes(whole[:length])
        refused(lambda: open_source(path).read((0, 0, 0), array.shape), "a.tif")


def test_wrong_magic_and_a_damaged_page(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    path.write_bytes(b"\x89PNG\r\n\x1a\n")
    refused(lambda: open_source(path), "wrong magic", "PNG")
    tifffile.imwrite(path, values("u2", (2, 20, 30)), compression="zlib", photometric="minisblack")
    with tifffile.TiffFile(path) as file:
        begin, count = file.pages[1].dataoffsets[0], file.pages[1].databytecounts[0]
    content = bytearray(path.read_bytes())
    content[begin : begin + count] = bytes(count)
    path.write_bytes(content)
    source = open_source(path)
    np.testing.assert_array_equal(source.read((0, 0, 0), (1, 20, 30)), values("u2", (2, 20, 30))[:1])
    refused(lambda: source.read((1, 0, 0), (2, 20, 30)), "page 1", "cannot be decoded")
