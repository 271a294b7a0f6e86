"""What bricks on their way may take of this rank's time: a share of each frame, kept by working in small steps.

A step (a brick read back, a piece of one packed or opened, a brick stored) is made only where it should fit into what
is left of the frame's slice, once the frame is planned, by what steps of its kind took before. A step that took longer
than expected is a debt of the next frames. What a frame leaves unused is lost, but for as much as the next step needs:
steps that no slice can hold are made once in some frames.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import perf_counter

from clusterviz.balance import WHOLE

FRAMES = 4  # whose shortest is believed to be the next one's length
DOUBT = 0.8  # of the time that a refused step is expected to take: from frame to frame, so that it is tried again
MOST_DEBT = 1.0  # in frames: one step that another process held up shall not end migration


class TimeSlice:
    """The seconds that are left for migration on this rank.

    Parameters
    ----------
    share : of a frame's time; 1: any
    clock : seconds, for tests

    Attributes
    ----------
    seconds : spent since the frame began
    """

    def __init__(self, share: float, clock: Callable[[], float] = perf_counter) -> None:
        self._share, self._clock = share, clock
        self._frames: deque[float] = deque(maxlen=FRAMES)
        self._rates: dict[str, float] = {}
        self._left = self._slice = 0.0
        self._has_stepped = False
        self._refused: dict[str, float] = {}
        self.seconds = 0.0

    @property
    def frame_seconds(self) -> float:
        """That the next frame should take; 0 before any frame has ended."""
        return min(self._frames, default=0.0)

    @property
    def left(self) -> float:
        """Seconds; below 0 where frames before have taken too many."""
        return self._left

    def begin(self) -> None:
        """A frame begins."""
        frame = self.frame_seconds
        self._slice = self._share * frame
        most = max(self._slice, *self._refused.values(), 0.0)
        self._left = max(-MOST_DEBT * frame, min(self._left + self._slice, most))
        for kind in self._refused:
            self._rates[kind] *= DOUBT
        self._refused, self._has_stepped, self.seconds = {}, False, 0.0

    def end(self, frame_seconds: float) -> None:
        """A frame has taken so long, migration included."""
        self._frames.append(frame_seconds)

    def allows(self, kind: str, size: int) -> bool:
        """Whether a step with so many bytes should fit; one that does not may be made in a later frame."""
        if self._share >= WHOLE:
            return True
        expected = self._rates.get(kind, 0.0) * size
        # What frames before have saved is for one step, not for many.
        room = min(self._left, self._slice - self.seconds) if self._has_stepped else self._left
        if room >= expected:
            return True
        if kind in self._rates and self._left >= 0:
            self._refused[kind] = max(expected, self._refused.get(kind, 0.0))
        return False

    def spend(self, seconds: float) -> None:
        """Count what was done for migration before the slice could be asked."""
        self._left -= seconds
        self.seconds += seconds

    @contextmanager
    def step(self, kind: str = "", size: int = 0) -> Iterator[None]:
        """Measure the body: a step with so many bytes, or what goes with any, which has no size."""
        began = self._clock()
        try:
            yield
        finally:
            took = self._clock() - began
            self._left -= took
            self.seconds += took
            if size:
                self._has_stepped = True
                # Others on the same cores only make times longer.
                rate, known = took / size, self._rates.get(kind)
                self._rates[kind] = rate if known is None else min(rate, (rate + known) / 2, 2 * known)
