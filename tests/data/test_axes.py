"""Time steps and channels of every format that has them."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from pathlib import Path

import h5py
import nibabel
import nrrd
import numpy as np
import pytest
import tifffile
import yaml
from data.checks import check_placed, check_source, cut, refused, values

from clusterviz.data import open_source, open_volume
from clusterviz.data.axes import Subset
from clusterviz.scene import Volume

ARRAY = values("<i2", (3, 2, 4, 5, 6))  # time, channel, z, y, x


def _npy(path: Path) -> None:
    np.save(path, ARRAY)


def _fortran(path: Path) -> None:
    np.save(path, np.asfortranarray(ARRAY))


def _raw(path: Path) -> None:
    ARRAY.tofile(path)
    path.with_name(path.name + ".yaml").write_text(yaml.safe_dump({"shape": list(ARRAY.shape), "dtype": "int16"}))


def _nrrd(path: Path) -> None:
    array = np.moveaxis(ARRAY, 1, -1)
    kinds = ["vector", "domain", "domain", "domain", "time"]
    nrrd.write(str(path), array, {"encoding": "gzip", "kinds": kinds}, index_order="C")


def _metaimage(path: Path) -> None:
    head = "NDims = 4\nDimSize = 6 5 4 3\nElementNumberOfChannels = 2\nCompressedData = True\n"
    content = f"{head}ElementType = MET_SHORT\nElementDataFile = LOCAL\n".encode()
    path.write_bytes(content + zlib.compress(np.moveaxis(ARRAY, 1, -1).tobytes()))


def _nifti(path: Path) -> None:
    nibabel.save(nibabel.Nifti1Image(np.moveaxis(ARRAY, 1, 0).T, np.eye(4), dtype="<i2"), path)


def _imagej(path: Path) -> None:
    metadata = {"axes": "TZCYX"}
    tifffile.imwrite(path, np.moveaxis(ARRAY, 1, 2), imagej=True, byteorder=">", metadata=metadata)


def _pages(path: Path) -> None:
    metadata = {"axes": "TCZYX", "Channel": {"Name": ["DAPI", "GFP"]}}
    tifffile.imwrite(path, ARRAY, ome=True, compression="zlib", photometric="minisblack", metadata=metadata)


def _interleaved(path: Path) -> None:
    array = np.moveaxis(ARRAY.astype("u2"), 1, -1)
    array = np.concatenate([array, array[..., :1]], axis=-1)
    tifffile.imwrite(path, array, photometric="rgb", metadata={"axes": "TZYXS"})


def _hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file.create_dataset("a", data=np.moveaxis(ARRAY, 0, 2), chunks=True)
        for axis, label in zip(file["a"].dims, "cztyx", strict=True):
            axis.label = label


WRITERS: list[tuple[str, Callable[[Path], None]]] = [
    ("a.npy", _npy),
    ("b.npy", _fortran),
    ("a.raw", _raw),
    ("a.nrrd", _nrrd),
    ("a.mha", _metaimage),
    ("a.nii", _nifti),
    ("a.nii.gz", _nifti),
    ("a.tif", _imagej),
    ("a.ome.tif", _pages),
    ("b.tif", _interleaved),
    ("a.h5", _hdf5),
]


@pytest.mark.parametrize(("name", "write"), WRITERS)
def test_each_step_and_channel_of_every_format(tmp_path: Path, name: str, write: Callable[[Path], None]) -> None:
    path = tmp_path / name
    write(path)
    for time, channel in ((0, 0), (2, 1), (1, 1)):
        source = open_source(path, subset=Subset(time=time, channel=channel))
        expected = ARRAY.astype("u2") if write is _interleaved else ARRAY
        check_source(source, expected[time, channel])
        assert f"time={time}" in source.name
    channels = 3 if write is _interleaved else 2
    refused(lambda: open_source(path, subset=Subset(channel=0)), "several time steps", "3 time steps", "time: 0 to 2")
    refused(
        lambda: open_source(path, subset=Subset(time=0)), "several channels", f"{channels} channels", "channel: 0 to"
    )
    refused(lambda: open_source(path, subset=Subset(time=3, channel=0)), "no such time step", "3, and 3 time steps")
    refused(lambda: open_source(path, subset=Subset(time=0, channel="far")), "no such channel", "far")
    first = open_source(path, subset=Subset(first=True))
    np.testing.assert_array_equal(first.read((3, 4, 0), (4, 5, 6)), expected[0, 0, 3:, 4:])


def test_channels_by_name(tmp_path: Path) -> None:
    _pages(tmp_path / "a.ome.tif")
    source = open_source(tmp_path / "a.ome.tif", subset=Subset(time=1, channel="GFP"))
    check_source(source, ARRAY[1, 1])
    assert source.name.endswith(":time=1:channel=GFP")
    refused(lambda: open_source(tmp_path / "a.ome.tif", subset=Subset(time=1, channel="gfp")), "DAPI, GFP")
    _interleaved(tmp_path / "b.tif")
    check_source(open_source(tmp_path / "b.tif", subset=Subset(time=2, channel="green")), ARRAY.astype("u2")[2, 1])


@pytest.mark.parametrize("extension", [".npy", ".raw", ".nii"])
def test_every_step_is_counted_in_the_size(tmp_path: Path, extension: str) -> None:
    path = tmp_path / f"a{extension}"
    dict(zip((".npy", ".raw", ".nii"), (_npy, _raw, _nifti), strict=True))[extension](path)
    refused(lambda: open_source(cut(path, 1), subset=Subset(time=0, channel=0)), "truncated", path.name)


def test_four_axes_without_names_are_time_or_channels(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", ARRAY[:, 0])
    check_source(open_source(tmp_path / "a.npy", subset=Subset(time=2)), ARRAY[2, 0])
    check_source(open_source(tmp_path / "a.npy", subset=Subset(channel=1)), ARRAY[1, 0])


def test_a_volume_alone_has_step_0_and_channel_0_and_no_others(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", ARRAY[0, 0])
    check_source(open_source(tmp_path / "a.npy", subset=Subset(time=0, channel=0)), ARRAY[0, 0])
    refused(lambda: open_source(tmp_path / "a.npy", subset=Subset(time=1)), "no such time step", "1 time step")
    refused(lambda: open_source(tmp_path / "a.npy", subset=Subset(channel="red")), "no such channel", "channel: 0")


def test_pictures_over_time_are_a_stack_unless_a_time_is_named(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "a.tif", ARRAY[:, 0, 0], imagej=True, metadata={"axes": "TYX"})
    check_source(open_source(tmp_path / "a.tif"), ARRAY[:, 0, 0])
    check_source(open_source(tmp_path / "a.tif", subset=Subset(time=1)), ARRAY[1:2, 0, 0])


def test_a_scene_places_its_volume_where_it_says(tmp_path: Path) -> None:
    path, turned = tmp_path / "a.raw", [[0, -0.7071, 0.7071], [1, 0, 0], [0, 0.7071, 0.7071]]
    _raw(path)
    keys = {"shape": list(ARRAY.shape), "dtype": "int16", "spacing": [1, 2, 4], "origin": [7, 8, 9]}
    path.with_name("a.raw.yaml").write_text(yaml.safe_dump(keys))
    part = {"path": str(path), "time": 2, "channel": 1}
    check_placed(
        open_volume(Volume.model_validate(part)), np.array([[1, 0, 0, 7], [0, 2, 0, 8], [0, 0, 4, 9], [0, 0, 0, 1]])
    )
    moved = open_volume(Volume.model_validate({**part, "direction": turned, "origin": [1, 2, 3]}))
    check_source(moved, ARRAY[2, 1])
    half = 0.5**0.5
    expected = np.array([[0, -2 * half, 4 * half, 1], [1, 0, 0, 2], [0, 2 * half, 4 * half, 3], [0, 0, 0, 1]])
    check_placed(moved, expected)
    spaced = open_volume(Volume.model_validate({**part, "spacing": [0.1, 0.2, 0.3]}))
    assert spaced.grid.spacing == pytest.approx((0.1, 0.2, 0.3))
    assert spaced.grid.origin == (7, 8, 9)
