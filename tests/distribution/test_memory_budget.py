"""Insufficient memory is an error before anything is loaded, with a sufficient number of ranks."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clusterviz.distribution.memory_budget import check_memory
from clusterviz.errors import InputError
from clusterviz.partition import build_tree, interleave, owners_of


def trees(sizes: np.ndarray, ranks: int) -> np.ndarray:
    return owners_of(build_tree(np.ones(sizes.shape), ranks)).sums(sizes)


def dealt(sizes: np.ndarray, ranks: int) -> np.ndarray:
    return interleave(np.ones(sizes.shape), ranks).sums(sizes)


@given(st.integers(0, 2**32 - 1), st.integers(1, 5), st.integers(10, 400))
def test_the_ranks_that_are_named_do(seed: int, ranks: int, limit: int) -> None:
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(1, 6, 3))
    sizes = rng.integers(0, 10, shape)
    if trees(sizes, ranks).max() <= limit:
        check_memory(lambda n: trees(sizes, n), ranks, sizes, limit)
        return
    with pytest.raises(InputError) as refusal:
        check_memory(lambda n: trees(sizes, n), ranks, sizes, limit)
    if named := re.search(r"allowed (\d+) ranks", str(refusal.value)):
        assert int(named[1]) > ranks
        assert trees(sizes, int(named[1])).max() <= limit


def test_four_ranks_do_where_two_do_not() -> None:
    sizes = np.full((2, 2, 2), 100)
    with pytest.raises(InputError, match=r"share of 2 ranks takes 400 bytes.*found 200 bytes.*allowed 4 ranks"):
        check_memory(lambda n: dealt(sizes, n), 2, sizes, 200)


def test_a_brick_above_the_limit_asks_for_smaller_bricks() -> None:
    sizes = np.full((2, 2, 2), 100)
    with pytest.raises(InputError, match="smaller bricks: one takes 100 bytes"):
        check_memory(lambda n: dealt(sizes, n), 2, sizes, 99)
