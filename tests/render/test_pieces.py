"""Pieces: any assignment of bricks, drawn in groups and windows, bricks coming and going, makes the same picture."""

from __future__ import annotations

import moderngl
import numpy as np
import pytest
from render.scenes import FAINT, SHAPE, Prepared, camera_at, draw, noise, prepare, scene_of, whole

from clusterviz.data.source import Grid
from clusterviz.image.partial import Rect
from clusterviz.partition import BrickBox, Owners, Piece, owner_pieces
from clusterviz.plan.plan import Plan
from clusterviz.reference import over
from clusterviz.render.brick_atlas import capacity
from clusterviz.render.opengl import opengl_caster

pytestmark = pytest.mark.gl

GRID = Grid(SHAPE)
BOUND = 1e-6


def planned(camera: str, **keys: object) -> Prepared:
    voxels = noise(dtype="uint8")
    return prepare(scene_of(voxels, camera_at(camera, GRID), opacity=FAINT, **keys), voxels, brick=7)


def dealt(plan: Plan, ranks: int, seed: int) -> tuple[Piece, ...]:
    """Bricks at random to ranks, in groups from front to back."""
    owner = np.random.default_rng(seed).integers(0, ranks, plan.cost.shape).astype(np.int32)
    return owner_pieces(Owners(ranks, owner), plan.eye_in_bricks(), plan.view.forward)


@pytest.mark.parametrize("camera", ["outside", "inside", "parallel"])
def test_any_assignment_makes_the_same_picture_and_takes_each_sample_once(
    context: moderngl.Context, camera: str
) -> None:
    prepared = planned(camera)
    plan, expected = prepared.plan, draw(context, prepared)
    caster = opengl_caster(context, plan)
    caster.load(plan, prepared.shown)
    for ranks in (2, 3, 5):
        drawn = caster.draw(plan, dealt(plan, ranks, ranks))
        found = over([whole(each.partial, plan.view.size) for each in drawn])
        assert len(drawn) > ranks
        assert np.abs(found - whole(expected.partial, plan.view.size)).max() <= BOUND
        assert sum(each.samples for each in drawn) == expected.samples
    caster.release()


def test_windows_cut_the_picture_and_nothing_else(context: moderngl.Context) -> None:
    prepared = planned("outside")
    plan, expected = prepared.plan, whole(draw(context, prepared).partial, (24, 20))
    box = BrickBox((0, 0, 0), plan.layout.counts_zyx)
    windows = [Rect(0, 0, 11, 20), Rect(11, 0, 24, 9), Rect(11, 9, 24, 20)]
    caster = opengl_caster(context, plan)
    caster.load(plan, prepared.shown)
    found = np.zeros_like(expected)
    for window, drawn in zip(windows, caster.draw(plan, [Piece(0, box, None, w) for w in windows]), strict=True):
        rect = drawn.partial.rect
        assert rect == rect.intersect(window)
        found += whole(drawn.partial, (24, 20))
    np.testing.assert_array_equal(found, expected)
    caster.release()


@pytest.mark.parametrize("filter", ["exact", "hardware"])
@pytest.mark.parametrize("block_bytes", [None, 6000])
def test_bricks_that_come_and_go_leave_the_picture_as_it_is(
    context: moderngl.Context, filter: str, block_bytes: int | None
) -> None:
    """Slots are filled, freed, filled by others, and moved to larger buffers and textures."""
    prepared = planned("inside", filter=filter)
    plan, rng = prepared.plan, np.random.default_rng(4)
    every = sorted(prepared.shown)
    box = BrickBox((0, 0, 0), plan.layout.counts_zyx)
    caster, other = opengl_caster(context, plan, block_bytes), opengl_caster(context, plan)
    here: set[tuple[int, ...]] = set()
    for _ in range(12):
        come = {every[i] for i in rng.choice(len(every), 9)} - here
        caster.load(plan, {index: prepared.bricks[index] for index in come})
        here |= come
        gone = {index for index in here if rng.random() < 0.3}
        caster.drop(gone)
        here -= gone
        assert caster.pool.bricks == here
        assert caster.pool.voxels == sum(prepared.bricks[index].size for index in here)
    mask = np.zeros(box.shape_zyx, bool)
    mask[tuple(np.array(sorted(here)).T)] = True
    other.load(plan, {index: prepared.bricks[index] for index in here})
    pictures = []
    for each in (caster, other):
        groups = [Piece(0, BrickBox(i, tuple(n + 1 for n in i))) for i in sorted(here)]
        pictures.append([whole(drawn.partial, plan.view.size) for drawn in each.draw(plan, groups)])
    bound = BOUND if filter == "exact" else 0.01
    assert np.abs(np.array(pictures[0]) - np.array(pictures[1])).max() <= bound
    for index, stored in caster.pool.stored(here):
        ((_, expected),) = other.pool.stored([index])
        np.testing.assert_array_equal(stored.parts[0].samples, expected.parts[0].samples)
        np.testing.assert_array_equal(stored.low, expected.low)
    caster.release()
    other.release()


def test_a_brick_that_is_not_there_is_no_hole_in_the_picture(context: moderngl.Context) -> None:
    prepared = planned("outside")
    plan = prepared.plan
    for block_bytes in (None, 6000):
        caster = opengl_caster(context, plan, block_bytes)
        bricks = prepared.shown
        del bricks[0, 0, 0]
        caster.load(plan, bricks)
        with pytest.raises(KeyError):
            caster.draw(plan, [Piece(0, BrickBox((0, 0, 0), plan.layout.counts_zyx))])
        caster.release()


def test_limits_leave_room_for_one_brick(context: moderngl.Context) -> None:
    caster = opengl_caster(context, planned("outside").plan)
    assert capacity(context, caster.slot, 1) == 1
    caster.release()
