"""Beyond the machine: how long a frame should take on up to 65,536 ranks.

Compositing is the time model's (docs/time-model.md), which `auto` chooses by too. What is put into it was measured: how
large the canvas is, and how much of it a rank's image covers. A rank's share of a volume of n parts covers about the
n^(-2/3)-th part of the canvas, as the bricks of a cube do; the constant is that of the largest measured count.

Drawing is a line in the samples of the slowest rank, fitted to all ranks that had a core or a GPU of their own. The
samples are the scene's, divided by the ranks, times the measured imbalance. Where something is opaque they grow with
the ranks, since a ray that ends in front goes on in the ranks behind; what was measured of that is in it, and beyond
the largest count they are taken to stay. So it is assumed that bricks are cut small enough for all ranks to have some,
and that balance gets no worse; both are said on the page.
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
from clusterviz.report.pages.scale.points import STRONG, Point
from clusterviz.scene import Cluster

MAX_RANKS = 65_536
COVER_EXPONENT = 2 / 3
"""The exponent of a brick's share of the screen."""
NEAR_OPTIMAL = 1.05
MIN_SAMPLE_RATIO = 4.0
"""Samples of the fitted ranks must differ so many times for a fixed time of each rank to be told from noise."""


@dataclass(frozen=True)
class Rates:
    """What of the measurements goes into a forecast.

    Attributes
    ----------
    draw_seconds, draw_seconds_per_sample : of a rank's drawing, a line; the first is 0 where it cannot be told
    readback_seconds_per_pixel : of a rank's image
    samples : of the scene, all ranks together, by number of ranks
    imbalance : of the samples, at the largest measured count
    images : what was composited there
    crowded : whether only ranks that take turns could be asked, so that drawing seems slower than it is
    """

    draw_seconds: float
    draw_seconds_per_sample: float
    readback_seconds_per_pixel: float
    samples: dict[int, float]
    imbalance: float
    images: ImageStatistics
    crowded: bool


@dataclass(frozen=True)
class PredictedFrame:
    """A frame on so many ranks: seconds of drawing and reading back on the slowest rank, and of compositing."""

    ranks: int
    draw_seconds: float
    compositing_seconds: float
    algorithm: str
    transport: str

    @property
    def total_seconds(self) -> float:
        """The frame."""
        return self.draw_seconds + self.compositing_seconds


@dataclass(frozen=True)
class Machine:
    """Where a forecast is for.

    Attributes
    ----------
    near, far : the network of a job on one node, and on several
    ranks_per_node : each with a core or a GPU of its own
    """

    near: Network
    far: Network
    ranks_per_node: int

    def network(self, ranks: int) -> Network:
        """The constants for a job of so many ranks, each with a core of its own."""
        return replace(self.near if ranks <= self.ranks_per_node else self.far, cores=0)


def fit_rates(points: Sequence[Point]) -> Rates:
    """The rates, of at least one point; those of ranks that take turns only where there are no others."""
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
    # Weak scaling draws the scene as often as there are ranks.
    scenes = {p.ranks: sum(p.samples) / (1 if p.scaling == STRONG else p.ranks) for p in reversed(points)}
    return Rates(fixed, each, readback, scenes, largest.imbalance_samples, largest.images, not own)


def _line(times: dict[int, float]) -> tuple[float, float]:
    """Seconds of nothing, and of a sample; through the origin where the samples are too much alike to tell both."""
    if times and max(times) >= MIN_SAMPLE_RATIO * min(times):
        fixed, each = fit_line(times)
        if each > 0:
            return fixed, each
    return 0.0, median(seconds / samples for samples, seconds in times.items()) if times else 0.0


def forecast(
    rates: Rates, machine: Machine, cluster: Cluster, weak: bool, counts: Sequence[int]
) -> list[PredictedFrame]:
    """What to expect for each number of ranks, of the strong scaling or of the weak one."""
    return [_expect(rates, machine, cluster, weak, ranks) for ranks in counts]


def rank_counts(most: int = MAX_RANKS) -> list[int]:
    """1, 2, 4, …"""
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
    """What so many ranks would composite; no image is smaller than a pixel."""
    before = max(measured.images, 1)
    shrunk = min(1.0, measured.cover * (before / ranks) ** COVER_EXPONENT) if ranks > 1 else 1.0
    cover = max(shrunk, 1 / max(measured.pixels, 1))
    largest = min(1.0, cover * measured.largest / measured.cover)
    return replace(measured, images=ranks, cover=cover, largest=max(cover, largest))


def _compositing(images: ImageStatistics, machine: Machine, cluster: Cluster, ranks: int) -> tuple[float, str, str]:
    """The fastest of what the scene allows, as `auto` would choose."""
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
    """What composites so many images; in shared memory it always is direct send, in place."""
    if transport == "shared":
        return ["direct-send"]
    return candidates(images) if cluster.compositing == "auto" else [cluster.compositing]


def _transports(cluster: Cluster, nodes: int, each: int) -> list[str]:
    """What is possible on so many nodes and wanted; a scene that wants what it cannot have gets messages."""
    possible = ["messages"]
    if each > 1:
        possible.append("hierarchical" if nodes > 1 else "shared")
    if cluster.transport == "auto":
        return possible if cluster.compositing == "auto" or nodes > 1 else ["messages"]
    return [name for name in possible if name == cluster.transport] or ["messages"]


def crossover_ranks(expected: Sequence[PredictedFrame]) -> int | None:
    """From how many ranks on compositing takes longer than drawing; None where it never does."""
    return next((one.ranks for one in expected if one.compositing_seconds > one.draw_seconds), None)


def sufficient_ranks(expected: Sequence[PredictedFrame]) -> PredictedFrame:
    """The fewest ranks whose frame is about as short as the shortest there is."""
    least = min(one.total_seconds for one in expected)
    return next(one for one in expected if one.total_seconds <= NEAR_OPTIMAL * least)
