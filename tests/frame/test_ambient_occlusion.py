"""Ambient occlusion: the same on any ranks and bricks, with several volumes, and within its limits."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from render.scenes import SHAPE, TURNED, camera_at, scene_of, smooth

from clusterviz.comm import LoopbackChannel, run_loopback
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid
from clusterviz.errors import InputError, SceneError
from clusterviz.frame import Options, render_frame
from clusterviz.reference import render_reference
from clusterviz.scene.overrides import with_settings
from clusterviz.scene.values import Clip, Scene

OBLIQUE = Grid(SHAPE, (1.3, 0.6, 2.0), (100.0, -50.0, 3.0), TURNED)
BESIDE = Grid((15, 12, 17), origin=(106.0, -47.0, 9.0))
DENSE = ((0.5, 0.0), (0.6, 0.5))
KEYS: dict[str, Any] = {"shade": True, "ambient": 0.9, "unit": 3.0, "opacity": DENSE, "clim": (0.0, 1.0)}


def scene(radius: float, **keys: Any) -> Scene:
    found = scene_of(smooth(), camera_at("outside", OBLIQUE), ambient_occlusion={"radius": radius}, **KEYS, **keys)
    return with_settings(found, {"brick": 8})


def draw(shown: Scene, ranks: int, grids: tuple[Grid, ...], device: Any) -> np.ndarray:
    sources = [ArraySource(smooth(grid.shape_zyx), grid) for grid in grids]
    image = run_loopback(ranks, lambda channel: render_frame(shown, channel, sources, Options(device)))[0].image
    assert image is not None
    return image


@pytest.mark.cover("0-grids1")
@pytest.mark.gl
@pytest.mark.parametrize(("device", "grids"), [(0, (OBLIQUE,)), (0, (OBLIQUE, BESIDE)), ("cpu", (OBLIQUE, BESIDE))])
def test_ranks_and_bricks_leave_no_trace(device: Any, grids: tuple[Grid, ...]) -> None:
    cut = (tuple(OBLIQUE.corners.mean(axis=0).tolist()), (1, 0.3, 0))
    shown = scene(3.0, clip=Clip(planes=(cut,)))
    shown = shown.model_copy(update={"volumes": shown.volumes * len(grids)})
    alone = draw(shown, 1, grids, device)
    expected = render_reference(shown, grids, [smooth(grid.shape_zyx) for grid in grids])
    assert np.abs(alone - expected).max() < 4e-5
    assert (
        draw(with_settings(shown, {"volumes.0.ambient_occlusion.strength": 0.0}), 1, grids, device) - alone
    ).max() > 0.1
    for ranks in (3, 5):
        assert np.abs(draw(shown, ranks, grids, device) - alone).max() < 1e-5
    assert np.abs(draw(with_settings(shown, {"brick": 64}), 1, grids, device) - alone).max() < 1e-5


def test_limits() -> None:
    said = "radius: too many voxels .*; found 10, which is 16.7 voxels; allowed at most 4.8, which is 8 voxels"
    with pytest.raises(InputError, match=said):
        render_frame(scene(10.0), LoopbackChannel(), ArraySource(smooth(), OBLIQUE), Options("cpu"))
    for keys in ({"shade": False}, {"blending": "maximum"}, {"gradient_opacity": ((0.0, 1.0),)}):
        with pytest.raises(SceneError, match="ambient_occlusion: not with"):
            with_settings(scene(3.0), keys)
