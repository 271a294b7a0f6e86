"""Flow control of the pictures for one client: the newest picture only, and a window of those on their way.

A client acknowledges each picture that it has shown. At most a window of pictures is on its way without that: two, or
more where the round trip is long. The window follows the number of pictures that wait on the link, estimated from the
round trip by that of an empty link, as in TCP Vegas. Where the link takes too few pictures a second, moving ones get
fewer bytes.

Nothing here blocks or knows of sockets; the caller passes the time.

References
----------
L. Brakmo, S. O'Malley, L. Peterson: TCP Vegas: new techniques for congestion detection and avoidance, SIGCOMM 1994.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from clusterviz.viewer.encoding import LOSSLESS, LOSSY, Encoding, Picture

MIN_WINDOW, MAX_WINDOW = 2, 8
"""Pictures on their way to a client."""
FEW_WAITING, MANY_WAITING = 1.0, 2.0
"""Pictures waiting on the link: with fewer than the first a full window grows, with more than the second it shrinks."""
ACK_SECONDS = 10.0
"""Time after which a picture without acknowledgement counts as lost."""
SLOW, FAST = 1 / 12, 1 / 20
"""Seconds a picture on the link: above the first, pictures get fewer bytes; below the second, more."""
CALM = 50
"""Pictures in a row that did not wait, after which pictures get more bytes."""
GROWTH = 1.6
"""Bytes of a picture by those in the next smaller encoding, until both are known."""


@dataclass(frozen=True)
class _Sent:
    number: int
    encoding: Encoding
    bytes: int
    time: float
    on_way: int
    """Pictures on their way, with this one."""
    acknowledged_bytes: int
    """Of all pictures acknowledged before."""


class FlowControl:
    """Pictures for one client; not thread-safe."""

    def __init__(self) -> None:
        self._newest: Picture | None = None
        self._on_way: deque[_Sent] = deque()
        self._window = MIN_WINDOW
        self._acknowledged_bytes = 0
        self._shortest = math.inf
        self._level, self._calm = 0, 0
        self._sizes: dict[Encoding, int] = {}

    @property
    def has_newer(self) -> bool:
        """Whether a picture waits."""
        return self._newest is not None

    def offer(self, picture: Picture) -> None:
        """Let a picture wait, in the place of an older one."""
        self._newest = picture

    def take(self, now: float) -> tuple[Picture, Encoding] | None:
        """Return the waiting picture and its encoding if the window has room for it."""
        while self._on_way and now - self._on_way[0].time > ACK_SECONDS:
            self._on_way.popleft()
        if self._newest is None or len(self._on_way) >= self._window:
            return None
        picture, self._newest = self._newest, None
        return picture, LOSSLESS if picture.still else LOSSY[self._level]

    def sent(self, picture: Picture, encoding: Encoding, size: int, now: float) -> None:
        """Count a picture of `size` bytes as on its way."""
        on_way = len(self._on_way) + 1
        self._on_way.append(_Sent(picture.number, encoding, size, now, on_way, self._acknowledged_bytes))
        self._sizes[encoding] = size

    def acknowledge(self, number: int, now: float) -> None:
        """Count a picture and all before it as arrived."""
        arrived: _Sent | None = None
        while self._on_way and self._on_way[0].number <= number:
            arrived = self._on_way.popleft()
            self._acknowledged_bytes += arrived.bytes
        if arrived is None or arrived.encoding is LOSSLESS:
            return
        seconds = max(now - arrived.time, 1e-4)
        self._shortest = min(self._shortest, seconds)
        waiting = arrived.on_way * (1 - self._shortest / seconds)
        if waiting > MANY_WAITING:
            self._window = max(self._window - 1, MIN_WINDOW)
        elif waiting < FEW_WAITING and arrived.on_way >= self._window:
            self._window = min(self._window + 1, MAX_WINDOW)
        if arrived.encoding is LOSSY[self._level]:
            self._adapt(waiting >= FEW_WAITING, (self._acknowledged_bytes - arrived.acknowledged_bytes) / seconds)

    def _adapt(self, is_limiting: bool, rate: float) -> None:
        """Choose the encoding by whether the link limits the pictures a second, and by its bytes a second."""
        self._calm = 0 if is_limiting else self._calm + 1
        size = self._sizes[LOSSY[self._level]]
        larger = self._sizes.get(LOSSY[self._level - 1], size * GROWTH)
        if is_limiting and size / rate > SLOW and self._level + 1 < len(LOSSY):
            self._level += 1
        elif self._level and (self._calm > CALM or (is_limiting and larger / rate < FAST)):
            self._level, self._calm = self._level - 1, 0
