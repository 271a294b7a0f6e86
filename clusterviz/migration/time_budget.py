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

from clusterviz.distribution.migration_rate import WHOLE

FRAMES = 4  # whose shortest is believed to be the next one's length
DOUBT = 0.8  # of the time that a step above every slice is expected to take: from frame to frame, so that it is tried
MOST_DEBT = 1.0  # in frames: one step that another process held up shall not end migration


class TimeBudget:
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
        self._doubted: set[str] = set()
        self._saving = self._reserved = 0.0
        self.seconds = 0.0

    @property
    def frame_seconds(self) -> float:
        """That the next frame should take; 0 before any frame has ended."""
        return min(self._frames, default=0.0)

    @property
    def left(self) -> float:
        """Seconds; below 0 where frames before have taken too many."""
        return self._left

    def begin(self, planning: float = 0.0) -> None:
        """A frame begins, for which planning should take so long, and posting what is planned as long as it took."""
        frame = self.frame_seconds
        self._slice = self._share * frame
        self._left = max(-MOST_DEBT * frame, min(self._left + self._slice, max(self._slice, self._saving)))
        for kind in self._doubted:
            self._rates[kind] *= DOUBT
        self._doubted, self._saving = set(), 0.0
        self._has_stepped, self.seconds = False, 0.0
        self._reserved = planning + self._rates.get("post", 0.0) if planning else 0.0

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
        if room >= expected + self._reserved:
            return True
        self._refuse(kind, expected)
        return False

    def spend(self, seconds: float) -> None:
        """Count what planning took, for which nothing is reserved any more."""
        self._left -= seconds
        self.seconds += seconds
        self._reserved = 0.0

    @contextmanager
    def step(self, kind: str = "", size: int = 0) -> Iterator[None]:
        """Measure the body: a step with so many bytes, or what is made without asking, which has no size."""
        began = self._clock()
        try:
            yield
        finally:
            took = self._clock() - began
            self._left -= took
            self.seconds += took
            if size:
                self._has_stepped = True
            if kind:
                # Others on the same cores only make times longer.
                rate, known = took / max(size, 1), self._rates.get(kind)
                self._rates[kind] = rate if known is None else min(rate, (rate + known) / 2, 2 * known)

    def _refuse(self, kind: str, expected: float) -> None:
        """Save for a step that no slice can hold, or none of a frame that is planned; and doubt how long it takes."""
        needed = expected + self._reserved
        if kind in self._rates and self._left >= 0 and needed > self._slice:
            self._saving = max(self._saving, needed)
            if expected > self._slice:
                self._doubted.add(kind)
