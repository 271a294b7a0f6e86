"""Counters of one rank's compositing, for the report."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields


@dataclass(frozen=True)
class PeerCounters:
    """Counters of one peer in one stage.

    Attributes
    ----------
    peer : rank of the channel
    messages_sent, pixels_sent : sent to it
    bytes_raw, bytes_sent : bytes of those pixels before and after the codec
    seconds_encode : time of packing and starting the send
    seconds_wait : time from the start of waiting until its message had arrived; 0 if none was expected
    """

    peer: int
    messages_sent: int = 0
    pixels_sent: int = 0
    bytes_raw: int = 0
    bytes_sent: int = 0
    seconds_encode: float = 0.0
    seconds_wait: float = 0.0


@dataclass(frozen=True)
class StageCounters:
    """Counters of one stage.

    Attributes
    ----------
    messages_sent, pixels_sent : sent to other ranks
    bytes_raw, bytes_sent : bytes of those pixels before and after the codec
    seconds_encode : time of packing and starting the sends
    seconds_wait : time of waiting for messages
    seconds_blend : time of unpacking and merging
    peers : counters of each peer; empty if there are no messages
    """

    messages_sent: int = 0
    pixels_sent: int = 0
    bytes_raw: int = 0
    bytes_sent: int = 0
    seconds_encode: float = 0.0
    seconds_wait: float = 0.0
    seconds_blend: float = 0.0
    peers: tuple[PeerCounters, ...] = ()


@dataclass(frozen=True)
class CompositeCounters:
    """Counters of all stages, and what was chosen.

    Attributes
    ----------
    algorithm, transport : what ran, never "auto"
    codec : as requested; "auto" is decided for each message
    participants : number of ranks with pixels
    seconds_agree : time of the exchange of footprints and of planning
    seconds_predicted : prediction of the time model, from the footprints to the picture on the root
    stages : one for each stage of the schedule; empty on ranks without pixels
    seconds_collect : time of the final gather; 0 if it was left to the caller
    bytes_collected : bytes that this rank sent to the root in the final gather
    """

    algorithm: str
    codec: str
    transport: str
    participants: int
    seconds_agree: float
    seconds_predicted: float
    stages: tuple[StageCounters, ...]
    seconds_collect: float = 0.0
    bytes_collected: int = 0

    @property
    def seconds(self) -> float:
        """Measured time, to be compared with `seconds_predicted`."""
        total = self.total
        spent = total.seconds_encode + total.seconds_wait + total.seconds_blend
        return self.seconds_agree + spent + self.seconds_collect

    @property
    def total(self) -> StageCounters:
        """Sums over all stages, without the peers."""
        return _sum(self.stages)


def _sum(stages: Iterable[StageCounters]) -> StageCounters:
    stages = tuple(stages)
    names = [field.name for field in fields(StageCounters) if field.name != "peers"]
    return StageCounters(**{name: sum(getattr(stage, name) for stage in stages) for name in names})
