"""Picture files: round trips and failed writes."""

from __future__ import annotations

import os
import resource
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from clusterviz.errors import InputError, OutputError
from clusterviz.image import check_writable, finish, read_image, write_image
from clusterviz.image.picture import Image as Picture
from clusterviz.image.replace import replacing

FORMATS = [".npy", ".png", ".exr", ".npz"]


def picture(height: int = 9, width: int = 7) -> np.ndarray:
    rng = np.random.default_rng(5)
    rgba = rng.random((height, width, 4), np.float32)
    rgba[..., :3] *= rgba[..., 3:]
    return rgba


@contextmanager
def disk_full_after(size: int) -> Iterator[None]:
    """Limit files to `size` bytes, so that writing fails as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    sys.dont_write_bytecode = True  # modules that are compiled meanwhile would be kept cut off
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        sys.dont_write_bytecode = False
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("extension", [".npy", ".exr", ".npz"])
@pytest.mark.parametrize("size", [(9, 7), (1, 1), (1, 300), (300, 1)])
def test_float_formats_are_exact(tmp_path: Path, extension: str, size: tuple[int, int]) -> None:
    rgba = picture(*size)
    rgba[0, 0] = [2.5, -1e-30, 1e30, 1e-8]
    for each in (rgba, rgba[::-1, ::2]):
        write_image(tmp_path / f"a{extension}", each, (1, 1, 1))
        read = read_image(tmp_path / f"a{extension}")
        assert read.dtype == np.float32
        assert np.array_equal(read, each)


def test_layers_are_named_channels_and_arrays(tmp_path: Path) -> None:
    rgba = picture(9, 7)
    depth = np.full((9, 7), np.inf, np.float32)
    depth[0] = 1e9
    layers = {"depth": depth, "normal": rgba[..., :3], "object": np.full((9, 7), -1, np.int32)}
    Picture(rgba, layers=layers).save(tmp_path / "a.exr")
    write_image(tmp_path / "a.npz", rgba, None, layers=layers)
    with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        channels = {name: channel.pixels for name, channel in file.channels().items()}
    assert set("RGBA") | {"depth.Z", "normal.X", "normal.Y", "normal.Z", "object.ID"} == set(channels)
    with np.load(tmp_path / "a.npz") as arrays:
        assert {name: arrays[name].dtype for name in arrays} == {
            "rgba": "f4",
            "depth": "f4",
            "normal": "f4",
            "object": "i4",
        }
        assert all(np.array_equal(arrays[name], layers[name], equal_nan=True) for name in layers)
    assert np.array_equal(channels["depth.Z"], layers["depth"], equal_nan=True)
    assert np.array_equal(channels["normal.Y"], layers["normal"][..., 1])
    assert np.array_equal(channels["object.ID"], layers["object"])
    assert all(np.array_equal(read_image(tmp_path / name), rgba) for name in ("a.exr", "a.npz"))
    with pytest.raises(OutputError, match=r"holds no layers; found \.png; allowed \.exr, \.npz"):
        write_image(tmp_path / "a.png", rgba, None, layers=layers)


@pytest.mark.parametrize("background", [None, (1.0, 0.5, 0.0)])
def test_png_holds_the_finished_bytes(tmp_path: Path, background: tuple[float, float, float] | None) -> None:
    write_image(tmp_path / "a.PNG", picture(), background)
    with Image.open(tmp_path / "a.PNG") as file:
        assert file.format == "PNG"
        assert np.array_equal(np.asarray(file), finish(picture(), background))


def test_png_reads_as_premultiplied(tmp_path: Path) -> None:
    write_image(tmp_path / "a.png", picture(), None)
    assert np.abs(read_image(tmp_path / "a.png") - picture()).max() <= 1 / 255


@pytest.mark.parametrize("extension", FORMATS)
@pytest.mark.parametrize("room", [0, 1, 60, 1000])
def test_disk_full_leaves_the_old_file_and_nothing_else(tmp_path: Path, extension: str, room: int) -> None:
    path = tmp_path / f"a{extension}"
    path.write_bytes(b"old")
    with disk_full_after(room), pytest.raises(OutputError, match=path.name):
        write_image(path, picture(90, 70) if room > 100 else picture(5, 3), None)
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == [path.name]


@pytest.mark.parametrize("missing", [1, 200, 500])
def test_an_exr_that_lacks_its_last_bytes_is_noticed(tmp_path: Path, missing: int) -> None:
    write_image(tmp_path / "whole.exr", picture(40, 3), None)
    room = (tmp_path / "whole.exr").stat().st_size - missing
    with disk_full_after(room), pytest.raises(OutputError, match=r"part\.exr"):
        write_image(tmp_path / "part.exr", picture(40, 3), None)
    assert os.listdir(tmp_path) == ["whole.exr"]


@pytest.mark.parametrize(
    ("name", "said"),
    [
        *((f"{folder}/a{extension}", folder) for folder in ("missing", "file", "/proc") for extension in FORMATS),
        ("folder.png", "a folder"),
        *((name, r"\.png, \.npy, \.exr") for name in ("a.bmp", "a", ".png")),
    ],
)
def test_what_cannot_be_written_is_named(tmp_path: Path, name: str, said: str) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "folder.png").mkdir()
    for attempt in (check_writable, lambda path: write_image(path, picture(), None)):
        with pytest.raises(OutputError, match=said):
            attempt(tmp_path / name)
    if said.startswith(r"\."):
        with pytest.raises(InputError, match=said):
            read_image(tmp_path / name)
    assert sorted(os.listdir(tmp_path)) == ["file", "folder.png"]


def test_check_writable_leaves_nothing_and_harms_nothing(tmp_path: Path) -> None:
    (tmp_path / "old.png").write_bytes(b"old")
    check_writable(tmp_path / "old.png")
    check_writable(tmp_path / "new.png")
    assert os.listdir(tmp_path) == ["old.png"]
    assert (tmp_path / "old.png").read_bytes() == b"old"


def test_new_files_get_the_usual_permissions(tmp_path: Path) -> None:
    (tmp_path / "plain").touch()
    write_image(tmp_path / "a.npy", picture(), None)
    assert (tmp_path / "a.npy").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_an_interrupt_leaves_nothing(tmp_path: Path) -> None:
    def interrupted() -> None:
        with replacing(tmp_path / "movie.mp4") as temporary:
            assert temporary.suffix == ".mp4"
            temporary.write_bytes(b"half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("shape", [(4, 4), (4, 4, 3), (0, 4, 4)])
def test_what_is_no_picture_is_not_written(tmp_path: Path, shape: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="not a picture"):
        write_image(tmp_path / "a.npy", np.zeros(shape, np.float32), None)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("extension", FORMATS)
def test_files_that_are_no_pictures_are_named(tmp_path: Path, extension: str) -> None:
    path = tmp_path / f"a{extension}"
    with pytest.raises(InputError, match=path.name):
        read_image(path)
    write_image(path, picture(90, 70), None)
    for content in (path.read_bytes()[: path.stat().st_size // 2], b"", b"not a picture at all"):
        path.write_bytes(content)
        with pytest.raises(InputError, match=path.name):
            read_image(path)
    np.save(tmp_path / "b.npy", np.zeros((3, 3)))
    with pytest.raises(InputError, match=r"\(3, 3\)"):
        read_image(tmp_path / "b.npy")


@pytest.mark.parametrize("name", ["a.jpg", "a.jpeg", "a.gif"])
def test_pictures_for_the_web_are_over_the_background(name: str, tmp_path: Path) -> None:
    rgba = np.zeros((8, 8, 4), np.float32)
    rgba[:4] = 1.0
    write_image(tmp_path / name, rgba, (1.0, 0.0, 0.0))
    seen = read_image(tmp_path / name)
    assert np.abs(seen[:2] - 1).max() < 0.05
    assert np.abs(seen[6:] - np.float32([1, 0, 0, 1])).max() < 0.05
    if name != "a.gif":
        with pytest.raises(OutputError, match="cannot be transparent"):
            write_image(tmp_path / "b.jpg", rgba, None)
        assert not (tmp_path / "b.jpg").exists()
