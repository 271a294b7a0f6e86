"""Cubic B-splines against what is known of them in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from clusterviz.reference.sample import cubic, cubic_gradient, trilinear

SHAPE = (8, 9, 10)


def points(count: int = 200, margin: float = 1.0) -> np.ndarray:
    """Random positions (x, y, z), `margin` away from the faces."""
    last = np.array(SHAPE[::-1]) - 1
    return margin + np.random.default_rng(4).random((count, 3)) * (last - 2 * margin)


def test_an_impulse_is_the_spline() -> None:
    voxels = np.zeros(SHAPE)
    voxels[4, 4, 4] = 1.0
    spline = {0.0: 2 / 3, 0.5: 23 / 48, 1.0: 1 / 6, 1.5: 1 / 48, 2.0: 0.0, -0.5: 23 / 48, -1.0: 1 / 6}
    for x, along in spline.items():
        for z, aside in spline.items():
            found, _ = cubic(voxels, np.array([4 + x]), np.array([4.0]), np.array([4 + z]))
            assert found[0] == pytest.approx(along * 2 / 3 * aside, abs=1e-15)


def test_linear_fields_are_kept_and_constants_to_the_bit() -> None:
    z, y, x = np.indices(SHAPE)
    where = points()
    found, valid = cubic(2.0 * x - 0.5 * y + 3.0 * z + 7, *where.T)
    assert valid.all()
    assert found == pytest.approx(where @ (2, -0.5, 3) + 7)
    assert (cubic(np.full(SHAPE, 0.1), *points(margin=0.0).T)[0] == 0.1).all()
    assert not cubic_gradient(np.full(SHAPE, 0.1), points(margin=0.0)).any()


def test_a_square_gains_a_third_of_its_curvature() -> None:
    x = np.indices(SHAPE)[2].astype(float)
    where = points()
    assert cubic(x * x, *where.T)[0] == pytest.approx(where[:, 0] ** 2 + 1 / 3)


def test_gradient_is_the_derivative() -> None:
    voxels = np.random.default_rng(6).random(SHAPE)
    where, h = points(margin=0.1), 1e-5
    gradient = cubic_gradient(voxels, where)
    for axis in range(3):
        step = h * np.eye(3)[axis]
        after, before = (cubic(voxels, *(where + side).T)[0] for side in (step, -step))
        assert gradient[:, axis] == pytest.approx((after - before) / (2 * h), abs=1e-6)


def test_invalid_corners_hide_a_cell_and_invalid_neighbours_do_not() -> None:
    voxels = np.random.default_rng(6).random(SHAPE)
    voxels[3, 3, 3] = np.nan
    where = points(1000, margin=0.0)
    found, valid = cubic(voxels, *where.T)
    assert np.array_equal(valid, trilinear(voxels, *where.T)[1])
    assert np.isfinite(found).all()
    assert 0 < np.count_nonzero(~valid) < 100
