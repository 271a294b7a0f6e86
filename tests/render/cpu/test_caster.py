"""The CPU ray caster's threads, numbers and bricks; ../test_conformance.py holds its pictures to the reference."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from render.scenes import LIT, SHAPE, camera_at, draw, noise, prepare, scene_of, smooth, whole

from clusterviz.data.source import Grid
from clusterviz.image.partial import Rect
from clusterviz.partition import Piece, build_tree
from clusterviz.render import sizes, variant
from clusterviz.render.cpu import memory
from clusterviz.render.cpu.device import cpu_caster

GRID = Grid(SHAPE)


@pytest.mark.cover("float64-adaptive", "float32-interpolation-shade-ambient-diffuse-specular-specular_power")
@pytest.mark.parametrize(
    ("dtype", "keys"),
    [
        ("uint8", LIT),
        ("int16", {"interpolation": "cubic"}),
        ("float32", {"classification": "pre-integrated", "borders": "split"}),
        ("float64", {"adaptive": 0.01}),
        ("float32", {"interpolation": "nearest"} | LIT),
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
            drawn.append(draw(None, prepared, build_tree(prepared.plan.cost, 1).leaves[0].box))
        uniform, larger = drawn
        assert uniform.partial.rgba.any()
        assert np.array_equal(uniform.partial.rgba, larger.partial.rgba)
        assert uniform.samples == larger.samples
        assert uniform.bricks > 2 * larger.bricks


@pytest.mark.cover
@pytest.mark.parametrize(
    "keys",
    [{}, LIT, {"classification": "pre-integrated"}, {"blending": "isosurface", "isosurfaces": [(140.0, 0.4), 100.0]}],
    ids=["plain", "lit", "pre-integrated", "surfaces"],
)
def test_threads_change_nothing(keys: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    voxels = smooth(dtype="uint8")
    prepared = prepare(scene_of(voxels, camera_at("outside", GRID), step=0.3, size=(97, 83), **keys), voxels)
    drawn = []
    for threads in ("1", "2", "5"):
        monkeypatch.setenv("NUMBA_NUM_THREADS", threads)
        drawn.append(draw(None, prepared))
    assert drawn[0].partial.rgba.any()
    for other in drawn[1:]:
        assert np.array_equal(other.partial.rgba, drawn[0].partial.rgba)
        assert other.samples == drawn[0].samples


def test_without_bricks_the_picture_is_blank() -> None:
    prepared = prepare(scene_of(noise(), camera_at("outside", GRID)), noise())
    hidden = replace(prepared.plan, cost=np.zeros_like(prepared.plan.cost))
    caster = cpu_caster(hidden)
    (drawn,) = caster.draw(hidden, [Piece(0, build_tree(prepared.plan.cost, 1).leaves[0].trimmed)])
    assert drawn.partial.rect.pixels == 0


def test_bricks_come_and_go() -> None:
    """Every second brick alone, then the others alone: together they are the whole, and nothing is held twice."""
    voxels = noise(dtype="uint16")
    scene = scene_of(voxels, camera_at("outside", GRID), opacity=((0.0, 0.001), (1.0, 0.02)), step=0.4)
    prepared = prepare(scene, voxels, brick=7)
    plan, bricks = prepared.plan, prepared.shown
    caster = cpu_caster(plan)
    box = build_tree(plan.cost, 1).leaves[0].trimmed
    own = np.indices(box.shape_zyx).sum(axis=0) % 2 == 0
    samples, size = 0, []
    for mine in (own, ~own):
        here = {index: bricks[index] for index in bricks if mine[tuple(np.subtract(index, box.begin_zyx))]}
        caster.drop(caster.pool.bricks)
        caster.load(plan, dict(here))
        assert caster.pool.bricks == set(here)
        samples += caster.draw(plan, [Piece(0, box, mine)])[0].samples
        size.append(caster.pool.bytes)
    assert samples == draw(None, prepared).samples
    assert max(size) <= 4 * len(bricks) * (8**3 + 1)


@pytest.mark.cover
@pytest.mark.parametrize(
    ("dtype", "keys"),
    [("uint8", LIT), ("uint16", {}), ("float32", {"interpolation": "cubic"})],
    ids=["u8 lit", "u16", "f32 cubic"],
)
def test_numbers_of_64_bits_change_nothing(dtype: str, keys: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """As more than 16 GiB of voxels need them."""
    voxels = noise(dtype=dtype)
    prepared = prepare(scene_of(voxels, camera_at("outside", GRID), **keys), voxels, brick=7)
    narrow = draw(None, prepared)
    monkeypatch.setattr(memory, "NARROW", 0)
    wide = draw(None, prepared)
    assert np.array_equal(wide.partial.rgba, narrow.partial.rgba)
    assert wide.samples == narrow.samples > 0


def test_neither_sizes_as_constants_nor_prefetching_change_anything(monkeypatch: pytest.MonkeyPatch) -> None:
    """A volume that fills bricks of the usual size has them as constants; voxels far apart are fetched ahead."""
    grid = Grid((65, 66, 67))
    voxels = smooth(grid.shape_zyx, "uint8")
    prepared = prepare(scene_of(voxels, camera_at("outside", grid), step=2.0), voxels, grid, brick=64)
    usual = draw(None, prepared)
    monkeypatch.setattr(sizes, "CACHED", 0)
    ahead = draw(None, prepared)
    monkeypatch.setattr(variant, "USUAL_BRICK", 0)
    for other in (ahead, draw(None, prepared)):
        assert other.samples == usual.samples > 0
        assert np.array_equal(other.partial.rgba, usual.partial.rgba)


def test_bricks_that_are_read_back_outlast_their_slots() -> None:
    voxels = noise(dtype="uint16")
    prepared = prepare(scene_of(voxels, camera_at("outside", GRID)), voxels, brick=7)
    caster = cpu_caster(prepared.plan)
    first, *others = bricks = prepared.shown
    caster.load(prepared.plan, {first: bricks[first]})
    ((_, stored),) = caster.pool.stored([first])
    before = stored.parts[0].samples.copy()
    caster.drop([first])
    caster.load(prepared.plan, {index: bricks[index] for index in others})
    assert np.array_equal(stored.parts[0].samples, before)


def test_windows_cut_the_picture() -> None:
    voxels = noise(dtype="uint8")
    scene = scene_of(voxels, camera_at("outside", GRID))
    prepared = prepare(scene, voxels)
    picture = whole(draw(None, prepared).partial, (24, 20))
    caster, box = cpu_caster(prepared.plan), build_tree(prepared.plan.cost, 1).leaves[0].trimmed
    caster.load(prepared.plan, prepared.shown)
    window = Rect(5, 3, 18, 14)
    (drawn,) = caster.draw(prepared.plan, [Piece(0, box, None, window)])
    rect = drawn.partial.rect
    assert rect.intersect(window) == rect
    assert drawn.work.shape == (-(-rect.height // 8), -(-rect.width // 8))
    assert drawn.work.sum() == drawn.samples
    expected = picture[rect.y_begin : rect.y_end, rect.x_begin : rect.x_end]
    assert np.array_equal(drawn.partial.rgba, expected)
