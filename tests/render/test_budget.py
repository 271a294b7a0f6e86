"""Calls, waits, buffers and bytes of a frame from another camera; times are nobody's to promise, these are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import moderngl
import numpy as np
import pytest
from render import scenes, test_cells
from render.scenes import Prepared

from clusterviz.data.source import Grid
from clusterviz.gl.device import Counts
from clusterviz.partition import Piece, build_tree
from clusterviz.render import opengl
from clusterviz.render.abuffer import raster
from clusterviz.render.opengl import opengl_caster
from clusterviz.scene.values import Scene

pytestmark = pytest.mark.gl
SHAPE = (40, 36, 44)
VOXELS = scenes.smooth(SHAPE)
DENSE = ((0.0, 0.3), (1.0, 0.99))
Frames = Callable[[float], Prepared]


def moved(scene: Scene, share: float) -> Scene:
    """The scene, seen from a place that much farther away."""
    place = np.array(scene.camera.position) + share * np.array(scene.camera.position)[::-1]
    return scene.model_copy(update={"camera": scene.camera.model_copy(update={"position": tuple(place.tolist())})})


def volumes(**keys: Any) -> Frames:
    """Frames of one volume in 180 bricks."""

    def frame(share: float) -> Prepared:
        scene = scenes.scene_of(VOXELS, scenes.camera_at("outside", Grid(SHAPE)), size=(150, 110), **keys)
        return scenes.prepare(moved(scene, share), VOXELS, Grid(SHAPE), 8)

    return frame


def content(grids: Any, given: Any = (), meshes: Any = (), **keys: Any) -> Frames:
    """Frames of grids, volumes and meshes in few bricks."""

    def frame(share: float) -> Prepared:
        scene = moved(test_cells.scene_of(grids, "outside", given, meshes, **keys), share)
        return test_cells.prepared(scene, grids, given, meshes)

    return frame


GRID = ((test_cells.THIN, test_cells.HOLES),)
KBUFFERED = ((test_cells.by_entries(test_cells.THIN, 16, "sorted"), test_cells.HOLES),)
CASES: dict[str, tuple[Frames, int, int, int]] = {
    "volume": (volumes(), 1, 1, 4096),
    "rays end early": (volumes(early_termination=0.01), 1, 1, 4096),
    "rays end early in what is dense": (volumes(early_termination=0.01, opacity=DENSE), 1, 1, 4096),
    "lit, clipped": (volumes(shade=True, clip=scenes.clip_of(Grid(SHAPE))), 1, 1, 4096),
    "k-buffer": (content(KBUFFERED), 1, 1, 70_000),
    "grid": (content(GRID), 3, 1, 4096),
    "volume, mesh and grid": (content(GRID, (test_cells.VOLUME,), (test_cells.MESH,)), 4, 1, 4096),
}
"""Frames, and most dispatches, waits and uploaded bytes; those of a k-buffer are its tile lists."""


@pytest.mark.cover
@pytest.mark.parametrize("name", CASES)
def test_a_moving_camera_takes_few_calls_one_wait_and_no_buffers(
    context: moderngl.Context, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One more dispatch packs the picture."""
    monkeypatch.setattr(opengl, "ITERATIONS", (1 << 16,) * 2)  # as on GPUs
    monkeypatch.setattr(raster, "is_llvmpipe", lambda _: False)
    frame, dispatches, waits, uploaded = CASES[name]
    one, other = frame(0.0), frame(0.01)
    caster = opengl_caster(context, one.plan, band_pixels=1 << 62, packs=True, raster=True)
    caster.load(one.plan, one.shown | other.shown)
    found = list[Counts]()
    pieces = [Piece(0, build_tree(one.plan.cost, 1).leaves[0].trimmed)]
    for number in range(6):
        plan = replace(one.plan, view=(one, other)[number % 2].plan.view)
        before = replace(caster.counts)
        (drawn,) = caster.draw(plan, pieces)
        found.append(caster.counts.since(before))
    caster.release()
    fresh = opengl_caster(context, other.plan, raster=False)
    fresh.load(other.plan, other.shown)
    (expected,) = fresh.draw(other.plan, pieces)
    fresh.release()
    assert np.array_equal(drawn.partial.rgba, expected.partial.rgba)
    assert (drawn.bricks, drawn.occluded) == (expected.bricks, expected.occluded)
    for each in found[4:]:
        assert each.dispatches <= dispatches + 1
        assert (each.waits, each.made) == (waits, 0)
        assert each.uploaded <= uploaded
    assert found[0].made > 5
