"""Bricks of several volumes: kept, read back as they came, and taken over from elsewhere."""

from __future__ import annotations

import numpy as np
from render.scenes import rotation
from render.test_multi_volume import BYTES, FLOATS, WORDS, prepared, scene_of

from clusterviz.data.source import Grid
from clusterviz.partition import BrickBox
from clusterviz.render.cpu.multi_volume_memory import MixedMemory
from clusterviz.render.multi_volume_bricks import store_multi_volume
from clusterviz.render.storage import slot_of
from clusterviz.render.stored_brick import Stored

APART = (*FLOATS[:2], Grid((15, 12, 17), (1.3, 0.9, 1.1), (5, 4, 30), rotation((1, 2, 3), 40)))
PARTS = BYTES, APART, WORDS


def filled() -> tuple[MixedMemory, dict[tuple[int, int, int], Stored]]:
    """A memory of the bricks of a scene, and these."""
    plan, bricks = prepared(scene_of(PARTS, brick=9), PARTS)
    assert plan.multi_volume is not None
    slot = slot_of(plan)
    stored = {index: store_multi_volume(portions, plan.multi_volume, slot) for index, portions in bricks.items()}
    memory = MixedMemory(slot)
    memory.put(dict(stored), lambda _, one: one)
    return memory, stored


def test_bricks_are_read_back_as_they_came() -> None:
    memory, stored = filled()
    assert memory.bricks == set(stored)
    assert memory.voxels == sum(one.voxels for one in stored.values())
    for index, found in memory.stored(list(stored)):
        assert np.array_equal(found.samples, stored[index].samples)
        assert np.array_equal(found.low, stored[index].low, equal_nan=True)
        assert np.array_equal(found.high, stored[index].high, equal_nan=True)


def test_volumes_take_memory_only_in_bricks_that_they_meet() -> None:
    memory, stored = filled()
    indices = np.array(list(stored))
    box = BrickBox((0, 0, 0), tuple((indices.max(axis=0) + 1).tolist()))
    numbered = memory.numbered(box, indices)
    assert all(0 < one.bricks < len(stored) for one in numbered)
    for one in numbered:
        there = one.firsts[..., 3] > 0
        assert there.sum() == one.bricks
        assert len(np.unique(one.numbers[there])) == one.bricks
    assert memory.bytes == sum(one.bricks * one.voxels.nbytes for one in numbered)


def test_bricks_that_are_given_up_leave_their_room_to_others() -> None:
    memory, stored = filled()
    before = memory.bytes
    some = list(stored)[::2]
    memory.drop(some)
    assert memory.bricks == set(stored) - set(some)
    memory.put({index: stored[index] for index in some}, lambda _, one: one)
    assert memory.bytes == before
