"""Stacks of layers: three numbers against the two-flux equations of the whole stack, and the thesis's form beside."""

from __future__ import annotations

from functools import reduce
from itertools import pairwise

import numpy as np
import pytest
from plan.slabs import slab

from clusterviz.image.spectral.two_flux import Fluxes, over_background, stacked
from clusterviz.reference.two_flux import solve_layers, symmetrical_front_to_back

K, S = np.array([0.14, 0.11, 0.6, 0.06]), np.array([1.44, 0.76, 0.05, 2.49])
"""Four unequal layers of length 1; the docstring of the reference has their figures."""
IDENTITY = Fluxes(np.float64(0), np.float64(0), np.float64(1))


def fluxes_of(k: np.ndarray, s: np.ndarray) -> list[Fluxes]:
    return [Fluxes(*(part[0], part[0], part[1])) for part in zip(*slab(k, s), strict=True)]


def test_three_numbers_solve_the_equations_and_the_thesis_form_does_not() -> None:
    found, solved = reduce(stacked, fluxes_of(K, S)), solve_layers(K, S, 1.0)
    np.testing.assert_allclose(found, solved, rtol=1e-13)
    assert (round(solved.front, 4), round(solved.transmitted, 4)) == (0.6005, 0.0346)
    thesis = symmetrical_front_to_back(list(zip(*slab(K, S), strict=True)))
    assert tuple(round(each, 4) for each in thesis) == (0.6054, 0.0506)
    # Its claim that transmittance does not depend on the direction holds for three numbers, not for its own form.
    turned = list(zip(*slab(K[::-1], S[::-1]), strict=True))
    assert solve_layers(K[::-1], S[::-1], 1.0).transmitted == pytest.approx(solved.transmitted, rel=1e-13)
    assert abs(symmetrical_front_to_back(turned)[1] - thesis[1]) > 1e-3


def test_equal_layers_are_one_layer_in_both_forms() -> None:
    whole = slab(0.3, 1.2)
    parts = list(zip(*slab(np.full(4, 0.075), np.full(4, 0.3)), strict=True))
    np.testing.assert_allclose(symmetrical_front_to_back(parts), whole, rtol=1e-13)
    np.testing.assert_allclose(solve_layers(0.3, 1.2, np.ones(1)), (whole[0], whole[0], whole[1]), rtol=1e-13)


@pytest.mark.parametrize("seed", range(20))
def test_random_stacks(seed: int) -> None:
    rng = np.random.default_rng(seed)
    k, s = rng.choice([0, 1], (2, 12), p=[0.2, 0.8]) * 10 ** rng.uniform(-6, 0.5, (2, 12))
    layers = fluxes_of(k, s)
    found, solved = reduce(stacked, layers), solve_layers(k, s, 1.0)
    np.testing.assert_allclose(found, solved, rtol=1e-11, atol=1e-300)
    assert found.front + found.transmitted <= 1 + 1e-15
    # Any grouping, and any place of the identity.
    cut = rng.integers(1, 11)
    grouped = stacked(reduce(stacked, layers[:cut]), stacked(IDENTITY, reduce(stacked, layers[cut:])))
    np.testing.assert_allclose(grouped, found, rtol=1e-13)
    assert stacked(IDENTITY, found) == stacked(found, IDENTITY) == found
    # Turned round.
    np.testing.assert_allclose(reduce(stacked, layers[::-1]), (found.back, found.front, found.transmitted), rtol=1e-12)
    # Over a background, which is a layer that transmits nothing.
    mirror = Fluxes(np.float64(0.7), np.float64(0.7), np.float64(0.0))
    assert over_background(found, np.float64(0.7)) == stacked(found, mirror).front


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_ten_thousand_slabs_are_one(kind: type[np.floating]) -> None:
    eps = float(np.finfo(kind).eps)
    k, s = np.array([(0.0, 1e6), (0.0, 1e-2), (1e-3, 1e6), (5.0, 20.0), (2.0, 0.0)]).T
    part = slab(k / 1e4, s / 1e4)
    layer = Fluxes(*(each.astype(kind) for each in (part.reflected, part.reflected, part.transmitted)))
    found, whole = reduce(stacked, [layer] * 10_000), slab(k, s)
    assert found.front.dtype == kind
    for each, exact in zip(found, (whole.reflected, whole.reflected, whole.transmitted), strict=True):
        np.testing.assert_allclose(each, exact, atol=1e4 * 4 * eps)
        np.testing.assert_allclose(each[s <= 1], exact[s <= 1], rtol=1e4 * 4 * eps)  # what is small keeps its digits
    total = found.front + found.transmitted
    np.testing.assert_allclose(total[k == 0], 1, atol=1e4 * 4 * eps)
    assert (total <= 1 + eps).all()


def test_reflectances_that_round_to_one() -> None:
    almost = Fluxes(*(np.float32(each) for each in (1.0, 1.0, 1e-9)))
    found = stacked(almost, almost)
    assert found == (1, 1, pytest.approx(5e-10, rel=1e-6))
    mirror = Fluxes(*(np.float32(each) for each in (1.0, 1.0, 0.0)))
    assert stacked(mirror, mirror) == mirror
    assert over_background(mirror, np.float32(1)) == 1
    brightness = [over_background(stacked(almost, almost), np.float32(each)) for each in (0, 0.5, 1)]
    assert all(a <= b <= 1 for a, b in pairwise(brightness))
