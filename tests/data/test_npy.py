from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from data.checks import DTYPES, check_source, cut, refused, values

from clusterviz.data import open_source


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("dtype", DTYPES)
def test_every_type_in_either_byte_order(tmp_path: Path, dtype: str, order: str) -> None:
    array = values(order + dtype)
    np.save(tmp_path / "a.npy", array)
    check_source(open_source(tmp_path / "a.npy"), array)


def test_fortran_order(tmp_path: Path) -> None:
    array = np.asfortranarray(values("f4"))
    np.save(tmp_path / "a.npy", array)
    check_source(open_source(tmp_path / "a.npy"), array)


def test_rows_far_apart_are_read_one_by_one(tmp_path: Path) -> None:
    array = values("f8", (2, 3, 2000))
    np.save(tmp_path / "a.npy", array)
    source = open_source(tmp_path / "a.npy")
    np.testing.assert_array_equal(source.read((0, 1, 1990), (2, 3, 1995)), array[:, 1:, 1990:1995])
    np.testing.assert_array_equal(source.read((1, 0, 5), (2, 3, 8)), array[1:, :, 5:8])


def test_a_picture_is_one_layer_and_a_mask_is_uint8(tmp_path: Path) -> None:
    mask = np.random.default_rng(0).random((4, 5)) > 0.5
    np.save(tmp_path / "a.npy", mask)
    check_source(open_source(tmp_path / "a.npy"), mask.astype(np.uint8)[None])


def test_one_voxel(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.full((1, 1, 1), 7, np.int16))
    check_source(open_source(tmp_path / "a.npy"), np.full((1, 1, 1), 7, np.int16))


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
def test_what_is_no_volume_is_refused(tmp_path: Path, array: np.ndarray, part: str) -> None:
    np.save(tmp_path / "a.npy", array)
    refused(lambda: open_source(tmp_path / "a.npy"), part, "a.npy")


def test_truncated_long_or_damaged(tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    np.save(path, values("f4"))
    refused(lambda: open_source(cut(path, 1)), "truncated", "839 bytes", "840")
    with path.open("ab") as file:
        file.write(b"more")
    refused(lambda: open_source(path), "longer than the header says")
    path.write_bytes(path.read_bytes()[:40])
    refused(lambda: open_source(path), "header cannot be read")
    refused(lambda: open_source(path, "density"), "no such array", "density")


def test_a_file_larger_than_memory_is_read_by_the_box(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shape = (2500, 2000, 2000)  # 20 GB of holes
    path = tmp_path / "a.npy"
    np.lib.format.open_memmap(path, "w+", np.uint16, shape).flush()
    patch = values("u2", (3, 4, 5))
    np.load(path, mmap_mode="r+")[2000:2003, 1000:1004, 1500:1505] = patch
    counts, pread = [], os.pread
    monkeypatch.setattr(os, "pread", lambda file, count, at: counts.append(count) or pread(file, count, at))
    source = open_source(path)
    assert counts == []
    np.testing.assert_array_equal(source.read((2000, 1000, 1500), (2003, 1004, 1505)), patch)
    assert sum(counts) < 50_000
    assert not source.read((2499, 0, 0), (2500, 10, 2000)).any()
