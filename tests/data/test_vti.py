from __future__ import annotations

import base64
import lzma
import zlib
from pathlib import Path

import lz4.block
import numpy as np
import pytest
from data.checks import check_placed, check_source, cut, refused, values

from clusterviz.data import open_source
from clusterviz.data.vti import TYPES

COMPRESSORS = {
    "": None,
    "vtkZLibDataCompressor": zlib.compress,
    "vtkLZMADataCompressor": lzma.compress,
    "vtkLZ4DataCompressor": lambda block: lz4.block.compress(block, store_size=False),
}
NAMES = {code: name for name, code in TYPES.items()}
FORMS = ("ascii", "binary", "base64", "raw")  # the last two appended


def packed(data: bytes, header: str, compressor: str, text: bool, block: int = 100) -> bytes:
    """Return the array with its header, as VTK writes it."""
    encode = base64.b64encode if text else bytes
    compress = COMPRESSORS[compressor]
    if compress is None:
        return encode(np.array([len(data)], header).tobytes() + data)
    blocks = [compress(data[begin : begin + block]) for begin in range(0, len(data), block)]
    numbers = [len(blocks), block, len(data) % block, *map(len, blocks)]
    return encode(np.array(numbers, header).tobytes()) + encode(b"".join(blocks))


def write(
    path: Path,
    arrays: dict[str, np.ndarray],
    form: str = "raw",
    compressor: str = "",
    header: str = "<u8",
    where: str = "PointData",
    image: str = 'WholeExtent="0 6 0 5 0 4" Origin="0 0 0" Spacing="1 1 1"',
    piece: str = "0 6 0 5 0 4",
    scalars: str = "",
    extra: str = "",
    space: str = "\n  ",
) -> Path:
    """Write a file with `arrays` as point or cell data."""
    tags, appended = "", b""
    for name, array in arrays.items():
        kind = NAMES[array.dtype.newbyteorder("=").str[1:]]
        start = f'<DataArray type="{kind}" Name="{name}" {extra}'
        if form == "ascii":
            numbers = " ".join(map(repr, array.ravel().tolist()))
            tags += f'{start} format="ascii">\n{numbers}\n</DataArray>'
            continue
        data = packed(array.tobytes(), header, compressor, form != "raw")
        if form == "binary":
            key = '<InformationKey name="RANGE" location="x">7</InformationKey>'
            tags += f'{start} format="binary">{key}{space}{data.decode()}{space}</DataArray>'
        else:
            tags += f'{start} format="appended" offset="{len(appended)}"/>'
            appended += data
    order = "LittleEndian" if header[0] == "<" else "BigEndian"
    kind = {"4": "UInt32", "8": "UInt64"}[header[-1]]
    active = f'Scalars="{scalars}"' if scalars else ""
    packing = f'compressor="{compressor}"' if compressor else ""
    text = f'<?xml version="1.0"?>\n<VTKFile type="ImageData" byte_order="{order}" header_type="{kind}" {packing}>'
    text += f'<ImageData {image}><Piece Extent="{piece}"><{where} {active}>{tags}</{where}></Piece></ImageData>'
    content = text.encode()
    if appended:
        content += f'<AppendedData encoding="{form}">\n   _'.encode() + appended + b"\n</AppendedData>"
    path.write_bytes(content + b"</VTKFile>")
    return path


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("dtype", list(NAMES))
def test_every_type_in_either_byte_order(tmp_path: Path, dtype: str, order: str, form: str) -> None:
    array = values(order + dtype)
    check_source(open_source(write(tmp_path / "a.vti", {"s": array}, form, header=order + "u4")), array)


@pytest.mark.parametrize("form", FORMS[1:])
@pytest.mark.parametrize("header", ["<u4", "<u8", ">u4", ">u8"])
@pytest.mark.parametrize("compressor", list(COMPRESSORS))
def test_every_packing(tmp_path: Path, compressor: str, header: str, form: str) -> None:
    array = values(header[0] + "i2")
    check_source(open_source(write(tmp_path / "a.vti", {"s": array}, form, compressor, header)), array)


@pytest.mark.parametrize("form", FORMS[1:])
def test_blocks_that_fit_exactly(tmp_path: Path, form: str) -> None:
    array = values("u1", (4, 5, 10))
    extent = "0 9 0 4 0 3"
    path = write(
        tmp_path / "a.vti", {"s": array}, form, "vtkZLibDataCompressor", image=f'WholeExtent="{extent}"', piece=extent
    )
    check_source(open_source(path), array)


@pytest.mark.parametrize("header", ["<u4", "<u8"])
@pytest.mark.parametrize("form", ["binary", "base64"])
def test_a_header_in_base64_of_its_own(tmp_path: Path, form: str, header: str) -> None:
    array = values("<f4")
    path = write(tmp_path / "a.vti", {"s": array}, form, header=header)
    number, data = np.array([array.nbytes], header).tobytes(), array.tobytes()
    together, apart = base64.b64encode(number + data), base64.b64encode(number) + base64.b64encode(data)
    assert together in path.read_bytes()
    path.write_bytes(path.read_bytes().replace(together, apart))
    check_source(open_source(path), array)


@pytest.mark.parametrize("form", FORMS)
def test_arrays_by_name_active_or_alone(tmp_path: Path, form: str) -> None:
    one, two = values("f4"), values("<i2", seed=2)
    path = write(tmp_path / "a.vti", {"one": one, "two": two}, form)
    check_source(open_source(path, "one"), one)
    check_source(open_source(path, "two"), two)
    refused(lambda: open_source(path), "several arrays", "one \\(points\\), two \\(points\\)")
    refused(lambda: open_source(path, "three"), "no such scalar array", "three", "one \\(points\\)")
    check_source(open_source(write(path, {"one": one, "two": two}, form, scalars="two")), two)


def test_cell_data_lies_at_the_cells_centres(tmp_path: Path) -> None:
    image = 'WholeExtent="0 6 0 5 0 4" Origin="10 20 30" Spacing="2 3 4"'
    array = values("f4", (4, 5, 6))
    source = open_source(write(tmp_path / "a.vti", {"s": array}, where="CellData", image=image))
    check_source(source, array)
    check_placed(source, np.array([[2, 0, 0, 11], [0, 3, 0, 21.5], [0, 0, 4, 32], [0, 0, 0, 1.0]]))


def test_extent_origin_and_direction_place_the_volume(tmp_path: Path) -> None:
    image = 'WholeExtent="2 8 -1 4 3 7" Origin="10 20 30" Spacing="2 3 4" Direction="0 -1 0 1 0 0 0 0 1"'
    array = values("u1")
    source = open_source(write(tmp_path / "a.vti", {"s": array}, image=image, piece="2 8 -1 4 3 7"))
    check_source(source, array)
    check_placed(source, np.array([[0, -3, 0, 13], [2, 0, 0, 24], [0, 0, 4, 42], [0, 0, 0, 1.0]]))


@pytest.mark.parametrize(
    ("changes", "parts"),
    [
        ({"extra": 'NumberOfComponents="3"'}, ("no scalar volume",)),
        ({"image": 'WholeExtent="0 6 0 5 0 4" Spacing="1 0 1"'}, ("singular placement",)),
        ({"image": 'WholeExtent="0 6 0 5 0 4" Spacing="1 1"'}, ("impossible Spacing", "3 numbers")),
        ({"image": 'WholeExtent="0 6 0 5 0 9"'}, ("piece is not the whole",)),
        ({"image": "", "piece": "0 6 0 5 0 -1"}, ("no samples",)),
        ({"image": "", "piece": "0 6 0 5 0 9"}, ("size is not the image's", "420 bytes", "840")),
        ({"image": "", "piece": "0 6"}, ("impossible Extent",)),
    ],
)
@pytest.mark.parametrize("compressor", ["", "vtkZLibDataCompressor"])
def test_a_header_that_cannot_be(
    tmp_path: Path, changes: dict[str, str], parts: tuple[str, ...], compressor: str
) -> None:
    path = write(tmp_path / "a.vti", {"s": values("<i2")}, compressor=compressor, **changes)  # type: ignore[arg-type]
    refused(lambda: open_source(path), "a.vti", *parts)


@pytest.mark.parametrize(
    ("old", "new", "part"),
    [
        ('type="ImageData"', 'type="UnstructuredGrid"', "not a VTK image"),
        ('type="Int16"', 'type="String"', "not a scalar volume"),
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
)
def test_damaged_xml(tmp_path: Path, old: str, new: str, part: str) -> None:
    path = write(tmp_path / "a.vti", {"s": values("<i2")}, compressor="vtkZLibDataCompressor")
    assert old.encode() in path.read_bytes()
    path.write_bytes(path.read_bytes().replace(old.encode(), new.encode(), 1))
    refused(lambda: open_source(path), part, "a.vti")


@pytest.mark.parametrize("compressor", ["", "vtkZLibDataCompressor"])
@pytest.mark.parametrize("form", FORMS)
def test_truncated(tmp_path: Path, form: str, compressor: str) -> None:
    path = write(tmp_path / "a.vti", {"s": values("<i2")}, form, compressor)
    whole = path.read_bytes()
    for length in (30, 200, len(whole) // 2, len(whole) - 80):
        path.write_bytes(whole[:length])
        refused(lambda: open_source(path), "a.vti")


@pytest.mark.parametrize("form", ["raw", "binary"])
def test_a_damaged_block_is_found_when_read(tmp_path: Path, form: str) -> None:
    array = values("u1")
    path = write(tmp_path / "a.vti", {"s": array}, form, "vtkZLibDataCompressor")
    blocks = [zlib.compress(array.tobytes()[begin : begin + 100]) for begin in (0, 100, 200)]
    old = base64.b64encode(b"".join(blocks)) if form == "binary" else b"".join(blocks)
    damaged = blocks[0] + bytes(len(blocks[1])) + blocks[2]
    new = base64.b64encode(damaged) if form == "binary" else damaged
    assert old in path.read_bytes()
    path.write_bytes(path.read_bytes().replace(old, new))
    source = open_source(path)
    np.testing.assert_array_equal(source.read((0, 0, 0), (1, 6, 7)), array[:1])
    refused(lambda: source.read((3, 0, 0), (4, 6, 7)), "block 1 is damaged", "a.vti")


def test_damaged_text(tmp_path: Path) -> None:
    path = write(tmp_path / "a.vti", {"s": values("<i2")}, "ascii")
    path.write_bytes(path.read_bytes().replace(b"</DataArray>", b" 5</DataArray>"))
    refused(lambda: open_source(path).read((0, 0, 0), (1, 1, 1)), "lies about its size", "211 numbers", "210")
    path.write_bytes(path.read_bytes().replace(b"\n 5</DataArray>", b"x</DataArray>"))
    refused(lambda: open_source(path).read((0, 0, 0), (1, 1, 1)), "not a number")
    path = write(tmp_path / "b.vti", {"s": values("<i2")}, "binary")
    content = path.read_bytes()
    middle = content.index(b"</InformationKey>") + 200
    path.write_bytes(content[:middle] + b"****" + content[middle + 4 :])
    refused(lambda: open_source(path).read((0, 0, 0), (5, 6, 7)), "damaged base64")


def test_wrong_magic_and_no_arrays(tmp_path: Path) -> None:
    path = tmp_path / "a.vti"
    path.write_bytes(b"\x89PNG\r\n")
    refused(lambda: open_source(path), "XML", "a.vti")
    path.write_bytes(b"<html></html>")
    refused(lambda: open_source(path), "not a VTK image file")
    refused(lambda: open_source(write(path, {}, "ascii")), "no scalar volume")


def test_a_file_larger_than_memory_is_read_by_the_box(tmp_path: Path) -> None:
    extent = "0 1999 0 1999 0 2499"
    size, patch = 2 * 2000 * 2000 * 2500, values("<i2", (1, 1, 5))
    path = write(tmp_path / "a.vti", {"s": patch}, image=f'WholeExtent="{extent}"', piece=extent)
    begin = path.read_bytes().index(b"_", path.read_bytes().index(b"Appended")) + 1
    with path.open("r+b") as file:
        file.seek(begin)
        file.write(np.array([size], "<u8").tobytes() + bytes(patch.nbytes))
        file.truncate(begin + 8 + size)
        file.seek(begin + 8 + 2 * ((2400 * 2000 + 1000) * 2000 + 3))
        file.write(patch.tobytes())
    np.testing.assert_array_equal(open_source(cut(path, 0)).read((2400, 1000, 3), (2401, 1001, 8)), patch)
