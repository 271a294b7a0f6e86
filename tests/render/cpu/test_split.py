"""Slabs that are cut at bricks, with the processor's vectors: what is empty is left out; ../test_split.py says more."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from render.scenes import draw_on_cpu, prepare, whole
from render.test_independence import in_parts
from render.test_split import split_scene

from clusterviz.data.source import Grid
from clusterviz.reference import render_reference


@pytest.mark.parametrize("brick", [5, 12, 16])
def test_leaps_end_before_what_is_visible(brick: int) -> None:
    """Single voxels, in bricks that groups of cells divide, do not divide, and that are smaller than a group."""
    voxels = (np.random.default_rng(2).random((26, 41, 43)) > 0.998).astype(np.uint8) * 200
    grid, size = Grid(voxels.shape), (14, 12)
    keys: dict[str, Any] = {"clim": (0.0, 200.0), "opacity": ((0.0, 0.0), (0.02, 0.3)), "step": 1.7, "size": size}
    scene = split_scene(voxels, "outside", brick, grid=grid, **keys)
    prepared = prepare(scene, voxels, grid, brick)
    drawn = draw_on_cpu(prepared)
    picture, expected = whole(drawn.partial, size), render_reference(scene, grid, voxels)
    assert expected[..., 3].max() > 0.1
    assert np.abs(picture - expected).max() <= 1e-5
    found, samples = in_parts(None, scene, prepared, 5)
    assert samples == drawn.samples
    assert np.abs(found - picture).max() <= 1e-6
