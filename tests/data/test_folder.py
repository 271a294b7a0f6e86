"""Pictures, and folders of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile
from data.checks import check_source, cut, refused, values
from PIL import Image

from clusterviz.data import open_source
from clusterviz.data.axes import Subset


def fill(folder: Path, layers: np.ndarray, extension: str) -> Path:
    """Write slices whose names do not sort as text."""
    folder.mkdir()
    for z, layer in enumerate(layers):
        path = folder / f"slice {z + 7}{extension}"
        if extension == ".tif":
            tifffile.imwrite(path, layer, photometric="minisblack", resolution=(4, 2), imagej=True)
        else:
            Image.fromarray(layer).save(path)
    return folder


@pytest.mark.parametrize(
    ("extension", "dtype"),
    [(".tif", "u1"), (".tif", "u2"), (".tif", "f4"), (".png", "u1"), (".png", "u2"), (".bmp", "u1"), (".pgm", "u1")],
)
def test_slices_in_the_order_of_their_numbers(tmp_path: Path, extension: str, dtype: str) -> None:
    layers = values(dtype)
    folder = fill(tmp_path / "stack", layers, extension)
    (folder / ".hidden.png").write_bytes(b"")
    (folder / "notes.txt").write_text("not a slice")
    source = open_source(folder)
    check_source(source, layers)
    assert source.grid.spacing == ((0.25, 0.5, 1) if extension == ".tif" else (1, 1, 1))
    assert source.name == str(folder)


def test_masks_palettes_and_colours(tmp_path: Path) -> None:
    mask, indices, colours = values("u1")[0] > 99, values("u1")[1] % 8, values("u1", (3, 4, 5, 3))
    Image.fromarray(mask).save(tmp_path / "mask.png")
    check_source(open_source(tmp_path / "mask.png"), mask.astype("u1")[None])
    painted = Image.fromarray(indices)
    painted.putpalette(bytes(range(24)))
    painted.save(tmp_path / "palette.png")
    check_source(open_source(tmp_path / "palette.png"), indices[None])
    folder = fill(tmp_path / "stack", colours, ".png")
    check_source(open_source(folder, subset=Subset(channel="green")), colours[..., 1])
    refused(lambda: open_source(folder), "several channels", "red, green, blue")


def test_folders_that_are_no_stack(tmp_path: Path) -> None:
    layers = values("u1")
    refused(lambda: open_source(tmp_path), "a directory without slices", r"\.tif .*\.png")
    folder = fill(tmp_path / "stack", layers, ".png")
    Image.fromarray(layers[0, :, :3]).save(folder / "slice 9.png")
    source = open_source(folder)
    refused(lambda: source.read((0, 0, 0), (5, 6, 7)), "not of one size and type", "slice 9.png", "3 x 6", "7 x 6")
    np.testing.assert_array_equal(source.read((0, 0, 0), (2, 6, 7)), layers[:2])
    Image.fromarray(layers[0]).save(folder / "slice 8.bmp")
    refused(lambda: open_source(folder), "slices of several kinds", r"5 \.png", r"1 \.bmp")
    (tmp_path / "series").mkdir()
    (tmp_path / "series" / "IM0001").write_bytes(bytes(128) + b"DICM" + bytes(99))
    refused(lambda: open_source(tmp_path / "series"), "a DICOM series", "dcm2niix")
    (tmp_path / "stacks").mkdir()
    tifffile.imwrite(tmp_path / "stacks" / "a.tif", layers, photometric="minisblack")
    refused(lambda: open_source(tmp_path / "stacks"), "not a slice", "5 layers")


def test_truncated_damaged_and_lying_pictures(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    Image.fromarray(values("u1", (200, 300))).save(path)
    source = open_source(cut(path, path.stat().st_size // 2))
    refused(lambda: source.read((0, 0, 0), (1, 200, 300)), "cannot be decoded", "a.png")
    path.write_bytes(b"P5 7 6 255\n")
    refused(lambda: open_source(path).read((0, 0, 0), (1, 6, 7)), "a.png")
    path.with_suffix(".pgm").write_bytes(b"P5 9000 9000 255\n")
    refused(lambda: open_source(path.with_suffix(".pgm")), "lies about its size", "a.pgm")
    path.write_bytes(b"GIF? no")
    refused(lambda: open_source(path), "wrong magic", "a.png")
