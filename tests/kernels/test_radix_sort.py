"""The radix sort against NumPy's stable sort."""

from __future__ import annotations

import numpy as np
import pytest

from clusterviz.kernels.radix_sort import LEAST, sorted_order

RNG, MANY = np.random.default_rng(2), 3 * LEAST + 5
KEYS = {
    "none": np.zeros(0, np.float32),
    "one": np.ones(1, np.float32),
    "equal": np.full(MANY, 7, np.uint32),
    "one digit": RNG.integers(0, 200, MANY).astype(np.uint32),
    "two digits": RNG.integers(0, 60_000, MANY).astype(np.uint32),
    "whole": RNG.integers(0, 2**32, MANY, dtype=np.uint32),
    "depths": RNG.normal(size=MANY).astype(np.float32),
    "extremes": np.float32([3, np.inf, -1e-45, -3e38, 1e-45, -np.inf, 0, -3, 3e38]),
}


@pytest.mark.parametrize("threads", [1, 2, 3])
@pytest.mark.parametrize("name", KEYS)
def test_order_is_that_of_a_stable_sort(name: str, threads: int) -> None:
    found = sorted_order(KEYS[name], threads)
    assert found.dtype == np.uint32
    np.testing.assert_array_equal(found, np.argsort(KEYS[name], kind="stable"))
