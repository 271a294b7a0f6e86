"""Load balancer: how even ranks become, in how many frames, and at how many bytes a frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clusterviz.distribution import balancer
from clusterviz.distribution.balancer import Balance, Policy, begin, complete, learn, plan_moves
from clusterviz.distribution.flights import dispatch, switch
from clusterviz.errors import InputError
from clusterviz.partition import ray_origin, visible_groups

BRICKS = (32, 32, 32)
BYTES = np.full(BRICKS, 100)
BUDGET = 800_000  # a quarter of all bricks
POLICY = Policy(BUDGET, 10**7)
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
        balance = plan_moves(balance, model, policy)
        planned = [flight.brick for flight in balance.migration.flights if flight.stage == "planned"]
        assert sum(int(BYTES[brick]) for brick in planned) <= policy.budget_bytes
        assert (balance.migration.held_bytes <= policy.limit_bytes).all()
        owners = balance.migration.owners
        found.append(owners.imbalance(cost))
        balance = replace(balance, migration=dispatch(balance.migration, planned))
        balance = complete(learn(balance, model, owners.loads(cost)), planned)
    return balance, found


@pytest.mark.parametrize("ranks", [4, 7])
def test_a_dear_corner_is_balanced_after_ten_frames(ranks: int) -> None:
    cost = corner((0.1, 0.15, 0.2))
    _, found = frames(begin(np.ones(BRICKS), ranks, BYTES, POLICY), POLICY, [cost] * (LATE + 3))
    assert found[0] > 2.4
    assert max(found[LATE:]) <= 1.05


def test_balanced_costs_and_frames_without_any_move_and_recall_nothing() -> None:
    start = begin(np.ones(BRICKS), 4, BYTES, POLICY)
    for cost in (np.ones(BRICKS), np.zeros(BRICKS)):
        end, found = frames(start, POLICY, [cost] * 3)
        assert max(found) == pytest.approx(1)
        assert (end.migration.owners.owner == start.migration.owners.owner).all()
    recalling = replace(start, recalled=np.arange(4))
    assert not plan_moves(recalling, np.zeros(BRICKS), POLICY).recalled.any()


def test_visibility_groups_are_one_a_rank_once_all_has_arrived() -> None:
    """From an eye that is past the borders along all axes."""
    eye = (-112.5, 87.5, 62.5)
    balance = begin(np.ones(BRICKS), 7, BYTES, POLICY, ray_origin(eye, (1, 0, 0)))
    cost, budget = corner((0.1, 0.15, 0.2)), replace(POLICY, budget_bytes=10**9)
    for _ in range(3):
        balance = learn(balance, np.ones(BRICKS), balance.migration.owners.loads(cost))
        balance = plan_moves(balance, np.ones(BRICKS), budget, ray_origin(eye, (1, 0, 0)))
        flying = [flight.brick for flight in balance.migration.flights if flight.stage == "planned"]
        balance = complete(replace(balance, migration=dispatch(balance.migration, flying)), flying)
    balance = replace(balance, migration=switch(balance.migration))
    assert (balance.migration.owners.owner == balance.target.owner).all()
    assert len(visible_groups(balance.migration.owners, eye, (1, 0, 0))) == 7


def test_fronts_stay_where_they_leave_ranks_even_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(balancer, "HYSTERESIS", 0.05)
    rng = np.random.default_rng(3)
    noisy = [1 + 0.05 * rng.random(BRICKS) for _ in range(4)]
    end, found = frames(begin(np.ones(BRICKS), 4, BYTES, POLICY), POLICY, noisy)
    assert max(found) < 1.05
    assert (end.aim == 1).all()
    assert (end.target.owner == begin(np.ones(BRICKS), 4, BYTES, POLICY).target.owner).all()


def test_after_a_jump_of_the_cost_it_is_balanced_again() -> None:
    near, far = corner((0.1, 0.15, 0.2)), corner((0.9, 0.8, 0.3))
    _, found = frames(begin(np.ones(BRICKS), 4, BYTES, POLICY), POLICY, [near] * 10 + [far] * 15)
    assert found[10] > 1.5
    assert min(found[11:]) <= 1.10


def test_bricks_that_nobody_holds_cost_no_budget() -> None:
    held = BYTES.copy()
    held[:, :, 16:] = 0
    policy = Policy(100, 10**7)
    model = np.where(held > 0, 1.0, 0.0)
    start = begin(model, 4, held, policy)
    turned = plan_moves(learn(start, model, np.array([9.0, 1, 1, 1])), model, policy)
    assert sum(int(held[flight.brick]) for flight in turned.migration.flights) <= 100


def test_what_bricks_take_on_their_way_is_not_what_they_take_where_they_lie() -> None:
    """The budget is of messages, the limit of memory."""
    held, wire, policy = 4 * BYTES, BYTES, Policy(1000, 4 * 10**7)
    start = begin(np.ones(BRICKS), 4, held, policy, wire_bytes=wire)
    turned = plan_moves(learn(start, np.ones(BRICKS), np.array([9.0, 1, 1, 1])), np.ones(BRICKS), policy)
    assert len(turned.migration.flights) == 10
    assert turned.migration.pinned_bytes.sum() == held.sum() + 4000


def test_bricks_beyond_the_memory_of_a_rank_are_refused() -> None:
    with pytest.raises(InputError, match="memory limit"):
        begin(np.ones(BRICKS), 2, BYTES, Policy(1, 1000))
