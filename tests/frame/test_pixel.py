"""`quality.pixel` in the frame loop: fewer bytes and the stated error bound, in every mode."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from frame.views import ALL, on_ranks, pixels, views

from clusterviz.composite import rounding_bound
from clusterviz.errors import SceneError
from clusterviz.scene.overrides import with_settings

BYTES = {"float32": 16, "float16": 8, "uint8": 4}


@pytest.mark.gl
@pytest.mark.parametrize(
    "keys",
    [{"transport": "messages"}, {"mode": "sort-first"}, {"distribution": "interleaved", "transport": "messages"}],
)
def test_the_picture_is_the_same_to_the_bound_and_the_bytes_are_fewer(keys: dict[str, Any]) -> None:
    scene = with_settings(views(1)[0], {"opacity": ALL, "codec": "raw", **keys})
    (exact,) = on_ranks(1, [scene])
    frames, sent = on_ranks(3, [with_settings(scene, {"pixel": pixel}) for pixel in BYTES]), set()
    for frame, (pixel, size) in zip(frames, BYTES.items(), strict=True):
        sent.add(sum(rank.bytes_raw for rank in frame.statistics.per_rank) / size)
        assert pixels(frame).dtype == np.float32
        images = max(3, sum(rank.bricks_drawn for rank in frame.statistics.per_rank))
        assert np.abs(pixels(frame) - pixels(exact)).max() <= max(1e-6, rounding_bound(pixel, images))
    assert len(sent) == 1
    assert min(sent) > 0


@pytest.mark.gl
def test_a_check_of_compositing_allows_for_rounding() -> None:
    scene = with_settings(views(1)[0], {"opacity": ALL, "pixel": "float16", "compositing": "binary-swap"})
    assert pixels(on_ranks(4, [scene], check=True)[0]).any()


def test_scalars_and_sums_are_not_rounded() -> None:
    with pytest.raises(SceneError, match=r"quality.pixel: uint8 holds colours only; found \"blending: maximum"):
        with_settings(views(1)[0], {"pixel": "uint8", "blending": "maximum"})
