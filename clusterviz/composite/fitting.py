"""From measured times to the constants of the time model.

All fits are Theil and Sen's: the slope is the median of the slopes between all pairs of points. Up to a quarter of the
times may be wrong by any amount, as they are on machines where others work, and the constants stay.

References
----------
P. K. Sen, "Estimates of the regression coefficient based on Kendall's tau", J. Am. Stat. Assoc. 63, 1968.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from statistics import median

# From here on a message's time is that of its bytes; below the other limit, that of being a message.
LARGE_BYTES = 1 << 16
SMALL_BYTES = 1 << 10


@dataclass(frozen=True)
class Link:
    """What a message between two ranks costs.

    Attributes
    ----------
    latency_seconds : α, of a round; the one message in it not counted
    overhead_seconds : o, of each message
    seconds_per_byte : β
    error : the median of |measured / predicted − 1| over all sizes
    worst_error : the largest of those
    """

    latency_seconds: float
    overhead_seconds: float
    seconds_per_byte: float
    error: float
    worst_error: float

    def seconds(self, messages: int, size: int) -> float:
        """The time predicted for a round of messages, all sizes together."""
        return self.latency_seconds + messages * self.overhead_seconds + size * self.seconds_per_byte


def fit_line(points: Mapping[int, float]) -> tuple[float, float]:
    """Intercept and slope of times by number, at least two; neither is negative."""
    slope = max(0.0, median((points[b] - points[a]) / (b - a) for a, b in combinations(sorted(points), 2)))
    return max(0.0, median(value - slope * number for number, value in points.items())), slope


def fit_link(by_size: Mapping[int, float], by_count: Mapping[int, float]) -> Link:
    """The constants of a link.

    Parameters
    ----------
    by_size : seconds from sending a message until it is there, by its bytes; small ones and large ones among them
    by_count : seconds of sending so many small messages at once, by their number
    """
    _, per_byte = fit_line({size: seconds for size, seconds in by_size.items() if size >= LARGE_BYTES})
    small = median(seconds - size * per_byte for size, seconds in by_size.items() if size <= SMALL_BYTES)
    _, overhead = fit_line(by_count)
    # A round of one message has its overhead in it. What is no longer than that has no latency that could be seen.
    overhead = min(overhead, max(small, 0.0))
    link = Link(max(small, 0.0) - overhead, overhead, per_byte, 0.0, 0.0)
    errors = [abs(seconds / max(link.seconds(1, size), 1e-12) - 1) for size, seconds in by_size.items()]
    return Link(link.latency_seconds, overhead, per_byte, median(errors), max(errors))
