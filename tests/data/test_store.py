"""Stores: the codec of bricks and its error bound, levels, writing on several processes, and damaged stores."""

from __future__ import annotations

import gc
import json
import os
import shutil
import struct
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import google_crc32c
import numpy as np
import pytest
import zarr
import zstandard
from data.checks import DTYPES, check_placed, check_source, check_summary, refused, values
from hypothesis import given, settings
from hypothesis import strategies as some

from clusterviz.comm import LoopbackChannel, agree, run_loopback
from clusterviz.data import open_source, override_grid
from clusterviz.data.axes import Subset
from clusterviz.data.bricks import BrickLayout, read_bricks
from clusterviz.data.memory import ArraySource
from clusterviz.data.series import Series, open_series
from clusterviz.data.source import Grid, levels_of
from clusterviz.data.store import zfp
from clusterviz.data.store.cache import CACHE, BrickCache, Owner
from clusterviz.data.store.levels import coarser, difference, low_pass
from clusterviz.data.store.shards import BrickCodec, description_checksum
from clusterviz.data.store.wavelet import decode_brick, encode_brick
from clusterviz.data.store.writer import StoreWriter, write_store
from clusterviz.data.summary import kept_summary, summarise
from clusterviz.errors import DataError, InputError, OutputError, RankError
from clusterviz.frame.opening import open_content
from clusterviz.frame.run import Options, Run
from clusterviz.scene.values import Scene, Volume

SHAPES = [(1, 1, 1), (1, 1, 2), (2, 1, 1), (1, 9, 4), (33, 1, 2), (5, 6, 7), (16, 17, 9), (1, 64, 80)]


def samples_of(kind: str, dtype: str, shape: tuple[int, ...]) -> np.ndarray:
    """Samples of a type: both ends of its range among noise, few values, one value, or a smooth field."""
    native = np.dtype(dtype)
    if kind == "noise":
        return values(dtype, shape) if np.prod(shape) >= 4 else values(dtype, (4,))[: np.prod(shape)].reshape(shape)
    z, y, x = np.indices(shape)
    if kind == "labels":
        return (1 + 31 * ((z // 3 + y // 4 + x // 5) % 4)).astype(native)
    if kind == "constant":
        return np.full(shape, -0.0 if native.kind == "f" else 7, native)
    return (60 + 40 * np.sin(z / 5 + y / 7) * np.cos(x / 6)).astype(native)


KINDS = ("noise", "labels", "constant", "smooth")


@pytest.mark.parametrize("dtype", DTYPES)
def test_bricks_come_back_bit_for_bit(dtype: str) -> None:
    for shape in SHAPES:
        for kind in KINDS:
            brick = samples_of(kind, dtype, shape)
            again = decode_brick(encode_brick(brick), shape, brick.dtype)
            assert (again.dtype, again.shape, again.tobytes()) == (brick.dtype, shape, brick.tobytes()), (shape, kind)


@given(
    some.tuples(*[some.integers(1, 20)] * 3), some.sampled_from(DTYPES), some.integers(0, 2**32), some.integers(1, 22)
)
@settings(max_examples=30, deadline=None)
def test_bricks_of_any_shape_come_back(shape: tuple[int, int, int], dtype: str, seed: int, effort: int) -> None:
    brick = np.random.default_rng(seed).integers(0, 256, (*shape, np.dtype(dtype).itemsize), np.uint8)
    brick = brick.view(dtype).reshape(shape)
    assert decode_brick(encode_brick(brick, effort=effort), shape, brick.dtype).tobytes() == brick.tobytes()


def adversaries(dtype: str) -> list[np.ndarray]:
    """Bricks whose predictions are as wrong as can be, or whose samples are at the ends of the range."""
    native, shape = np.dtype(dtype), (16, 11, 18)
    limits = (np.finfo if native.kind == "f" else np.iinfo)(native)
    low, high = limits.min, limits.max
    checkers, random = np.indices(shape).sum(axis=0) % 2, np.random.default_rng(5)
    ends = np.array([low, high], native)
    spikes = np.where(random.random(shape) < 0.02, ends[1], ends[0])
    bricks = [ends[checkers], ends[random.integers(0, 2, shape)], spikes, *(samples_of(k, dtype, shape) for k in KINDS)]
    small = random.integers(0, 40, shape).astype(native)
    bricks += [small, ends[1] - small, ends[0] + small]
    if native.kind == "f":
        tiny = (random.random(shape) * 2.0**-20).astype(native)
        bricks += [tiny, (1 + tiny).astype(native), np.where(checkers, np.nan, tiny), np.full(shape, np.inf, native)]
    return bricks


@pytest.mark.parametrize("error", [1, 2, 4, 100.5, 1e4, 2.0**40, 1e-5])
@pytest.mark.parametrize("dtype", DTYPES)
def test_no_sample_is_farther_away_than_the_error(dtype: str, error: float) -> None:
    for brick in adversaries(dtype):
        again = decode_brick(encode_brick(brick, error), brick.shape, brick.dtype)
        finite = np.isfinite(brick)
        assert again[~finite].tobytes() == brick[~finite].tobytes()
        if brick.dtype.kind == "f":
            with np.errstate(over="ignore"):
                away = np.abs(again[finite].astype(np.float64) - brick[finite].astype(np.float64))
        else:
            away = np.array([abs(int(a) - int(b)) for a, b in zip(again.ravel(), brick.ravel(), strict=True)], float)
        assert away.max(initial=0.0) <= error


def test_errors_make_bricks_smaller_and_few_values_are_found() -> None:
    noisy = (samples_of("smooth", "f8", (32, 32, 32)) + np.random.default_rng(1).normal(size=(32, 32, 32)) * 4).astype(
        "u1"
    )
    sizes = [len(encode_brick(noisy, error)) for error in (0, 1, 2, 4)]
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[3] < sizes[0] / 2 < len(zstandard.compress(noisy, 19)) / 2
    gaps = noisy.astype("u2") * 47
    assert len(encode_brick(gaps)) < 1.1 * sizes[0]


def header(**changes: int) -> Callable[[bytes], bytes]:
    """Change numbers of a brick's header."""
    names = ("magic", "method", "width", "step", "offset", "low", "spacing", "entries", "table_bytes")
    layout = struct.Struct("<4sBB2xIQddII")

    def change(data: bytes) -> bytes:
        found = dict(zip(names, layout.unpack(data[: layout.size]), strict=True)) | changes
        return layout.pack(*found.values()) + data[layout.size :]

    return change


@pytest.mark.parametrize(
    ("damage", "text"),
    [
        (lambda data: data[:20], "ends early"),
        (lambda data: b"abcd" + data[4:], "not a brick"),
        (header(method=2), "not a brick"),
        (header(width=3), "not a brick"),
        (header(width=8), "not a brick"),
        (header(step=4), "step 4"),
        (header(entries=70000), "70000 values"),
        (header(table_bytes=1 << 30), "damaged brick"),
        (lambda data: data[:-9], "damaged brick"),
        (lambda data: data[:44] + zstandard.compress(bytes(1 << 24)), "16777216 bytes"),
        (lambda data: data[:44] + b"not a frame of zstd", "damaged brick"),
    ],
)
def test_damaged_bricks_are_refused(damage: Callable[[bytes], bytes], text: str) -> None:
    data = encode_brick(samples_of("smooth", "u2", (8, 9, 10)))
    refused(lambda: decode_brick(damage(data), (8, 9, 10), np.dtype("u2"), "here"), "here", text)


@pytest.mark.parametrize("shape", [(1, 1, 1), (2, 3, 1), (7, 8, 9), (16, 5, 12)])
def test_low_pass_is_the_lifted_one_in_any_box(shape: tuple[int, int, int]) -> None:
    field = np.random.default_rng(2).normal(size=shape)

    def read(begin: Any, end: Any) -> np.ndarray:
        return field[tuple(map(slice, begin, end))]

    expected = field
    for axis in range(3):
        lines = np.moveaxis(expected, axis, 0)
        if len(lines) == 1:
            continue
        even, odd = lines[0::2], lines[1::2]
        after = np.concatenate([even[1:], even[-1:]])[: len(odd)]
        detail = odd - (even[: len(odd)] + after) / 2
        left = np.concatenate([detail[:1], detail])[: len(even)]
        right = np.concatenate([detail, detail[-1:]])[: len(even)]
        expected = np.moveaxis(even + (left + right) / 4, 0, axis)
    coarse = coarser(shape)
    np.testing.assert_allclose(low_pass(read, shape, (0, 0, 0), coarse), expected, rtol=1e-12, atol=1e-12)
    for corner in np.ndindex(coarse):
        box = low_pass(read, shape, corner, tuple(c + 1 for c in corner))
        assert box[0, 0, 0] == low_pass(read, shape, (0, 0, 0), coarse)[corner]


def interpolated(coarse: np.ndarray, shape: tuple[int, ...], apart: int) -> np.ndarray:
    """A level at the samples of the finest one, by `numpy.interp`."""
    found = coarse.astype(float)
    for axis, count in enumerate(shape):
        at = apart * np.arange(found.shape[axis])
        found = np.apply_along_axis(lambda line, at=at, n=count: np.interp(np.arange(n), at, line), axis, found)
    return found


def make_source(dtype: str = "u1", shape: tuple[int, int, int] = (40, 70, 51)) -> ArraySource:
    z, y, x = np.indices(shape)
    noise = np.random.default_rng(3).normal(size=shape)
    field = 100 + 60 * np.sin(z / 9 + y / 11) * np.cos(x / 7) + 3 * noise
    direction = ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    return ArraySource(field.astype(dtype), Grid(shape, (0.5, 1.0, 2.0), (3.0, -4.0, 5.0), direction, "RAS"))


@pytest.mark.cover
@pytest.mark.parametrize(
    ("dtype", "codec"),
    [
        ("u1", BrickCodec("zstd")),
        ("u1", BrickCodec("wavelet", 0.0, 3)),
        ("i2", BrickCodec("wavelet", 2.0)),
        ("f4", BrickCodec("wavelet", 0.25)),
        ("f8", BrickCodec("zstd")),
        ("f4", BrickCodec("zfp", 0.25)),
        ("i4", BrickCodec("zfp")),
    ],
)
def test_store_holds_the_volume_its_levels_and_their_errors(dtype: str, codec: BrickCodec, tmp_path: Path) -> None:
    source = make_source(dtype)
    shape = source.grid.shape_zyx
    whole = source.read((0, 0, 0), shape)
    path = tmp_path / "a.ome.zarr"
    writer = write_store(source, path, codec, 16)
    opened = open_source(path)
    levels = levels_of(override_grid(opened, Volume(path="-", origin=source.grid.origin)))
    assert levels
    assert (levels.levels, levels.brick) == (len(writer.arrays), 16)
    assert opened.grid == source.grid
    check_placed(opened, source.grid.world_from_index)
    stored = opened.read((0, 0, 0), shape)
    assert np.abs(stored.astype(float) - whole).max() <= codec.error
    check_source(opened, stored, 11)
    group = zarr.open_group(str(path), mode="r")
    scales = group.attrs["ome"]["multiscales"][0]
    assert [each["path"] for each in scales["datasets"]] == [array.path.name for array in writer.arrays]
    assert max(writer.arrays[-1].counts_zyx) == 1
    for n, array in enumerate(writer.arrays):
        named = open_source(path, str(n))
        assert named.grid.spacing == tuple(step * 2**n for step in source.grid.spacing)
        level = named.read((0, 0, 0), array.shape_zyx)
        np.testing.assert_array_equal(group[str(n)][:], level)
        lows, highs, errors = group[f"bricks/{n}"][:]
        np.testing.assert_array_equal([lows, highs, errors], levels.bounds(n))
        assert levels.level(n).grid == named.grid
        np.testing.assert_array_equal(levels.level(n).read((0, 0, 0), array.shape_zyx), level)
        assert scales["datasets"][n]["coordinateTransformations"][0]["scale"] == [2.0 * 2**n, 2**n, 0.5 * 2**n]
        away = np.abs(interpolated(level, shape, 2**n) - whole)
        for brick in np.ndindex(array.counts_zyx):
            begin, end = array.box_of(brick)
            own = level[tuple(map(slice, begin, end))]
            assert (lows[brick], highs[brick]) == (own.min(), own.max())
            between = 1 if n else 0
            here = tuple(slice(b << n, (e << n) + between) for b, e in zip(begin, end, strict=True))
            assert away[here].max() <= errors[brick] + 1e-9
        assert errors.max() <= 3 * away.max() + codec.error
    for side, margin in ((16, 2), (8, 0), (23, 4)):
        layout = BrickLayout(shape, side, margin)
        bricks = list(read_bricks(opened, layout, np.ndindex(layout.counts_zyx)))
        found = summarise(opened.dtype, layout, lambda bricks=bricks: iter(bricks), lambda value: [value])
        kept = kept_summary(opened, layout)
        assert kept is not None
        check_summary(kept, found, bricks_too=(side, margin) == (16, 2))
        assert (kept.minimum <= found.minimum).all()
        assert (kept.maximum >= found.maximum).all()
    assert kept_summary(open_source(path, "1"), layout) is None


def test_level_with_missing_samples_has_no_bound() -> None:
    fine = np.ones((4, 4, 4))
    assert difference(fine, np.ones((2, 2, 2))) == 0
    fine[1, 2, 3] = np.nan
    assert difference(fine, np.ones((2, 2, 2))) == np.inf
    assert difference(fine * np.nan, np.full((2, 2, 2), np.nan)) == 0


def test_threads_decode_a_brick_once_and_keep_to_a_limit() -> None:
    decoded, failed = list[int](), threading.Event()
    cache, owner = BrickCache(100), Owner()

    def get(number: int) -> int:
        def decode() -> np.ndarray:
            time.sleep(0.01)
            decoded.append(number)
            if number == 7 and not failed.is_set():
                failed.set()
                raise DataError("damaged")
            return np.full(40, number, np.uint8)

        return int(cache.get(owner, (number,), decode)[0])

    with ThreadPoolExecutor(8) as pool:
        assert list(pool.map(get, [1, 1, 1, 2, 2, 1])) == [1, 1, 1, 2, 2, 1]
        assert sorted(decoded) == [1, 2]
        assert list(pool.map(get, [3, 3, 2])) == [3, 3, 2]
    assert cache.bytes == 80
    with pytest.raises(DataError, match="damaged"):
        get(7)
    assert (get(7), cache.bytes) == (7, 80)


def test_bricks_go_with_the_array() -> None:
    gc.collect()
    owner, before = Owner(), CACHE.bytes
    CACHE.get(owner, (0,), lambda: np.zeros(64, np.uint8))
    assert CACHE.bytes == before + 64
    del owner
    assert CACHE.bytes == before


def contents(path: Path) -> dict[str, bytes]:
    return {str(file.relative_to(path)): file.read_bytes() for file in path.rglob("*") if file.is_file()}


def test_processes_share_the_files_and_half_a_store_is_continued(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("clusterviz.data.store.shards.SHARD_BYTES", 8 * 16**3)
    source, codec = make_source(), BrickCodec("wavelet", 1.0)
    alone, shared = tmp_path / "1" / "a.zarr", tmp_path / "3" / "a.zarr"
    for path in (alone, shared):
        path.parent.mkdir()
    write_store(source, alone, codec, 16)
    writers = [StoreWriter(source, shared, codec, 16, rank, 3) for rank in range(3)]
    handle = writers[0].begin()
    for level in range(len(writers[0].arrays)):
        for writer in writers:
            writer.write(level)
        refused(lambda: open_source(shared), "half written")
        for writer in writers:
            writer.measure(level)
    run_loopback(3, lambda channel: writers[channel.rank].summarise(channel.allgather))
    writers[0].finish()
    os.close(handle)
    expected = contents(alone)
    assert contents(shared) == expected
    assert len([name for name in expected if name.startswith("0/c")]) > 4
    lost = ["0/c/0/1/1", "bricks/0/c/0/0/0/0", "1/c/0/0/0", "bricks/statistics.npz"]
    for name in lost:
        (alone / name).unlink()
    kept = {name: (alone / name).stat().st_ino for name in expected if "c/" in name and name not in lost}
    with pytest.raises(OutputError, match=r"something else is there.*codec"):
        write_store(source, alone, BrickCodec("wavelet", 2.0), 16)
    write_store(source, alone, codec, 16)
    assert contents(alone) == expected
    touched = [name for name, inode in kept.items() if (alone / name).stat().st_ino != inode]
    assert sorted(touched) == ["0/c/0/0/0", "bricks/0/c/0/0/1/1"]  # whose other halves were lost


def test_complete_store_can_be_read_while_it_is_checked(tmp_path: Path) -> None:
    source, path = make_source(shape=(4, 5, 6)), tmp_path / "a.zarr"
    write_store(source, path, BrickCodec())
    handle = StoreWriter(source, path, BrickCodec()).begin()
    check_source(open_source(path), source.read((0, 0, 0), (4, 5, 6)))
    os.close(handle)


def test_store_that_cannot_be_written(tmp_path: Path) -> None:
    source, codec = make_source(shape=(4, 5, 6)), BrickCodec()
    (tmp_path / "file.zarr").write_text("here")
    (tmp_path / "other.zarr").mkdir()
    (tmp_path / "other.zarr" / "notes").write_text("mine")
    held = StoreWriter(source, tmp_path / "held.zarr", codec)
    handle = held.begin()
    for name, text in [
        ("file.zarr", "a file is in the way"),
        ("other.zarr", "something else is there"),
        ("nowhere/a.zarr", "folder .*nowhere is missing"),
        ("held.zarr", "another process writes"),
    ]:
        with pytest.raises(OutputError, match=text):
            write_store(source, tmp_path / name, codec)
    os.close(handle)
    assert sorted(contents(tmp_path / "other.zarr")) == ["notes"]
    for wrong in ({"name": "zip"}, {"error": -1.0}, {"name": "zstd", "error": 1.0}, {"effort": 23}):
        with pytest.raises(InputError):
            BrickCodec(**wrong)


def edit(name: str | Path, change: Callable[[dict[str, Any]], object]) -> Callable[[Path], None]:
    """Change a JSON file."""

    def apply(path: Path) -> None:
        found = json.loads((path / name).read_text())
        change(found)
        (path / name).write_text(json.dumps(found))

    return apply


def patch(name: str, at: int, data: bytes) -> Callable[[Path], None]:
    """Overwrite bytes of a file, from its end if `at` is negative."""

    def apply(path: Path) -> None:
        content = bytearray((path / name).read_bytes())
        at_ = at % len(content)
        content[at_ : at_ + len(data)] = data
        (path / name).write_bytes(content)

    return apply


def cut(name: str, count: int) -> Callable[[Path], None]:
    return lambda path: (path / name).write_bytes((path / name).read_bytes()[:-count]) and None


def without_first_brick(path: Path) -> None:
    """Make the first entry of a shard's index an absent brick, with a right checksum."""
    data = (path / "0/c/0/0/0").read_bytes()
    index = b"\xff" * 16 + data[-(8 * 16 + 4) : -4][16:]
    (path / "0/c/0/0/0").write_bytes(data[: -len(index) - 4] + index + google_crc32c.value(index).to_bytes(4, "little"))


def sealed(change: Callable[[dict[str, Any]], object]) -> Callable[[Path], None]:
    """Change the description of a store, and write the checksum of that."""

    def apply(found: dict[str, Any]) -> None:
        attributes = found["attributes"]
        change(attributes["clusterviz"])
        attributes["clusterviz"]["checksum"] = description_checksum(attributes)

    return edit("zarr.json", apply)


def absurd(**changes: list[int]) -> Callable[[Path], None]:
    """Make the descriptions of a store and its first level agree on something absurd."""

    def apply(path: Path) -> None:
        shape = changes.get("shape", [20, 21, 22])
        sealed(lambda own: own.update(shape=shape))(path)
        sharding = {"chunk_shape": changes["shard"]} if "shard" in changes else {}
        edit("0/zarr.json", lambda found: found.update(shape=shape))(path)
        edit("0/zarr.json", lambda found: found["chunk_grid"]["configuration"].update(sharding))(path)
        brick = {"chunk_shape": changes["brick"]} if "brick" in changes else {}
        edit("0/zarr.json", lambda found: found["codecs"][0]["configuration"].update(brick))(path)

    return apply


@pytest.mark.cover
@pytest.mark.parametrize(
    ("damage", "text"),
    [
        (without_first_brick, "brick .* is missing"),
        (absurd(shape=[10**12] * 3), "disagree"),
        (absurd(shape=[20, -21, 22]), "disagree"),
        (absurd(brick=[4096] * 3, shard=[4096] * 3), "disagree"),
        (absurd(brick=[0] * 3), "disagree"),
        (lambda path: (path / "0/c/0/0/0").unlink(), "no such file"),
        (lambda path: shutil.rmtree(path / "0"), "no such file"),
        (cut("0/c/0/0/0", 1), "shard is damaged or truncated"),
        (cut("0/c/0/0/0", 10000), "shard is damaged or truncated"),
        (patch("0/c/0/0/0", 60, b"wrong"), "brick .* wrong checksum"),
        (patch("0/c/0/0/0", -100, b"wrong"), "shard is damaged"),
        (edit("zarr.json", lambda found: found["attributes"]["clusterviz"].update(complete=False)), "half written"),
        (edit("0/zarr.json", lambda found: found.update(data_type="int16")), "disagree"),
        (edit("0/zarr.json", lambda found: found.update(shape=[1, 2, 3])), "disagree"),
        (edit("0/zarr.json", lambda found: found.update(codecs=[])), "disagree"),
        (cut("bricks/statistics.npz", 100), "statistics.npz.*damaged"),
        (patch("bricks/statistics.npz", 0, b"junk"), "holds objects of Python, which are not read"),
        (lambda path: (path / "bricks/statistics.npz").unlink(), "no such file"),
        (patch("bricks/0/c/0/0/0/0", 8 * 8 * 2 + 7, b"\x01"), "statistics of bricks have a wrong checksum"),
        (cut("bricks/1/c/0/0/0/0", 4), "damaged statistics of bricks"),
        (sealed(lambda own: own.update(version=3)), "another version; found 3; allowed 1, 2"),
        (edit("zarr.json", lambda found: found["attributes"]["ome"]["multiscales"][0].update(name="b")), "or edited"),
        (patch("zarr.json", 0, b"["), "damaged"),
        (lambda path: (path / "zarr.json").write_text("[]"), "an object of JSON"),
        (lambda path: (path / "zarr.json").unlink(), "without a store of Zarr"),
    ],
)
def test_damaged_stores_are_refused(damage: Callable[[Path], object], text: str, tmp_path: Path) -> None:
    path = tmp_path / "a.ome.zarr"
    write_store(make_source(shape=(20, 21, 22)), path, BrickCodec(), 16)
    damage(path)

    def read_all() -> None:
        source = open_source(path)
        kept_summary(source, BrickLayout(source.grid.shape_zyx, 16))
        levels = levels_of(source)
        for level in range(levels.levels if levels else 0):
            levels.bounds(level)
        source.read((0, 0, 0), source.grid.shape_zyx)

    refused(read_all, "a.ome.zarr", text)


def as_of_version_1(path: Path) -> None:
    """Remove what stores of version 1 do not hold: checksums but those of samples."""
    for file in path.glob("bricks/*/c/*/*/*/*"):
        file.write_bytes(file.read_bytes()[:-4])
    for file in path.glob("bricks/*/zarr.json"):
        edit(file.relative_to(path), lambda found: found["codecs"].pop())(path)
    with np.load(path / "bricks/statistics.npz") as found:
        kept = {key: found[key] for key in found.files if key != "checksum"}
    np.savez_compressed(path / "bricks/statistics.npz", **kept)
    edit("zarr.json", lambda found: found["attributes"]["clusterviz"].pop("checksum"))(path)
    edit("zarr.json", lambda found: found["attributes"]["clusterviz"].update(version=1))(path)


def test_stores_of_version_1_are_read_with_a_warning(tmp_path: Path) -> None:
    path, layout = tmp_path / "a.ome.zarr", BrickLayout((20, 21, 22), 16)
    write_store(make_source(shape=layout.shape_zyx), path, BrickCodec(), 16)
    now = open_source(path)
    expected, levels = kept_summary(now, layout), levels_of(now)
    bounds = [levels.bounds(level) for level in range(levels.levels)] if levels else []
    as_of_version_1(path)
    with pytest.warns(FutureWarning, match="its statistics and error bounds have no checksum"):
        then = open_source(path)
    kept, levels = kept_summary(then, layout), levels_of(then)
    assert kept
    assert expected
    assert levels
    check_summary(kept, expected)
    assert len(bounds) == 2
    np.testing.assert_array_equal(bounds[0], levels.bounds(0))
    np.testing.assert_array_equal(bounds[1], levels.bounds(1))


@pytest.mark.parametrize("known", [True, False])
def test_store_that_is_written_anew_under_a_running_job(known: bool, tmp_path: Path) -> None:
    path, shape = tmp_path / "a.ome.zarr", (20, 21, 22)
    write_store(make_source(shape=shape), path, BrickCodec(), 16)
    source = open_source(path)
    if known:  # its index is in memory
        source.read((0, 0, 0), (1, 1, 1))
    shutil.rmtree(path)
    refused(lambda: source.read((0, 0, 0), shape), "a.ome.zarr", "no such file|changed while it was in use")
    other = 255 - make_source(shape=shape).read((0, 0, 0), shape)
    write_store(ArraySource(other, name="other"), path, BrickCodec(), 16)
    refused(lambda: source.read((0, 0, 0), shape), "a.ome.zarr", "changed while it was in use")
    check_source(open_source(path), other)


def test_ranks_that_open_different_stores(tmp_path: Path) -> None:
    scene = Scene.model_validate({"volumes": [{"path": "a.ome.zarr"}]})
    for name, shape in (("a", (20, 21, 22)), ("b", (20, 21, 22)), ("c", (20, 21, 23))):
        write_store(make_source(shape=shape), tmp_path / f"{name}.ome.zarr", BrickCodec(), 16)

    def open_on(channel: LoopbackChannel, *names: str) -> None:
        source = open_source(tmp_path / f"{names[channel.rank]}.ome.zarr")
        open_content(Run(channel, Options()), scene, source)

    run_loopback(2, lambda channel: open_on(channel, "a", "a"))
    for names in (("a", "b"), ("a", "a", "c")):
        with pytest.raises(RankError, match="ranks read different data"):
            run_loopback(len(names), lambda channel, names=names: open_on(channel, *names))


def test_full_disk_leaves_what_can_be_continued(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source, codec, whole = make_source(shape=(20, 21, 22)), BrickCodec(), tmp_path / "a.zarr"
    opened, full_at, open_file = 0, 0, Path.open

    def open_until_full(self: Path, mode: str = "r", *rest: Any, **more: Any) -> Any:
        nonlocal opened
        opened += "w" in mode
        is_full = opened == full_at and "w" in mode
        return open_file(Path("/dev/full") if is_full else self, mode, *rest, **more)

    monkeypatch.setattr(Path, "open", open_until_full)
    write_store(source, whole, codec, 16)
    files, expected = opened, contents(whole)
    assert files > 10
    for n in (*range(1, files, 3), files):
        opened, full_at, path = 0, n, tmp_path / str(n) / "a.zarr"
        path.parent.mkdir()
        with pytest.raises(OutputError, match="No space left"):
            write_store(source, path, codec, 16)
        refused(lambda path=path: open_source(path), "without a store|half written.*the same `clusterviz store` again")
        assert not contents(path).keys() - expected.keys()
        full_at = 0
        write_store(source, path, codec, 16)
        assert contents(path) == expected


FIELD = np.arange(2 * 3 * 5 * 6 * 7, dtype="<u2").reshape(2, 3, 5, 6, 7)
SCALE = {"type": "scale", "scale": [1.0, 1.0, 4.0, 2.5, 2.0]}
SHIFT = {"type": "translation", "translation": [0.0, 0.0, 1.0, 2.0, 3.0]}


@pytest.mark.parametrize(
    ("shape", "text"), [((), "not a volume|no samples"), ((4, 0, 3), "no samples"), ((2,) * 6, "not a volume|axes")]
)
def test_arrays_that_are_no_volumes(shape: tuple[int, ...], text: str, tmp_path: Path) -> None:
    zarr.create_array(str(tmp_path / "a.zarr"), shape=shape, dtype="u1")
    refused(lambda: open_source(tmp_path / "a.zarr"), text)


@pytest.mark.parametrize("package", ["zstandard", "google_crc32c", "zarr"])
def test_missing_package_is_named(package: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source, ours, theirs = make_source(shape=(4, 5, 6)), tmp_path / "ours.zarr", tmp_path / "theirs.zarr"
    write_store(source, ours, BrickCodec())
    zarr.create_array(str(theirs), data=source.read((0, 0, 0), (4, 5, 6)))
    monkeypatch.setitem(sys.modules, package, None)
    text = rf"needs the {package} package.*\.\[store\]"
    if package == "zarr":
        refused(lambda: open_source(theirs), text)
        check_source(open_source(ours), source.read((0, 0, 0), (4, 5, 6)))
    else:
        refused(lambda: open_source(ours), text)
        refused(lambda: write_store(source, tmp_path / "new.zarr", BrickCodec()), text)
        check_source(open_source(theirs), source.read((0, 0, 0), (4, 5, 6)))


@pytest.mark.parametrize(
    ("dtype", "error", "text"),
    [
        ("u1", 0.0, r"codec.*does not pack this type.*uint8.*float32.*wavelet"),
        ("u4", 0.0, r"codec.*does not pack this type.*uint32.*float32, float64, int32, int64; wavelet"),
        ("i4", 1.0, "error.*floats only.*1.0"),
    ],
)
def test_zfp_refuses_what_it_does_not_pack(dtype: str, error: float, text: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=text):
        write_store(make_source(dtype), tmp_path / "a.zarr", BrickCodec("zfp", error))
    assert not (tmp_path / "a.zarr").exists()


def test_floats_are_rounded_within_the_error_even_where_their_type_rounds_too() -> None:
    samples = np.random.default_rng(3).uniform(-1, 1, (16, 16, 16)).astype("f4")
    data = encode_brick(samples, 0.01)
    assert np.abs(decode_brick(data, samples.shape, samples.dtype) - samples.astype(float)).max() <= 0.01
    assert len(data) < 0.3 * samples.nbytes


def test_bricks_of_zfp_are_exact_where_asked_and_never_read_beyond_their_bytes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    samples, dtype = make_source("f4").read((0, 0, 0), (8, 9, 10)), np.dtype("f4")
    samples[1, 2, 3] = np.nan
    packed = zfp.encode_brick(samples, 0.5)
    assert zfp.decode_brick(packed, (8, 9, 10), dtype, "here").tobytes() == samples.tobytes()
    for shape, kind in [((8, 9, 11), "f4"), ((8, 9, 10), "f8"), ((8, 90, 1), "f4")]:
        refused(lambda: zfp.decode_brick(packed, shape, np.dtype(kind), "here"), "here", "damaged brick of zfp")  # noqa: B023
    refused(lambda: zfp.decode_brick(packed[:4], (8, 9, 10), dtype, "here"), "damaged brick of zfp")
    assert zfp.decode_brick(packed[:40], (8, 9, 10), dtype, "here").shape == (8, 9, 10)
    write_store(make_source("f4"), tmp_path / "a.zarr", BrickCodec("zfp"))
    monkeypatch.setitem(sys.modules, "zfpy", None)
    refused(lambda: open_source(tmp_path / "a.zarr"), r"needs the zfpy package.*\.\[zfp\]")


def moving(step: int, channel: int = 0, shape: tuple[int, int, int] = (20, 48, 35)) -> np.ndarray:
    """Volume in which a block moves from step to step; all else grows by 1 at every second step."""
    field = make_source(shape=shape).read((0, 0, 0), shape)
    field[2:9, 4 * step : 4 * step + 8, 3:12] = 200 + channel
    return field + np.uint8(step // 2)


def write_files(folder: Path, steps: int, names: str = "a_{}.npy", channel: int = 0) -> list[str]:
    for n in range(steps):
        np.save(folder / names.format(n), moving(n, channel))
    return [str(folder / names.format(n)) for n in range(steps)]


def opened_series(names: list[str], along: str = "time") -> Series:
    return open_series(names, along, Subset(), lambda name, subset: open_source(name, subset=subset))


def on_three_processes(series: Series, path: Path, codec: BrickCodec) -> None:
    """Write a series on three threads, which wait for each other."""

    def write(channel: Any) -> None:
        write_store(series, path, codec, 16, channel.rank, 3, lambda stage: agree(channel, 0, stage), channel.allgather)

    run_loopback(3, write)


@pytest.mark.cover
@pytest.mark.parametrize("codec", [BrickCodec("wavelet"), BrickCodec("wavelet", 2.0), BrickCodec("zstd")], ids=str)
def test_bricks_of_time_steps_refer_to_earlier_ones_within_the_error(
    codec: BrickCodec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, files = tmp_path / "a.ome.zarr", write_files(tmp_path, 5)
    writer = write_store(opened_series([str(tmp_path / "a_*.npy")]), path, codec, 16)
    group = zarr.open_group(str(path), mode="r")
    assert group.attrs["ome"]["multiscales"][0]["axes"][0] == {"name": "t", "type": "time"}
    for t, file in enumerate(files):
        source, whole = open_source(path, subset=Subset(time=t)), np.load(file)
        stored = source.read((0, 0, 0), source.grid.shape_zyx)
        assert np.abs(stored.astype(int) - whole).max() <= codec.error
        for n, array in enumerate(writer.arrays):
            level = array.at(t)
            low, high, error = level.statistics()
            found = group[f"bricks/{n}"][t]
            np.testing.assert_array_equal(found, [low, high, error, level.steps()])
            own = open_source(path, subset=Subset(str(n), t)).read((0, 0, 0), array.shape_zyx)
            if codec.name == "zstd":
                np.testing.assert_array_equal(group[str(n)][t], own)
            for brick in np.ndindex(array.counts_zyx):
                begin, end = level.box_of(brick)
                box = tuple(map(slice, begin, end))
                before = open_source(path, subset=Subset(str(n), int(level.steps()[brick])))
                np.testing.assert_array_equal(before.read(begin, end), own[box])
                assert (low[brick], high[brick]) == (own[box].min(), own[box].max())
    shares = [(writer.arrays[0].at(t).steps() != t).mean() for t in range(5)]
    assert shares[0] == 0
    assert min(shares[1], shares[3]) > 0.5
    assert max(shares[2], shares[4]) < 0.5
    expected = contents(path)
    for name in ("0/c/1/0/0/0", "1/c/3/0/0/0", "bricks/1/c/2/0/0/0/0"):
        (path / name).unlink()
    on_three_processes(opened_series(files), path, codec)
    assert contents(path) == expected
    if codec.name == "wavelet":
        with pytest.raises(DataError, match="samples of time step 0"):
            group["0"][1]
        monkeypatch.setattr("clusterviz.data.store.shards.referred_step", lambda data: 2)
        refused(
            lambda: open_source(path, subset=Subset(time=2)).read((0, 0, 0), (1, 1, 1)), "refers to a wrong time step"
        )


def test_channels_and_time_steps_of_one_file_are_kept(tmp_path: Path) -> None:
    path, other = tmp_path / "a.ome.zarr", tmp_path / "other.ome.zarr"
    group = zarr.create_group(str(other))
    group.create_array("0", data=FIELD, chunks=(1, 1, 5, 6, 7))
    axes = [{"name": n, "type": k} for n, k in zip("tczyx", ("time", "channel", *["space"] * 3), strict=True)]
    scales = {"axes": axes, "datasets": [{"path": "0", "coordinateTransformations": [SCALE, SHIFT]}]}
    shown = [{"label": name} for name in ("DNA", "actin", "RNA")]
    shown[1] |= {"color": "80FF01", "window": {"start": 5, "end": 60}, "active": False}
    described = {"multiscales": [scales], "omero": {"channels": shown}}
    group.attrs.update({"ome": {"version": "0.5", **described}})
    write_store(opened_series([str(other)]), path, BrickCodec("zstd"), 8)
    source = open_source(path, subset=Subset(time=1, channel="RNA"))
    check_source(source, FIELD[1, 2])
    assert (source.slab.time_steps, source.slab.channel_names) == (2, ("DNA", "actin", "RNA"))
    stored = zarr.open_group(str(path), mode="r")
    np.testing.assert_array_equal(stored["0"][:], FIELD)
    channels = stored.attrs["ome"]["omero"]["channels"]
    assert (channels[1]["color"], channels[1]["active"]) == ("80FF01", False)
    assert (channels[1]["window"]["start"], channels[1]["window"]["end"]) == (5, 60)
    ends = FIELD[:, 2].min(), FIELD[:, 2].max(), np.percentile(FIELD[0, 2], 1), np.percentile(FIELD[1, 2], 99)
    assert list(channels[2]["window"].values()) == pytest.approx(ends, abs=1)
    refused(lambda: open_source(path, subset=Subset(time=2, channel=0)), "no such time step")


def test_files_of_a_series_must_agree(tmp_path: Path) -> None:
    files = write_files(tmp_path, 11)
    assert [Path(each.name).name for each in opened_series(sorted(files)).sources][-2:] == ["a_9.npy", "a_10.npy"]
    assert [Path(each.name).name for each in opened_series(files[1::-1]).sources] == ["a_1.npy", "a_0.npy"]
    assert opened_series(files[:2], "channels").channels == ("a_0", "a_1")
    last = open_source(tmp_path / "a_*.npy", subset=Subset(time=10))
    check_source(last, moving(10))
    assert (last.slab.time, last.slab.time_steps) == (10, 11)
    refused(lambda: open_source(tmp_path / "a_*.npy"), "several time steps")
    refused(lambda: open_source(tmp_path / "a_*.npy", subset=Subset(time=11)), "0 to 10")
    refused(lambda: opened_series([str(tmp_path / "b_*.npy")]), "no file matches")
    np.save(files[1], moving(1)[1:])
    refused(lambda: opened_series(files), "different shape", "a_0.npy")
    np.save(files[1], moving(1).astype("u2"))
    refused(lambda: opened_series(files), "35 × 48 × 20 uint16")
