"""Bricks, and fields of several levels: continuous where bricks meet, equal from every side and at every level."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest
from data.checks import Pyramid, pyramid
from hypothesis import given, settings
from hypothesis import strategies as some
from hypothesis import strategies as st
from numpy.typing import NDArray

from clusterviz.data import bricks
from clusterviz.data.bricks import BrickLayout, read_bricks
from clusterviz.data.levels import LevelMap, MixedSource
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Index

SHAPES = st.tuples(st.integers(1, 9), st.integers(1, 9), st.integers(1, 9))
BRICKS = st.integers(1, 10)


def box_of(begin: Index, end: Index) -> tuple[slice, ...]:
    return tuple(slice(b, e) for b, e in zip(begin, end, strict=True))


@st.composite
def layouts(draw: st.DrawFn) -> BrickLayout:
    """Bricks of one size, or of several: every second border or so is left out."""
    layout = BrickLayout(draw(SHAPES), draw(BRICKS))
    if draw(st.booleans()):
        return layout
    z, y, x = (tuple(edge for edge in range(1, count) if draw(st.booleans())) for count in layout.counts_zyx)
    return BrickLayout(layout.shape_zyx, layout.brick, edges_zyx=(z, y, x))


@given(layouts())
def test_every_cell_and_every_sample_belongs_to_one_brick(layout: BrickLayout) -> None:
    shape = layout.shape_zyx
    cells, samples = np.zeros(layout.cells_zyx, int), np.zeros(shape, int)
    for index in np.ndindex(*layout.counts_zyx):
        cells[box_of(*layout.cell_box(index))] += 1
        samples[box_of(*layout.owned_box(index))] += 1
    assert (cells == 1).all()
    assert (samples == 1).all()


@given(layouts())
def test_the_units_of_all_bricks_are_the_bricks_of_one_size(layout: BrickLayout) -> None:
    uniform, bricks = BrickLayout(layout.shape_zyx, layout.brick), np.argwhere(np.ones(layout.counts_zyx))
    units = [(z, y, x) for z, y, x in layout.units(bricks).tolist()]
    assert sorted(units) == list(np.ndindex(*uniform.counts_zyx))
    assert layout.unit_box((0, 0, 0), layout.counts_zyx) == ((0, 0, 0), uniform.counts_zyx)


@given(SHAPES, BRICKS)
def test_a_brick_holds_the_corners_of_its_cells(shape: Index, brick: int) -> None:
    layout = BrickLayout(shape, brick)
    for index in np.ndindex(*layout.counts_zyx):
        (begin, end), (first, last) = layout.cell_box(index), layout.sample_box(index)
        assert first == begin
        for a in range(3):
            assert 0 < end[a] - begin[a] <= brick
            assert last[a] == (end[a] + 1 if shape[a] > 1 else 1)
        owned_begin, owned_end = layout.owned_box(index)
        assert owned_begin == first
        assert all(o <= s for o, s in zip(owned_end, last, strict=True))


def test_a_layout_by_hand() -> None:
    layout = BrickLayout((10, 9, 1), 4)
    assert layout.cells_zyx == (9, 8, 1)
    assert layout.counts_zyx == (3, 2, 1)
    assert layout.cell_box((2, 1, 0)) == ((8, 4, 0), (9, 8, 1))
    assert layout.sample_box((2, 1, 0)) == ((8, 4, 0), (10, 9, 1))
    assert layout.sample_box((0, 0, 0)) == ((0, 0, 0), (5, 5, 1))
    assert layout.owned_box((0, 0, 0)) == ((0, 0, 0), (4, 4, 1))
    assert layout.owned_box((2, 1, 0)) == ((8, 4, 0), (10, 9, 1))


class Recorder(ArraySource):
    """Array source that records the boxes that are read."""

    def __init__(self, array: NDArray[Any]) -> None:
        super().__init__(array)
        self.boxes: list[tuple[Index, Index]] = []

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        self.boxes.append((begin_zyx, end_zyx))
        return super().read(begin_zyx, end_zyx)


@given(SHAPES, BRICKS, st.sampled_from([1, 100, 1 << 20]), st.data())
def test_any_choice_of_bricks_in_order(shape: Index, brick: int, slab_bytes: int, data: st.DataObject) -> None:
    layout = BrickLayout(shape, brick)
    array = np.arange(np.prod(shape), dtype=np.float32).reshape(shape)
    wanted = data.draw(st.lists(st.sampled_from(list(np.ndindex(*layout.counts_zyx)))))
    source = Recorder(array)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bricks, "SLAB_BYTES", slab_bytes)
        read = list(read_bricks(source, layout, wanted))
    assert [index for index, _ in read] == sorted(set(wanted))
    for index, samples in read:
        assert samples.flags.c_contiguous
        assert samples.flags.owndata
        np.testing.assert_array_equal(samples, array[box_of(*layout.sample_box(index))])
    begins = [begin[0] for begin, _ in source.boxes]
    assert begins == sorted(begins)
    if slab_bytes > 100:
        assert len(source.boxes) == len({index[0] for index in wanted})
    for begin, end in source.boxes:
        size = np.prod(np.subtract(end, begin)) * 4
        assert size <= slab_bytes or end[0] - begin[0] == 1


def test_only_the_wanted_bricks_are_spanned() -> None:
    source = Recorder(np.zeros((9, 9, 9), np.uint8))
    list(read_bricks(source, BrickLayout((9, 9, 9), 2), [(1, 2, 3), (1, 2, 2), (3, 0, 0)]))
    assert source.boxes == [((2, 4, 4), (5, 7, 9)), ((6, 0, 0), (9, 3, 3))]
    assert list(read_bricks(source, BrickLayout((9, 9, 9), 2), [])) == []


@given(SHAPES, BRICKS, st.integers(1, 3))
def test_a_margin_surrounds_every_brick_and_repeats_what_lies_before_the_volume(
    shape: Index, brick: int, margin: int
) -> None:
    layout = BrickLayout(shape, brick, margin)
    array = np.arange(np.prod(shape), dtype=np.float32).reshape(shape)
    padded = np.pad(array, margin, mode="edge")
    for index, samples in read_bricks(ArraySource(array), layout, np.ndindex(*layout.counts_zyx)):
        begin, end = layout.cell_box(index)
        assert samples.flags.c_contiguous
        # Behind the volume nothing is read; in front of it the first samples are repeated.
        after = [min(n, e + 1 + margin) + margin for e, n in zip(end, shape, strict=True)]
        np.testing.assert_array_equal(samples, padded[tuple(slice(b, a) for b, a in zip(begin, after, strict=True))])


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
