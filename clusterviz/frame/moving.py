"""Migration in the loop: what the dynamic distribution plans is sent, and what has come is told to all."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import replace
from time import perf_counter
from typing import Any

from clusterviz.balance import Flight
from clusterviz.comm import abort_on_failure
from clusterviz.data.source import Index
from clusterviz.frame.alike import check_same
from clusterviz.frame.courier import Courier
from clusterviz.frame.drawing import Drawing
from clusterviz.frame.dynamic import Dynamic
from clusterviz.frame.parcel import Parcels, parcels_of, stamp_of
from clusterviz.frame.run import Run
from clusterviz.frame.several import Opened
from clusterviz.frame.share import OpenedVolume, Share
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
        self._slice.begin()
        self._depart(opened, share)
        return share

    def counted(self, counts: RankFrame) -> RankFrame:
        """Take what has come by now; a frame's counts with what was sent and received in it, and so far."""
        courier, found = self._courier, dict[str, Any]()
        if courier is not None:
            with abort_on_failure(self._run.channel, self._run.frame, "migrate"), self._run.clock.stage("migrate"):
                courier.collect(self._store)
            delivery = courier.delivered()
            self._run.clock.note(*delivery.spans)
            self._received += len(delivery.arrived)
            self._lost += sum(number in self._flying for number in delivery.lost)
            found = {"arrived": delivery.arrived, "lost": delivery.lost}
            for name, before in self._sums.items():
                found[name] = getattr(courier, name) - before
        found |= {"bricks_received": self._received, "bricks_lost": self._lost}
        found |= {"seconds": self._slice.seconds, "frame_seconds": self._slice.frame_seconds}
        return replace(counts, balance=self._counts | found)

    def after(self, share: Share, costs: Sequence[RankFrame]) -> None:
        """What has come changes hands; of damaged messages all ranks hear."""
        check_same(self._run, {"which bricks fly": [int(rank.balance.get("planned", 0)) for rank in costs]})
        if share.plan is not None:
            arrived, lost = (
                sorted(number for rank in costs for number in rank.balance.get(name, ()))
                for name in ("arrived", "lost")
            )
            self._distribution.land(self._known(arrived), self._known(lost))
            # The first frame opens what lasts: but for drawing, it tells nothing of others.
            drawing = max(rank.seconds.get("render", 0.0) for rank in costs)
            self._slice.end(perf_counter() - self._began if self._frames else drawing)
            self._frames += 1

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
        flights = distribution.depart()
        self._counts = {
            "planned_imbalance": distribution.planned_imbalance,
            "images": len(list(share.pieces_of(rank))),
            "flights": len(flights),
            "planned": zlib.crc32(repr(flights).encode()),
            "bricks_sent": sum(flight.source == rank for flight in flights),
            "bytes_sent": 0,
            "bricks_recalled": distribution.recalled(rank),
        }
        if share.plan is not None and isinstance(opened, OpenedVolume):
            with abort_on_failure(self._run.channel, self._run.frame, "migrate"), self._run.clock.stage("migrate"):
                self._send(share.plan, parcels_of(share.plan, opened.source.dtype), flights, share.holds)

    def _send(self, plan: Plan, parcels: Parcels, flights: Sequence[Flight], holds: frozenset[Index]) -> None:
        """What came first, so that it changes hands soon; then what shall go."""
        courier = self._courier = self._courier or Courier(self._run.channel, parcels, self._slice)
        self._sums = {name: getattr(courier, name) for name in ("bytes_sent", "bytes_raw", "bytes_opened")}
        self._plan = plan
        numbers = courier.post(flights, parcels)
        self._flying.update(zip(numbers, (flight.brick for flight in flights), strict=True))

        def read(brick: Index, asked: Parcels) -> Stored | None:
            return self._drawing.stored([brick])[brick] if brick in holds and asked == parcels else None

        courier.collect(self._store)
        courier.send(read)

    def _store(self, brick: Index, stamp: int, stored: Stored) -> bool:
        """Whether a brick that came is stored as frames now have it; it is drawn when it has changed hands."""
        if self._plan is None or stamp != stamp_of(self._plan):
            return False
        self._drawing.take(self._plan, brick, stored)
        return True

    def _known(self, numbers: list[int]) -> list[Index]:
        """The bricks of flights that are still of use."""
        return [self._flying.pop(number) for number in numbers if number in self._flying]
