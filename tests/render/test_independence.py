"""The picture does not depend on who draws which part of it, nor in how many pieces."""

from __future__ import annotations

import moderngl
import numpy as np
import pytest
from render.scenes import CAMERAS, SHAPE, Prepared, camera_at, draw, draw_on_cpu, noise, prepare, scene_of, whole

from clusterviz.data.source import Grid
from clusterviz.partition import build_tree, front_to_back
from clusterviz.reference import over
from clusterviz.scene.values import Scene

pytestmark = pytest.mark.gl

GRID = Grid(SHAPE)
FAINT = ((0.0, 0.001), (1.0, 0.02))
BOUND = 1e-6
# The texture unit rounds weights to 8 bits; where a weight is half-way, a brick's place in the texture decides.
HARDWARE_BOUND = 0.01


def in_parts(context: moderngl.Context | None, scene: Scene, prepared: Prepared, parts: int) -> tuple[np.ndarray, int]:
    """The boxes of a tree drawn apart and composited in float64, and the samples that they took together.

    Without a context the processor draws.
    """
    plan = prepared.plan
    tree = build_tree(plan.cost, parts)
    order = front_to_back(tree, plan.eye_in_bricks(), plan.view.forward)
    boxes = [tree.leaves[rank].trimmed for rank in order if tree.leaves[rank].cost > 0]
    drawn = [draw(context, prepared, box) if context else draw_on_cpu(prepared, box) for box in boxes]
    layers = [whole(part.partial, scene.image.size) for part in drawn]
    return over(layers), sum(part.samples for part in drawn)


@pytest.mark.parametrize("camera", CAMERAS)
def test_parts_drawn_apart_make_the_whole_and_take_each_sample_once(context: moderngl.Context, camera: str) -> None:
    voxels = noise(dtype="uint8")
    for step in (1.0, 0.3):
        scene = scene_of(voxels, camera_at(camera, GRID), opacity=FAINT, step=step)
        prepared = prepare(scene, voxels, brick=7)
        for where, drawn in ((context, draw(context, prepared)), (None, draw_on_cpu(prepared))):
            picture = whole(drawn.partial, scene.image.size)
            assert picture[..., 3].max() > 0.01
            for parts in (2, 3, 5):
                found, samples = in_parts(where, scene, prepared, parts)
                assert np.abs(found - picture).max() <= BOUND, f"step {step}, {parts} parts"
                assert samples == drawn.samples, f"step {step}, {parts} parts"


def test_parts_of_an_opaque_volume_make_the_whole(context: moderngl.Context) -> None:
    voxels = noise(dtype="int16")
    scene = scene_of(voxels, camera_at("inside", GRID), opacity=0.9)
    prepared = prepare(scene, voxels, brick=5)
    picture = whole(draw(context, prepared).partial, scene.image.size)
    for parts in (1, 2, 4, 7):
        assert np.abs(in_parts(context, scene, prepared, parts)[0] - picture).max() <= BOUND


@pytest.mark.parametrize("step", [0.02, 1e-3])
def test_short_slabs_at_the_faces_of_bricks_are_taken_once(context: moderngl.Context, step: float) -> None:
    """Where a slab is as short as the rounding of a position, faces between boxes are the hard case."""
    voxels = noise((5, 6, 60), np.float32)
    grid = Grid(voxels.shape)
    scene = scene_of(voxels, camera_at("outside", grid), opacity=FAINT, step=step, size=(5, 4))
    prepared = prepare(scene, voxels, brick=29)
    for where, drawn in ((context, draw(context, prepared)), (None, draw_on_cpu(prepared))):
        for parts in (2, 3):
            found, samples = in_parts(where, scene, prepared, parts)
            assert samples == drawn.samples
            assert np.abs(found - whole(drawn.partial, scene.image.size)).max() <= BOUND


@pytest.mark.parametrize("brick", [16, 33, 64])
def test_brick_size_changes_neither_picture_nor_samples(context: moderngl.Context, brick: int) -> None:
    voxels = noise((40, 35, 70), np.uint16)
    grid = Grid(voxels.shape)
    scene = scene_of(voxels, camera_at("outside", grid), opacity=FAINT)
    one, other = (prepare(scene, voxels, grid, side) for side in (70, brick))
    first = draw(context, one)
    for drawn in (draw(context, other), draw_on_cpu(one), draw_on_cpu(other)):
        assert drawn.samples == first.samples
        assert np.abs(whole(drawn.partial, (24, 20)) - whole(first.partial, (24, 20))).max() <= BOUND


@pytest.mark.parametrize("filter", ["exact", "hardware"])
@pytest.mark.parametrize("camera", ["outside", "inside", "parallel", "on-a-face"])
def test_little_memory_for_bricks_changes_nothing(context: moderngl.Context, camera: str, filter: str) -> None:
    voxels = noise(dtype="uint8")
    scene = scene_of(voxels, camera_at(camera, GRID), filter=filter)
    prepared = prepare(scene, voxels, brick=7)
    plenty = draw(context, prepared)
    for block_bytes in (1, 2000, 6000):
        little = draw(context, prepared, block_bytes=block_bytes)
        assert little.bricks == plenty.bricks
        difference = whole(little.partial, (24, 20)) - whole(plenty.partial, (24, 20))
        assert np.abs(difference).max() <= (BOUND if filter == "exact" else HARDWARE_BOUND), block_bytes


@pytest.mark.parametrize("brick", [9, 20])
def test_gaps_at_the_far_side_of_a_brick_end_with_it(context: moderngl.Context, brick: int) -> None:
    """Where a group of cells is cut by its brick's end, a leap over it must not go on into the next brick."""
    shape = (33, 30, 35)
    voxels = (np.random.default_rng(4).random(shape) < 0.0006).astype(np.uint8)
    scene = scene_of(voxels, camera_at("on-a-corner", Grid(shape)), clim=(0.0, 1.0), opacity=((0.5, 0.0), (1.0, 0.8)))
    whole_volume = whole(draw(context, prepare(scene, voxels, brick=64)).partial, scene.image.size)
    in_bricks = whole(draw(context, prepare(scene, voxels, brick=brick)).partial, scene.image.size)
    assert np.abs(in_bricks - whole_volume).max() <= BOUND
