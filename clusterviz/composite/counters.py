"""What one rank's composition cost: plain numbers, for the report."""

from __future__ import annotations

from dataclasses import dataclass


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
    """

    messages_sent: int = 0
    pixels_sent: int = 0
    bytes_raw: int = 0
    bytes_sent: int = 0
    seconds_encode: float = 0.0
    seconds_wait: float = 0.0
    seconds_blend: float = 0.0


@dataclass(frozen=True)
class CompositeCounters:
    """All stages on one rank, and what was chosen.

    Attributes
    ----------
    algorithm, codec : what ran, never "auto"
    participants : ranks that had pixels
    seconds_agree : the exchange of footprints
    stages : one for each stage of the schedule; empty on ranks without pixels
    """

    algorithm: str
    codec: str
    participants: int
    seconds_agree: float
    stages: tuple[StageCounters, ...]

    @property
    def total(self) -> StageCounters:
        """The sums over all stages."""
        return StageCounters(
            sum(stage.messages_sent for stage in self.stages),
            sum(stage.pixels_sent for stage in self.stages),
            sum(stage.bytes_raw for stage in self.stages),
            sum(stage.bytes_sent for stage in self.stages),
            sum(stage.seconds_encode for stage in self.stages),
            sum(stage.seconds_wait for stage in self.stages),
            sum(stage.seconds_blend for stage in self.stages),
        )
