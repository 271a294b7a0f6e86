"""Float pixels to bytes: exact levels, rounding, clipping, straight alpha."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clusterviz.errors import InputError
from clusterviz.image import finish

LEVELS = np.arange(256, dtype=np.uint8)


def pixel(*rgba: float) -> np.ndarray:
    return np.array(rgba, np.float32).reshape(1, 1, 4)


def test_every_level_of_an_opaque_picture_survives() -> None:
    rgba = np.ones((1, 256, 4), np.float32)
    rgba[..., :3] = (LEVELS / 255)[None, :, None]
    assert (finish(rgba, (1, 1, 1)) == LEVELS[None, :, None]).all()
    assert (finish(rgba, None)[..., :3] == LEVELS[None, :, None]).all()
    assert (finish(rgba, None)[..., 3] == 255).all()


def test_straight_colour_and_alpha_come_back_from_premultiplied() -> None:
    colour, alpha = np.meshgrid(LEVELS, LEVELS[1:], indexing="ij")
    rgba = np.repeat((colour / 255.0 * (alpha / 255.0))[..., None], 4, axis=-1).astype(np.float32)
    rgba[..., 3] = alpha / 255.0
    bytes_ = finish(rgba, None)
    assert (bytes_[..., 0] == colour).all()
    assert (bytes_[..., 3] == alpha).all()


@given(*[st.floats(0, 1, width=32)] * 4)
def test_a_pixel_is_within_half_a_level_of_exact_arithmetic(
    colour: float, alpha: float, red: float, blue: float
) -> None:
    value = finish(pixel(colour * alpha, 0, 0, alpha), (red, 0, blue))
    assert value.shape == (1, 1, 3)
    assert abs(float(value[0, 0, 0]) - 255 * (colour * alpha + (1 - alpha) * red)) <= 0.5 + 1e-4
    assert abs(float(value[0, 0, 2]) - 255 * (1 - alpha) * blue) <= 0.5 + 1e-4


def test_nothing_drawn_shows_the_background_or_nothing() -> None:
    empty = np.zeros((2, 3, 4), np.float32)
    assert (finish(empty, (0.2, 0.4, 1.0)) == [51, 102, 255]).all()
    assert (finish(empty, None) == 0).all()
    assert not empty.any(), "the input is not changed"


def test_values_outside_0_to_1_and_nan_are_clipped() -> None:
    assert finish(pixel(2, -1, np.nan, 1), (0, 0, 0)).tolist() == [[[255, 0, 0]]]
    assert finish(pixel(np.inf, 0.5, -np.inf, 0.5), None).tolist() == [[[255, 255, 0, 128]]]
    assert finish(pixel(1e-40, 0, 0, 1e-40), None).tolist() == [[[255, 0, 0, 0]]]


def test_three_channels_are_refused() -> None:
    with pytest.raises(InputError, match=r"\(2, 2, 3\)"):
        finish(np.zeros((2, 2, 3), np.float32), None)
