"""Difference of two pictures."""

from __future__ import annotations

import math

import numpy as np
import pytest

from clusterviz.errors import InputError
from clusterviz.image import compare

BLACK = np.zeros((4, 5, 4), np.float32)


def changed(*changes: tuple[int, int, int, float]) -> np.ndarray:
    rgba = BLACK.copy()
    for row, column, channel, value in changes:
        rgba[row, column, channel] = value
    return rgba


def test_equal_pictures() -> None:
    difference = compare(BLACK, BLACK)
    assert (difference.max, difference.rms, difference.count, difference.first_wrong_pixel) == (0, 0, 0, None)
    assert str(difference) == "max 0, rms 0, no pixel above 0"
    assert compare(BLACK[:0], BLACK[:0]).count == 0


def test_max_rms_count_and_first_pixel() -> None:
    difference = compare(BLACK, changed((3, 0, 0, 0.5), (1, 4, 2, -0.25), (1, 4, 3, 0.25), (0, 0, 1, 0.125)), 0.125)
    assert difference.max == 0.5
    assert difference.rms == pytest.approx(math.sqrt((0.25 + 2 * 0.0625 + 0.015625) / BLACK.size), rel=1e-15)
    assert difference.count == 2
    assert difference.first_wrong_pixel == (1, 4)
    assert str(difference) == "max 0.5, rms 0.0699, 2 pixels above 0.125, the first at row 1, column 4"


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("both", [False, True])
def test_not_finite_is_wrong_even_where_both_agree(value: float, both: bool) -> None:
    broken = changed((2, 3, 1, value))
    difference = compare(broken if both else BLACK, broken, tolerance=math.inf)
    assert (difference.max, difference.rms) == (math.inf, math.inf)
    assert (difference.count, difference.first_wrong_pixel) == (1, (2, 3))


def test_no_difference_is_lost_to_its_type() -> None:
    tiny, huge = np.zeros((1, 1)), np.zeros((1, 1))
    white, dark = np.full((1, 1, 3), 255, np.uint8), np.full((1, 1, 3), 1, np.uint8)
    assert compare(white, dark).max == compare(dark, white).max == 254
    assert compare(tiny, tiny + 1e-200).rms == pytest.approx(1e-200, rel=1e-15, abs=0)
    assert compare(huge, huge + 1e200).rms == pytest.approx(1e200, rel=1e-15)


def test_other_shapes_and_units_are_refused() -> None:
    with pytest.raises(InputError, match=r"\(4, 5, 4\) and \(4, 4, 4\)"):
        compare(BLACK, BLACK[:, :4])
    with pytest.raises(InputError, match="float32 and uint8"):
        compare(BLACK, BLACK.astype(np.uint8))
