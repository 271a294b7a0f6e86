"""Serial compositing: the formula, grouping, and opacities at both ends."""

from __future__ import annotations

import numpy as np
import pytest

from clusterviz.errors import InputError
from clusterviz.reference import over


def layers(count: int) -> list[np.ndarray]:
    rgba = np.random.default_rng(9).random((count, 3, 5, 4))
    rgba[..., :3] *= rgba[..., 3:]
    return list(rgba)


def test_two_layers_follow_the_formula() -> None:
    front, back = layers(2)
    assert np.allclose(over([front, back]), front + (1 - front[..., 3:]) * back, rtol=0, atol=1e-16)


def test_grouping_does_not_matter_but_order_does() -> None:
    a = layers(7)
    for cut in range(1, 7):
        assert np.abs(over([over(a[:cut]), over(a[cut:])]) - over(a)).max() < 1e-15
    assert np.abs(over(a[::-1]) - over(a)).max() > 0.01


def test_one_layer_is_itself_and_the_input_stays() -> None:
    (layer,) = layers(1)
    copy = layer.copy()
    result = over([layer])
    result += 1
    assert np.array_equal(layer, copy)


def test_float32_layers_are_summed_in_float64() -> None:
    thin = np.full((1, 1, 4), 1e-8, np.float32)
    opacity = float(np.float32(1e-8))
    assert over([thin] * 1000)[0, 0, 3] == pytest.approx(-np.expm1(1000 * np.log1p(-opacity)), rel=1e-8)


def test_nothing_and_unlike_shapes_are_refused() -> None:
    with pytest.raises(InputError, match="layers"):
        over([])
    with pytest.raises(InputError, match=r"\(1, 1, 4\)"):
        over([np.zeros((1, 1, 4)), np.zeros((1, 2, 4))])
