"""Points of scaling curves: times, efficiency, imbalance, messages, memory and picture of one rank count.

The expected numbers are those of `clusterviz simulate` for the rectangles that the ranks drew. The simulation evaluates
the schedule with whole arrays, independently of the compositor, which runs it rank by rank.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise, zip_longest
from statistics import median
from typing import Any

from clusterviz.composite.fragment import Patch
from clusterviz.composite.model.communication import ImageStatistics
from clusterviz.composite.schedules.algorithms import make_schedule
from clusterviz.composite.schedules.rectangles import Rectangles
from clusterviz.composite.simulation.loads import count_sparse
from clusterviz.composite.simulation.simulate import Options, count_load
from clusterviz.image.compare import Difference
from clusterviz.image.partial import Rect, bounding_rect
from clusterviz.pages.scale.measure import Measured, RankResources
from clusterviz.report.statistics import FrameStatistics, RankFrame


@dataclass(frozen=True)
class Round:
    """One round of all ranks, without the final gather.

    `messages`, `bytes`: counted by the compositor, for raw pixels. `messages_theory`, `bytes_theory`: according to the
    schedule, for the rectangles of the ranks' images.
    """

    messages: int
    messages_theory: int
    bytes: int
    bytes_theory: int

    @property
    def agrees(self) -> bool:
        """Whether the counts equal the expected numbers."""
        return (self.messages, self.bytes) == (self.messages_theory, self.bytes_theory)


def count_rounds(measured: Measured) -> tuple[Round, ...]:
    """Return the rounds of the counted frame; empty for one rank, or for several images of a rank."""
    drawn = [(rank, Rect(*measured.rects[rank])) for rank in measured.order]
    drawn = [(rank, rect) for rank, rect in drawn if rect.pixels]
    if not measured.algorithm or len(drawn) < 2:
        return ()
    theory = _theory(measured.algorithm, [rect for _, rect in drawn])
    ran = [[sum(column) for column in zip(*stage, strict=True)] for stage in _by_stage(measured.counted)]
    size = measured.bytes_per_pixel
    rows = zip_longest(ran, theory, fillvalue=(0, 0))
    return tuple(Round(m, expected, p * size, pixels * size) for (m, p), (expected, pixels) in rows)


def dense_bytes(measured: Measured) -> int:
    """Return the bytes that the algorithm would send if every image covered the canvas, an upper bound."""
    drawn = [Rect(*rect) for rect in measured.rects if Rect(*rect).pixels]
    if not measured.algorithm or len(drawn) < 2:
        return 0
    canvas = bounding_rect(drawn)
    load, _ = count_load(measured.algorithm, len(drawn), (canvas.width, canvas.height), "dense", Options())
    return int(load.pixels_sent.sum()) * measured.bytes_per_pixel


def _by_stage(counted: Sequence[Sequence[tuple[int, int]]]) -> list[tuple[tuple[int, int], ...]]:
    """Return the counts by stage, then rank; ranks without pixels take part in no stage."""
    return list(zip_longest(*counted, fillvalue=(0, 0)))


def _theory(algorithm: str, rects: Sequence[Rect]) -> list[tuple[int, int]]:
    """Return messages and pixels of each stage, for images from front to back."""
    canvas = bounding_rect(rects)
    x, y = canvas.x_begin, canvas.y_begin
    shifted = [Rect(r.x_begin - x, r.y_begin - y, r.x_end - x, r.y_end - y) for r in rects]
    patches = [Patch(canvas.width, 0, canvas.pixels, rect) for rect in shifted]
    schedule = make_schedule(algorithm, len(patches), canvas.pixels, patches, range(len(patches)))
    footprints = Rectangles.of_patches(patches)
    # Cumulative counts after each stage; a stage's counts are the differences.
    sums = [(0, 0)]
    for count in range(1, len(schedule.stages) + 1):
        load = count_sparse(replace(schedule, stages=schedule.stages[:count]), footprints)
        sums.append((int(load.messages_sent.sum()), int(load.pixels_sent.sum())))
    return [(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(sums)]


STRONG, WEAK = "strong", "weak"
COMPOSITING = ("encode", "exchange", "blend", "collect")
DISTRIBUTIONS = ("coherent", "dynamic")
"""Distributions compared: without and with load balancing."""
FRAMES, DEGREES = 12, 90.0
"""Number of frames and angle of the orbit, which begins at the scene's camera."""


@dataclass(frozen=True)
class Point:
    """Results of one rank count; seconds are those of the slowest rank in the median frame.

    Attributes
    ----------
    seconds : stage -> seconds; `plan`, `load`, `context`, `shaders` and `finish` once a job, the others once a frame
    total_seconds, total_seconds_min, total_seconds_max : median, minimum and maximum of a frame, from a barrier until
        the picture is complete
    compositing_seconds, predicted_seconds : measured on the slowest rank, and predicted by the time model; 0 without
        compositing
    counted_algorithm, rounds, bytes_dense : results of one frame with messages; see `rounds`
    """

    scaling: str  # "strong" or "weak"
    ranks: int
    nodes: int
    step: float  # step in voxels
    crowded: str  # oversubscribed cores or GPUs in words, for which times do not show scaling; "" if there are none
    seconds: dict[str, float]
    total_seconds: float
    total_seconds_min: float
    total_seconds_max: float
    render_mean_seconds: float  # seconds of drawing, mean of the ranks
    cpu_seconds: float  # CPU seconds of a frame, all ranks and threads
    compositing_seconds: float
    predicted_seconds: float
    efficiency: float | None  # parallel efficiency relative to the smallest count; None if either is oversubscribed
    imbalance: tuple[float, ...]  # largest over mean seconds of drawing, by frame
    samples: tuple[int, ...]  # field samples of a frame, by rank
    draw_seconds: tuple[float, ...]  # seconds of drawing by rank, the minimum over frames
    sharing: str  # mode: sort-last, sort-first or hybrid
    algorithm: str
    transport: str
    codec: str
    counted_algorithm: str
    rounds: tuple[Round, ...]
    bytes_dense: int
    bricks: tuple[int, ...]
    voxel_bytes: tuple[int, ...]
    peak_memory_bytes: tuple[int, ...]
    images: ImageStatistics
    readback_seconds_per_pixel: float  # seconds per pixel of the slowest rank
    renderer: str
    software: bool  # whether all ranks drew on the CPU
    difference: Difference | None  # difference from the picture of the first rank count; None for weak scaling

    @property
    def imbalance_samples(self) -> float:
        """Largest over mean number of samples, which other programs do not disturb."""
        return max(self.samples) * len(self.samples) / sum(self.samples) if sum(self.samples) else 1.0

    @property
    def render_seconds(self) -> float:
        """Seconds of drawing on the slowest rank."""
        return self.seconds["render"]


def make_point(scaling: str, measured: Measured, difference: Difference | None) -> Point:
    """Return the point of one job, without efficiency; see `with_efficiency`."""
    frames = [FrameStatistics(tuple(ranks)) for ranks in measured.frames]
    names = dict.fromkeys(name for frame in frames for name in frame.seconds)
    seconds = {name: median(frame.seconds.get(name, 0.0) for frame in frames) for name in names}
    totals = [frame.seconds["total"] for frame in frames]
    once = {name: max(rank[name] for rank in measured.once) for name in measured.once[0]}
    cpu, last = seconds.pop("cpu"), measured.frames[-1]
    stages = seconds | once | {"finish": measured.finish_seconds}
    del stages["total"]
    rects = [Rect(*rect) for rect in measured.rects]
    pixels = max((rect.pixels for rect in rects), default=0)
    return Point(
        scaling=scaling,
        ranks=len(last),
        nodes=len({one.host for one in measured.resources}),
        step=measured.step,
        crowded=oversubscription(measured.resources),
        seconds=stages,
        total_seconds=median(totals),
        total_seconds_min=min(totals),
        total_seconds_max=max(totals),
        render_mean_seconds=median(_of_ranks(measured, "render", lambda each: sum(each) / len(each))),
        cpu_seconds=median(_of_ranks(measured, "cpu", sum)) if cpu else 0.0,
        compositing_seconds=median(max(map(_compositing, ranks)) for ranks in measured.frames),
        predicted_seconds=float(last[0].compositing.get("seconds_predicted", 0.0)),
        efficiency=None,
        imbalance=tuple(frame.imbalance for frame in frames),
        samples=tuple(rank.samples for rank in last),
        draw_seconds=tuple(min(frame[i].seconds["render"] for frame in measured.frames) for i in range(len(last))),
        sharing=measured.sharing,
        algorithm=last[0].compositing.get("algorithm", "gather"),
        transport=last[0].compositing.get("transport", "messages"),
        codec=last[0].compositing.get("codec", "raw"),
        counted_algorithm=measured.algorithm,
        rounds=count_rounds(measured),
        bytes_dense=dense_bytes(measured),
        bricks=tuple(rank.bricks for rank in last),
        voxel_bytes=tuple(rank.voxel_bytes for rank in last),
        peak_memory_bytes=tuple(rank.peak_memory_bytes for rank in last),
        images=_images(measured, rects),
        readback_seconds_per_pixel=seconds["readback"] / pixels if pixels else 0.0,
        renderer=next((rank.renderer for rank in last if rank.renderer), ""),
        software=all(one.gpu is None for one in measured.resources),
        difference=difference,
    )


def with_efficiency(points: Sequence[Point]) -> list[Point]:
    """Return points with their efficiency relative to the smallest count that is not oversubscribed."""
    base = next((point for point in sorted(points, key=lambda point: point.ranks) if not point.crowded), None)
    return [point if base is None or point.crowded else _with_efficiency_of(point, base) for point in points]


def oversubscription(resources: Sequence[RankResources]) -> str:
    """Return the oversubscribed cores or GPUs of a job in words; "" if each rank has its own."""
    for host in dict.fromkeys(one.host for one in resources):
        here = [one for one in resources if one.host == host]
        cores = len({core for one in here for core in one.cores})
        if len(here) > cores:
            return f"{len(here)} ranks on {cores} core{'s' * (cores > 1)}"
        gpus = Counter(one.gpu for one in here if one.gpu is not None)
        if gpus and max(gpus.values()) > 1:
            return f"{sum(gpus.values())} ranks on {len(gpus)} GPU{'s' * (len(gpus) > 1)}"
    return ""


def _with_efficiency_of(point: Point, base: Point) -> Point:
    """Return a point with its efficiency: ideally ranks · seconds (strong) or seconds (weak) are constant."""
    more = base.ranks / point.ranks if point.scaling == STRONG else 1.0
    return replace(point, efficiency=base.total_seconds * more / point.total_seconds)


def _compositing(rank: RankFrame) -> float:
    return sum(rank.seconds[stage] for stage in COMPOSITING)


def _of_ranks(measured: Measured, stage: str, reduce: Callable[[list[float]], float]) -> list[float]:
    """Reduce the seconds of a stage over ranks, for each frame."""
    return [reduce([rank.seconds[stage] for rank in frame]) for frame in measured.frames]


def _images(measured: Measured, rects: Sequence[Rect]) -> ImageStatistics:
    drawn = [rect.pixels for rect in rects if rect.pixels]
    pixels = bounding_rect(rects).pixels
    if not drawn:
        return ImageStatistics(0, 0, 1.0, 1.0, measured.bytes_per_pixel, True)
    front = next(rank for rank in measured.order if rects[rank].pixels)
    cover = sum(drawn) / len(drawn) / pixels
    return ImageStatistics(len(drawn), pixels, cover, max(drawn) / pixels, measured.bytes_per_pixel, front == 0)


def as_json(point: Point) -> dict[str, Any]:
    """Return a point's entry in scale.json."""
    found = asdict(point) | {"imbalance_samples": point.imbalance_samples}
    for one, values in zip(point.rounds, found["rounds"], strict=True):
        values["agrees"] = one.agrees
    return found


@dataclass(frozen=True)
class Balance:
    """Imbalance of one distribution over an orbit; lists are by frame."""

    distribution: str
    ranks: int
    imbalance: tuple[float, ...]  # largest over mean seconds of drawing
    imbalance_samples: tuple[float, ...]  # largest over mean number of samples, which other programs do not disturb
    busiest_samples: tuple[int, ...]  # largest number of samples of a rank

    def rows(self) -> list[Mapping[str, Any]]:
        """Return a line of the CSV file for each frame."""
        columns = zip(self.imbalance, self.imbalance_samples, self.busiest_samples, strict=True)
        names = ("imbalance", "imbalance_samples", "busiest_samples")
        about = {"distribution": self.distribution, "ranks": self.ranks}
        return [
            about | {"frame": number} | dict(zip(names, numbers, strict=True)) for number, numbers in enumerate(columns)
        ]


def make_balance(distribution: str, measured: Measured) -> Balance:
    """Return the imbalance in the job of one distribution."""
    samples = [[rank.samples for rank in frame] for frame in measured.frames]
    even = [max(each) * len(each) / sum(each) if sum(each) else 1.0 for each in samples]
    times = tuple(FrameStatistics(tuple(frame)).imbalance for frame in measured.frames)
    return Balance(distribution, len(samples[0]), times, tuple(even), tuple(map(max, samples)))
