"""Warnings for pictures that show nothing: with a reason and numbers, and only then."""

from __future__ import annotations

import re
import warnings
from typing import Any

import numpy as np
import pytest

from clusterviz.comm import LoopbackChannel
from clusterviz.data.memory import ArraySource
from clusterviz.frame import FrameLoop, Options, render_frame
from clusterviz.scene import Scene, Volume
from clusterviz.scene.overrides import with_settings

RAMP = np.linspace(0, 255, 6 * 7 * 8).reshape(6, 7, 8).astype(np.float32)
AWAY = {"position": (3, 3, -50), "focal_point": (3, 3, -90)}
CASES: list[tuple[np.ndarray, dict[str, Any], str]] = [
    (RAMP, {}, ""),
    (RAMP, {"clim": (300, 400)}, "clim 300 to 400 lies beyond the data's range 0 to 255: nothing is drawn"),
    (RAMP, {"clim": (-9, -5), "opacity": 0.5}, "clim -9 to -5 lies beyond .* 0 to 255: all of it has one colour"),
    (RAMP, {"opacity": 0}, "opacity is 0 all over the data's range 0 to 255: nothing is drawn"),
    (RAMP, {"blending": "maximum", "opacity": [[256, 0], [300, 1]]}, "opacity is 0 all over"),
    (RAMP, {"blending": "isosurface", "isosurfaces": [500]}, "no isosurface, since 500 lies beyond .* 0 to 255"),
    (RAMP, {"isosurfaces": [100], "opacity": [[0, 0.0], [99, 0.0], [101, 0.5]]}, ""),
    (np.full_like(RAMP, np.nan), {}, "all 336 samples are NaN or infinite"),
    (
        RAMP,
        AWAY,
        r"camera looks away: from \(3, 3, -50\) towards \(3, 3, -90\) .* \(0, 0, 0\) to \(7, 6, 5\) lies behind",
    ),
    (RAMP, {"position": (3, 3, 50), "focal_point": (90, 3, 0)}, "lies beside the picture: .* of 24 × 18"),
    (RAMP, {"position": (3, 3, 5e4), "focal_point": (3, 3, 0)}, r"covers 0.00\d+ × 0.00\d+ pixels: the eye is 49997"),
    (RAMP, {"box": (90, 91, 90, 91, 90, 91)}, "the picture is empty"),
]


def scene_of(settings: dict[str, Any]) -> Scene:
    return with_settings(Scene(volumes=(Volume(path="array"),)), {"size": (24, 18), "brick": 8, **settings})


@pytest.mark.parametrize(("voxels", "settings", "expected"), CASES)
def test_what_is_not_seen_is_said(voxels: np.ndarray, settings: dict[str, Any], expected: str) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        done = render_frame(scene_of(settings), LoopbackChannel(), ArraySource(voxels), Options("cpu"))
    lines = [str(warning.message) for warning in caught]
    assert tuple(lines) == done.statistics.warnings == tuple(done.statistics.as_json()["warnings"])
    assert len(lines) == bool(expected)
    assert re.search(expected, "".join(lines))
    assert expected or (done.image is not None and done.image[..., 3].any())


def test_a_scene_without_volumes_and_frames_of_one_animation() -> None:
    with pytest.warns(UserWarning, match="the scene has no volumes"):
        render_frame(Scene(), LoopbackChannel(), options=Options("cpu"))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with FrameLoop(scene_of(AWAY), LoopbackChannel(), ArraySource(RAMP), Options("cpu")) as loop:
            frames = [loop.frame(number=number) for number in range(3)]
    assert len(caught) == 1
    assert all(frame.statistics.warnings for frame in frames)
