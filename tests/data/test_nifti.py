from __future__ import annotations

import gzip
from pathlib import Path

import nibabel
import numpy as np
import pytest
from data.checks import check_placed, check_source, cut, refused, values

from clusterviz.data import open_source
from clusterviz.data.axes import Subset

SHEARED = np.array([[-2, 0.5, 0, 10], [0, 3, 0.1, -20], [0.2, 0, 0.5, 30], [0, 0, 0, 1.0]])


def write(path: Path, array: np.ndarray, affine: np.ndarray | None = None, version: int = 1, **header: object) -> Path:
    """Write `array`, which is (z, y, x) or (t, z, y, x)."""
    kind = nibabel.Nifti1Image if version == 1 else nibabel.Nifti2Image
    image = kind(array.T, np.eye(4) if affine is None else affine, dtype=array.dtype)
    for key, value in header.items():
        image.header[key] = value
    nibabel.save(image, path)
    return path


@pytest.mark.parametrize("name", ["a.nii", "a.nii.gz"])
@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("dtype", ["i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8"])
def test_every_type_in_either_byte_order(tmp_path: Path, name: str, order: str, dtype: str) -> None:
    array = values(dtype)
    header = nibabel.Nifti1Header(endianness=order)
    header.set_data_dtype(np.dtype(dtype).newbyteorder(order))
    header.set_data_shape(array.T.shape)
    header["magic"], header["vox_offset"] = b"n+1", 352
    header.set_sform(SHEARED, 1)
    content = header.binaryblock + bytes(4) + array.astype(order + dtype).tobytes()
    path = tmp_path / name
    path.write_bytes(gzip.compress(content) if name.endswith("gz") else content)
    source = open_source(path)
    check_source(source, array)
    check_placed(source, SHEARED)


def test_nifti_2(tmp_path: Path) -> None:
    check_source(open_source(write(tmp_path / "a.nii", values("i2"), version=2)), values("i2"))


@pytest.mark.parametrize("name", ["a.nii", "a.nii.gz"])
def test_slope_and_intercept(tmp_path: Path, name: str) -> None:
    array = values("i2")
    image = nibabel.Nifti1Image(array.T, np.eye(4))
    image.header.set_slope_inter(0.25, -3)
    nibabel.save(image, tmp_path / name)
    content = tmp_path / name
    raw = bytearray(gzip.decompress(content.read_bytes()) if name.endswith("gz") else content.read_bytes())
    raw[112:120] = np.array([0.25, -3], "<f4").tobytes()
    raw[352:] = array.tobytes()
    content.write_bytes(gzip.compress(raw) if name.endswith("gz") else raw)
    check_source(open_source(content), (array * 0.25 - 3).astype(np.float32))
    np.testing.assert_array_equal(
        open_source(content).read((0, 0, 0), array.shape), nibabel.load(content).get_fdata().T.astype(np.float32)
    )


def test_one_time_step_needs_no_name_and_several_do(tmp_path: Path) -> None:
    steps = values("i2", (3, 4, 5, 6))
    one = write(tmp_path / "one.nii", steps[:1])
    check_source(open_source(one), steps[0])
    check_source(open_source(one, subset=Subset(time=0)), steps[0])
    for name in ("all.nii", "all.nii.gz"):
        path = write(tmp_path / name, steps)
        check_source(open_source(path, subset=Subset(time=0)), steps[0])
        check_source(open_source(path, subset=Subset(time=2)), steps[2])
        refused(lambda path=path: open_source(path), "several time steps", "0 to 2")
        refused(lambda path=path: open_source(path, subset=Subset(time=3)), "no such time step", "3", "0 to 2")
    refused(lambda: open_source(one, "t"), "no such array")


def test_a_singular_affine(tmp_path: Path) -> None:
    flat = np.diag([1.0, 1, 1, 1])
    flat[:3, 2] = flat[:3, 0]
    refused(lambda: open_source(write(tmp_path / "a.nii", values("u1"), flat)), "singular placement")


def test_colours_and_vectors(tmp_path: Path) -> None:
    colours = np.zeros((2, 3, 4), [("R", "u1"), ("G", "u1"), ("B", "u1")])
    refused(lambda: open_source(write(tmp_path / "a.nii", colours)), "not a scalar volume")
    refused(
        lambda: open_source(write(tmp_path / "b.nii", values("c8".replace("c8", "f4")).astype("c8"))), "not a scalar"
    )
    refused(lambda: open_source(write(tmp_path / "c.nii", values("f4", (3, 1, 2, 3, 4)))), "several channels")


def test_truncated_empty_axis_and_wrong_magic(tmp_path: Path) -> None:
    path = write(tmp_path / "a.nii", values("f4"))
    refused(lambda: open_source(cut(path, 1)), "truncated", "a.nii")
    content = bytearray(write(tmp_path / "b.nii", values("f4")).read_bytes())
    content[42:44] = b"\0\0"
    path.write_bytes(content)
    refused(lambda: open_source(path), "no samples|header")
    path.write_bytes(b"\x89PNG" + bytes(1000))
    refused(lambda: open_source(path), "wrong magic")
    path.write_bytes(content[:100])
    refused(lambda: open_source(path), "a.nii")
    packed = tmp_path / "c.nii.gz"
    packed.write_bytes(content)
    refused(lambda: open_source(packed), "wrong magic", "gzip")


def test_damage_in_compressed_data_is_found_when_read(tmp_path: Path) -> None:
    path = write(tmp_path / "a.nii.gz", values("f4", (40, 50, 60)))
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    source = open_source(path)
    refused(lambda: source.read((39, 0, 0), (40, 50, 60)), "truncated|damaged", "a.nii.gz")
    path.write_bytes(whole[: len(whole) // 2] + bytes(99) + whole[len(whole) // 2 + 99 :])
    refused(lambda: open_source(path).read((0, 0, 0), (40, 50, 60)), "truncated|damaged")
    short = gzip.compress(gzip.decompress(whole)[:-5])
    path.write_bytes(short)
    refused(lambda: open_source(path).read((39, 0, 0), (40, 50, 60)), "truncated", "when decompressed")


def test_a_file_larger_than_memory_is_read_by_the_box(tmp_path: Path) -> None:
    header = nibabel.Nifti2Header()
    header.set_data_dtype("<u2")
    header.set_data_shape((2000, 2000, 2500))
    header["magic"], header["vox_offset"] = b"n+2\0\r\n\x1a\n", 544
    path, patch = tmp_path / "a.nii", values("u2", (1, 1, 5))
    path.write_bytes(header.binaryblock + bytes(4))
    with path.open("r+b") as file:
        file.truncate(544 + 2 * 2000 * 2000 * 2500)
        file.seek(544 + 2 * ((2400 * 2000 + 1000) * 2000 + 3))
        file.write(patch.tobytes())
    np.testing.assert_array_equal(open_source(path).read((2400, 1000, 3), (2401, 1001, 8)), patch)
