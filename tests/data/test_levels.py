"""Fields of several levels: continuous where bricks meet, equal from every side and at every level they are read at."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from data.checks import Pyramid, pyramid
from hypothesis import given, settings
from hypothesis import strategies as some

from clusterviz.data.bricks import BrickLayout
from clusterviz.data.levels import LevelMap, MixedSource
from clusterviz.data.source import Index

BRICK = 8


def expected(source: Pyramid, level_map: LevelMap, point: np.ndarray) -> float:
    """The field at a point in samples of the finest level, (z, y, x), as the coarsest brick there has it."""
    bricks = bricks_at(point, level_map)
    level = max(int(level_map.levels[brick]) for brick in product(*bricks))
    array, total = source.arrays[level], 0.0
    low = np.floor(point / 2**level)
    for corner in np.ndindex(2, 2, 2):
        at = low + corner
        weight = float(np.prod(1 - np.abs(point / 2**level - at)))
        if weight > 0:
            sample, here = np.minimum(at, np.array(array.shape) - 1).astype(int), at * 2**level
            inside = np.minimum(here, np.array(source.arrays[0].shape) - 1)
            further = max(int(level_map.levels[b]) for b in product(*bricks_at(inside, level_map))) > level
            total += weight * (expected(source, level_map, here) if further else float(array[tuple(sample)]))
    return total


def bricks_at(point: np.ndarray, level_map: LevelMap) -> list[set[int]]:
    """The bricks along each axis in or on which a point lies."""
    return [
        {min(max(0, int(np.ceil(at / BRICK)) - 1), count - 1), min(int(at // BRICK), count - 1)}
        for at, count in zip(point, level_map.levels.shape, strict=True)
    ]


def seen_from(source: Pyramid, level_map: LevelMap, brick: Index, point: np.ndarray, level: int) -> float:
    """The field at a point of a brick by the samples that are read for it at a level."""
    layout = BrickLayout(source.grid.shape_zyx, BRICK)
    begin, end = layout.cell_box(brick)
    low = tuple(b >> level for b in begin)
    high = tuple(-(-e // 2**level) + 1 for e in end)
    samples = MixedSource(source, level_map, level).read(low, high)
    local = point / 2**level - low
    cell = np.minimum(np.floor(local).astype(int), np.array(samples.shape) - 2)
    total = 0.0
    for corner in np.ndindex(2, 2, 2):
        total += float(samples[tuple(cell + corner)]) * float(np.prod(1 - np.abs(local - cell - corner)))
    return total


@given(some.tuples(*[some.integers(9, 30)] * 3), some.integers(0, 2**32), some.sampled_from(["u1", "f4", "i4"]))
@settings(max_examples=12, deadline=None)
def test_the_field_is_one_from_all_bricks(shape: Index, seed: int, dtype: str) -> None:
    random = np.random.default_rng(seed)
    source = pyramid(shape, 4, dtype, random)
    counts = BrickLayout(shape, BRICK).counts_zyx
    level_map = LevelMap(random.integers(0, 4, counts).astype(np.uint8), BRICK)
    last = np.array(shape) - 1
    for _ in range(6):
        # On faces, edges and corners of bricks, or within.
        point = random.random(3) * last
        on = random.random(3) < 0.6
        point = np.where(on, np.minimum(np.round(point / BRICK) * BRICK, last), point)
        value = expected(source, level_map, point)
        for brick in product(*bricks_at(point, level_map)):
            own = int(level_map.levels[brick])
            for level in [own] if level_map.is_uniform else range(own + 1):
                found = seen_from(source, level_map, brick, point, level)
                assert found == pytest.approx(value, rel=1e-6, abs=1e-4), (point, brick, level)


def test_one_level_everywhere_is_read_as_it_is() -> None:
    source = pyramid((9, 12, 20), 5, "u1", np.random.default_rng(3))
    level_map = LevelMap(np.full((1, 2, 3), 4, np.uint8), BRICK)
    field = MixedSource(source, level_map, 4)
    read = field.read((0, 0, 0), field.grid.shape_zyx)
    assert (read.dtype, read.shape) == (np.uint8, (2, 2, 3))
    np.testing.assert_array_equal(read, np.pad(source.arrays[4], [(0, 1), (0, 1), (0, 1)], mode="edge"))


def test_levels_that_end_between_borders_are_refused() -> None:
    with pytest.raises(ValueError, match="no border at samples of level 4"):
        LevelMap(np.array([[[0, 4]]], np.uint8), BRICK)
