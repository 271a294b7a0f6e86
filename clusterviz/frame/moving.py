"""Migration in the loop: what the dynamic distribution plans is sent, and what has come is told to all."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import replace
from time import perf_counter
from typing import Any

from clusterviz.balance.migration import Flight
from clusterviz.comm import abort_on_failure
from clusterviz.data.source import Index
from clusterviz.frame.alike import check_same
from clusterviz.frame.courier import Courier
from clusterviz.frame.drawing import Drawing
from clusterviz.frame.dynamic import Dynamic
from clusterviz.frame.parcel import Parcels, parcels_of, stamp_of
from clusterviz.frame.run import Run
from clusterviz.frame.several import Opened
from clusterviz.frame.share import Share
from clusterviz.frame.time_slice import TimeSlice
from clusterviz.plan.plan import Plan
from clusterviz.render.stored import Stored
from clusterviz.report.statistics import RankFrame


class Moving:
    """Bricks between ranks, from frame to frame; every method is collective.

    Parameters
    ----------
    run : of the loop
    distribution : which plans
    drawing : from where bricks are taken, and where they are put
    """

    def __init__(self, run: Run, distribution: Dynamic, drawing: Drawing) -> None:
        self._run, self._distribution, self._drawing = run, distribution, drawing
        self._slice = TimeSlice(distribution.share)
        self._courier: Courier | None = None
        self._flying: dict[int, Index] = {}
        self._under_way: set[int] = set()
        self._beginnings = 0
        self._counts: dict[str, Any] = {}
        self._received, self._lost, self._frames = 0, 0, 0
        self._began = 0.0
        self._plan: Plan | None = None
        self._sums: dict[str, int] = {}

    def before(self, opened: Opened, share: Share) -> Share:
        """Send what shall fly, as far as there is time; what is drawn stays as it was dealt."""
        done = self._run.clock.seconds
        self._began = perf_counter() - done["plan"] - done["load"]
        self._depart(opened, share)
        return share

    def counted(self, counts: RankFrame) -> RankFrame:
        """A frame's counts with what was sent for it and what has come since the last one, and so far."""
        found: dict[str, Any] = {"seconds": self._slice.seconds, "frame_seconds": self._slice.frame_seconds}
        found |= {"bricks_received": self._received, "bricks_lost": self._lost}
        if self._courier is not None:
            now = {"bytes_sent": 0, "bytes_raw": 0, "bytes_opened": 0, "bricks_stored": 0}
            now = {name: getattr(self._courier, name) for name in now}
            found |= {name: count - self._sums.get(name, 0) for name, count in now.items()}
            self._sums = now
        return replace(counts, balance=self._counts | found)

    def after(self, share: Share, costs: Sequence[RankFrame]) -> None:
        """What has come by now changes hands; of damaged messages all ranks hear. The next frame's slice begins."""
        check_same(self._run, {"which bricks fly": [int(rank.balance.get("planned", 0)) for rank in costs]})
        if share.plan is None:
            return
        # The first frame opens what lasts: but for drawing, it tells nothing of others.
        drawing = max(rank.seconds.get("render", 0.0) for rank in costs)
        self._slice.end(perf_counter() - self._began if self._frames else drawing)
        self._frames += 1
        self._slice.begin(self._distribution.planning_expected)
        self._land()

    def close(self) -> None:
        """Let what is under way arrive, and give the channel back."""
        if self._courier is not None:
            self._courier.close()

    def _depart(self, opened: Opened, share: Share) -> None:
        distribution, rank = self._distribution, self._run.channel.rank
        if self._beginnings != distribution.beginnings:
            # What still flies was planned for bricks that have been dealt anew.
            self._beginnings = distribution.beginnings
            self._flying.clear()
            if self._courier is not None:
                self._courier.void()
        self._slice.spend(distribution.planning_seconds)
        flights = distribution.depart()
        self._counts = {
            "planned_imbalance": distribution.planned_imbalance,
            "planning_seconds": distribution.planning_seconds,
            "images": len(list(share.pieces_of(rank))),
            "flights": len(flights),
            "planned": zlib.crc32(repr(flights).encode()),
            "bricks_sent": sum(flight.source == rank for flight in flights),
            "bytes_sent": 0,
            "bricks_recalled": distribution.recalled(rank),
        }
        if share.plan is not None:
            with abort_on_failure(self._run.channel, self._run.frame, "migrate"), self._run.clock.stage("migrate"):
                self._send(share.plan, parcels_of(share.plan, opened.range_type), flights, share.holds)

    def _send(self, plan: Plan, parcels: Parcels, flights: Sequence[Flight], holds: frozenset[Index]) -> None:
        courier = self._courier = self._courier or Courier(self._run.channel, parcels, self._slice)
        self._plan = plan
        numbers = courier.post(flights, parcels)
        self._flying.update(zip(numbers, (flight.brick for flight in flights), strict=True))
        self._under_way.update(numbers)

        def read(brick: Index, asked: Parcels) -> Stored | None:
            return self._drawing.stored([brick])[brick] if brick in holds and asked == parcels.of(brick) else None

        courier.send(read)

    def _land(self) -> None:
        """Every rank has sent by now what it had time for; so what arrives is the same in every run, where all has."""
        if self._courier is None or not self._under_way:
            self._distribution.land([], [])
            return
        with abort_on_failure(self._run.channel, self._run.frame, "migrate"), self._run.clock.stage("migrate"):
            delivery = self._courier.collect(self._store)
            told = self._run.channel.allgather((delivery.arrived, delivery.lost))
        self._run.clock.note(*delivery.spans)
        arrived, lost = (sorted(number for rank in told for number in rank[side]) for side in (0, 1))
        self._under_way -= {*arrived, *lost}
        self._received += len(delivery.arrived)
        self._lost += sum(number in self._flying for number in delivery.lost)
        self._distribution.land(self._known(arrived), self._known(lost))

    def _store(self, brick: Index, stamp: int, stored: Stored) -> bool:
        """Whether a brick that came is stored as frames now have it; it is drawn when it has changed hands."""
        if self._plan is None or stamp != stamp_of(self._plan):
            return False
        self._drawing.take(self._plan, brick, stored)
        return True

    def _known(self, numbers: list[int]) -> list[Index]:
        """The bricks of flights that are still of use."""
        return [self._flying.pop(number) for number in numbers if number in self._flying]
