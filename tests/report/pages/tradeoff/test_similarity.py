"""SSIM by the paper's definition: known values of its terms, and a window by window computation."""

from __future__ import annotations

import numpy as np
import pytest

from clusterviz.report.pages.tradeoff.similarity import luminance, ssim

RNG = np.random.default_rng(3)


def window_by_window(x: np.ndarray, y: np.ndarray) -> float:
    """Equations 13 and 14 to 16 of the paper, one window after another, in two dimensions."""
    offset = np.arange(11) - 5
    weight = np.exp(-(offset[:, None] ** 2 + offset**2) / (2 * 1.5**2))
    weight /= weight.sum()
    found = []
    for row in range(x.shape[0] - 10):
        for column in range(x.shape[1] - 10):
            a, b = (picture[row : row + 11, column : column + 11] for picture in (x, y))
            mean_a, mean_b = (weight * a).sum(), (weight * b).sum()
            var_a, var_b = (weight * (a - mean_a) ** 2).sum(), (weight * (b - mean_b) ** 2).sum()
            cov = (weight * (a - mean_a) * (b - mean_b)).sum()
            above = (2 * mean_a * mean_b + 1e-4) * (2 * cov + 9e-4)
            found.append(above / ((mean_a**2 + mean_b**2 + 1e-4) * (var_a + var_b + 9e-4)))
    return float(np.mean(found))


def test_against_the_definition() -> None:
    x, y = RNG.random((14, 17)), RNG.random((14, 17))
    for a, b in ((x, y), (x, 0.9 * x + 0.05), (x, 1 - x)):
        assert ssim(a, b) == pytest.approx(window_by_window(a, b), abs=1e-12)


def test_equal_pictures_are_alike_and_opposite_ones_are_not() -> None:
    x = RNG.random((20, 20))
    assert ssim(x, x) == pytest.approx(1, abs=1e-12)
    assert ssim(x, 1 - x) < -0.5


def test_flat_pictures_differ_by_luminance_alone() -> None:
    assert ssim(np.full((12, 12), 0.2), np.full((12, 12), 0.6)) == pytest.approx(0.2401 / 0.4001, abs=1e-9)


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (5, 3), (11, 11)])
def test_pictures_smaller_than_the_window(shape: tuple[int, int]) -> None:
    x = RNG.random(shape)
    assert ssim(x, x) == pytest.approx(1, abs=1e-12)
    assert ssim(x, 1 - x) < 0.99


def test_luminance_of_white_is_one_and_green_counts_most() -> None:
    grey = luminance(np.array([[[1, 1, 1], [1, 0, 0], [0, 1, 0], [0, 0, 1]]]))
    assert grey[0] == pytest.approx([1, 0.299, 0.587, 0.114])
