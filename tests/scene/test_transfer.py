"""Transfer functions: control points, steps, the range of float64, and transparent intervals."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from clusterviz.scene.transfer import OPAQUE, TransferFunction, interpolate


def function(points: list[tuple[float, float]], unit: float = 1.0) -> TransferFunction:
    values, opacities = np.array(points, np.float64).T
    return TransferFunction(
        np.array([0.0, 1.0]), np.array([[0, 0, 0], [1, 0.5, 0]]), values, opacities, unit, (0.0, 1.0)
    )


def test_colours_are_linear_between_and_constant_beyond() -> None:
    colours = function([(0, 0)]).colour([[-1, 0.0], [0.5, 9]])
    assert colours.shape == (2, 2, 3)
    assert colours.tolist() == [[[0, 0, 0], [0, 0, 0]], [[0.5, 0.25, 0], [1, 0.5, 0]]]


def test_a_repeated_value_is_a_step_where_the_later_holds() -> None:
    f = function([(0, 0.2), (1, 0.4), (1, 0.9), (1, 0.6), (2, 0.8)])
    assert f.opacity_values.tolist() == [0, 1, 1, 2]
    assert f.opacity([np.nextafter(1, 0), 1, np.nextafter(1, 2)]) == pytest.approx([0.4, 0.6, 0.6])
    assert f.opacity(1.0) == 0.6


def test_steps_at_both_ends_hold_beyond_them() -> None:
    f = function([(0, 0.1), (0, 0.3), (1, 0.5), (1, 0.7)])
    assert f.opacity([-1, 0, 1, 2]).tolist() == [0.1, 0.3, 0.7, 0.7]


def test_nan_and_infinity() -> None:
    f = function([(0, 0.25), (1, 0.5)])
    assert f.opacity([math.nan, -math.inf, math.inf]).tolist() == [0, 0.25, 0.5]
    assert f.colour(math.nan).tolist() == [0, 0, 0]


@pytest.mark.parametrize(
    ("low", "high"), [(-1.79e308, 1.79e308), (0, 5e-324), (1e300, 1.7e308), (-5e-324, 1e308), (1, 1 + 2**-52)]
)
def test_the_ends_of_float64_neither_overflow_nor_vanish(low: float, high: float) -> None:
    with np.errstate(all="raise", under="ignore"):
        found = interpolate([low, high], np.array([low, high]), np.array([[0.0], [1.0]]))[:, 0]
    assert found.tolist() == [0, 1]


def test_the_middle_of_all_of_float64_is_half_way() -> None:
    assert interpolate(0.0, np.array([-1.7e308, 1.7e308]), np.array([[0.0], [1.0]])).tolist() == [0.5]


@given(
    st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=6, unique=True).map(sorted),
    st.lists(st.floats(0, 1), min_size=6, max_size=6),
    st.floats(-2e6, 2e6),
)
def test_interpolation_agrees_with_numpy(values: list[float], results: list[float], s: float) -> None:
    assume(min(np.diff(values)) > 1e-6)
    table = np.array(results[: len(values)])
    found = interpolate(s, np.array(values), table[:, None])[0]
    assert found == pytest.approx(np.interp(s, values, table), abs=1e-9)


def test_extinction_is_minus_log_of_transparency_by_unit() -> None:
    f = function([(0, 0), (1, 1e-8), (2, 0.5), (3, 1 - 1e-6), (4, 1), (5, 1 - 1e-8)], unit=2.0)
    expected = [
        0,
        1e-8 / 2 * (1 + 5e-9),
        math.log(2) / 2,
        -math.log(1e-6) / 2,
        24 * math.log(2) / 2,
        24 * math.log(2) / 2,
    ]
    assert f.extinction([0, 1, 2, 3, 4, 5]) == pytest.approx(expected, rel=1e-7)
    assert f.extinction(4.0) == -math.log1p(-OPAQUE) / 2


TENT = [(10.0, 0.0), (20.0, 0.0), (30.0, 1.0), (40.0, 0.0), (50.0, 0.0), (50.0, 0.5), (60.0, 0.5), (60.0, 0.0)]


@pytest.mark.parametrize(
    ("low", "high", "transparent"),
    [
        (-100, 5, True),
        (0, 20, True),
        (0, np.nextafter(20, 21), False),
        (25, 25, False),
        (0, 35, False),
        (20, 40, False),
        (40, 45, True),
        (45, 50, False),
        (45, np.nextafter(50, 0), True),
        (55, 56, False),
        (60, 60, True),
        (np.nextafter(60, 0), 60, False),
        (60, 1e300, True),
        (-math.inf, math.inf, False),
        (-math.inf, 20, True),
        (60, math.inf, True),
        (math.nan, 5, False),
        (5, math.nan, False),
        (math.inf, -math.inf, True),
    ],
)
def test_an_interval_is_transparent_iff_opacity_is_zero_on_all_of_it(
    low: float, high: float, transparent: bool
) -> None:
    assert bool(function(TENT).is_transparent(low, high)) is transparent


@given(
    st.lists(st.tuples(st.integers(0, 8), st.sampled_from([0.0, 0.0, 0.5])), min_size=1, max_size=7),
    st.lists(st.tuples(st.integers(-8, 40), st.integers(-8, 40)), min_size=1, max_size=9),
)
def test_transparency_agrees_with_dense_sampling(points: list[tuple[int, float]], ends: list[tuple[int, int]]) -> None:
    """Breaks at whole numbers, ends at quarters, samples at sixteenths: between samples nothing can hide."""
    f = function([(float(v), a) for v, a in sorted(points, key=lambda point: point[0])])
    low, high = np.sort(np.array(ends) / 4, axis=1).T
    samples = [np.arange(a * 16, b * 16 + 1) / 16 for a, b in zip(low, high, strict=True)]
    expected = [not f.opacity(s).any() for s in samples]
    assert f.is_transparent(low, high).tolist() == expected


def test_arrays_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="read-only"):
        function([(0, 0)]).opacities[0] = 1
