from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clusterviz.plan.encoding import FAR, in_units_of_clim, make_encoding

INTEGERS = ("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64")


def scalars(voxels: np.ndarray, clim: tuple[float, float]) -> np.ndarray:
    """What the shader makes of the stored voxels, in float32."""
    encoding = make_encoding(voxels.dtype, clim)
    stored = encoding.encode(voxels)
    if encoding.kind == "f32":
        return stored
    difference = (stored.astype(np.int64) - encoding.base).astype(np.float32)
    return difference * np.float32(encoding.scale) + np.float32(encoding.bias)


@pytest.mark.parametrize("dtype", INTEGERS)
def test_both_ends_of_an_integer_type_are_both_ends_of_the_range(dtype: str) -> None:
    info = np.iinfo(dtype)
    low, high = float(info.min), float(info.max)
    found = scalars(np.array([info.min, info.max], dtype), (low, high))
    assert found.tolist() == pytest.approx([0, 1], abs=1e-6)


@pytest.mark.parametrize(
    ("dtype", "kind"),
    [
        ("int8", "u8"),
        ("uint8", "u8"),
        ("int16", "u16"),
        ("uint16", "u16"),
        ("int32", "f32"),
        ("float16", "f32"),
        ("float64", "f32"),
    ],
)
def test_small_integers_keep_their_size(dtype: str, kind: str) -> None:
    encoding = make_encoding(np.dtype(dtype), (0.0, 1.0))
    stored = encoding.encode(np.zeros((2, 3, 4), dtype))
    assert encoding.kind == kind
    assert stored.shape == (2, 3, 4)
    assert stored.dtype == {"u8": np.uint8, "u16": np.uint16, "f32": np.float32}[kind]


@given(
    dtype=st.sampled_from(INTEGERS[:4]),
    low=st.floats(-70000, 70000),
    width=st.floats(0.5, 1e5),
)
def test_small_integers_become_units_of_clim(dtype: str, low: float, width: float) -> None:
    """The error is float32's, in units of the larger of the scalar and what was added to it."""
    info = np.iinfo(dtype)
    voxels = np.unique(np.linspace(info.min, info.max, 999).astype(dtype))
    clim = (low, low + width)
    expected = (voxels.astype(np.float64) - low) / (clim[1] - clim[0])
    scale = np.abs(expected) + 1 + (256 / width if np.dtype(dtype).itemsize == 1 else 0)
    # A range beyond the type's values is far from every voxel, and the bias that leads there is a large number.
    beyond = max(0.0, info.min - low, low - info.max) / width
    assert (np.abs(scalars(voxels, clim) - expected) <= 3e-7 * (scale + beyond)).all()


def test_narrow_range_of_16_bit_values_keeps_float32s_digits() -> None:
    voxels = np.arange(40000, 40004).astype(np.uint16)
    found = scalars(voxels, (40000.25, 40002.25))
    assert found.tolist() == pytest.approx([-0.125, 0.375, 0.875, 1.375], abs=1e-7)
    signed = np.arange(-30002, -29998).astype(np.int16)
    assert scalars(signed, (-30001.0, -29999.0)).tolist() == pytest.approx([-0.5, 0, 0.5, 1], abs=1e-7)


def test_what_is_not_finite_is_nan_and_nothing_else_is() -> None:
    voxels = np.array([np.nan, np.inf, -np.inf, 0.0, -0.0, 5e-324, 1.7e308, -1.7e308])
    found = scalars(voxels, (0.0, 1.0))
    assert np.isnan(found).tolist() == [True] * 3 + [False] * 5
    assert found[3:].tolist() == [0, 0, 0, np.float32(FAR), -np.float32(FAR)]


def test_denormals_of_float16_and_float32_are_told_apart() -> None:
    for dtype in (np.float16, np.float32, np.float64):
        tiny = float(np.finfo(dtype).smallest_subnormal)
        voxels = (np.arange(5) * tiny).astype(dtype)
        assert scalars(voxels, (0.0, 4 * tiny)).tolist() == [0, 0.25, 0.5, 0.75, 1]


@pytest.mark.parametrize("size", [1e-300, 1e-310, 1.0, 1e300])
def test_ranges_of_any_size_give_the_same_units(size: float) -> None:
    values = np.linspace(-2, 2, 9) * size
    assert in_units_of_clim(values, -size, size).tolist() == pytest.approx(np.linspace(-0.5, 1.5, 9).tolist(), abs=1e-9)


def test_range_over_all_floats_does_not_overflow() -> None:
    largest = float(np.finfo(np.float64).max)
    found = in_units_of_clim([-largest, 0, largest], -largest, largest)
    assert found.tolist() == [0, 0.5, 1]


def test_integers_beyond_float32_keep_what_the_range_can_tell_apart() -> None:
    voxels = 2**40 + np.arange(5, dtype=np.int64)
    assert scalars(voxels, (2.0**40, 2.0**40 + 4)).tolist() == [0, 0.25, 0.5, 0.75, 1]


def test_differences_of_far_values_stay_finite_in_float32() -> None:
    found = scalars(np.array([1e308, -1e308]), (0.0, 1e-300))
    with np.errstate(over="raise"):
        assert np.isfinite(found[0] - found[1])
