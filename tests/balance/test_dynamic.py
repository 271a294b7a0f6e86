"""Planes that follow the cost: how even ranks become, how fast, and at how many bytes a frame."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from clusterviz.balance import Balance, Policy, begin, dispatch, land, learn, steer
from clusterviz.errors import InputError
from clusterviz.partition import owners_of, visible_groups

BRICKS = (32, 32, 32)
BYTES = np.full(BRICKS, 100)
BUDGET = 800_000  # a quarter of all bricks
UNIFORM = Policy(BUDGET, 10**7, unit=2)
REFINED = Policy(BUDGET, 10**7, unit=8, refined=True)
LATE = 10  # frames after which it must be balanced


def corner(at: tuple[float, float, float], width: float = 0.18) -> np.ndarray:
    """A cost that lies in one place, with a little everywhere."""
    z, y, x = np.meshgrid(*[(np.arange(n) + 0.5) / n for n in BRICKS], indexing="ij")
    squares = (z - at[0]) ** 2 + (y - at[1]) ** 2 + (x - at[2]) ** 2
    return 0.01 + np.exp(-squares / (2 * width**2))


def frames(balance: Balance, policy: Policy, costs: list[np.ndarray]) -> tuple[Balance, list[float]]:
    """Draw frame after frame, of which ranks are only told their sums; everything arrives in the next frame."""
    found, model = [], np.ones(BRICKS)
    for cost in costs:
        owners = balance.migration.owners
        found.append(owners.imbalance(cost))
        balance = steer(learn(balance, model, owners.loads(cost), policy), model, policy)
        planned = [flight.brick for flight in balance.migration.flights if flight.stage == "planned"]
        assert sum(int(BYTES[brick]) for brick in planned) <= policy.budget_bytes
        assert (balance.migration.held_bytes <= policy.limit_bytes).all()
        sent = dispatch(balance.migration, planned)
        balance = land(Balance(balance.measured, balance.tree, balance.leaf_ranks, sent), planned)
    return balance, found


@pytest.mark.parametrize("ranks", [4, 7])
@pytest.mark.parametrize(("policy", "bound"), [(UNIFORM, 1.10), (REFINED, 1.05)], ids=["uniform", "refined"])
def test_a_dear_corner_is_balanced_after_ten_frames(policy: Policy, bound: float, ranks: int) -> None:
    cost = corner((0.1, 0.15, 0.2))
    _, found = frames(begin(np.ones(BRICKS), ranks, BYTES, policy), policy, [cost] * (LATE + 3))
    assert found[0] > 2.4
    assert max(found[LATE:]) <= bound


def test_balanced_costs_move_nothing() -> None:
    start = begin(np.ones(BRICKS), 4, BYTES, UNIFORM)
    end, found = frames(start, UNIFORM, [np.ones(BRICKS)] * 3)
    assert max(found) == pytest.approx(1)
    assert (end.migration.owners.owner == start.migration.owners.owner).all()


def test_frames_without_any_cost_move_nothing() -> None:
    start = begin(np.ones(BRICKS), 4, BYTES, UNIFORM)
    end, _ = frames(start, UNIFORM, [np.zeros(BRICKS)] * 3)
    assert (end.migration.owners.owner == start.migration.owners.owner).all()


def test_visibility_groups_are_one_a_rank_once_all_has_arrived() -> None:
    policy = Policy(10**9, 10**7, unit=2)
    balance, _ = frames(begin(np.ones(BRICKS), 7, BYTES, policy), policy, [corner((0.1, 0.15, 0.2))] * 2)
    assert len(visible_groups(balance.migration.owners, (-900, 700, 500), (1, 0, 0), 8)) == 7


def test_a_target_is_a_tree_of_all_ranks() -> None:
    balance, _ = frames(begin(np.ones(BRICKS), 7, BYTES, UNIFORM), UNIFORM, [corner((0.9, 0.8, 0.2))] * 3)
    leaves = owners_of(balance.tree).owner
    assert sorted(balance.leaf_ranks) == list(range(7))
    for leaf, rank in enumerate(balance.leaf_ranks):
        assert (balance.target.owner[leaves == leaf] == rank).all()


def test_after_a_jump_of_the_cost_it_is_balanced_again() -> None:
    near, far = corner((0.1, 0.15, 0.2)), corner((0.9, 0.8, 0.3))
    _, found = frames(begin(np.ones(BRICKS), 4, BYTES, UNIFORM), UNIFORM, [near] * 10 + [far] * 20)
    assert found[10] > 1.5
    assert min(found[11:]) <= 1.10


def test_bricks_that_nobody_holds_cost_no_budget() -> None:
    held = BYTES.copy()
    held[:, :, 16:] = 0
    policy = Policy(100, 10**7, unit=2)
    model = np.where(held > 0, 1.0, 0.0)
    start = begin(model, 4, held, policy)
    turned = steer(learn(start, model, np.array([9.0, 1, 1, 1]), policy), model, policy)
    assert sum(int(held[flight.brick]) for flight in turned.migration.flights) <= 100


@pytest.mark.parametrize(
    "make",
    [
        lambda: Policy(-1, 1),
        lambda: Policy(1, 1, unit=0),
        lambda: begin(np.ones(BRICKS), 2, BYTES, Policy(1, 1000)),
    ],
)
def test_impossible_policies_are_refused(make: Callable[[], object]) -> None:
    with pytest.raises(InputError):
        make()
