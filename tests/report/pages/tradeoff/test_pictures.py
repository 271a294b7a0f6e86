"""Pictures of the page: no wrong pixel is lost, and errors are magnified by a stated factor."""

from __future__ import annotations

import base64
import io

import numpy as np
import pytest
from PIL import Image

from clusterviz.report.pages.tradeoff.pictures import MAX_FACTOR, WIDTH, error_map_url, thumbnail_url


def pixels(url: str) -> np.ndarray:
    head, _, data = url.partition(",")
    assert head == "data:image/png;base64"
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))))


def test_a_single_wrong_pixel_survives_being_made_smaller() -> None:
    difference = np.zeros((37, 3 * WIDTH + 1, 4))
    difference[36, 3 * WIDTH, 2] = -0.004
    url, factor = error_map_url(difference)
    seen = pixels(url)
    assert factor == 200
    assert seen.shape[1] <= WIDTH
    assert seen[-1, -1].tolist() == [255, 255, 102]  # 0.8 of full scale: red, green, and 0.4 of blue
    assert np.count_nonzero(seen.any(axis=2)) == 1


@pytest.mark.parametrize(
    ("error", "factor"), [(0.0, 1), (1.0, 1), (0.5, 2), (0.3, 2), (0.011, 50), (1e-12, MAX_FACTOR)]
)
def test_the_factor_is_round_and_makes_the_error_seen(error: float, factor: float) -> None:
    found = error_map_url(np.full((4, 4, 4), error))[1]
    assert found == pytest.approx(factor, rel=1e-12)


def test_errors_rise_from_black_to_white() -> None:
    error = np.zeros((1, 101, 4))
    error[0, :, 3] = np.linspace(0, 1, 101)
    brightness = pixels(error_map_url(error)[0]).sum(axis=2)[0].astype(int)
    assert (brightness[0], brightness[-1]) == (0, 3 * 255)
    assert (np.diff(brightness) >= 0).all()


def test_a_picture_lies_over_its_background() -> None:
    half = np.full((3, 5, 4), 0.5)
    assert pixels(thumbnail_url(half, (1.0, 0.0, 0.0)))[0, 0].tolist() == [255, 128, 128]
    assert pixels(thumbnail_url(half, None)).shape == (3, 5, 4)
