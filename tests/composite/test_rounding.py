"""Fewer bits: rounded to nearest, and no picture further off than is stated, by any algorithm and number of images."""

from __future__ import annotations

import numpy as np
import pytest
from composite.images import over_all, picture, random_partial, random_rect

from clusterviz.comm import run_loopback
from clusterviz.composite import ALGORITHMS, as_floats, rounded, rounding_bound
from clusterviz.image.partial import PartialImage, blank
from clusterviz.image.region import Rect

SIZE = (13, 9)


@pytest.mark.parametrize("pixel", ["float16", "uint8"])
def test_values_are_rounded_to_nearest(pixel: str) -> None:
    partial = random_partial(np.random.default_rng(3), Rect(2, 1, 9, 8), np.float32)
    found, step = rounded(partial, pixel), 2.0**-11 if pixel == "float16" else 1 / 255
    assert found.rect == partial.rect
    assert found.rgba.dtype == pixel
    floats = as_floats(found.rgba)
    assert np.abs(floats - partial.rgba).max() <= 0.5001 * step
    np.testing.assert_array_equal(rounded(PartialImage(partial.rect, floats), pixel).rgba, found.rgba)


def test_floats_stay_what_they_are_and_nothing_stays_nothing() -> None:
    partial = random_partial(np.random.default_rng(4), Rect(0, 0, 5, 4), np.float32)
    assert rounded(partial, "float32") is partial
    assert rounded(blank(), "uint8").rgba.shape == (0, 0, 4)


@pytest.mark.parametrize("pixel", ["float16", "uint8"])
@pytest.mark.parametrize("algorithm", [name for name in ALGORITHMS if name != "auto"])
def test_no_picture_is_further_off_than_is_stated(algorithm: str, pixel: str) -> None:
    for ranks in (2, 5):
        rng = np.random.default_rng(ranks)
        whole = Rect(0, 0, *SIZE)
        drawn = [
            random_partial(rng, whole if rank % 2 else random_rect(rng, SIZE), np.float32) for rank in range(ranks)
        ]
        order = rng.permutation(ranks).tolist()
        stored = [rounded(one, pixel) for one in drawn]
        made = run_loopback(ranks, lambda channel, given=(stored, order): picture(channel, *given, SIZE, algorithm))
        assert made[0] is not None
        error = np.abs(as_floats(made[0]) - over_all(drawn, order, SIZE)).max()
        assert 0 < error <= rounding_bound(pixel, ranks)
