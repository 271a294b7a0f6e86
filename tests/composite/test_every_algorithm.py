"""Every algorithm on drawn footprints, orders and roots makes the picture of the serial one in float64."""

from __future__ import annotations

import numpy as np
import pytest
from composite.images import composite_all, over_all, random_partial
from hypothesis import given, settings
from hypothesis import strategies as st

from clusterviz.composite import ALGORITHMS
from clusterviz.image.region import Rect


@pytest.mark.parametrize("algorithm", ALGORITHMS)
@settings(max_examples=25, deadline=None)
@given(st.data())
def test_random_footprints_orders_and_roots(algorithm: str, data: st.DataObject) -> None:
    ranks = data.draw(st.integers(1, 11), label="ranks")
    # Primes, single rows and columns, and fewer pixels than ranks are all among these.
    size = data.draw(st.tuples(st.integers(1, 13), st.integers(1, 11)), label="size")
    sides = [st.tuples(st.integers(0, side), st.integers(0, side)).map(sorted) for side in size]
    drawn = data.draw(st.lists(st.tuples(*sides), min_size=ranks, max_size=ranks), label="footprints")
    order = data.draw(st.permutations(range(ranks)), label="order")
    root = data.draw(st.integers(0, ranks - 1), label="root")
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1), label="seed"))
    partials = [random_partial(rng, Rect(x[0], y[0], x[1], y[1]), np.float32) for x, y in drawn]
    made = composite_all(partials, order, size, algorithm, root)
    assert np.abs(made - over_all(partials, order, size)).max() <= max(ranks, 2) * 2.0**-23
