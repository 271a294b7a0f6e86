"""Rate of migration: bytes of bricks that may be in flight, and frames between plans, by a share of the frames' time.

Each rank limits its own time in a frame, and may stop in the middle of a brick (`TimeBudget`). This module adapts the
plans: if bricks arrive slowly, few are planned, so that plans do not become outdated. Planning takes time of the same
share, so with short frames not every frame is planned. All ranks use the same numbers and reach the same plans.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

FRAMES_AHEAD = 4  # frames that bricks in flight should need at most
GUESS = 1e8  # bytes a second, before the first measurement
MEMORY = 0.8  # weight of earlier measurements
PLANNING = 0.5  # largest part of the share for planning; the rest is for transfers
WHOLE = 1.0  # share without any limit


@dataclass(frozen=True)
class MigrationRate:
    """Measured rate of migration.

    Attributes
    ----------
    share : of a frame's time that each rank may spend on migration; 1: no limit
    frame_seconds : mean time of frames; 0 if unknown
    seconds, bytes : time of migration, and bytes packed and unpacked in it; sums over ranks and frames in which older
        frames count less
    planning : seconds that one plan takes; 0 if unknown
    saved : unused seconds for planning
    """

    share: float
    frame_seconds: float = 0.0
    seconds: float = 0.0
    bytes: float = 0.0
    planning: float = 0.0
    saved: float = 0.0

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

        Parameters
        ----------
        under_way : bytes of bricks that are planned or sent and have not arrived
        largest : bytes of the largest brick, which is allowed if nothing else is under way

        Returns
        -------
        allowed : 0, or at least `largest`
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
