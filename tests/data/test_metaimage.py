from __future__ import annotations

import gzip
import zlib
from pathlib import Path

import numpy as np
import pytest
from data.checks import check_placed, check_source, cut, refused, values

from clusterviz.data import open_source
from clusterviz.data.metaimage import TYPES

FIELDS = {"NDims": "3", "DimSize": "7 6 5", "ElementType": "MET_SHORT"}


def write(path: Path, data: bytes, entry: str = "LOCAL", **fields: str) -> Path:
    """Write a file of 5 × 6 × 7 shorts, changed by `fields`; "" removes a field."""
    text = "".join(f"{key} = {value}\n" for key, value in {**FIELDS, **fields}.items() if value)
    path.write_bytes(f"{text}ElementDataFile = {entry}\n".encode() + data)
    return path


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("kind", list(TYPES))
def test_every_type_in_either_byte_order(tmp_path: Path, kind: str, order: str) -> None:
    array = values(order + TYPES[kind])
    path = write(tmp_path / "a.mha", array.tobytes(), ElementType=kind, BinaryDataByteOrderMSB=str(order == ">"))
    check_source(open_source(path), array)


@pytest.mark.parametrize("pack", [zlib.compress, gzip.compress])
def test_compressed_as_text_and_detached(tmp_path: Path, pack: object) -> None:
    array = values("<i2", (40, 50, 60)) % 50
    packed = pack(array.tobytes())  # type: ignore[operator]
    (tmp_path / "a.zraw").write_bytes(packed)
    fields = {"DimSize": "60 50 40", "CompressedData": "True", "CompressedDataSize": str(len(packed))}
    path = write(tmp_path / "a.mhd", b"", "a.zraw", **fields)
    check_source(open_source(path), array, brick=16)
    middle = len(packed) // 2
    (tmp_path / "a.zraw").write_bytes(packed[:middle] + bytes(500) + packed[middle + 500 :])
    refused(lambda: open_source(path).read((0, 0, 0), array.shape), "damaged or truncated", "a.zraw")
    refused(lambda: open_source(cut(tmp_path / "a.zraw", 9) and path), "truncated", "a.zraw")
    lying = write(tmp_path / "b.mha", packed, **{**fields, "DimSize": "6000 5000 4000"})
    refused(lambda: open_source(lying), "lies about its size", "b.mha")
    text = " ".join(map(str, values("<i2").ravel())).encode()
    check_source(open_source(write(tmp_path / "c.mha", text, BinaryData="False")), values("<i2"))
    short = write(tmp_path / "d.mha", text[:900], BinaryData="False")
    refused(lambda: open_source(short).read((0, 0, 0), (1, 1, 1)), "lies about its size", "210")


def test_several_data_files_and_header_bytes(tmp_path: Path) -> None:
    array = values("<i2")
    for z, layer in enumerate(array):
        (tmp_path / f"s{z:02d}.raw").write_bytes(b"head" + layer.tobytes())
    for skip in ("-1", "4"):
        path = write(tmp_path / "a.mhd", b"", "s%02d.raw 0 4 1", HeaderSize=skip)
        check_source(open_source(path), array)
    listed = write(tmp_path / "b.mhd", b"s03.raw\ns00.raw\n", "LIST", HeaderSize="4", DimSize="7 6 2")
    check_source(open_source(listed), array[[3, 0]])
    refused(lambda: open_source(write(tmp_path / "c.mhd", b"", "s%02d.raw 0 5 1", HeaderSize="4")), "no such file")
    cut(tmp_path / "s03.raw", 1)
    refused(lambda: open_source(path), "truncated", "s03.raw")
    packed = write(tmp_path / "d.mhd", b"s00.raw\ns01.raw\n", "LIST", CompressedData="True")
    refused(lambda: open_source(packed), "several data files")


def test_placement(tmp_path: Path) -> None:
    matrix, data = "0 1 0 -1 0 0 0 0 1", values("<i2").tobytes()  # x of the volume is y of the world
    expected = np.array([[0, -3, 0, 7], [2, 0, 0, 8], [0, 0, 4, 9], [0, 0, 0, 1.0]])
    fields = {"TransformMatrix": matrix, "Offset": "7 8 9", "ElementSpacing": "2 3 4", "AnatomicalOrientation": "RAI"}
    source = open_source(write(tmp_path / "a.mha", data, **fields))
    check_placed(source, expected)
    assert source.grid.orientation == "LPS"
    old = open_source(write(tmp_path / "a.mha", data, Rotation=matrix, Position="7 8 9", ElementSize="2 3 4"))
    check_placed(old, expected)
    assert old.grid.orientation == ""
    flat = write(tmp_path / "b.mha", values("<i2", (6, 7)).tobytes(), NDims="2", DimSize="7 6", Offset="1 2")
    check_source(open_source(flat), values("<i2", (1, 6, 7)))
    assert open_source(flat).grid.origin == (1, 2, 0)


@pytest.mark.parametrize(
    ("fields", "part"),
    [
        ({"NDims": ""}, "wrong magic"),
        ({"NDims": "5", "DimSize": "7 6 5 1 1"}, "2 to 4 axes"),
        ({"ObjectType": "Scene"}, "ObjectType Scene"),
        ({"DimSize": "7 6"}, "impossible DimSize"),
        ({"DimSize": "7 6 x"}, "7 6 x"),
        ({"DimSize": "7 0 5"}, "no samples"),
        ({"DimSize": "7 6 4"}, "longer than the header says"),
        ({"DimSize": "7 6 6"}, "truncated"),
        ({"ElementType": "MET_STRING"}, "ElementType MET_STRING"),
        ({"ElementNumberOfChannels": "3", "DimSize": "7 5 2"}, "several channels"),
        ({"ElementSpacing": "1 0 1"}, "singular placement"),
        ({"ElementSpacing": "1 nan 1"}, "impossible ElementSpacing"),
        ({"TransformMatrix": "1 0 0 1"}, "impossible TransformMatrix"),
        ({"HeaderSize": "-1", "CompressedData": "True"}, "impossible HeaderSize"),
    ],
)
def test_a_header_that_cannot_be(tmp_path: Path, fields: dict[str, str], part: str) -> None:
    refused(lambda: open_source(write(tmp_path / "a.mha", values("<i2").tobytes(), **fields)), part, "a.mha")


def test_a_file_larger_than_memory_is_read_by_the_box(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mha", b"", DimSize="2000 2000 2500")
    begin, patch = path.stat().st_size, values("<i2", (1, 1, 5))
    with path.open("r+b") as file:
        file.truncate(begin + 2 * 2000 * 2000 * 2500)
        file.seek(begin + 2 * ((2400 * 2000 + 1000) * 2000 + 3))
        file.write(patch.tobytes())
    np.testing.assert_array_equal(open_source(path).read((2400, 1000, 3), (2401, 1001, 8)), patch)
