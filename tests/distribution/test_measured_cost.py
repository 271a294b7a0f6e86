"""Cost factors of bricks, learnt from the costs of ranks."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from clusterviz.distribution.brick_cost import measure, predict, unmeasured
from clusterviz.partition import Owners, build_tree, owners_of


@given(st.integers(0, 2**32 - 1), st.integers(1, 6))
def test_the_frame_that_was_measured_is_predicted(seed: int, ranks: int) -> None:
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(2, 7, 3))
    model, truth = rng.random(shape) + 0.1, rng.random(shape) + 0.1
    owners = Owners(ranks, rng.integers(0, ranks, shape).astype(np.int32))
    learnt = measure(unmeasured(shape), model, owners, owners.loads(truth))
    cost = predict(learnt, model, np.ones(shape, bool))
    loads, wanted = owners.loads(cost), owners.loads(truth)
    np.testing.assert_allclose(loads / loads.sum(), wanted / wanted.sum(), rtol=0.01)


def test_what_was_learnt_of_bricks_remains_when_they_change_hands() -> None:
    model, truth = np.ones((1, 1, 4)), np.array([[[8.0, 1, 1, 1]]])
    learnt = unmeasured((1, 1, 4))
    for owner in ([0, 0, 1, 1], [0, 1, 1, 1], [0, 0, 0, 1], [0, 1, 0, 1], [0, 1, 1, 0]) * 6:
        owners = Owners(2, np.array([[owner]], np.int32))
        learnt = measure(learnt, model, owners, owners.loads(truth))
    np.testing.assert_allclose(learnt.factor / learnt.factor[0, 0, 1], truth, rtol=0.05)


def test_a_frame_that_costs_nothing_teaches_nothing() -> None:
    owners = owners_of(build_tree(np.ones((2, 2, 2)), 3))
    past = measure(unmeasured((2, 2, 2)), np.ones((2, 2, 2)), owners, np.array([1.0, 2, 3]))
    for model in (np.ones((2, 2, 2)), np.zeros((2, 2, 2))):
        assert measure(past, model, owners, np.zeros(3)) is past


def test_a_rank_that_costs_nothing_is_cheap_but_not_lost() -> None:
    owners = owners_of(build_tree(np.ones((1, 1, 4)), 2))
    learnt = unmeasured((1, 1, 4))
    for _ in range(50):
        learnt = measure(learnt, np.ones((1, 1, 4)), owners, np.array([1.0, 0.0]))
    cost = predict(learnt, np.ones((1, 1, 4)), np.ones((1, 1, 4), bool))
    assert (cost > 0).all()
    assert cost[0, 0, 3] < 0.01 * cost[0, 0, 0]


def test_bricks_out_of_view_keep_their_factor_and_a_cost() -> None:
    model = np.array([[[1.0, 1, 0, 0]]])
    owners = owners_of(build_tree(np.ones((1, 1, 4)), 2))
    learnt = measure(unmeasured((1, 1, 4)), model, owners, np.array([7.0, 0.0]))
    assert learnt.factor[0, 0, 2:].tolist() == [1, 1]
    shown = np.array([[[True, True, True, False]]])
    cost = predict(learnt, model, shown)
    assert ((cost > 0) == shown).all()
    assert (predict(learnt, np.zeros((1, 1, 4)), shown)[shown] == 1).all()
