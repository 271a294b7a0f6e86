"""The processor's ray caster in every width of vectors; test_raycast.py and others hold it to the reference too."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from render.scenes import SHAPE, camera_at, draw_on_cpu, noise, prepare, scene_of, shown, whole
from render.test_shading import LIT

from clusterviz.data.source import Grid
from clusterviz.image.partial import Rect
from clusterviz.partition import Piece, build_tree
from clusterviz.reference import render_reference
from clusterviz.render.cpu import memory
from clusterviz.render.cpu.caster import VectorCaster
from clusterviz.render.cpu.width import WIDTHS, Width

BOUND = 1e-5
GRID = Grid(SHAPE)
OTHERS = [width for width in WIDTHS if width.lanes != 16]


@pytest.mark.parametrize("width", OTHERS, ids=lambda width: width.lanes)
@pytest.mark.parametrize(
    ("dtype", "interpolation", "look"),
    [("uint8", "linear", {}), ("float32", "nearest", {}), ("int16", "linear", LIT)],
    ids=["u8", "nearest", "lit"],
)
def test_narrower_vectors_give_the_same_picture(width: Width, dtype: str, interpolation: str, look: Any) -> None:
    voxels = noise(dtype=dtype)
    for camera in ("outside", "inside"):
        keys: dict[str, Any] = {"interpolation": interpolation, "look": look}
        scene = scene_of(voxels, camera_at(camera, GRID), step=0.7, size=(23, 19), **keys)
        prepared = prepare(scene, voxels, brick=7)
        found = whole(draw_on_cpu(prepared, width=width).partial, scene.image.size)
        assert np.abs(found - render_reference(scene, GRID, voxels)).max() <= BOUND


@pytest.mark.parametrize(
    ("dtype", "keys"),
    [
        ("uint8", {"look": LIT}),
        ("int16", {"interpolation": "cubic"}),
        ("float32", {"classification": "pre-integrated", "borders": "split"}),
        ("float64", {"adaptive": 0.01}),
        ("float32", {"interpolation": "nearest", "look": LIT}),
    ],
    ids=lambda value: value if isinstance(value, str) else "-".join(value),
)
def test_bricks_of_several_sizes_change_no_bit(dtype: str, keys: dict[str, Any]) -> None:
    grid = Grid((19, 43, 58))
    voxels = noise(grid.shape_zyx, dtype)
    for camera in ("outside", "inside"):
        scene = scene_of(voxels, camera_at(camera, grid), step=0.7, size=(33, 29), **keys)
        drawn = []
        for edges in (None, ((1,), (1, 2, 4), (3, 4, 6))):
            prepared = prepare(scene, voxels, grid, 8, edges)
            drawn.append(draw_on_cpu(prepared, build_tree(prepared.plan.cost, 1).leaves[0].box))
        uniform, larger = drawn
        assert uniform.partial.rgba.any()
        assert np.array_equal(uniform.partial.rgba, larger.partial.rgba)
        assert uniform.samples == larger.samples
        assert uniform.bricks > 2 * larger.bricks


@pytest.mark.parametrize("look", [{}, LIT], ids=["plain", "lit"])
def test_threads_change_nothing(look: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    voxels = noise(dtype="uint8")
    scene = scene_of(voxels, camera_at("outside", GRID), step=0.3, size=(97, 83), look=look)
    drawn = []
    for threads in ("1", "2", "5"):
        monkeypatch.setenv("NUMBA_NUM_THREADS", threads)
        drawn.append(draw_on_cpu(prepare(scene, voxels)))
    for other in drawn[1:]:
        assert np.array_equal(other.partial.rgba, drawn[0].partial.rgba)
        assert other.samples == drawn[0].samples


def test_gaps_between_visible_bricks_are_leapt_over_and_their_ends_are_not() -> None:
    """Visible sheets far apart, one cell thick, at the ends of groups and of bricks that groups do not divide."""
    voxels = np.zeros((9, 9, 120), np.uint8)
    voxels[..., [0, 8, 9, 33, 63, 64, 65, 119]] = 200
    grid = Grid(voxels.shape)
    scene = scene_of(voxels, camera_at("outside", grid), clim=(0.0, 255.0), opacity=((0.3, 0.0), (1.0, 0.9)), step=0.4)
    expected = render_reference(scene, grid, voxels)
    for brick in (64, 33, 12, 8, 5):
        drawn = draw_on_cpu(prepare(scene, voxels, grid, brick))
        assert np.abs(whole(drawn.partial, scene.image.size) - expected).max() <= BOUND, brick


def test_without_bricks_the_picture_is_blank() -> None:
    prepared = prepare(scene_of(noise(), camera_at("outside", GRID)), noise())
    hidden = replace(prepared.plan, cost=np.zeros_like(prepared.plan.cost))
    caster = VectorCaster(hidden)
    (drawn,) = caster.draw(hidden, [Piece(0, build_tree(prepared.plan.cost, 1).leaves[0].trimmed)])
    assert drawn.partial.rect.pixels == 0


def test_bricks_come_and_go() -> None:
    """Every second brick alone, then the others alone: together they are the whole, and nothing is held twice."""
    voxels = noise(dtype="uint16")
    scene = scene_of(voxels, camera_at("outside", GRID), opacity=((0.0, 0.001), (1.0, 0.02)), step=0.4)
    prepared = prepare(scene, voxels, brick=7)
    plan, bricks = prepared.plan, shown(prepared)
    caster = VectorCaster(plan)
    box = build_tree(plan.cost, 1).leaves[0].trimmed
    own = np.indices(box.shape_zyx).sum(axis=0) % 2 == 0
    samples, size = 0, []
    for mine in (own, ~own):
        here = {index: bricks[index] for index in bricks if mine[tuple(np.subtract(index, box.begin_zyx))]}
        caster.drop(caster.pool.bricks)
        caster.load(plan, dict(here))
        assert caster.pool.bricks == set(here)
        samples += caster.draw(plan, [Piece(0, box, mine)])[0].samples
        size.append(caster.voxel_bytes)
    assert samples == draw_on_cpu(prepared).samples
    assert max(size) <= 4 * len(bricks) * (8**3 + 1)


@pytest.mark.parametrize(
    ("dtype", "look"),
    [("uint8", LIT), ("uint16", {}), ("float32", {"interpolation": "cubic"})],
    ids=["u8 lit", "u16", "f32 cubic"],
)
def test_numbers_of_64_bits_change_nothing(dtype: str, look: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """As more than 16 GiB of voxels need them."""
    voxels = noise(dtype=dtype)
    keys = look if "interpolation" in look else {"look": look}
    prepared = prepare(scene_of(voxels, camera_at("outside", GRID), **keys), voxels, brick=7)
    narrow = draw_on_cpu(prepared)
    monkeypatch.setattr(memory, "NARROW", 0)
    wide = draw_on_cpu(prepared)
    assert np.array_equal(wide.partial.rgba, narrow.partial.rgba)
    assert wide.samples == narrow.samples > 0


def test_bricks_that_are_read_back_outlast_their_slots() -> None:
    voxels = noise(dtype="uint16")
    prepared = prepare(scene_of(voxels, camera_at("outside", GRID)), voxels, brick=7)
    caster = VectorCaster(prepared.plan)
    first, *others = bricks = shown(prepared)
    caster.load(prepared.plan, {first: bricks[first]})
    ((_, stored),) = caster.pool.stored([first])
    before = stored.samples.copy()
    caster.drop([first])
    caster.load(prepared.plan, {index: bricks[index] for index in others})
    assert np.array_equal(stored.samples, before)


def test_windows_cut_the_picture() -> None:
    voxels = noise(dtype="uint8")
    scene = scene_of(voxels, camera_at("outside", GRID))
    prepared = prepare(scene, voxels)
    picture = whole(draw_on_cpu(prepared).partial, (24, 20))
    caster, box = VectorCaster(prepared.plan), build_tree(prepared.plan.cost, 1).leaves[0].trimmed
    caster.load(prepared.plan, shown(prepared))
    window = Rect(5, 3, 18, 14)
    (drawn,) = caster.draw(prepared.plan, [Piece(0, box, None, window)])
    rect = drawn.partial.rect
    assert rect.intersect(window) == rect
    assert drawn.work.shape == (-(-rect.height // 8), -(-rect.width // 8))
    assert drawn.work.sum() == drawn.samples
    expected = picture[rect.y_begin : rect.y_end, rect.x_begin : rect.x_end]
    assert np.array_equal(drawn.partial.rgba, expected)
