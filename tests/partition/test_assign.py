"""Assignment: all ranks together draw every brick that costs something, once."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from clusterviz.errors import InputError
from clusterviz.partition import bricks_of, build_tree

costs = arrays(np.float64, array_shapes(min_dims=3, max_dims=3, max_side=4), elements=st.sampled_from([0.0, 1.0, 2.5]))


@given(costs, st.integers(1, 9))
def test_every_brick_with_a_cost_is_drawn_once(cost: np.ndarray, ranks: int) -> None:
    tree = build_tree(cost, ranks)
    drawn = np.concatenate([bricks_of(tree, rank, cost) for rank in range(ranks)])
    assert sorted(map(tuple, drawn)) == list(map(tuple, np.argwhere(cost > 0)))


def test_other_ranks_and_other_bricks_are_refused() -> None:
    tree = build_tree(np.ones((1, 1, 2)), 2)
    with pytest.raises(InputError, match="0 … 1"):
        bricks_of(tree, 2, np.ones((1, 1, 2)))
    with pytest.raises(InputError, match=r"\(1, 1, 3\)"):
        bricks_of(tree, 0, np.ones((1, 1, 3)))
