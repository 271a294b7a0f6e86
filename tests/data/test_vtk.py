from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from data.checks import check_placed, check_source, cut, refused, values

from clusterviz.data import open_source
from clusterviz.data.axes import Subset

NAMES = {"i1": "char", "u1": "unsigned_char", "i2": "short", "u2": "unsigned_short", "i4": "int", "u4": "unsigned_int"}
NAMES |= {"i8": "vtktypeint64", "u8": "unsigned_long", "f4": "float", "f8": "double"}
HEAD = "# vtk DataFile Version 5.1\na title\n{form}\nDATASET STRUCTURED_POINTS\n"
HEAD += "DIMENSIONS 7 6 5\nSPACING 2 3 4\nORIGIN 1 2 3\n"


def packed(array: np.ndarray, form: str) -> bytes:
    """Return samples as the file stores them; text has nine numbers a line, as VTK writes it."""
    if form == "BINARY":
        return array.astype(array.dtype.newbyteorder(">")).tobytes() + b"\n"
    words = [repr(number) for number in array.ravel().tolist()]
    return "".join(" ".join(words[i : i + 9]) + " \n" for i in range(0, len(words), 9)).encode()


def write(path: Path, form: str, *parts: str | np.ndarray, head: str = HEAD) -> Path:
    """Write a file of header lines and arrays."""
    texts = [part.encode() + b"\n" if isinstance(part, str) else packed(part, form) for part in parts]
    path.write_bytes(head.format(form=form).encode() + b"".join(texts))
    return path


@pytest.mark.parametrize("form", ["ASCII", "BINARY"])
@pytest.mark.parametrize("dtype", list(NAMES))
def test_every_type(tmp_path: Path, dtype: str, form: str) -> None:
    array = values(dtype)
    path = write(
        tmp_path / "a.vtk", form, "POINT_DATA 210", f"SCALARS density {NAMES[dtype]}", "LOOKUP_TABLE default", array
    )
    source = open_source(path)
    check_source(source, array)
    check_placed(source, np.array([[2, 0, 0, 1], [0, 3, 0, 2], [0, 0, 4, 3], [0, 0, 0, 1.0]]))


@pytest.mark.parametrize("form", ["ASCII", "BINARY"])
def test_arrays_of_every_kind_and_what_stands_between_them(tmp_path: Path, form: str) -> None:
    one, two, cells = values("f4"), values("i2", seed=2), values("u1", (4, 5, 6))
    vectors = values("f8", (5, 6, 7, 3))
    path = write(
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
        head=HEAD.replace("DATASET", "METADATA\nINFORMATION 0\n\nDATASET"),
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


@pytest.mark.parametrize(
    ("old", "new", "part"),
    [
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
)
def test_a_file_that_cannot_be(tmp_path: Path, old: str, new: str, part: str) -> None:
    path = write(
        tmp_path / "a.vtk", "BINARY", "POINT_DATA 210", "SCALARS s short 1", "LOOKUP_TABLE default", values("i2")
    )
    content = path.read_bytes()
    assert old.encode() in content
    path.write_bytes(content.replace(old.encode(), new.encode(), 1))
    refused(lambda: open_source(path), part, "a.vtk")


@pytest.mark.parametrize("form", ["ASCII", "BINARY"])
def test_truncated_and_several_without_a_name(tmp_path: Path, form: str) -> None:
    array = values("i2")
    lines = ("POINT_DATA 210", "FIELD data 2", "one 1 210 short", array, "two 1 210 short", array)
    path = write(tmp_path / "a.vtk", form, *lines)
    refused(lambda: open_source(path), "several arrays", "one .points., two .points.")
    whole = path.read_bytes()
    for length in (20, 50, 150, len(whole) // 2, len(whole) - 20):
        path.write_bytes(whole[:length])
        refused(lambda: open_source(path, "two"), "a.vtk")
    path = write(tmp_path / "b.vtk", form, "POINT_DATA 210", "SCALARS s short", array)
    if form == "BINARY":
        refused(lambda: open_source(cut(path, 2)), "truncated")
        return
    path.write_bytes(path.read_bytes().replace(b"\n", b"\nx", 13))
    refused(lambda: open_source(path).read((0, 0, 0), (1, 1, 1)), "b.vtk")


def test_a_file_larger_than_memory_is_read_by_the_box(tmp_path: Path) -> None:
    head = HEAD.replace("7 6 5", "2000 2000 2500")
    path = write(tmp_path / "a.vtk", "BINARY", "POINT_DATA 10000000000", "SCALARS s short 1", head=head)
    begin, patch = path.stat().st_size, values(">i2", (1, 1, 5))
    with path.open("r+b") as file:
        file.truncate(begin + 2 * 2000 * 2000 * 2500)
        file.seek(begin + 2 * ((2400 * 2000 + 1000) * 2000 + 3))
        file.write(patch.tobytes())
    np.testing.assert_array_equal(open_source(path).read((2400, 1000, 3), (2401, 1001, 8)), patch)
