"""Counters of one rank's compositing, for the report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any


@dataclass(frozen=True)
class _Counters:
    # sent to other ranks
    messages_sent: int = 0
    pixels_sent: int = 0
    # bytes of those pixels before and after the codec
    bytes_raw: int = 0
    bytes_sent: int = 0
    seconds_encode: float = 0.0  # time of packing and starting the sends
    # time of waiting for messages; of a peer, until its message had arrived, 0 if none was expected
    seconds_wait: float = 0.0


@dataclass(frozen=True)
class PeerCounters(_Counters):
    """Counters of one peer in one stage: `peer` is its rank of the channel."""

    peer: int = -1


@dataclass(frozen=True)
class StageCounters(_Counters):
    seconds_blend: float = 0.0  # time of unpacking and merging
    peers: tuple[PeerCounters, ...] = ()  # counters of each peer; empty if there are no messages


@dataclass(frozen=True)
class CompositeCounters:
    """Counters of all stages, and what was chosen."""

    # what ran, never "auto"
    algorithm: str
    codec: str  # as requested; "auto" is decided for each message
    transport: str
    participants: int  # number of ranks with pixels
    seconds_agree: float  # time of the exchange of footprints and of planning
    seconds_predicted: float  # prediction of the time model, from the footprints to the picture on the root
    stages: tuple[StageCounters, ...]  # one for each stage of the schedule; empty on ranks without pixels
    seconds_collect: float = 0.0  # time of the final gather; 0 if it was left to the caller
    bytes_collected: int = 0  # bytes that this rank sent to the root in the final gather

    @property
    def seconds(self) -> float:
        """Measured time, to be compared with `seconds_predicted`."""
        total = self.total
        spent = total.seconds_encode + total.seconds_wait + total.seconds_blend
        return self.seconds_agree + spent + self.seconds_collect

    @property
    def total(self) -> StageCounters:
        """Sums over all stages, without the peers."""
        return summed(self.stages, seconds_blend=sum(stage.seconds_blend for stage in self.stages))


def summed(counters: Sequence[_Counters], **more: Any) -> StageCounters:
    """Return the sums of what was sent and received as counters of a stage, with its other fields."""
    sums = {each.name: sum(getattr(one, each.name) for one in counters) for each in fields(_Counters)}
    return StageCounters(**sums, **more)
