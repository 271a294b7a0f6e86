"""Checks of the contract of a source, which the test of each format runs on its own files."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clusterviz.data.bricks import BrickLayout, read_bricks
from clusterviz.data.levels import LevelMap, MixedSource
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid, Index, Source
from clusterviz.data.summary import VolumeSummary
from clusterviz.errors import DataError

SHAPE = (5, 6, 7)
DTYPES = ("i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f2", "f4", "f8")


def values(dtype: str, shape: tuple[int, ...] = SHAPE, seed: int = 1) -> NDArray[Any]:
    """Return random samples that include both ends of the type's range."""
    native, random = np.dtype(dtype), np.random.default_rng(seed)
    if native.kind == "f":
        array = random.normal(size=shape).astype(native)
        ends = np.array([np.finfo(native).min, np.finfo(native).max, np.nan, -np.inf], native)
    else:
        limits = np.iinfo(native)
        array = random.integers(limits.min, limits.max, shape, native.newbyteorder("="), endpoint=True).astype(native)
        ends = np.array([limits.min, limits.max], native)
    array.ravel()[: len(ends)] = ends
    return array


def check_source(source: Source, expected: NDArray[Any], brick: int = 2) -> None:
    """Check the samples of the whole volume, of single boxes, of bricks in order and of an earlier box."""
    assert source.grid.shape_zyx == expected.shape
    assert source.dtype == expected.dtype.newbyteorder("=")
    layout = BrickLayout(source.grid.shape_zyx, brick)
    again = np.zeros(expected.shape, source.dtype)
    wanted = list(np.ndindex(*layout.counts_zyx))
    seen = []
    for index, samples in read_bricks(source, layout, wanted):
        (z, y, x), (z_end, y_end, x_end) = layout.sample_box(index)
        check_box_read(samples, source, expected[z:z_end, y:y_end, x:x_end])
        again[z:z_end, y:y_end, x:x_end] = samples
        seen.append(index)
    assert seen == sorted(wanted)
    np.testing.assert_array_equal(again, expected)
    check_box_read(source.read((0, 0, 0), expected.shape), source, expected)
    z, y, x = expected.shape
    check_box_read(source.read((z - 1, y // 2, x - 1), (z, y, x)), source, expected[z - 1 :, y // 2 :, x - 1 :])
    check_box_read(source.read((0, 0, 0), (1, 1, 1)), source, expected[:1, :1, :1])
    assert source.read((0, 0, 0), (0, y, x)).shape == (0, y, x)
    with pytest.raises(IndexError, match="does not lie in"):
        source.read((0, 0, 0), (z + 1, y, x))


def check_box_read(samples: NDArray[Any], source: Source, expected: NDArray[Any]) -> None:
    assert samples.dtype == source.dtype
    assert samples.dtype.isnative
    assert samples.flags.c_contiguous
    assert samples.flags.writeable
    np.testing.assert_array_equal(samples, expected)


def check_placed(source: Source, world_from_index: NDArray[np.float64]) -> None:
    """Check the grid's matrix, and that its direction has unit vectors."""
    np.testing.assert_allclose(source.grid.world_from_index, world_from_index, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(source.grid.direction, axis=0), 1, rtol=1e-12)
    assert min(source.grid.spacing) > 0


def check_summary(one: VolumeSummary, other: VolumeSummary, bricks_too: bool = True) -> None:
    """Check that two summaries of a volume are equal."""
    np.testing.assert_array_equal(one.histogram, other.histogram)
    assert one.value_range == other.value_range
    assert one.percentiles == other.percentiles
    np.testing.assert_array_equal(one.blocks, other.blocks)
    assert (one.categories is None) == (other.categories is None)
    if one.categories and other.categories:
        for name in ("values", "counts", "equal", "pairs", "jumps"):
            np.testing.assert_array_equal(getattr(one.categories, name), getattr(other.categories, name))
    if bricks_too:
        np.testing.assert_array_equal(one.minimum, other.minimum)
        np.testing.assert_array_equal(one.maximum, other.maximum)


def refused(open_it: Callable[[], object], *parts: str) -> None:
    """Check that opening raises a `DataError` with all of `parts` in its text."""
    with pytest.raises(DataError) as caught:
        open_it()
    for part in parts:
        assert re.search(part, str(caught.value)), f"{part!r} is not in {caught.value!s}"


def cut(path: Path, count: int) -> Path:
    """Remove the last `count` bytes of a file."""
    with path.open("r+b") as file:
        file.truncate(path.stat().st_size - count)
    return path


@dataclass(frozen=True)
class Pyramid:
    """Levels in memory, of noise: no level tells anything of another one."""

    arrays: tuple[np.ndarray, ...]
    brick: int = 8

    name = "pyramid"

    @property
    def levels(self) -> int:
        return len(self.arrays)

    @property
    def grid(self) -> Grid:
        return Grid(self.arrays[0].shape)

    @property
    def dtype(self) -> np.dtype[Any]:
        return self.arrays[0].dtype

    def level(self, number: int) -> ArraySource:
        return ArraySource(self.arrays[number], self.grid.coarser(number))

    def bounds(self, number: int) -> np.ndarray:
        samples, side = self.arrays[number].astype(float), self.brick << number
        one = LevelMap(
            np.full([-(-max(1, n - 1) // self.brick) for n in self.grid.shape_zyx], number, np.uint8), self.brick
        )
        drawn = MixedSource(self, one, 0).read((0, 0, 0), self.grid.shape_zyx)
        away = np.abs(drawn.astype(float) - self.arrays[0])
        found = np.zeros((3, *(-(-n // self.brick) for n in samples.shape)))
        for at in np.ndindex(found.shape[1:]):
            own = samples[tuple(slice(i * self.brick, (i + 1) * self.brick) for i in at)]
            error = away[tuple(slice(i * side, (i + 1) * side + 1) for i in at)].max()
            found[(slice(None), *at)] = own.min(), own.max(), error
        return found

    def read(self, begin: Index, end: Index) -> np.ndarray:
        return self.level(0).read(begin, end)


def pyramid(shape: Index, levels: int, dtype: str, random: np.random.Generator) -> Pyramid:
    shapes = [tuple(-(-n // 2**level) for n in shape) for level in range(levels)]
    return Pyramid(tuple(random.integers(0, 200, each).astype(dtype) for each in shapes))
