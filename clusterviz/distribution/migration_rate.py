"""How many bytes of bricks may be under way, and how often that is planned: as a share of the frames' time carries.

What limits the time of a frame is decided on each rank, which stops to pack in the middle of a brick
(`migration/time_budget.py`). Here the plans keep up with that: where bricks come slowly few are planned, so that plans
do not grow old. Planning takes of the same share: where frames are short, not every one is planned for. All ranks are
told the same numbers, and so plan alike.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

FRAMES_AHEAD = 4  # that what is under way should take, at most
GUESS = 1e8  # bytes a second, before any was measured: what is planned shall not wait for that
MEMORY = 0.8  # weight of what was measured before
PLANNING = 0.5  # of the share, at most: the rest is for what was planned
WHOLE = 1.0  # a share by which nothing is limited


@dataclass(frozen=True)
class MigrationRate:
    """What a frame's time carries.

    Attributes
    ----------
    share : of a frame's time that each rank may give to migration; 1: any
    frame_seconds : that frames take; 0 where that is not known
    seconds, bytes : what bricks took, and what of them was packed and opened, summed over ranks and frames, older ones
        less
    planning : seconds that planning where bricks go takes once; 0 where that is not known
    saved : seconds for planning that frames have left
    """

    share: float
    frame_seconds: float = 0.0
    seconds: float = 0.0
    bytes: float = 0.0
    planning: float = 0.0
    saved: float = 0.0

    @property
    def may_plan(self) -> bool:
        """Whether there is time to plan for the next frame."""
        return self.share >= WHOLE or self.saved >= self.planning

    def after(self, frame_seconds: float, work: Iterable[tuple[float, int]], planning: float = 0.0) -> MigrationRate:
        """What is known after another frame.

        Parameters
        ----------
        frame_seconds : that it took the slowest rank; 0 where nobody knows
        work : of each rank the seconds of its work on bricks, and the bytes that it packed and opened
        planning : seconds that planning for it took, the same on all ranks; 0 where nothing was planned
        """
        seconds, handled = self.seconds, self.bytes
        for took, size in work:
            # Ranks that only looked for messages tell nothing of bytes.
            seconds, handled = (seconds + took, handled + size) if size else (seconds, handled)
        known = MEMORY * self.frame_seconds + (1 - MEMORY) * frame_seconds if self.frame_seconds else frame_seconds
        limited = replace(self, frame_seconds=known, seconds=MEMORY * seconds, bytes=MEMORY * handled)
        return limited._planned(planning, PLANNING * self.share * frame_seconds)

    def affordable_bytes(self, ranks: int, under_way: int, largest: int) -> int | None:
        """Bytes that all ranks together may start to send in a frame; None: any.

        Parameters
        ----------
        under_way : bytes that were planned before and have not arrived
        largest : brick, in bytes: one at least may go where nothing else is under way

        Returns
        -------
        allowed : 0, or enough for any brick
        """
        if self.share >= WHOLE:
            return None
        # Each byte is packed by one rank and opened by another.
        rate = self.bytes / self.seconds if self.seconds else GUESS
        slice_seconds = self.share * self.frame_seconds
        slice_seconds -= min(self.planning, PLANNING * slice_seconds)
        room = int(FRAMES_AHEAD * slice_seconds * rate * ranks / 2) - under_way
        if room >= largest:
            return room
        return 0 if under_way else largest

    def _planned(self, took: float, left: float) -> MigrationRate:
        """After a frame whose plan took so long, if there was one, and which has left so much for another."""
        once = self.planning
        if took:
            # Others on the same cores only make times longer.
            once = min(took, (took + once) / 2, 2 * once) if once else took
        saved = max(0.0, self.saved - once) if took else self.saved
        # What is left over counts, so that two plans may come in three frames.
        return replace(self, planning=once, saved=min(2 * once, saved + left))
