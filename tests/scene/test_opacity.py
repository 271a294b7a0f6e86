"""Opacity presets have PyVista's values over the range of the colour map."""

from __future__ import annotations

import numpy as np
import pytest

from clusterviz.scene.opacity import PRESETS, opacity_points, preset_points
from clusterviz.scene.transfer import TransferFunction

BLACK = (np.zeros(1), np.zeros((1, 3)))


def table(name: str) -> np.ndarray:
    """The preset at PyVista's 256 places, in bytes."""
    places, opacities = preset_points(name)
    function = TransferFunction(*BLACK, places, opacities, 1.0, (0.0, 1.0))
    return function.opacity(np.linspace(0, 1, 256)) * 255


@pytest.mark.parametrize(("name", "reach"), [("sigmoid", 10), ("sigmoid_3", 3), ("sigmoid_10", 10), ("sigmoid_20", 20)])
def test_sigmoids_are_bytes_of_the_logistic_curve(name: str, reach: int) -> None:
    expected = np.array(1 / (1 + np.exp(-np.linspace(-reach, reach, 256))) * 255, np.uint8)
    np.testing.assert_allclose(table(name), expected, atol=1e-9)
    np.testing.assert_allclose(table(f"{name}_r"), expected[::-1], atol=1e-9)


def test_linear_and_geom_are_the_spaced_bytes() -> None:
    np.testing.assert_allclose(table("linear"), np.linspace(0, 255, 256, dtype=np.uint8), atol=1e-9)
    np.testing.assert_allclose(table("linear_r"), np.linspace(255, 0, 256, dtype=np.uint8), atol=1e-9)
    np.testing.assert_allclose(table("geom"), np.geomspace(1e-6, 255, 256, dtype=np.uint8), atol=1e-9)
    np.testing.assert_allclose(table("foreground"), [0] + [255] * 255, atol=1e-9)


def test_linear_needs_two_points_only() -> None:
    places, opacities = preset_points("linear")
    assert places.tolist() == [0, 1]
    assert opacities.tolist() == [0, 1]


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_covers_the_range_exactly(name: str) -> None:
    values, opacities = opacity_points(name, (-1.7e308, 1.7e308))
    assert (values[0], values[-1]) == (-1.7e308, 1.7e308)
    assert np.isfinite(values).all()
    assert (values[1:] > values[:-1]).all()
    assert opacities.min() >= 0
    assert opacities.max() <= 1


def test_numbers_and_points_are_kept() -> None:
    assert [part.tolist() for part in opacity_points(0.25, (1.0, 2.0))] == [[1.0], [0.25]]
    assert [part.tolist() for part in opacity_points(((5, 0), (5, 1)), (1.0, 2.0))] == [[5, 5], [0, 1]]
