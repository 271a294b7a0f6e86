"""`quality.pixel` in the frame loop: fewer bytes and the stated error bound, in every mode."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from frame.views import ALL, draw_all, views

from clusterviz.comm import LoopbackChannel, run_loopback
from clusterviz.composite import rounding_bound
from clusterviz.errors import SceneError
from clusterviz.frame import Options, render_frame
from clusterviz.scene.overrides import with_settings

BYTES = {"float32": 16, "float16": 8, "uint8": 4}


@pytest.mark.gl
@pytest.mark.parametrize(
    "keys",
    [{"transport": "messages"}, {"mode": "sort-first"}, {"distribution": "interleaved", "transport": "messages"}],
)
def test_the_picture_is_the_same_to_the_bound_and_the_bytes_are_fewer(keys: dict[str, Any]) -> None:
    scene = with_settings(views(1)[0], {"opacity": ALL, "codec": "raw", **keys})
    exact = draw_all([scene], LoopbackChannel())[0].image
    assert exact is not None
    scenes = [with_settings(scene, {"pixel": pixel}) for pixel in BYTES]
    frames = run_loopback(3, lambda channel: draw_all(scenes, channel))
    pixels = [
        sum(rank.bytes_raw for rank in one.statistics.per_rank) / size
        for one, size in zip(frames[0], BYTES.values(), strict=True)
    ]
    assert pixels[0] > 0
    assert pixels == [pixels[0]] * 3
    for frame, pixel in zip(frames[0], BYTES, strict=True):
        assert frame.image is not None
        assert frame.image.dtype == np.float32
        images = max(3, sum(rank.bricks_drawn for rank in frame.statistics.per_rank))
        assert np.abs(frame.image - exact).max() <= max(1e-6, rounding_bound(pixel, images))


@pytest.mark.gl
def test_a_check_of_compositing_allows_for_rounding() -> None:
    scene = with_settings(views(1)[0], {"opacity": ALL, "pixel": "float16", "compositing": "binary-swap"})
    frames = run_loopback(4, lambda channel: render_frame(scene, channel, options=Options(check=True)))
    assert frames[0].image is not None


def test_scalars_and_sums_are_not_rounded() -> None:
    with pytest.raises(SceneError, match=r"quality.pixel: uint8 holds colours only; found \"blending: maximum"):
        with_settings(views(1)[0], {"pixel": "uint8", "blending": "maximum"})
