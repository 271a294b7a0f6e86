"""The dynamic distribution: bricks go from rank to rank until all take equally long, few bytes a frame.

What frames cost is learnt in samples, which are the same in every run. `clusterviz.balance` decides; here its values go
from frame to frame.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from time import thread_time

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.source import Index
from clusterviz.distribution.balancer import Balance, Policy, begin, complete, first_owners, learn, plan_moves, skip
from clusterviz.distribution.expected_cost import expected_samples
from clusterviz.distribution.flights import Flight, dispatch, withdraw
from clusterviz.distribution.measured_cost import predict, rank_costs, unmeasured
from clusterviz.distribution.memory_budget import MemoryBudget, check_memory
from clusterviz.distribution.migration_rate import WHOLE, MigrationRate
from clusterviz.errors import InputError
from clusterviz.partition import UNASSIGNED, Owners, Piece, RayOrigin, owner_pieces, ray_origin
from clusterviz.plan.plan import Plan, shows_more
from clusterviz.render.storage import slot_of
from clusterviz.report.statistics import RankFrame

EVEN_SHARES = 3  # that a rank may hold where no limit is given: its own bricks, others to come, and a cache
BUDGET, JUMP_BUDGET = 1 / 20, 1 / 4  # of all bricks a frame, where none is given: in general, and far from even
FAR_FROM_EVEN = 1.25  # busiest over mean
HANDLED = ("bytes_raw", "bytes_opened")  # of what a rank tells of a frame
UNIT = 8  # longest side of what moves as one, in bricks


class Dynamic:
    """Fronts follow the expected cost, and bricks the fronts.

    Parameters
    ----------
    ranks : how many there are
    holding : what a rank may hold: thrice an even share where nothing is said
    budget_bytes : of bricks that all ranks together may send in a frame; None: a share of all
    share : of a frame's time that a rank may give to migration

    Attributes
    ----------
    share : the same
    beginnings : how often bricks were dealt anew
    planned_imbalance : busiest over mean of the last deal, as expected
    planning_seconds : processor time of planning for the last deal where fronts should be, and what moves
    """

    def __init__(self, ranks: int, budget: MemoryBudget, budget_bytes: int | None = None, share: float = WHOLE) -> None:
        self._ranks, self._budget, self._budget_bytes = ranks, budget, budget_bytes
        self._balance: Balance | None = None
        self._model: tuple[Plan, NDArray[np.float64]] | None = None
        self._sizes: NDArray[np.int64] = np.zeros((1, 1, 1), np.int64)
        self._wire = self._sizes
        self._policy, self._rate = Policy(0, 0), MigrationRate(share)
        self.migration_share = share
        self.beginnings = 0
        self.planned_imbalance = 1.0
        self.planning_seconds = 0.0

    def assign(self, plan: Plan) -> tuple[Piece, ...]:
        """A piece for each group of bricks that one rank draws whole; what shall fly during the frame is planned.

        Raises
        ------
        InputError
            A share does not fit into the memory of a rank; the budget cannot carry a brick.
        """
        model, self.planning_seconds = self._expected(plan), 0.0
        if self._balance is None or shows_more(plan, self._sizes.astype(np.float64)):
            balance = self._begin(plan, model)
        elif model.any() and not self._planned and self._rate.may_plan:
            began = thread_time()
            balance = plan_moves(self._balance, model, self._hurried(model), _eye(plan))
            self.planning_seconds = thread_time() - began
        else:
            balance = skip(self._balance)
        self._balance = balance
        owner = np.where(plan.cost > 0, balance.migration.owners.owner, UNASSIGNED).astype(np.int32)
        owners = Owners(self._ranks, owner)
        self.planned_imbalance = owners.imbalance(predict(balance.measured, model, self._sizes > 0))
        return owner_pieces(owners, plan.eye_in_bricks(), plan.view.forward)

    def holds(self, rank: int) -> frozenset[Index]:
        """What it draws, has received and caches."""
        if self._balance is None:
            return frozenset()
        return frozenset(brick for brick in self._balance.migration.holds(rank) if self._sizes[brick])

    def depart(self) -> tuple[Flight, ...]:
        """The bricks that shall be sent now; they count as sent."""
        planned = self._planned
        if self._balance is not None:
            sent = dispatch(self._balance.migration, [flight.brick for flight in planned])
            self._balance = replace(self._balance, migration=sent)
        return planned

    def learn(self, plan: Plan, costs: Sequence[RankFrame]) -> None:
        """What bricks cost, from what they cost together; and how fast they move."""
        told = [rank.balance for rank in costs]
        planning = [float(each.get("planning_seconds", 0)) for each in told]
        work = [
            (float(each.get("seconds", 0)) - took, sum(map(each.get, HANDLED, (0, 0))))
            for each, took in zip(told, planning, strict=True)
        ]
        # Before a frame has ended, the time of drawing tells most of it.
        frame = max(float(rank.balance.get("frame_seconds") or rank.seconds.get("render", 0)) for rank in costs)
        # All ranks plan the same: more than the least time is what others took of their cores.
        self._rate = self._rate.after(frame, work, min(planning))
        if self._balance is not None:
            self._balance = learn(self._balance, self._expected(plan), rank_costs(costs), self._policy)

    def complete(self, arrived: Collection[Index], lost: Collection[Index]) -> None:
        """After a frame: these bricks have arrived, and those will not."""
        if self._balance is not None:
            stayed = replace(self._balance, migration=withdraw(self._balance.migration, lost))
            self._balance = complete(stayed, arrived)

    def recalled(self, rank: int) -> int:
        """How many bricks of the last deal a rank gets back from its own cache, and nobody has to send."""
        return int(self._balance.recalled[rank]) if self._balance else 0

    @property
    def planning_expected(self) -> float:
        """Seconds that planning for the next deal should take; 0 where there is no time for any."""
        return self._rate.planning if self._rate.may_plan else 0.0

    @property
    def _planned(self) -> tuple[Flight, ...]:
        flights = self._balance.migration.flights if self._balance else ()
        return tuple(flight for flight in flights if flight.stage == "planned")

    def _expected(self, plan: Plan) -> NDArray[np.float64]:
        """What a plan should take: asked for when it is dealt, and when its costs are known."""
        if self._model is None or self._model[0] is not plan:
            self._model = plan, expected_samples(plan)
        return self._model[1]

    def _begin(self, plan: Plan, model: NDArray[np.float64]) -> Balance:
        """A tree by what is expected, and by what is known from frames before bricks were dealt anew."""
        measured = self._balance.measured if self._balance else unmeasured(plan.layout.counts_zyx)
        # Bricks that were shown once may be shown again.
        sizes = self._sizes = np.maximum(self._sizes, self._budget.brick_bytes(plan))
        sent = slot_of(plan).counted(plan.layout.counts_zyx, lambda slot: slot.sample_bytes)
        wire = self._wire = np.where(sizes > 0, sent, 0)
        cost = predict(measured, model, sizes > 0)

        def shares(ranks: int) -> NDArray[np.int64]:
            return first_owners(cost, ranks, Policy(0, 0), _eye(plan)).sums(sizes)

        check_memory(shares, self._ranks, sizes, self._budget.limit_bytes)
        largest = int(shares(self._ranks).max())
        limit = self._budget.limit_bytes or max(largest, EVEN_SHARES * int(sizes.sum()) // self._ranks)
        if self._budget_bytes is not None and self._budget_bytes < wire.max():
            found, allowed = f"{self._budget_bytes} bytes", f"{wire.max()} bytes or more, which a brick takes"
            raise InputError("cannot carry one brick", where="cluster.migration_bytes", found=found, allowed=allowed)
        self._policy = Policy(self._share(BUDGET), limit, unit=UNIT, refined=True)
        self.beginnings += 1
        return replace(begin(cost, self._ranks, sizes, self._policy, _eye(plan), wire), measured=measured)

    def _hurried(self, model: NDArray[np.float64]) -> Policy:
        """More may be sent where the view or the cost has jumped: uneven frames cost more than messages."""
        assert self._balance, "steering follows the first frame"
        cost = predict(self._balance.measured, model, self._sizes > 0)
        far = self._balance.migration.landed.imbalance(cost) > FAR_FROM_EVEN
        budget, under_way = self._share(JUMP_BUDGET if far else BUDGET), self._under_way()
        affordable = self._rate.affordable_bytes(self._ranks, under_way, int(self._wire.max()))
        return replace(self._policy, budget_bytes=budget if affordable is None else min(budget, affordable))

    def _under_way(self) -> int:
        """Bytes of bricks that have been sent, or shall be."""
        assert self._balance, "something was planned"
        flights = self._balance.migration.flights
        return sum(int(self._wire[flight.brick]) for flight in flights if flight.stage != "held")

    def _share(self, share: float) -> int:
        """Bytes a frame, at least a brick."""
        return self._budget_bytes or max(int(self._wire.max()), int(share * int(self._wire.sum())))


def _eye(plan: Plan) -> RayOrigin:
    return ray_origin(plan.eye_in_bricks(), plan.view.forward)
