from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest
from data.checks import DTYPES, check_source, cut, refused, values

from clusterviz.data import open_source
from clusterviz.data.axes import Subset


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("dtype", DTYPES)
def test_every_type_in_either_byte_order(tmp_path: Path, dtype: str, order: str, save: object) -> None:
    array = values(order + dtype)
    save(tmp_path / "a.npz", density=array)  # type: ignore[operator]
    check_source(open_source(tmp_path / "a.npz"), array)


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_arrays_by_name_or_alone_and_their_axes(tmp_path: Path, save: object) -> None:
    path, steps = tmp_path / "a.npz", values("<i2", (3, 4, 5, 6))
    save(path, line=np.arange(5), steps=np.asfortranarray(steps))  # type: ignore[operator]
    check_source(open_source(path, subset=Subset(time=2)), steps[2])
    assert open_source(path, subset=Subset(time=2)).name == f"{path}:steps:time=2"
    refused(lambda: open_source(path), "several time steps", "3 time steps")
    refused(lambda: open_source(path, "line"), "1 axes")
    refused(lambda: open_source(path, "gone"), "no such array", "gone", r"line \(5,\), steps \(3, 4, 5, 6\)")
    save(path, one=steps[0], two=steps[1])  # type: ignore[operator]
    refused(lambda: open_source(path), "several arrays", "one .*two")
    check_source(open_source(path, "two"), steps[1])
    save(path, a=np.arange(5), b=np.arange(4))  # type: ignore[operator]
    refused(lambda: open_source(path), "no volume", "a .5,.")


def test_truncated_damaged_and_wrong_sizes(tmp_path: Path) -> None:
    path, array = tmp_path / "a.npz", values("u1", (20, 30, 40)) % 50
    np.savez_compressed(path, a=array)
    whole = path.read_bytes()
    path.write_bytes(whole[:5000] + bytes(2000) + whole[7000:])
    source = open_source(path)
    refused(lambda: source.read((0, 0, 0), array.shape), "damaged or truncated: wrong checksum", "a.npz")
    path.write_bytes(whole)
    refused(lambda: open_source(cut(path, 10)), "truncated or damaged", "a.npz")
    path.write_bytes(b"PK\3\4" + bytes(100))
    refused(lambda: open_source(path), "truncated or damaged")
    path.write_bytes(b"\x89PNG")
    refused(lambda: open_source(path), "wrong magic")
    np.save(tmp_path / "a.npy", array)
    content = (tmp_path / "a.npy").read_bytes()
    for kind in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        for part, text in ((content[:-1], "truncated"), (content + b"!", "longer than the header says")):
            with zipfile.ZipFile(path, "w", kind) as archive:
                archive.writestr("a.npy", part)
            refused(lambda: open_source(path), text, "a.npz:a")
    with zipfile.ZipFile(path, "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr("a.npy", content)
    refused(lambda: open_source(path), "unsupported compression")
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a.npy", b"hello")
    refused(lambda: open_source(path), "header cannot be read", "a.npz:a")


def test_an_archive_larger_than_memory_is_read_by_the_box(tmp_path: Path) -> None:
    path, patch = tmp_path / "a.npz", values("u1", (1, 1, 9))
    shape = (1000, 1000, 1000)
    np.savez(path, a=np.zeros((1, 1, 1), "u1"))
    with zipfile.ZipFile(path) as archive:
        entry = archive.infolist()[0]
    with path.open("r+b") as file:
        begin = entry.header_offset + 30 + len("a.npy") + 20  # savez writes ZIP64 fields of 20 bytes
        file.seek(begin)
        np.lib.format.write_array_header_1_0(file, {"shape": shape, "fortran_order": False, "descr": "|u1"})
        header_bytes = file.tell() - begin
        file.seek(10**9 - 9, 1)
        file.write(patch.tobytes())
        end = file.tell()
    entry.file_size = entry.compress_size = header_bytes + 10**9
    with zipfile.ZipFile(path, "a") as archive:
        archive.fp.seek(end)
        archive.start_dir, archive.filelist, archive._didModify = end, [entry], True
    np.testing.assert_array_equal(open_source(path).read((999, 999, 991), shape), patch)
