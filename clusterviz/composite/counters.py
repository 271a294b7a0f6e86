"""What one rank's composition cost: plain numbers, for the report."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields


@dataclass(frozen=True)
class PeerCounters:
    """One other rank in one stage, as one rank sees it.

    Attributes
    ----------
    peer : the channel's rank
    messages_sent, pixels_sent : to it
    bytes_raw, bytes_sent : of those pixels, and of what the codec made of them
    seconds_encode : packing, and starting the send
    seconds_wait : from the start of waiting until its message was here; 0 where none was expected
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
    """One stage on one rank.

    Attributes
    ----------
    messages_sent, pixels_sent : to other ranks
    bytes_raw, bytes_sent : of those pixels, and of what the codec made of them
    seconds_encode : packing, and starting the sends
    seconds_wait : waiting for messages
    seconds_blend : unpacking and merging them
    peers : the same, peer by peer; empty where no message passes
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
    """All stages on one rank, and what was chosen.

    Attributes
    ----------
    algorithm, transport : what ran, never "auto"
    codec : as wanted; "auto" is decided for each message
    participants : ranks that had pixels
    seconds_agree : the exchange of footprints, and the planning
    seconds_predicted : by the time model, from the footprints to the picture on the root
    stages : one for each stage of the schedule; empty on ranks without pixels
    seconds_collect : the final gather; 0 where it was left to the caller
    bytes_collected : what this rank sent to the root in it
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
        """What was measured, all together: the counterpart of `seconds_predicted`."""
        total = self.total
        spent = total.seconds_encode + total.seconds_wait + total.seconds_blend
        return self.seconds_agree + spent + self.seconds_collect

    @property
    def total(self) -> StageCounters:
        """The sums over all stages, without the peers."""
        return _sum(self.stages)


def _sum(stages: Iterable[StageCounters]) -> StageCounters:
    stages = tuple(stages)
    names = [field.name for field in fields(StageCounters) if field.name != "peers"]
    return StageCounters(**{name: sum(getattr(stage, name) for stage in stages) for name in names})
