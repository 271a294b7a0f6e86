"""Look-up between samples: exact where it must be, of order 2 elsewhere, defined at both ends of every type."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from clusterviz.reference.sample import nearest, trilinear

Sampler = Callable[..., tuple[np.ndarray, np.ndarray]]


def points(shape: tuple[int, int, int], count: int = 200) -> list[np.ndarray]:
    """Positions (x, y, z) inside, the corners of the box among them."""
    rng = np.random.default_rng(1)
    corners = np.array(list(np.ndindex(2, 2, 2)))
    unit = np.concatenate([corners, rng.random((count, 3))])
    return list((unit * (np.array(shape[::-1]) - 1)).T)


def test_linear_fields_are_exact() -> None:
    z, y, x = np.indices((4, 5, 6), float)
    px, py, pz = points((4, 5, 6))
    scalar, _ = trilinear(2 * x - 3 * y + 0.5 * z + x * y * z, px, py, pz)
    assert np.allclose(scalar, 2 * px - 3 * py + 0.5 * pz + px * py * pz, rtol=0, atol=1e-13)


@pytest.mark.parametrize("value", [0.1, -5e-324, 1e-310, 1.7976931348623157e308, -1.7976931348623157e308])
@pytest.mark.parametrize("sample", [trilinear, nearest])
def test_constant_fields_are_exact(sample: Sampler, value: float) -> None:
    scalar, valid = sample(np.full((3, 3, 3), value), *points((3, 3, 3)))
    assert valid.all()
    assert (scalar == value).all()


@pytest.mark.parametrize("dtype", ["i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f2", "f4", "f8"])
def test_both_ends_of_every_type_meet_in_the_middle(dtype: str) -> None:
    limits = np.finfo(dtype) if dtype[0] == "f" else np.iinfo(dtype)
    voxels = np.empty((2, 2, 2), dtype)
    voxels[..., 0], voxels[..., 1] = limits.min, limits.max
    low, high = float(limits.min), float(limits.max)
    x = np.array([0, 0.25, 0.5, 1])
    scalar, valid = trilinear(voxels, x, x, x)
    assert valid.all()
    assert scalar == pytest.approx([low, 0.75 * low + 0.25 * high, low / 2 + high / 2, high], rel=1e-15)


def test_a_point_on_a_face_between_cells_belongs_to_the_upper_one() -> None:
    voxels = np.zeros((2, 2, 3))
    voxels[0, 0, 2] = math.nan
    x = np.array([0.999, 1.0, 2.0])
    _, valid = trilinear(voxels, x, x * 0, x * 0)
    assert valid.tolist() == [True, False, False]


def test_positions_an_ulp_outside_count_as_on_the_face() -> None:
    voxels = np.arange(8.0).reshape(2, 2, 2)
    x = np.array([-1e-16, 1 + 2.3e-16])
    assert trilinear(voxels, x, x, x)[0].tolist() == [0, 7]
    assert nearest(voxels, x, x, x)[0].tolist() == [0, 7]


def test_nearest_rounds_half_up() -> None:
    voxels = np.arange(4.0).reshape(1, 1, 4)
    x = np.array([0, 0.49, 0.5, 1.49, 1.5, 2.5, 3])
    assert nearest(voxels, x, x * 0, x * 0)[0].tolist() == [0, 0, 1, 1, 2, 3, 3]
