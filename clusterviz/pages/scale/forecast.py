"""Forecast of frame times on up to 65,536 ranks.

Compositing follows the time model (docs/concepts/time-model.md), which `auto` uses too, with the measured canvas and
the measured cover of a rank's image. One of n parts of a volume covers about n^(-2/3) of the canvas, as the bricks of a
cube do; the constant is that of the largest measured count.

Drawing is linear in the samples of the slowest rank, fitted to all ranks with a core or GPU of their own. The samples
are the scene's, divided by the number of ranks, times the measured imbalance. In opaque scenes the samples of all ranks
grow with their number, since a ray that ends early in one rank continues in those behind it; the measured growth is
included, and beyond the largest count the samples are constant. The forecast assumes that there are enough bricks for
all ranks, and that imbalance does not grow; the page states both.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import median

import numpy as np

from clusterviz.composite.model.choice import HANDICAPS
from clusterviz.composite.model.communication import ImageStatistics
from clusterviz.composite.model.fitting import fit_line
from clusterviz.composite.model.network import Network
from clusterviz.composite.model.prediction import Placement, predict
from clusterviz.composite.schedules.algorithms import candidates
from clusterviz.pages.scale.points import STRONG, Point
from clusterviz.scene import Cluster

MAX_RANKS = 65_536
COVER_EXPONENT = 2 / 3
"""Exponent of a brick's cover of the canvas."""
NEAR_OPTIMAL = 1.05
MIN_SAMPLE_RATIO = 4.0
"""Smallest ratio of samples of the fitted ranks for which a fixed time of each rank is estimated."""


@dataclass(frozen=True)
class Rates:
    """Measured inputs of a forecast.

    `draw_seconds`, `draw_seconds_per_sample`: linear model of a rank's drawing; the first is 0 if it cannot be
    estimated.
    """

    draw_seconds: float
    draw_seconds_per_sample: float
    readback_seconds_per_pixel: float  # seconds per pixel of a rank's image
    samples: dict[int, float]  # number of ranks -> samples of the scene on all ranks
    imbalance: float  # imbalance of the samples at the largest measured count
    images: ImageStatistics  # partial images at the largest measured count
    crowded: bool  # whether all measured counts were oversubscribed, so that drawing is overestimated


@dataclass(frozen=True)
class PredictedFrame:
    """Predicted frame: seconds of drawing and readback on the slowest rank, and of compositing."""

    ranks: int
    draw_seconds: float
    compositing_seconds: float
    algorithm: str
    transport: str

    @property
    def total_seconds(self) -> float:
        """Seconds of the frame."""
        return self.draw_seconds + self.compositing_seconds


@dataclass(frozen=True)
class Machine:
    """Machine of a forecast. `near`, `far`: network constants for jobs on one node, and on several."""

    near: Network
    far: Network
    ranks_per_node: int

    def network(self, ranks: int) -> Network:
        """Return the network constants for a number of ranks, each with a core of its own."""
        return replace(self.near if ranks <= self.ranks_per_node else self.far, cores=0)


def fit_rates(points: Sequence[Point]) -> Rates:
    """Fit the rates to at least one point; oversubscribed points are used only if there are no others."""
    own = [point for point in points if not point.crowded]
    asked = own or list(points)
    draws: dict[int, list[float]] = {}
    for point in asked:
        for samples, seconds in zip(point.samples, point.draw_seconds, strict=True):
            draws.setdefault(samples, []).append(seconds)
    times = {samples: min(seconds) for samples, seconds in draws.items() if samples}
    fixed, each = _line(times)
    largest = max((point for point in points if point.scaling == STRONG), key=lambda p: p.ranks, default=points[-1])
    readback = min(point.readback_seconds_per_pixel for point in asked)
    # Weak scaling on n ranks has n times the samples of the scene.
    scenes = {p.ranks: sum(p.samples) / (1 if p.scaling == STRONG else p.ranks) for p in reversed(points)}
    return Rates(fixed, each, readback, scenes, largest.imbalance_samples, largest.images, not own)


def _line(times: dict[int, float]) -> tuple[float, float]:
    """Fit fixed seconds and seconds per sample; the line passes through the origin if the samples differ too little."""
    if times and max(times) >= MIN_SAMPLE_RATIO * min(times):
        fixed, each = fit_line(times)
        if each > 0:
            return fixed, each
    return 0.0, median(seconds / samples for samples, seconds in times.items()) if times else 0.0


def forecast(
    rates: Rates, machine: Machine, cluster: Cluster, weak: bool, counts: Sequence[int]
) -> list[PredictedFrame]:
    """Predict frames of strong or weak scaling for numbers of ranks."""
    return [_expect(rates, machine, cluster, weak, ranks) for ranks in counts]


def rank_counts(most: int = MAX_RANKS) -> list[int]:
    """Return 1, 2, 4, … up to a largest number."""
    return [2**k for k in range(most.bit_length())]


def _expect(rates: Rates, machine: Machine, cluster: Cluster, weak: bool, ranks: int) -> PredictedFrame:
    images = _images(rates.images, ranks)
    known = sorted(rates.samples.items())
    scene = float(np.interp(math.log(ranks), [math.log(n) for n, _ in known], [samples for _, samples in known]))
    share = scene if weak else scene / ranks
    slowest = share * (rates.imbalance if ranks > 1 else 1.0)
    draw = rates.draw_seconds + rates.draw_seconds_per_sample * slowest
    readback = rates.readback_seconds_per_pixel * images.largest * images.pixels
    seconds, algorithm, transport = _compositing(images, machine, cluster, ranks)
    return PredictedFrame(ranks, draw + readback, seconds, algorithm, transport)


def _images(measured: ImageStatistics, ranks: int) -> ImageStatistics:
    """Return the partial images of a number of ranks; no image is smaller than a pixel."""
    before = max(measured.images, 1)
    shrunk = min(1.0, measured.cover * (before / ranks) ** COVER_EXPONENT) if ranks > 1 else 1.0
    cover = max(shrunk, 1 / max(measured.pixels, 1))
    largest = min(1.0, cover * measured.largest / measured.cover)
    return replace(measured, images=ranks, cover=cover, largest=max(cover, largest))


def _compositing(images: ImageStatistics, machine: Machine, cluster: Cluster, ranks: int) -> tuple[float, str, str]:
    """Return seconds, algorithm and transport of the fastest compositing that the scene allows, as for `auto`."""
    if ranks == 1:
        return machine.network(1).frame_seconds, "none", "none"
    nodes = math.ceil(ranks / machine.ranks_per_node)
    each = min(ranks, machine.ranks_per_node)
    places = Placement(nodes, each, nodes, each, ranks - (nodes - 1) * each, each, False)
    network = machine.network(ranks)
    ways = [
        (predict(algorithm, transport, images, places, network), algorithm, transport)
        for transport in _transports(cluster, nodes, each)
        for algorithm in _algorithms(cluster, transport, nodes if transport == "hierarchical" else ranks)
    ]
    return min(ways, key=lambda way: way[0] * HANDICAPS.get(way[1], 1.0))


def _algorithms(cluster: Cluster, transport: str, images: int) -> list[str]:
    """Return the candidate algorithms; in shared memory only direct send in place."""
    if transport == "shared":
        return ["direct-send"]
    return candidates(images) if cluster.compositing == "auto" else [cluster.compositing]


def _transports(cluster: Cluster, nodes: int, each: int) -> list[str]:
    """Return the possible transports that the scene allows; messages if there is none."""
    possible = ["messages"]
    if each > 1:
        possible.append("hierarchical" if nodes > 1 else "shared")
    if cluster.transport == "auto":
        return possible if cluster.compositing == "auto" or nodes > 1 else ["messages"]
    return [name for name in possible if name == cluster.transport] or ["messages"]


def crossover_ranks(expected: Sequence[PredictedFrame]) -> int | None:
    """Return the smallest number of ranks for which compositing takes longer than drawing; None if there is none."""
    return next((one.ranks for one in expected if one.compositing_seconds > one.draw_seconds), None)


def sufficient_ranks(expected: Sequence[PredictedFrame]) -> PredictedFrame:
    """Return the prediction with the fewest ranks that is within 5 % of the shortest frame."""
    least = min(one.total_seconds for one in expected)
    return next(one for one in expected if one.total_seconds <= NEAR_OPTIMAL * least)
