"""How even a distribution leaves the ranks over the frames of an orbit: with bricks that stay, and that move."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from clusterviz.report.pages.scale.measure import Measured
from clusterviz.report.statistics import FrameStatistics

DISTRIBUTIONS = ("coherent", "dynamic")
"""Compared: balance off, and on."""
FRAMES, DEGREES = 12, 90.0
"""Of the orbit, which begins at the scene's camera."""


@dataclass(frozen=True)
class Balance:
    """One distribution; lists by frame, the first one included.

    Attributes
    ----------
    distribution, ranks : which, on how many
    imbalance : largest over mean seconds of drawing
    imbalance_samples : largest over mean number of samples, which no other program disturbs
    busiest_samples : of the rank that took most
    """

    distribution: str
    ranks: int
    imbalance: tuple[float, ...]
    imbalance_samples: tuple[float, ...]
    busiest_samples: tuple[int, ...]

    def rows(self) -> list[Mapping[str, Any]]:
        """A line of the CSV for each frame."""
        columns = zip(self.imbalance, self.imbalance_samples, self.busiest_samples, strict=True)
        names = ("imbalance", "imbalance_samples", "busiest_samples")
        about = {"distribution": self.distribution, "ranks": self.ranks}
        return [
            about | {"frame": number} | dict(zip(names, numbers, strict=True)) for number, numbers in enumerate(columns)
        ]


def make_balance(distribution: str, measured: Measured) -> Balance:
    """What the job of one distribution says."""
    samples = [[rank.samples for rank in frame] for frame in measured.frames]
    even = [max(each) * len(each) / sum(each) if sum(each) else 1.0 for each in samples]
    times = tuple(FrameStatistics(tuple(frame)).imbalance for frame in measured.frames)
    return Balance(distribution, len(samples[0]), times, tuple(even), tuple(map(max, samples)))
