"""OME-Zarr of other programs: axes, units, transforms, channels, images in a store, codecs, and damaged metadata."""

from __future__ import annotations

import asyncio
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr
from data.checks import check_placed, check_source, refused
from numpy.typing import NDArray
from zarr.codecs import BloscCodec, Crc32cCodec, GzipCodec, ZstdCodec

from clusterviz.data import open_scene, open_source
from clusterviz.data.axes import Subset, first_parts

FIELD = np.arange(3 * 4 * 5, dtype=">i2").reshape(3, 4, 5)
TYPES = {"t": "time", "c": "channel", "x": "space", "y": "space", "z": "space"}


def write_image(
    path: Path,
    array: NDArray[Any] = FIELD,
    axes: str = "zyx",
    units: tuple[str, ...] = (),
    transforms: tuple[dict[str, Any], ...] = (),
    around: tuple[dict[str, Any], ...] = (),
    version: str = "0.5",
    more: dict[str, Any] | None = None,
    **options: Any,
) -> Path:
    """Write an image with one level, `0`; `transforms` are the level's, `around` those of all levels."""
    zarr_format = 3 if version == "0.5" else 2
    group = zarr.open_group(str(path), mode="a", zarr_format=zarr_format)
    group.create_array("0", data=array, **options)
    names: list[dict[str, str]] = [{"name": name, "type": TYPES[name]} for name in axes]
    for name, unit in zip(names, units, strict=False):
        name |= {"unit": unit} if unit else {}
    scale = transforms or ({"type": "scale", "scale": [1.0] * array.ndim},)
    scales = {"axes": names, "datasets": [{"path": "0", "coordinateTransformations": scale}]}
    described = {"multiscales": [scales | ({"coordinateTransformations": around} if around else {})], **(more or {})}
    group.attrs.update({"ome": {"version": version, **described}} if version == "0.5" else described)
    return path


def scale(*numbers: float) -> dict[str, Any]:
    return {"type": "scale", "scale": numbers}


def shift(*numbers: float) -> dict[str, Any]:
    return {"type": "translation", "translation": numbers}


UM, NM = "micrometer", "nanometer"


@pytest.mark.parametrize(
    ("axes", "units", "transforms", "around", "matrix"),
    [
        ("zyx", (), (scale(4, 2.5, 2), shift(1, 2, 3)), (), [[2, 0, 0, 3], [0, 2.5, 0, 2], [0, 0, 4, 1]]),
        ("zyx", (), (scale(4, 2, 1), shift(1, 2, 3)), (scale(2, 2, 3), shift(5, 0, 7)),
         [[3, 0, 0, 16], [0, 4, 0, 4], [0, 0, 8, 7]]),
        ("zyx", (), ({"type": "identity"},), (scale(2, 3, 4),), [[4, 0, 0, 0], [0, 3, 0, 0], [0, 0, 2, 0]]),
        ("xyz", (), (scale(4, 2.5, 2), shift(1, 2, 3)), (), [[0, 0, 4, 1], [0, 2.5, 0, 2], [2, 0, 0, 3]]),
        ("yzx", (), (scale(4, 2.5, 2), shift(1, 2, 3)), (), [[2, 0, 0, 3], [0, 0, 4, 1], [0, 2.5, 0, 2]]),
        ("zyx", (UM, UM, UM), (scale(1.5, 1, 1),), (), [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1.5, 0]]),
        ("zyx", (UM, NM, NM), (scale(1.5, 20, 10), shift(1, 0, 0)), (),
         [[10, 0, 0, 0], [0, 20, 0, 0], [0, 0, 1500, 1000]]),
        ("zyx", (NM, "", ""), (scale(3, 1, 1),), (), [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 3, 0]]),
    ],
)  # fmt: skip
def test_axes_are_placed_by_name_and_unit(
    axes: str, units: tuple[str, ...], transforms: Any, around: Any, matrix: list[list[float]], tmp_path: Path
) -> None:
    for version in ("0.4", "0.5"):
        path = tmp_path / f"{version}.zarr"
        source = open_source(write_image(path, FIELD, axes, units, transforms, around, version))
        check_source(source, FIELD)
        check_placed(source, np.array([*matrix, [0, 0, 0, 1]], float))


@pytest.mark.parametrize(
    ("version", "options"),
    [
        ("0.4", {"chunks": (2, 3, 7), "compressors": {"id": "blosc", "cname": "lz4", "shuffle": 2}}),
        ("0.4", {"chunks": (64, 64, 64), "compressors": {"id": "gzip", "level": 5}, "order": "F"}),
        ("0.4", {"chunks": (1, 1, 1), "compressors": None}),
        ("0.5", {"chunks": (3, 5, 2), "compressors": [BloscCodec(cname="zstd")]}),
        ("0.5", {"chunks": (7, 11, 13), "compressors": [GzipCodec(), ZstdCodec()]}),
        ("0.5", {"chunks": (1, 2, 5), "shards": (3, 4, 5), "compressors": [GzipCodec()]}),
        ("0.5", {"chunks": (2, 2, 2), "filters": [zarr.codecs.TransposeCodec(order=(2, 0, 1))]}),
    ],
)
def test_chunks_and_codecs_of_others(version: str, options: dict[str, Any], tmp_path: Path) -> None:
    check_source(open_source(write_image(tmp_path / "a.zarr", version=version, **options)), FIELD)


def channel(label: str, color: str, *window: float, **more: Any) -> dict[str, Any]:
    ends = dict(zip(("start", "end", "min", "max"), window, strict=False))
    return {"label": label, "color": color, "window": ends, **more}


def test_channels_with_colours_become_volumes(tmp_path: Path) -> None:
    channels = [
        channel("DNA", "0000FF", 10, 200, 0, 255),
        channel("off", "FFFFFF", 0, 1, active=False),
        channel("actin", "00FF80", 5, 50.5, inverted=True),
    ]
    array = np.arange(2 * 3 * 2 * 3 * 4, dtype="u1").reshape(2, 3, 2, 3, 4)
    path = write_image(tmp_path / "a.zarr", array, "tczyx", more={"omero": {"channels": channels}})
    scene = open_scene(path, ["time=1"])
    found = [(each.channel, each.time, each.clim, each.cmap) for each in scene.volumes]
    assert found == [
        (0, 1, (10, 200), ((10, 0, 0, 0), (200, 0, 0, 1))),
        (2, 1, (5, 50.5), ((5, 0, 1, 128 / 255), (50.5, 0, 0, 0))),
    ]
    one = open_scene(path, ["channel=actin", "time=0"]).volumes
    assert [(each.channel, each.time, each.cmap) for each in one] == [("actin", 0, None)]
    check_source(open_source(path, subset=Subset(None, 1, "actin")), array[1, 2])
    check_source(open_source(path, subset=Subset("0", 0, 1)), array[0, 1])
    refused(lambda: open_source(path), "several time steps")
    refused(lambda: open_source(path, subset=Subset("7", 0, 1)), "7: no such array")
    for version, options in (
        ("0.4", {"chunks": (2, 3, 2, 2, 4)}),
        ("0.5", {"chunks": (1,) * 5, "shards": (1, 2, 2, 3, 4)}),
    ):
        placed = (scale(1, 1, 4, 2.5, 2), shift(0, 0, 1, 2, 3))
        several = write_image(tmp_path / version, array, "tczyx", (), placed, version=version, **options)
        source = open_source(several, subset=Subset(time=1, channel=2))
        check_source(source, array[1, 2])
        check_placed(source, np.array([[2, 0, 0, 3], [0, 2.5, 0, 2], [0, 0, 4, 1], [0, 0, 0, 1.0]]))
    del channels[2]["window"]
    path = write_image(tmp_path / "b.zarr", array, "tczyx", more={"omero": {"channels": channels}})
    assert [each.channel for each in open_scene(path).volumes] == [None]


def test_images_inside_a_store(tmp_path: Path) -> None:
    path = write_image(tmp_path / "a.zarr")
    labels = FIELD // 20
    write_image(path / "labels" / "cells", labels, transforms=(scale(2, 1, 1),))
    for name in ("labels/cells", "labels/cells/0"):
        source = open_source(path, name)
        check_source(source, labels)
        assert source.grid.spacing == (1, 1, 2)
    refused(lambda: open_source(path, "labels/nuclei"), "labels/nuclei: no such array")
    check_source(open_source(path / "labels" / "cells"), labels)
    series = zarr.open_group(str(tmp_path / "b.zarr"), mode="a", zarr_format=2)
    series.attrs["bioformats2raw.layout"] = 3
    write_image(tmp_path / "b.zarr" / "0", version="0.4")
    check_source(open_source(tmp_path / "b.zarr"), FIELD)
    write_image(tmp_path / "b.zarr" / "1", labels, version="0.4")
    refused(lambda: open_source(tmp_path / "b.zarr"), "several images")
    source, _, choices = first_parts(lambda part: open_source(tmp_path / "b.zarr", subset=part), Subset())
    check_source(source, FIELD)
    assert [str(choice) for choice in choices] == ["image 0 of 2 (0, 1)"]
    check_source(open_source(tmp_path / "b.zarr", "1"), labels)
    plate = zarr.open_group(str(tmp_path / "c.zarr"), mode="a")
    plate.attrs["ome"] = {"plate": {"wells": [{"path": "A/1"}, {"path": "B/2"}]}}
    write_image(tmp_path / "c.zarr" / "B" / "2" / "0")
    refused(lambda: open_source(tmp_path / "c.zarr"), "a plate", "A/1/0, B/2/0")
    check_source(open_source(tmp_path / "c.zarr", "B/2/0"), FIELD)


def edited(path: Path, name: str, *keys: Any, value: Any) -> None:
    """Change one value of a JSON file."""
    found = part = json.loads((path / name).read_text())
    for key in keys[:-1]:
        part = part[key]
    part[keys[-1]] = value
    (path / name).write_text(json.dumps(found))


LEVEL = ("attributes", "ome", "multiscales", 0, "datasets", 0, "coordinateTransformations", 0)
V2 = ("multiscales", 0)


@pytest.mark.parametrize(
    ("version", "name", "keys", "value", "text"),
    [
        ("0.5", "zarr.json", (*LEVEL, "scale"), [float("nan"), 1, 1], "not a position or spacing"),
        ("0.5", "zarr.json", (*LEVEL, "scale"), [1, 0, 1], "singular placement"),
        ("0.5", "zarr.json", (*LEVEL, "scale"), [1, 1], "transform .*scale and translation of 3"),
        ("0.5", "zarr.json", (*LEVEL, "scale"), "many", "a.zarr: damaged"),
        ("0.5", "zarr.json", (*LEVEL, "type"), "affine", "transform .*affine"),
        ("0.5", "zarr.json", (*LEVEL[:4], "axes"), [{"name": "z"}, {"name": "y"}], "levels disagree"),
        ("0.5", "zarr.json", (*LEVEL[:4], "axes", 0, "unit"), "furlong", "units that differ"),
        ("0.5", "zarr.json", (*LEVEL[:4], "datasets", 0, "path"), "9", "9: no such array"),
        ("0.5", "zarr.json", (*LEVEL[:4], "datasets"), 7, "a.zarr: damaged"),
        ("0.5", "zarr.json", ("attributes",), [], "an object"),
        ("0.5", "0/zarr.json", ("shape",), [10**12] * 3, "impossible size"),
        ("0.5", "0/zarr.json", ("shape",), [3, -4, 5], "a.zarr: damaged"),
        ("0.5", "0/zarr.json", ("chunk_grid", "configuration", "chunk_shape"), [10**6] * 3, "impossible size"),
        ("0.5", "0/zarr.json", ("codecs", 1), {"name": "imagecodecs_lerc"}, "_lerc.*pip install imagecodecs"),
        ("0.5", "0/zarr.json", ("codecs", 1), {"name": "acme"}, "not installed; found acme"),
        ("0.4", "0/.zarray", ("compressor",), {"id": "imagecodecs_jpeg2k"}, "jpeg2k.*pip install imagecodecs"),
        ("0.4", "0/.zarray", ("filters",), [{"id": "acme"}], "not installed; found acme"),
        ("0.4", "0/.zarray", ("chunks",), [0, 1, 1], "impossible size"),
    ],
)  # fmt: skip
def test_damaged_metadata(version: str, name: str, keys: Any, value: Any, text: str, tmp_path: Path) -> None:
    path = write_image(tmp_path / "a.zarr", axes="zyx", units=("", UM, UM), version=version, compressors="auto")
    edited(path, name, *keys, value=value)
    refused(lambda: open_source(path), "a.zarr", text)


@pytest.mark.parametrize("name", ["/{}/other.zarr/0", "../other.zarr/0", "0/../../other.zarr/0", "%2e%2e/other.zarr/0"])
@pytest.mark.parametrize("version", ["0.4", "0.5"])
def test_paths_that_lead_out_of_a_store_are_refused(name: str, version: str, tmp_path: Path) -> None:
    path, name = write_image(tmp_path / "a.zarr", version=version), name.format(str(tmp_path)[1:])
    write_image(tmp_path / "other.zarr", version=version)
    refused(lambda: open_source(path, name), "outside of the store", name)
    file, keys = ("zarr.json", LEVEL[:5]) if version == "0.5" else (".zattrs", (*V2, "datasets"))
    transform = {"coordinateTransformations": [scale(1, 1, 1)]}
    for before in ([], [{"path": "0", **transform}]):
        edited(path, file, *keys, value=[*before, {"path": name, **transform}])
        refused(lambda: open_source(path), "a.zarr: an array outside of the store", name)


def test_chunks_that_change_under_a_running_job(tmp_path: Path) -> None:
    path = write_image(tmp_path / "a.zarr", chunks=(3, 4, 2))
    source = open_source(path)
    (path / "0/c/0/0/2").unlink()
    expected = FIELD.astype("i2")
    expected[..., 4:] = 0
    check_source(source, expected)
    other = write_image(tmp_path / "b.zarr", FIELD + 1, chunks=(3, 4, 2))
    shutil.copy(other / "0/c/0/0/1", path / "0/c/0/0/1")
    source.read((0, 0, 0), (3, 4, 2))
    refused(lambda: source.read((0, 0, 0), (3, 4, 5)), "c/0/0/1", "changed while it was in use")
    (path / "0/c/0/0/0").unlink()
    refused(lambda: source.read((0, 0, 0), (3, 4, 2)), "c/0/0/0", "removed while it was in use")
    source = open_source(other)
    shutil.rmtree(other)
    refused(lambda: source.read((0, 0, 0), (3, 4, 2)), "b.zarr/0", "removed while it was in use")


def test_a_refused_chunk_leaves_no_reading_of_others_behind(tmp_path: Path) -> None:
    path = write_image(tmp_path / "a.zarr", chunks=(1, 1, 1), compressors=ZstdCodec())
    for chunk in path.glob("0/c/1/*/*"):
        chunk.write_bytes(b"not zstd")
    source = open_source(path)
    refused(lambda: source.read((0, 0, 0), FIELD.shape), "a.zarr")
    (zarr_loop,) = zarr.core.sync.loop
    assert not asyncio.all_tasks(zarr_loop)


@pytest.mark.parametrize("is_part", [False, True])
@pytest.mark.parametrize(
    ("version", "options"),
    [
        ("0.4", {"chunks": (3, 4, 5), "compressors": {"id": name}})
        for name in ("blosc", "gzip", "zlib", "bz2", "lz4", "zstd")
    ]
    + [("0.5", {"chunks": (3, 4, 5), "compressors": codecs}) for codecs in ([BloscCodec()], [GzipCodec(), ZstdCodec()])]
    + [("0.5", {"chunks": (1, 4, 5), "shards": (3, 4, 5), "compressors": [ZstdCodec(), Crc32cCodec()]})],
)
def test_chunks_larger_than_the_array_says(
    version: str, options: dict[str, Any], is_part: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("clusterviz.data.store.zarr_files.HARMLESS_BYTES", 0)
    large = np.ones((3 << 6, 64, 64), np.int16)
    shards = {"shards": large.shape, "chunks": (1 << 6, 64, 64)} if "shards" in options else {"chunks": large.shape}
    path = write_image(tmp_path / "a.zarr", version=version, **options)
    check_source(open_source(path), FIELD)
    bomb = write_image(tmp_path / "b.zarr", large, version=version, **options | shards)
    name = "0/c/0/0/0" if version == "0.5" else "0/0.0.0"
    shutil.copy(bomb / name, path / name)
    refused(
        lambda: open_source(path).read((0, 0, 0), (1 if is_part else 3, 4, 5)), "a chunk is larger than the array says"
    )
