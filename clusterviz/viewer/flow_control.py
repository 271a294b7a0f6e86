"""Flow control of the pictures for one client: the newest picture only, and a window of those on their way.

A client acknowledges each picture that it has shown. At most a window of pictures is on its way without that: two, or
as many as the link holds where its round trip is long. That is the product of bandwidth and delay, which are measured
from acknowledgements as in BBR. Where the link takes too few pictures a second, moving ones get fewer bytes.

Nothing here blocks or knows of sockets; the caller passes the time.

References
----------
N. Cardwell et al.: BBR: congestion-based congestion control, ACM Queue 14(5), 2016.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from clusterviz.viewer.encoding import LOSSLESS, LOSSY, Encoding, Picture

MIN_WINDOW, MAX_WINDOW = 2, 8
"""Pictures on their way to a client."""
ACK_SECONDS = 10.0
"""Time after which a picture without acknowledgement counts as lost."""
RATES, ROUND_TRIPS = 10, 50
"""Measurements of which the largest rate and the smallest round trip count."""
SLOW, FAST = 1 / 12, 1 / 20
"""Seconds a picture on the link: above the first, pictures get fewer bytes; below the second, more."""
GROWTH = 1.6
"""Bytes of an encoding by those of the next smaller one, until both are known."""


@dataclass(frozen=True)
class _Sent:
    number: int
    bytes: int
    time: float
    acknowledged_bytes: int
    """Bytes acknowledged when it was sent."""
    is_full: bool
    """Whether it filled the window: only then does the link limit the rate, and not the drawing."""


class FlowControl:
    """Pictures for one client; not thread-safe."""

    def __init__(self) -> None:
        self._newest: Picture | None = None
        self._on_way: deque[_Sent] = deque()
        self._acknowledged_bytes = 0
        self._rates: deque[float] = deque(maxlen=RATES)
        self._round_trips: deque[float] = deque(maxlen=ROUND_TRIPS)
        self._level = 0
        self._sizes: dict[int, int] = {}

    @property
    def has_newer(self) -> bool:
        """Whether a picture waits."""
        return self._newest is not None

    @property
    def window(self) -> int:
        """Largest number of pictures on their way."""
        if not self._rates or not self._sizes:
            return MIN_WINDOW
        held = max(self._rates) * min(self._round_trips) / max(self._sizes.get(self._level, 1), 1)
        return min(max(MIN_WINDOW, math.ceil(held) + 1), MAX_WINDOW)

    def offer(self, picture: Picture) -> None:
        """Let a picture wait in the place of an older one."""
        self._newest = picture

    def take(self, now: float) -> tuple[Picture, Encoding] | None:
        """Return the waiting picture and its encoding if the window has room for it."""
        while self._on_way and now - self._on_way[0].time > ACK_SECONDS:
            self._on_way.popleft()
        if self._newest is None or len(self._on_way) >= self.window:
            return None
        picture, self._newest = self._newest, None
        return picture, LOSSLESS if picture.still else LOSSY[self._level]

    def sent(self, picture: Picture, encoding: Encoding, size: int, now: float) -> None:
        """Count a picture of `size` bytes as on its way."""
        is_full = len(self._on_way) + 1 >= self.window
        self._on_way.append(_Sent(picture.number, size, now, self._acknowledged_bytes, is_full))
        if encoding in LOSSY:
            self._sizes[LOSSY.index(encoding)] = size

    def acknowledge(self, number: int, now: float) -> None:
        """Count a picture and all before it as arrived."""
        arrived: _Sent | None = None
        while self._on_way and self._on_way[0].number <= number:
            arrived = self._on_way.popleft()
            self._acknowledged_bytes += arrived.bytes
        if arrived is None:
            return
        seconds = max(now - arrived.time, 1e-4)
        self._round_trips.append(seconds)
        rate = (self._acknowledged_bytes - arrived.acknowledged_bytes) / seconds
        if arrived.is_full or rate > max(self._rates, default=0.0):
            self._rates.append(rate)
        if arrived.is_full:
            self._adapt()

    def _adapt(self) -> None:
        """Choose the encoding by the time that a picture takes on the link."""
        level, rate = self._level, max(self._rates)
        size = self._sizes.get(level)
        if size is None:
            return
        if size / rate > SLOW and level + 1 < len(LOSSY):
            self._level += 1
        elif level and self._sizes.get(level - 1, size * GROWTH) / rate < FAST:
            self._level -= 1
