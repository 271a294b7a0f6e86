from __future__ import annotations

import bz2
import gzip
from pathlib import Path

import nrrd
import numpy as np
import pytest
from data.checks import check_placed, check_source, cut, refused, values

from clusterviz.data import open_source
from clusterviz.data.axes import Subset

DTYPES = ("i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8")


def write(path: Path, array: np.ndarray, encoding: str = "raw", **header: object) -> Path:
    nrrd.write(str(path), array, {"encoding": encoding, **header}, index_order="C")
    return path


def by_hand(path: Path, data: bytes, *lines: str) -> Path:
    """Write an attached file of 5 × 6 × 7 shorts, changed by `lines`."""
    fields = {"type": "short", "dimension": "3", "sizes": "7 6 5", "endian": "little", "encoding": "raw"}
    fields |= dict(line.split(": ", 1) for line in lines)
    text = "NRRD0005\n# by hand\n" + "".join(f"{key}: {value}\n" for key, value in fields.items() if value != "-")
    path.write_bytes(text.encode() + b"\n" + data)
    return path


@pytest.mark.parametrize("encoding", ["raw", "gzip", "bzip2"])
@pytest.mark.parametrize("dtype", DTYPES)
def test_every_type(tmp_path: Path, dtype: str, encoding: str) -> None:
    check_source(open_source(write(tmp_path / "a.nrrd", values(dtype), encoding)), values(dtype))


@pytest.mark.parametrize("dtype", DTYPES)
def test_big_endian(tmp_path: Path, dtype: str) -> None:
    array = values(">" + dtype)
    names = {"i": "int", "u": "uint"}
    kind = {"f4": "float", "f8": "double"}.get(dtype) or f"{names[dtype[0]]}{8 * array.itemsize}"
    check_source(open_source(by_hand(tmp_path / "a.nrrd", array.tobytes(), "endian: big", f"type: {kind}")), array)


@pytest.mark.parametrize("dtype", ["i8", "u8", "u1", "f4", "f8"])
def test_ascii(tmp_path: Path, dtype: str) -> None:
    array = values(dtype)
    kind = {"f4": "float", "f8": "double", "u1": "uchar", "i8": "int64", "u8": "uint64"}[dtype]
    text = "\n".join(map(repr, array.ravel().tolist())).encode()
    path = by_hand(tmp_path / "a.nrrd", text, "encoding: ascii", f"type: {kind}", "endian: -")
    check_source(open_source(path), array)


@pytest.mark.parametrize("encoding", ["raw", "gzip", "bzip2"])
def test_detached(tmp_path: Path, encoding: str) -> None:
    path = write(tmp_path / "a.nhdr", values("i2"), encoding)
    assert path.stat().st_size < 300
    check_source(open_source(path), values("i2"))


def test_several_data_files(tmp_path: Path) -> None:
    array = values("i2")
    for z, layer in enumerate(array):
        (tmp_path / f"s{z:02d}.raw").write_bytes(layer.tobytes())
    path = by_hand(tmp_path / "a.nhdr", b"", "data file: s%02d.raw 0 4 1 2")
    check_source(open_source(path), array)
    path = by_hand(tmp_path / "b.nhdr", b"", "data file: s%02d.raw 4 0 -1")
    check_source(open_source(path), array[::-1])
    path.write_bytes(path.read_bytes().replace(b"s%02d.raw 4 0 -1\n", b"LIST\n" + b"s00.raw\ns03.raw\n"))
    path.write_bytes(path.read_bytes().replace(b"7 6 5", b"7 6 2").rstrip() + b"\n")
    check_source(open_source(path), array[[0, 3]])
    cut(tmp_path / "s03.raw", 1)
    refused(lambda: open_source(path), "truncated", "s03.raw")
    (tmp_path / "s03.raw").unlink()
    refused(lambda: open_source(path), "no such file", "s03.raw")


def test_skips(tmp_path: Path) -> None:
    array = values("<i2")
    head = b"first line\nsecond\n"
    path = by_hand(tmp_path / "a.nrrd", head + b"123" + array.tobytes(), "line skip: 2", "byte skip: 3")
    check_source(open_source(path), array)
    path = by_hand(tmp_path / "b.nrrd", b"anything" + array.tobytes(), "byte skip: -1")
    check_source(open_source(path), array)
    packed = head + gzip.compress(b"123" + array.tobytes())
    path = by_hand(tmp_path / "c.nrrd", packed, "encoding: gz", "line skip: 2", "byte skip: 3")
    check_source(open_source(path), array)
    (tmp_path / "d.raw").write_bytes(head + bz2.compress(array.tobytes()))
    path = by_hand(tmp_path / "d.nhdr", b"", "encoding: bz2", "line skip: 2", "data file: d.raw")
    check_source(open_source(path), array)


def test_placement(tmp_path: Path) -> None:
    steps = np.array([[0, 2, 0], [-3, 0, 0.5], [0, 0, 0.5]])
    header = {"space": "left-posterior-superior", "space directions": steps, "space origin": [1, 2, 3]}
    expected = np.eye(4)
    expected[:3, :3], expected[:3, 3] = steps.T, [1, 2, 3]
    check_placed(open_source(write(tmp_path / "a.nrrd", values("u1"), **header)), expected)
    expected = np.array([[2, 0, 0, 5], [0, 3, 0, 6], [0, 0, 4, 7], [0, 0, 0, 1.0]])
    spaced = by_hand(tmp_path / "b.nrrd", values("i2").tobytes(), "spacings: 2 3 4", "axis mins: 5 6 7")
    check_placed(open_source(spaced), expected)
    unknown = by_hand(tmp_path / "c.nrrd", values("i2").tobytes(), "spacings: 2 nan 4")
    assert open_source(unknown).grid.spacing == (2, 1, 4)
    flat = by_hand(
        tmp_path / "d.nrrd", values("i2").tobytes(), "space dimension: 3", "space directions: (1,0,0) (2,0,0) (0,0,1)"
    )
    refused(lambda: open_source(flat), "singular placement")


def test_pictures_and_unit_axes(tmp_path: Path) -> None:
    array = values("<i2", (4, 5))
    picture = by_hand(tmp_path / "a.nrrd", array.tobytes(), "dimension: 2", "sizes: 5 4", "spacings: 2 3")
    check_source(open_source(picture), array[None])
    assert open_source(picture).grid.spacing == (2, 3, 1)
    array = values("<i2")
    lines = ("dimension: 4", "sizes: 1 7 6 5", "space dimension: 3", "space directions: none (2,0,0) (0,3,0) (0,0,4)")
    one = by_hand(tmp_path / "b.nrrd", array.tobytes(), *lines)
    check_source(open_source(one), array)
    assert open_source(one).grid.spacing == (2, 3, 4)


def test_time_in_a_space_of_four_dimensions_as_itk_writes_it(tmp_path: Path) -> None:
    array = values("<i2", (2, 5, 6, 7))
    directions = "space directions: (2,0,0,0) (0,3,0,0) (0,0,4,0) (0,0,0,1)"
    lines = ("dimension: 4", "sizes: 7 6 5 2", "space dimension: 4", directions, "space origin: (1,2,3,0)")
    path = by_hand(tmp_path / "a.nrrd", array.tobytes(), *lines, "kinds: domain domain domain domain")
    source = open_source(path, subset=Subset(time=1))
    check_source(source, array[1])
    check_placed(source, np.array([[2, 0, 0, 1], [0, 3, 0, 2], [0, 0, 4, 3], [0, 0, 0, 1.0]]))


@pytest.mark.parametrize(
    ("lines", "part"),
    [
        (("type: block",), "type block"),
        (("dimension: 4", "sizes: 3 7 5 2"), "several time steps"),
        (("dimension: 4", "sizes: 3 7 5 2", "kinds: RGB-color domain domain domain"), "several channels"),
        (("dimension: 5", "sizes: 3 7 5 2 2", "kinds: domain domain domain domain domain"), "5 axes"),
        (("sizes: 7 6",), "do not match"),
        (("sizes: 7 0 5",), "no samples"),
        (("encoding: hex",), "unsupported encoding"),
        (("endian: -",), "byte order"),
        (("sizes: -",), "missing"),
        (("sizes: 7 6 6",), "truncated"),
        (("sizes: 7 6 4",), "longer than the header"),
        (("data file: gone.raw",), "no such file"),
    ],
)
def test_a_header_that_cannot_be(tmp_path: Path, lines: tuple[str, ...], part: str) -> None:
    refused(lambda: open_source(by_hand(tmp_path / "a.nrrd", values("<i2").tobytes(), *lines)), part, "gone|a.nrrd")


def test_truncated_wrong_magic_and_no_data_file(tmp_path: Path) -> None:
    path = by_hand(tmp_path / "a.nrrd", values("<i2").tobytes())
    refused(lambda: open_source(path, "x"), "no such array")
    refused(lambda: open_source(cut(path, 1)), "truncated", "a.nrrd")
    refused(lambda: open_source(by_hand(tmp_path / "b.nhdr", b"")), "needs a data file")
    packed = write(tmp_path / "c.nrrd", values("f8", (20, 30, 40)), "gzip")
    refused(lambda: open_source(cut(packed, 900)).read((0, 0, 0), (20, 30, 40)), "truncated|damaged")
    few = by_hand(tmp_path / "d.nrrd", b"1 2 3" + bytes(300).replace(b"\0", b" "), "encoding: ascii")
    refused(lambda: open_source(few).read((0, 0, 0), (1, 1, 1)), "lies about its size", "3 numbers", "210")
    wide = by_hand(tmp_path / "e.nrrd", b"70000 " * 210, "encoding: ascii")
    refused(lambda: open_source(wide).read((0, 0, 0), (1, 1, 1)), "not a number of type int16")
    path.write_bytes(b"P5 7 6 255\n")
    refused(lambda: open_source(path), "wrong magic", "NRRD")
    path.write_bytes(b"NRRD0005\nnonsense\n\n")
    refused(lambda: open_source(path), "header cannot be read")


def test_a_file_larger_than_memory_is_read_by_the_box(tmp_path: Path) -> None:
    path = by_hand(tmp_path / "a.nrrd", b"", "sizes: 2000 2000 2500")
    begin, patch = path.stat().st_size, values("<i2", (1, 1, 5))
    with path.open("r+b") as file:
        file.truncate(begin + 2 * 2000 * 2000 * 2500)
        file.seek(begin + 2 * ((2400 * 2000 + 1000) * 2000 + 3))
        file.write(patch.tobytes())
    np.testing.assert_array_equal(open_source(path).read((2400, 1000, 3), (2401, 1001, 8)), patch)


@pytest.mark.parametrize(
    ("space", "orientation"),
    [("left-posterior-superior", "LPS"), ("RAS", "RAS"), ("left-anterior-superior-time", "LAS"), ("scanner-xyz", "")],
)
def test_the_orientation_is_that_of_the_space(tmp_path: Path, space: str, orientation: str) -> None:
    path = by_hand(tmp_path / "a.nrrd", bytes(48), "dimension: 3", "sizes: 2 3 4", f"space: {space}")
    assert open_source(path).grid.orientation == orientation
