"""Migration in the loop: what the dynamic distribution plans is sent, and what has come is told to all."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from clusterviz.comm import abort_on_failure
from clusterviz.data.source import Index
from clusterviz.frame.alike import check_same
from clusterviz.frame.courier import Courier
from clusterviz.frame.drawing import Drawing
from clusterviz.frame.dynamic import Dynamic
from clusterviz.frame.parcel import parcels_of
from clusterviz.frame.run import Run
from clusterviz.frame.several import Opened
from clusterviz.frame.share import OpenedVolume, Share
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
        self._courier: Courier | None = None
        self._flying: dict[int, Index] = {}
        self._under_way: set[int] = set()
        self._beginnings = 0
        self._counts: dict[str, Any] = {}
        self._received, self._lost = 0, 0

    def before(self, opened: Opened, share: Share) -> Share:
        """Send what shall fly; what is drawn stays as it was dealt."""
        self._depart(opened, share)
        return share

    def counted(self, counts: RankFrame) -> RankFrame:
        """A frame's counts with what was sent in it, and what has been received so far."""
        so_far = {"bricks_received": self._received, "bricks_lost": self._lost}
        return replace(counts, balance=self._counts | so_far)

    def after(self, share: Share, costs: Sequence[RankFrame]) -> None:
        """What has come by now changes hands; of damaged messages all ranks hear."""
        told = [int(rank.balance.get("planned", 0)) for rank in costs]
        check_same(self._run, {"which bricks fly": told})
        if share.plan is not None:
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
        if not flights or share.plan is None or not isinstance(opened, OpenedVolume):
            return
        with abort_on_failure(self._run.channel, self._run.frame, "migrate"), self._run.clock.stage("migrate"):
            courier = self._courier = self._courier or Courier(self._run.channel)
            before = courier.bytes_sent
            mine = self._drawing.stored([flight.brick for flight in flights if flight.source == rank])
            numbers = courier.post(flights, parcels_of(share.plan, opened.source.dtype), mine)
            self._counts["bytes_sent"] = courier.bytes_sent - before
        self._flying.update(zip(numbers, (flight.brick for flight in flights), strict=True))
        self._under_way.update(numbers)

    def _land(self) -> None:
        if self._courier is None or not self._under_way:
            self._distribution.land([], [])
            return
        with abort_on_failure(self._run.channel, self._run.frame, "migrate"), self._run.clock.stage("migrate"):
            delivery = self._courier.collect()
            told = self._run.channel.allgather((sorted(delivery.bricks), delivery.lost))
        self._run.clock.note(*delivery.spans)
        came = {number: brick for number, brick in delivery.bricks.items() if number in self._flying}
        self._drawing.take({brick: (stamp, stored) for brick, stamp, stored in came.values()})
        self._received += len(delivery.bricks)
        self._lost += len(delivery.lost)
        arrived, lost = (sorted(number for rank in told for number in rank[side]) for side in (0, 1))
        self._under_way -= {*arrived, *lost}
        self._distribution.land(self._known(arrived), self._known(lost))

    def _known(self, numbers: list[int]) -> list[Index]:
        """The bricks of flights that are still of use."""
        return [self._flying.pop(number) for number in numbers if number in self._flying]
