"""Time budget of migration on one rank: a share of each frame, kept by working in small steps.

A step reads back a brick, packs or unpacks a part of one, or stores a brick. It starts only if its expected time, by
earlier steps of its kind, fits into the rest of the frame's slice. If it takes longer, later frames have less. Unused
time is lost, except what the next step needs: a step longer than every slice is made once in several frames.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import perf_counter

from clusterviz.distribution.dynamic import WHOLE

FRAMES = 4  # last frames, of which the shortest is the expected time of the next one
DOUBT = 0.8  # factor a frame on the expected time of a step longer than every slice, so that it is tried again
MOST_DEBT = 1.0  # in frames, so that one delayed step does not end migration


class TimeBudget:
    """Time that is left for migration on this rank.

    Parameters
    ----------
    share : of a frame's time, in (0, 1]; 1: no limit
    clock : returns seconds; another one for tests

    Attributes
    ----------
    seconds : spent since the frame began
    left : seconds that are left; negative if earlier frames took too many
    """

    def __init__(self, share: float, clock: Callable[[], float] = perf_counter) -> None:
        self._share, self._clock = share, clock
        self._frames: deque[float] = deque(maxlen=FRAMES)
        self._rates: dict[str, float] = {}
        self.left = self._slice = 0.0
        self._has_stepped = False
        self._doubted: set[str] = set()
        self._saving = self._reserved = 0.0
        self.seconds = 0.0

    @property
    def frame_seconds(self) -> float:
        """Expected seconds of the next frame; 0 before any frame has ended."""
        return min(self._frames, default=0.0)

    def begin(self, planning: float = 0.0) -> None:
        """Begin a frame, and reserve time: `planning` seconds, and the usual time of posting receives."""
        frame = self.frame_seconds
        self._slice = self._share * frame
        self.left = max(-MOST_DEBT * frame, min(self.left + self._slice, max(self._slice, self._saving)))
        for kind in self._doubted:
            self._rates[kind] *= DOUBT
        self._doubted, self._saving = set(), 0.0
        self._has_stepped, self.seconds = False, 0.0
        self._reserved = planning + self._rates.get("post", 0.0) if planning else 0.0

    def end(self, frame_seconds: float) -> None:
        """End a frame that took `frame_seconds`, migration included."""
        self._frames.append(frame_seconds)

    def allows(self, kind: str, size: int) -> bool:
        """True if a step of `size` bytes should fit; otherwise it may fit in a later frame."""
        if self._share >= WHOLE:
            return True
        expected = self._rates.get(kind, 0.0) * size
        # Saved time is for a single step.
        available = min(self.left, self._slice - self.seconds) if self._has_stepped else self.left
        if available >= expected + self._reserved:
            return True
        self._refuse(kind, expected)
        return False

    def spend(self, seconds: float) -> None:
        """Count the time of planning, and end its reservation."""
        self.left -= seconds
        self.seconds += seconds
        self._reserved = 0.0

    @contextmanager
    def step(self, kind: str = "", size: int = 0) -> Iterator[None]:
        """Measure the body: a step of `size` bytes, or work that does not ask `allows`, with size 0."""
        began = self._clock()
        try:
            yield
        finally:
            took = self._clock() - began
            self.left -= took
            self.seconds += took
            if size:
                self._has_stepped = True
            if kind:
                # Other processes only lengthen times, so short times count more.
                rate, known = took / max(size, 1), self._rates.get(kind)
                self._rates[kind] = rate if known is None else min(rate, (rate + known) / 2, 2 * known)

    def _refuse(self, kind: str, expected: float) -> None:
        """Save time for a step that does not fit into a slice; lower its expected time if no slice could hold it."""
        needed = expected + self._reserved
        if kind in self._rates and self.left >= 0 and needed > self._slice:
            self._saving = max(self._saving, needed)
            if expected > self._slice:
                self._doubted.add(kind)
