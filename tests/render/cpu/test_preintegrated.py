"""Pre-integrated slabs in every width of vectors, and where little light is left; test_preintegrated.py says more."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from render.scenes import SHAPE, camera_at, draw_on_cpu, noise, prepare, scene_of, whole

from clusterviz.data.source import Grid
from clusterviz.reference import render_reference
from clusterviz.render.cpu.width import WIDTHS, Width

GRID = Grid(SHAPE)
BOUND = 1e-5
NARROWER = [width for width in WIDTHS if width.lanes < 16]
STRIPES = tuple((x, 0.9 * (k % 2)) for k, x in enumerate(np.linspace(0, 1, 24).tolist()))
OPAQUE = ((0.0, 0.0), (0.3, 0.0), (0.3, 1.0), (1.0, 1.0))


def scene_between(voxels: np.ndarray, **keys: Any) -> Any:
    return scene_of(voxels, camera_at("outside", GRID), classification="pre-integrated", **keys)


@pytest.mark.parametrize("width", [None, *NARROWER], ids=["own", *(width.lanes for width in NARROWER)])
def test_all_widths_give_the_picture_of_the_reference(width: Width | None) -> None:
    """Slabs that pass many whole segments, and such that are opaque at once."""
    voxels = noise()
    voxels[np.random.default_rng(3).random(SHAPE) < 0.01] = np.nan
    for opacity in (STRIPES, OPAQUE):
        scene = scene_between(voxels, opacity=opacity, step=0.9, clim=(-0.9, 0.9), size=(23, 19))
        found = whole(draw_on_cpu(prepare(scene, voxels, brick=7), width=width).partial, (23, 19))
        expected = render_reference(scene, GRID, voxels)
        assert expected[..., 3].max() > 0.5
        assert np.abs(found - expected).max() <= BOUND


def test_a_ray_ends_with_the_slab_that_leaves_too_little_light() -> None:
    voxels = noise(dtype="uint8")
    drawn = []
    for residual in (0.0, 0.01):
        scene = scene_between(voxels, opacity=0.9, unit=1.0, step=0.4, early_termination=residual)
        drawn.append(draw_on_cpu(prepare(scene, voxels, brick=64)))
    difference = np.abs(whole(drawn[0].partial, (24, 20)) - whole(drawn[1].partial, (24, 20)))
    assert 0 < difference.max() <= 0.01
    assert drawn[1].samples < 0.3 * drawn[0].samples


def test_threads_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    voxels = noise(dtype="uint8")
    scene = scene_between(voxels, step=0.5, size=(97, 83))
    drawn = []
    for threads in ("1", "3"):
        monkeypatch.setenv("NUMBA_NUM_THREADS", threads)
        drawn.append(draw_on_cpu(prepare(scene, voxels)))
    assert np.array_equal(drawn[0].partial.rgba, drawn[1].partial.rgba)
    assert drawn[0].samples == drawn[1].samples
