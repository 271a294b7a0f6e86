from __future__ import annotations

import gzip
import struct
from pathlib import Path

import numpy as np
import pytest
from data.checks import check_placed, check_source, cut, refused, values

from clusterviz.data import open_source

MODES = {"i1": 0, "i2": 1, "f4": 2, "u2": 6, "f2": 12}


def header_of(array: np.ndarray, **changes: object) -> bytes:
    """Return a header for (sections, rows, columns); `changes` maps w<number from 0> to a 4-byte int or float."""
    order = ">" if array.dtype.byteorder == ">" else "<"
    sections, rows, columns = array.shape
    words: dict[int, int | float] = {0: columns, 1: rows, 2: sections, 3: MODES[array.dtype.newbyteorder("=").str[1:]]}
    words |= {7: columns, 8: rows, 9: sections, 10: 2.0 * columns, 11: 3.0 * rows, 12: 4.0 * sections}
    words |= {13: 90.0, 14: 90.0, 15: 90.0, 16: 1, 17: 2, 18: 3}
    words |= {int(key[1:]): value for key, value in changes.items()}  # type: ignore[misc]
    header = bytearray(1024)
    for word, value in words.items():
        struct.pack_into(order + ("i" if isinstance(value, int) else "f"), header, 4 * word, value)
    header[208:216] = b"MAP " + (b"\x11\x11\0\0" if order == ">" else b"\x44\x44\0\0")
    return bytes(header)


def write(path: Path, array: np.ndarray, extended: bytes = b"", **changes: object) -> Path:
    content = header_of(array, w23=len(extended), **changes) + extended + array.tobytes()
    path.write_bytes(gzip.compress(content) if path.suffix == ".gz" else content)
    return path


@pytest.mark.parametrize("name", ["a.mrc", "a.map", "a.ccp4", "a.map.gz"])
@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("dtype", list(MODES))
def test_every_mode_in_either_byte_order(tmp_path: Path, dtype: str, order: str, name: str) -> None:
    array = values(order + dtype)
    check_source(open_source(write(tmp_path / name, array, b"symmetry" * 10)), array)


def test_bytes_of_imod_are_unsigned(tmp_path: Path) -> None:
    array = values("i1")
    check_source(open_source(write(tmp_path / "a.mrc", array, w38=1146047817, w39=0)), array.view("u1"))
    check_source(open_source(write(tmp_path / "b.mrc", array, w38=1146047817, w39=1)), array)


def test_cell_and_start_place_the_map(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mrc", values("f4"), w4=10, w5=-20, w6=30)
    check_placed(open_source(path), np.array([[2, 0, 0, 20], [0, 3, 0, -60], [0, 0, 4, 120], [0, 0, 0, 1.0]]))
    path = write(tmp_path / "b.mrc", values("f4"), w49=7.0, w50=8.0, w51=9.0)
    check_placed(open_source(path), np.array([[2, 0, 0, 7], [0, 3, 0, 8], [0, 0, 4, 9], [0, 0, 0, 1.0]]))
    path = write(tmp_path / "c.mrc", values("f4"), w10=0.0, w11=0.0, w12=0.0)
    check_placed(open_source(path), np.eye(4))
    path = write(tmp_path / "d.mrc", values("f4"), w15=120.0)
    expected = np.array([[2, -1.5, 0, 0], [0, 1.5 * 3**0.5, 0, 0], [0, 0, 4, 0], [0, 0, 0, 1.0]])
    check_placed(open_source(path), expected)


@pytest.mark.parametrize("name", ["a.ccp4", "a.map.gz"])
@pytest.mark.parametrize("order", [(1, 2, 3), (2, 1, 3), (3, 2, 1), (2, 3, 1), (3, 1, 2), (1, 3, 2)])
def test_columns_rows_and_sections_may_be_any_axes(tmp_path: Path, order: tuple[int, int, int], name: str) -> None:
    volume = values("f4")  # (z, y, x)
    axes = [3 - axis for axis in order[::-1]]  # of sections, rows, columns in the volume
    stored = np.ascontiguousarray(volume.transpose(axes))
    start_xyz = (11, 12, 13)
    starts = {f"w{4 + i}": start_xyz[axis - 1] for i, axis in enumerate(order)}
    cell = {"w7": 7, "w8": 6, "w9": 5, "w10": 14.0, "w11": 18.0, "w12": 20.0}
    path = write(tmp_path / name, stored, w16=order[0], w17=order[1], w18=order[2], **starts, **cell)
    source = open_source(path)
    check_source(source, volume)
    check_placed(source, np.array([[2, 0, 0, 22], [0, 3, 0, 36], [0, 0, 4, 52], [0, 0, 0, 1.0]]))


@pytest.mark.parametrize(
    ("changes", "parts"),
    [
        ({"w3": 4}, ("unsupported mode", "4")),
        ({"w0": 0}, ("no samples",)),
        ({"w0": -7}, ("no samples",)),
        ({"w2": 6}, ("truncated", "1864 bytes", "2032")),
        ({"w16": 2}, ("impossible axis order",)),
        ({"w7": 0}, ("impossible grid intervals",)),
        ({"w10": float("nan")}, ("singular placement",)),
        ({"w13": 10.0, "w14": 10.0, "w15": 170.0}, ("singular placement",)),
    ],
)
def test_a_header_that_cannot_be(tmp_path: Path, changes: dict[str, object], parts: tuple[str, ...]) -> None:
    path = write(tmp_path / "a.mrc", values("f4"), **changes)
    refused(lambda: open_source(path), "a.mrc", *parts)


def test_truncated_and_wrong_magic(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mrc", values("f4"))
    refused(lambda: open_source(path, "x"), "no such array")
    refused(lambda: open_source(cut(path, 1)), "truncated")
    refused(lambda: open_source(cut(path, 1000)), "truncated", "1024")
    path.write_bytes(bytes(2000))
    refused(lambda: open_source(path), "wrong magic", "MAP")
    packed = write(tmp_path / "a.mrc.gz", values("f4", (20, 30, 40)))
    refused(lambda: open_source(cut(packed, 900)).read((0, 0, 0), (20, 30, 40)), "truncated|damaged")
    (tmp_path / "b.map.gz").write_bytes(bytes(2000))
    refused(lambda: open_source(tmp_path / "b.map.gz"), "wrong magic")


def test_a_file_larger_than_memory_is_read_by_the_box(tmp_path: Path) -> None:
    patch = values("i2", (1, 1, 5))
    path = write(tmp_path / "a.mrc", values("i2"), w0=2000, w1=2000, w2=2500)
    with path.open("r+b") as file:
        file.truncate(1024 + 2 * 2000 * 2000 * 2500)
        file.seek(1024 + 2 * ((2400 * 2000 + 1000) * 2000 + 3))
        file.write(patch.tobytes())
    np.testing.assert_array_equal(open_source(path).read((2400, 1000, 3), (2401, 1001, 8)), patch)
