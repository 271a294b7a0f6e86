"""Migration in the frame loop: planned flights are sent, and all ranks learn which bricks have arrived."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import replace
from time import perf_counter
from typing import Any, Protocol

from clusterviz.comm import abort_on_failure
from clusterviz.data.source import Index
from clusterviz.distribution.dynamic import Dynamic
from clusterviz.distribution.flights import Flight
from clusterviz.frame.run import Run
from clusterviz.frame.work import DrawnFrame, Planning, RankWork, check_equal
from clusterviz.migration.time_budget import TimeBudget
from clusterviz.migration.transfer import BrickTransfer
from clusterviz.migration.wire_format import WireFormat, wire_format_of
from clusterviz.plan.plan import Plan
from clusterviz.render.stored_brick import Stored, stamp_of
from clusterviz.report.statistics import RankFrame
from clusterviz.scene.values import Scene


class BrickStore(Protocol):
    """Bricks of a rank as its renderer stores them."""

    def stored(self, bricks: Sequence[Index]) -> dict[Index, Stored]:
        """Return bricks of this rank, as they lie in GPU memory."""

    def take(self, plan: Plan, brick: Index, stored: Stored) -> None:
        """Store a brick from another rank."""


class MigrationDriver:
    """Hooks of the dynamic distribution: they send and receive its flights; every method is collective.

    Parameters
    ----------
    distribution : that plans flights
    bricks : of this rank
    """

    def __init__(self, distribution: Dynamic, bricks: BrickStore) -> None:
        self._distribution, self._bricks = distribution, bricks
        self._time_budget = TimeBudget(distribution.migration_share)
        self._transfer: BrickTransfer | None = None
        self._flying: dict[int, Index] = {}
        self._under_way: set[int] = set()
        self._restarts = 0
        self._counts: dict[str, Any] = {}
        self._received, self._lost, self._frames = 0, 0, 0
        self._began = 0.0
        self._plan: Plan | None = None
        self._sums: dict[str, int] = {}

    def prepare(self, run: Run, scene: Scene, plan: Plan) -> Planning[None]:
        """Ask for nothing: bricks are assigned by the costs of earlier frames."""
        yield from ()

    def before(self, run: Run, work: RankWork) -> None:
        """Send bricks of planned flights while there is time."""
        done = run.clock.seconds
        self._began = perf_counter() - done["plan"] - done["load"]
        self._depart(run, work)

    def counted(self, counts: RankFrame) -> RankFrame:
        """Add the counts of migration in this frame to those of the frame."""
        found: dict[str, Any] = {"seconds": self._time_budget.seconds, "frame_seconds": self._time_budget.frame_seconds}
        found |= {"bricks_received": self._received, "bricks_lost": self._lost}
        if self._transfer is not None:
            now = {"bytes_sent": 0, "bytes_raw": 0, "bytes_opened": 0, "bricks_stored": 0}
            now = {name: getattr(self._transfer, name) for name in now}
            found |= {name: count - self._sums.get(name, 0) for name, count in now.items()}
            self._sums = now
        return replace(counts, balance=self._counts | found)

    def after(self, run: Run, drawn: DrawnFrame, costs: Sequence[RankFrame]) -> None:
        """Gather which bricks have arrived or were lost, and begin the next frame's time budget."""
        check_equal(run, {"which bricks fly": [int(rank.balance.get("planned", 0)) for rank in costs]})
        if drawn.work.plan is None:
            return
        # The first frame also sets things up, so only its time of drawing counts.
        drawing = max(rank.seconds.get("render", 0.0) for rank in costs)
        self._time_budget.end(perf_counter() - self._began if self._frames else drawing)
        self._frames += 1
        self._time_budget.begin(self._distribution.planning_expected)
        self._complete(run)

    def close(self) -> None:
        if self._transfer is not None:
            self._transfer.close()

    def _depart(self, run: Run, work: RankWork) -> None:
        distribution, rank = self._distribution, run.channel.rank
        if self._restarts != distribution.restarts:
            # All bricks were assigned anew, so earlier flights are void.
            self._restarts = distribution.restarts
            self._flying.clear()
            if self._transfer is not None:
                self._transfer.void()
        self._time_budget.spend(distribution.planning_seconds)
        flights = distribution.depart()
        self._counts = {
            "planned_imbalance": distribution.planned_imbalance,
            "planning_seconds": distribution.planning_seconds,
            "images": len(work.pieces_of(rank)),
            "flights": len(flights),
            "planned": zlib.crc32(repr(flights).encode()),
            "bricks_sent": sum(flight.source == rank for flight in flights),
            "bytes_sent": 0,
            "bricks_recalled": distribution.recalled(rank),
        }
        if work.plan is not None:
            with abort_on_failure(run.channel, run.frame, "migrate"), run.clock.stage("migrate"):
                self._send(run, work.plan, flights, work.holds)

    def _send(self, run: Run, plan: Plan, flights: Sequence[Flight], holds: frozenset[Index]) -> None:
        wire_format = wire_format_of(plan)
        transfer = self._transfer = self._transfer or BrickTransfer(run.channel, wire_format, self._time_budget)
        self._plan = plan
        numbers = transfer.post(flights, wire_format)
        self._flying.update(zip(numbers, (flight.brick for flight in flights), strict=True))
        self._under_way.update(numbers)

        def read(brick: Index, wanted: WireFormat) -> Stored | None:
            return self._bricks.stored([brick])[brick] if brick in holds and wanted == wire_format.of(brick) else None

        transfer.send(read)

    def _complete(self, run: Run) -> None:
        """Collect arrived bricks; all ranks have sent by now, so without a time limit arrivals are reproducible."""
        if self._transfer is None or not self._under_way:
            self._distribution.complete([], [])
            return
        with abort_on_failure(run.channel, run.frame, "migrate"), run.clock.stage("migrate"):
            delivery = self._transfer.collect(self._store)
            gathered = run.channel.allgather((delivery.arrived, delivery.lost))
        run.clock.note(*delivery.spans)
        arrived, lost = (sorted(number for rank in gathered for number in rank[side]) for side in (0, 1))
        self._under_way -= {*arrived, *lost}
        self._received += len(delivery.arrived)
        self._lost += sum(number in self._flying for number in delivery.lost)
        self._distribution.complete(self._known(arrived), self._known(lost))

    def _store(self, brick: Index, stamp: int, stored: Stored) -> bool:
        """Store a received brick; False if it is in another storage format than the current plan's."""
        if self._plan is None or stamp != stamp_of(self._plan):
            return False
        self._bricks.take(self._plan, brick, stored)
        return True

    def _known(self, numbers: list[int]) -> list[Index]:
        """Return the bricks of flights that are not void, and forget these flights."""
        return [self._flying.pop(number) for number in numbers if number in self._flying]
