from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from data.checks import DTYPES, check_placed, check_source, cut, refused, values

from clusterviz.data import open_source


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("dtype", DTYPES)
def test_every_type_in_either_byte_order(tmp_path: Path, dtype: str, order: str) -> None:
    array = values(order + dtype)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("density", data=array, chunks=(2, 3, 4), compression="gzip")
    check_source(open_source(tmp_path / "a.h5"), array)


@pytest.fixture
def several(tmp_path: Path) -> Path:
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file["one"] = values("f4")
        file["group/two"] = values("i2")
        file["mask"] = values("u1") > 100
        file["line"] = np.arange(5)
        file["vectors"] = np.zeros((2, 3, 4, 3))
        file["colours"] = np.zeros((2, 3, 4), [("r", "u1"), ("g", "u1")])
        file["waves"] = np.zeros((2, 3, 4), complex)
        file["picture"] = np.arange(12.0).reshape(3, 4)
        file["none"] = np.zeros((2, 0, 3))
    return path


def test_datasets_are_named_in_the_path_or_beside_it(several: Path) -> None:
    check_source(open_source(f"{several}:/group/two"), values("i2"))
    check_source(open_source(several, "/one"), values("f4"))
    check_source(open_source(several, "group/two"), values("i2"))
    check_source(open_source(f"{several}:/mask"), (values("u1") > 100).astype(np.uint8))
    check_source(open_source(f"{several}:/picture"), np.arange(12.0).reshape(1, 3, 4))
    assert open_source(f"{several}:/group/two").name == f"{several}:/group/two"


def test_what_is_no_volume_is_refused(several: Path) -> None:
    refused(lambda: open_source(several), "several volumes", "/one", "/group/two")
    refused(lambda: open_source(f"{several}:/gone"), "no such array", "/gone", "/group/two")
    refused(lambda: open_source(several, "group"), "no such array")
    refused(lambda: open_source(f"{several}:/one", "/mask"), "two arrays")
    refused(lambda: open_source(several, "vectors"), "several time steps", "2 time steps", "/vectors")
    refused(lambda: open_source(several, "line"), "1 axes")
    refused(lambda: open_source(several, "colours"), "not a scalar volume")
    refused(lambda: open_source(several, "waves"), "not a scalar volume")
    refused(lambda: open_source(several, "none"), "no samples")


def test_no_volume_at_all(tmp_path: Path) -> None:
    h5py.File(tmp_path / "a.hdf5", "w").close()
    refused(lambda: open_source(tmp_path / "a.hdf5"), "no 3-D dataset", "holds no dataset")


def test_attributes_place_the_volume(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["one"] = values("u1")
        file["one"].attrs["spacing"], file["one"].attrs["origin"] = [2.0, 3, 4], [5, 6, 7]
        file["two"] = values("u1")
        file["two"].attrs["element_size_um"] = [4.0, 3, 2]
        file["bad"] = values("u1")
        file["bad"].attrs["spacing"] = [0.0, 1, 1]
    expected = np.array([[2, 0, 0, 5], [0, 3, 0, 6], [0, 0, 4, 7], [0, 0, 0, 1.0]])
    check_placed(open_source(tmp_path / "a.h5", "one"), expected)
    expected[:3, 3] = 0
    check_placed(open_source(tmp_path / "a.h5", "two"), expected)
    refused(lambda: open_source(tmp_path / "a.h5", "bad"), "singular placement")


def test_truncated_and_wrong_magic(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file["one"] = values("f8", (20, 30, 40))
    refused(lambda: open_source(cut(path, 1000)), "truncated", "a.h5")
    path.write_bytes(b"not hdf5 at all")
    refused(lambda: open_source(path), "wrong magic")


def test_a_damaged_chunk_is_found_when_read(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        data = file.create_dataset("one", data=values("f8", (20, 30, 40)), chunks=(20, 30, 40), compression="gzip")
        begin = data.id.get_chunk_info(0).byte_offset
    content = bytearray(path.read_bytes())
    content[begin + 100 : begin + 200] = bytes(100)
    path.write_bytes(content)
    refused(lambda: open_source(path).read((0, 0, 0), (1, 1, 1)), "cannot be read", "a.h5:/one")


def test_a_file_larger_than_memory_is_read_by_the_box(tmp_path: Path) -> None:
    patch = values("u2", (1, 1, 5))
    with h5py.File(tmp_path / "a.h5", "w") as file:
        big = file.create_dataset("big", (2500, 2000, 2000), "u2", chunks=(16, 64, 64))
        big[2400, 1000, 3:8] = patch[0, 0]
    source = open_source(tmp_path / "a.h5")
    np.testing.assert_array_equal(source.read((2400, 1000, 3), (2401, 1001, 8)), patch)
