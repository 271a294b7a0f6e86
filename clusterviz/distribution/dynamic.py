"""Dynamic distribution: bricks migrate until all ranks take equally long, a few bytes in each frame.

Cost is measured in samples, which are the same in every run. The balancer decides on moves; this module keeps its state
from frame to frame, and limits the rate of migration. Each rank limits its own time in a frame, and may stop in the
middle of a brick (`TimeBudget`). The rate adapts the plans: if bricks arrive slowly, few are planned, so that plans do
not become outdated. Planning takes time of the same share, so with short frames not every frame is planned.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from time import thread_time

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.source import Index
from clusterviz.distribution.balancer import Balance, Policy, begin, complete, first_owners, learn, plan_moves, skip
from clusterviz.distribution.brick_cost import expected_samples, predict, rank_costs, unmeasured
from clusterviz.distribution.flights import Flight, dispatch, withdraw
from clusterviz.distribution.memory_budget import MemoryBudget
from clusterviz.errors import InputError
from clusterviz.frame.work import Mode
from clusterviz.partition import UNASSIGNED, Owners, Piece, RayOrigin, owner_pieces, ray_origin
from clusterviz.plan.plan import Plan, shows_more
from clusterviz.render.storage import slot_of
from clusterviz.report.statistics import RankFrame

EVEN_SHARES = 3  # default memory limit in even shares: own bricks, arriving bricks and a cache
BUDGET, JUMP_BUDGET = 1 / 20, 1 / 4  # default share of all bricks to send in a frame: usual, and at a large imbalance
LARGE_IMBALANCE = 1.25  # busiest over mean
HANDLED = ("bytes_raw", "bytes_opened")  # statistics keys of the bytes that a rank packed and unpacked
FRAMES_AHEAD = 4  # frames that bricks in flight should need at most
GUESS = 1e8  # bytes a second, before the first measurement
MEMORY = 0.8  # weight of earlier measurements
PLANNING = 0.5  # largest part of the share for planning; the rest is for transfers
WHOLE = 1.0  # share without any limit


@dataclass(frozen=True)
class MigrationRate:
    """Measured rate of migration."""

    share: float  # of a frame's time that each rank may spend on migration; 1: no limit
    frame_seconds: float = 0.0  # mean time of frames; 0 if unknown
    # time of migration, and bytes packed and unpacked in it; sums over ranks and frames in which older frames count
    # less
    seconds: float = 0.0
    bytes: float = 0.0
    planning: float = 0.0  # seconds that one plan takes; 0 if unknown
    saved: float = 0.0  # unused seconds for planning

    @property
    def may_plan(self) -> bool:
        """True if there is time to plan for the next frame."""
        return self.share >= WHOLE or self.saved >= self.planning

    def after(self, frame_seconds: float, work: Iterable[tuple[float, int]], planning: float = 0.0) -> MigrationRate:
        """Return the rate after another frame.

        Parameters
        ----------
        frame_seconds : of the slowest rank; 0 if unknown
        work : of each rank the seconds of migration, and the bytes that it packed and unpacked
        planning : seconds of planning for this frame, the same on all ranks; 0 if nothing was planned
        """
        seconds, handled = self.seconds, self.bytes
        for took, size in work:
            # Ranks that only tested for messages do not count.
            seconds, handled = (seconds + took, handled + size) if size else (seconds, handled)
        known = MEMORY * self.frame_seconds + (1 - MEMORY) * frame_seconds if self.frame_seconds else frame_seconds
        limited = replace(self, frame_seconds=known, seconds=MEMORY * seconds, bytes=MEMORY * handled)
        return limited._planned(planning, PLANNING * self.share * frame_seconds)

    def affordable_bytes(self, ranks: int, under_way: int, largest: int) -> int | None:
        """Return the bytes that all ranks together may start to send in a frame; None: no limit.

        Returns 0, or at least `largest`.

        Parameters
        ----------
        under_way : bytes of bricks that are planned or sent and have not arrived
        largest : bytes of the largest brick, which is allowed if nothing else is under way
        """
        if self.share >= WHOLE:
            return None
        # Each byte is packed by one rank and unpacked by another.
        rate = self.bytes / self.seconds if self.seconds else GUESS
        slice_seconds = self.share * self.frame_seconds
        slice_seconds -= min(self.planning, PLANNING * slice_seconds)
        allowed = int(FRAMES_AHEAD * slice_seconds * rate * ranks / 2) - under_way
        if allowed >= largest:
            return allowed
        return 0 if under_way else largest

    def _planned(self, took: float, left: float) -> MigrationRate:
        """Return the rate after a frame whose plan took `took` seconds, 0 without a plan, and left `left` seconds."""
        once = self.planning
        if took:
            # Other processes only lengthen times, so short times count more.
            once = min(took, (took + once) / 2, 2 * once) if once else took
        saved = max(0.0, self.saved - once) if took else self.saved
        # Unused time is saved, so that two of three frames may be planned.
        return replace(self, planning=once, saved=min(2 * once, saved + left))


class Dynamic:
    """Fronts follow the expected cost, and bricks follow the fronts.

    Parameters
    ----------
    ranks : number of ranks
    budget : memory of a rank for bricks; without a limit, `EVEN_SHARES` even shares
    budget_bytes : of bricks that all ranks together may send in a frame; None: a share of all bricks
    share : of a frame's time that a rank may spend on migration, in (0, 1]; 1: any time

    Attributes
    ----------
    migration_share : `share`
    restarts : number of assignments from scratch
    planned_imbalance : expected cost of the busiest rank over the mean, of the last assignment
    planning_seconds : CPU time of planning fronts and moves for the last assignment
    """

    mode: Mode = "sort-last"

    def __init__(self, ranks: int, budget: MemoryBudget, budget_bytes: int | None = None, share: float = WHOLE) -> None:
        self._ranks, self._budget, self._budget_bytes = ranks, budget, budget_bytes
        self._balance: Balance | None = None
        self._model: tuple[Plan, NDArray[np.float64]] | None = None
        self._sizes: NDArray[np.int64] = np.zeros((1, 1, 1), np.int64)
        self._wire = self._sizes
        self._policy, self._rate = Policy(0, 0), MigrationRate(share)
        self.migration_share = share
        self.restarts = 0
        self.planned_imbalance = 1.0
        self.planning_seconds = 0.0

    def assign(self, plan: Plan) -> tuple[Piece, ...]:
        """Return the pieces of a frame, and plan the flights that start during it.

        Raises InputError if the bricks of a rank do not fit into its memory, or the budget is smaller than a
        brick.
        """
        model, self.planning_seconds = self._expected(plan), 0.0
        if self._balance is None or shows_more(plan, self._sizes.astype(np.float64)):
            balance = self._begin(plan, model)
        elif model.any() and not self._planned and self._rate.may_plan:
            began = thread_time()
            balance = plan_moves(self._balance, model, self._policy_for(model), _eye(plan))
            self.planning_seconds = thread_time() - began
        else:
            balance = skip(self._balance)
        self._balance = balance
        owner = np.where(plan.cost > 0, balance.migration.owners.owner, UNASSIGNED).astype(np.int32)
        owners = Owners(self._ranks, owner)
        self.planned_imbalance = owners.imbalance(predict(balance.measured, model, self._sizes > 0))
        return owner_pieces(owners, plan.eye_in_bricks(), plan.view.forward)

    def holds(self, rank: int) -> frozenset[Index]:
        if self._balance is None:
            return frozenset()
        return frozenset(brick for brick in self._balance.migration.holds(rank) if self._sizes[brick])

    def depart(self) -> tuple[Flight, ...]:
        """Return the planned flights, and mark them as sent."""
        planned = self._planned
        if self._balance is not None:
            sent = dispatch(self._balance.migration, [flight.brick for flight in planned])
            self._balance = replace(self._balance, migration=sent)
        return planned

    def learn(self, plan: Plan, costs: Sequence[RankFrame]) -> None:
        """Learn the cost of bricks from the costs of ranks, and the rate of migration."""
        counts = [rank.balance for rank in costs]
        planning = [float(each.get("planning_seconds", 0)) for each in counts]
        work = [
            (float(each.get("seconds", 0)) - took, sum(map(each.get, HANDLED, (0, 0))))
            for each, took in zip(counts, planning, strict=True)
        ]
        # Before any frame has ended, the time of drawing is the best estimate.
        frame = max(float(rank.balance.get("frame_seconds") or rank.seconds.get("render", 0)) for rank in costs)
        # All ranks plan the same: the least time is the one least disturbed by other processes.
        self._rate = self._rate.after(frame, work, min(planning))
        if self._balance is not None:
            self._balance = learn(self._balance, self._expected(plan), rank_costs(costs))

    def complete(self, arrived: Collection[Index], lost: Collection[Index]) -> None:
        """Record after a frame which bricks have arrived, and which were lost."""
        if self._balance is not None:
            without_lost = replace(self._balance, migration=withdraw(self._balance.migration, lost))
            self._balance = complete(without_lost, arrived)

    def recalled(self, rank: int) -> int:
        """Return the number of bricks that the last assignment gave a rank from its own cache, without a message."""
        return int(self._balance.recalled[rank]) if self._balance else 0

    @property
    def planning_expected(self) -> float:
        """Expected seconds of planning for the next frame; 0 if it will not be planned."""
        return self._rate.planning if self._rate.may_plan else 0.0

    @property
    def _planned(self) -> tuple[Flight, ...]:
        flights = self._balance.migration.flights if self._balance else ()
        return tuple(flight for flight in flights if flight.stage == "planned")

    def _expected(self, plan: Plan) -> NDArray[np.float64]:
        """Return the expected samples of each brick; cached, since `assign` and `learn` need the same."""
        if self._model is None or self._model[0] is not plan:
            self._model = plan, expected_samples(plan)
        return self._model[1]

    def _begin(self, plan: Plan, model: NDArray[np.float64]) -> Balance:
        """Assign all bricks from scratch, by the expected cost and what earlier frames have taught."""
        measured = self._balance.measured if self._balance else unmeasured(plan.layout.counts_zyx)
        # Bricks that were visible once may become visible again.
        sizes = self._sizes = np.maximum(self._sizes, self._budget.brick_bytes(plan))
        sent = slot_of(plan).counted(plan.layout.counts_zyx, lambda slot: slot.sample_bytes)
        wire = self._wire = np.where(sizes > 0, sent, 0)
        cost = predict(measured, model, sizes > 0)

        def shares(ranks: int) -> NDArray[np.int64]:
            return first_owners(cost, ranks, _eye(plan)).sums(sizes)

        self._budget.check(shares, self._ranks, sizes)
        largest = int(shares(self._ranks).max())
        limit = self._budget.limit_bytes or max(largest, EVEN_SHARES * int(sizes.sum()) // self._ranks)
        if self._budget_bytes is not None and self._budget_bytes < wire.max():
            found, allowed = f"{self._budget_bytes} bytes", f"{wire.max()} bytes or more, which a brick takes"
            raise InputError("cannot carry one brick", where="cluster.migration_bytes", found=found, allowed=allowed)
        self._policy = Policy(self._share(BUDGET), limit)
        self.restarts += 1
        return replace(begin(cost, self._ranks, sizes, self._policy, _eye(plan), wire), measured=measured)

    def _policy_for(self, model: NDArray[np.float64]) -> Policy:
        """Return the policy of a frame: at a large imbalance more may be sent, since it costs more than messages."""
        assert self._balance, "the first frame begins the balance"
        cost = predict(self._balance.measured, model, self._sizes > 0)
        is_large = self._balance.migration.landed.imbalance(cost) > LARGE_IMBALANCE
        budget, under_way = self._share(JUMP_BUDGET if is_large else BUDGET), self._under_way()
        affordable = self._rate.affordable_bytes(self._ranks, under_way, int(self._wire.max()))
        return replace(self._policy, budget_bytes=budget if affordable is None else min(budget, affordable))

    def _under_way(self) -> int:
        """Bytes of bricks that are planned or sent and have not arrived."""
        assert self._balance, "the first frame begins the balance"
        flights = self._balance.migration.flights
        return sum(int(self._wire[flight.brick]) for flight in flights if flight.stage != "held")

    def _share(self, share: float) -> int:
        """Return the budget of a frame in bytes: a share of all bricks, at least one brick."""
        return self._budget_bytes or max(int(self._wire.max()), int(share * int(self._wire.sum())))


def _eye(plan: Plan) -> RayOrigin:
    return ray_origin(plan.eye_in_bricks(), plan.view.forward)
