"""Fit of the time model's constants to measured times.

All fits are Theil-Sen estimates: the slope is the median of the slopes between all pairs of points. Up to a quarter of
the times may be outliers, as on a shared machine.

Reference: P. K. Sen, "Estimates of the regression coefficient based on Kendall's tau", J. Am. Stat. Assoc. 63, 1968.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from statistics import median

from clusterviz.composite.model.communication import ImageStatistics
from clusterviz.composite.model.network import Network
from clusterviz.composite.model.prediction import Nodes, place_ranks, predict

# Up to this size the time of a message does not depend on its bytes.
SMALL_BYTES = 1 << 10


@dataclass(frozen=True)
class Link:
    """Cost of a message between two ranks."""

    latency_seconds: float  # α, time of a round without its message
    overhead_seconds: float  # o, time of each message
    seconds_per_byte: float  # β, time of each byte
    error: float  # median of |measured / predicted − 1| over all sizes
    worst_error: float  # largest |measured / predicted − 1|

    def seconds(self, messages: int, size: int) -> float:
        """Return the predicted time of a round of messages of `size` bytes in total."""
        return self.latency_seconds + messages * self.overhead_seconds + size * self.seconds_per_byte


def fit_line(points: Mapping[int, float]) -> tuple[float, float]:
    """Return intercept and slope, neither negative, of times by number (at least two)."""
    slope = max(0.0, median((points[b] - points[a]) / (b - a) for a, b in combinations(sorted(points), 2)))
    return max(0.0, median(value - slope * number for number, value in points.items())), slope


def fit_link(by_size: Mapping[int, float], by_count: Mapping[int, float], by_swap: Mapping[int, float]) -> Link:
    """Return the constants of a link.

    Parameters
    ----------
    by_size : seconds from sending a message until its arrival, by bytes; includes small messages
    by_count : seconds of sending several small messages at once, by their number
    by_swap : seconds of exchanging two large messages, by the bytes of one
    """
    _, per_byte = fit_line(by_swap)
    small = max(0.0, median(seconds - size * per_byte for size, seconds in by_size.items() if size <= SMALL_BYTES))
    _, overhead = fit_line(by_count)
    # A round of one message includes its overhead; if it takes no longer, there is no measurable latency.
    overhead = min(overhead, small)
    link = Link(small - overhead, overhead, per_byte, 0.0, 0.0)
    measured = {size: seconds for size, seconds in by_size.items() if size not in by_swap} | dict(by_swap)
    errors = [abs(seconds / max(link.seconds(1, size), 1e-12) - 1) for size, seconds in measured.items()]
    return replace(link, error=median(errors), worst_error=max(errors))


def fit_program(network: Network, nodes: Nodes, tiny: Mapping[int, float], pixels: int) -> Network:
    """Return the network with this program's cost of each frame and of each message.

    `tiny`: seconds of direct send by messages, by the number of ranks (the first ones) with an image; includes 1.
    `pixels`: pixels of each of these images, which all have the same rectangle.
    """

    def seconds(ranks: int, frame: float, message: float) -> float:
        stats = ImageStatistics(ranks, pixels, 1.0, 1.0, 4, True)
        costs = replace(network, frame_seconds=frame, message_seconds=message)
        return predict("direct-send", "messages", stats, place_ranks(tuple(range(ranks)), nodes), costs)

    # The model is linear in each of its constants.
    frame = tiny[1] / seconds(1, 1.0, 0.0)
    costs = [
        (measured - seconds(ranks, frame, 0.0)) / (seconds(ranks, frame, 1.0) - seconds(ranks, frame, 0.0))
        for ranks, measured in tiny.items()
        if ranks > 1
    ]
    return replace(network, frame_seconds=frame, message_seconds=max(0.0, median(costs)))
