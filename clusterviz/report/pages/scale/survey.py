"""All rank counts of a scene, one after another: the same work on more ranks, then more work with more ranks.

More work is a shorter step: on n ranks the n-th part of the scene's. Any scene can do it, the samples grow as the
ranks do, and everything else stays: the picture's size and so what is composited, the data, and the memory. A larger
picture would make compositing grow too, and would hide how much of a frame is lost to more ranks alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from clusterviz.errors import ClustervizError
from clusterviz.image.compare import Difference, compare
from clusterviz.report.pages.scale.measure import Image, Measured
from clusterviz.report.pages.scale.points import (
    DISTRIBUTIONS,
    STRONG,
    WEAK,
    Balance,
    Point,
    make_balance,
    make_point,
    with_efficiency,
)
from clusterviz.scene import Scene
from clusterviz.scene.settings import with_settings

TOLERANCE = 1e-5


@dataclass(frozen=True)
class FailedJob:
    """A rank count that gave nothing, and why."""

    scaling: str
    ranks: int
    reason: str


SORT_LAST_SETTINGS: dict[str, object] = {"mode": "sort-last", "groups": None, "tiling": "auto"}
"""Settings by which the ranks share the data, as those do whose distributions are compared."""


@dataclass(frozen=True)
class SurveyResult:
    """What was measured: points by rank count, what failed, and distributions over the frames of an orbit."""

    strong: tuple[Point, ...]
    weak: tuple[Point, ...]
    failed: tuple[FailedJob, ...]
    balance: tuple[Balance, ...] = ()

    @property
    def points(self) -> tuple[Point, ...]:
        """All of them; one that stands for both scalings once."""
        return (*self.strong, *(point for point in self.weak if point.scaling == WEAK and point.ranks > 1))


class Job(Protocol):
    """Draws a scene on so many ranks, and gives what it cost and the last picture; all frames of an orbit, if asked."""

    def __call__(self, scene: Scene, ranks: int, orbit: bool = False) -> tuple[Measured, Image]: ...


def steps_of(counts: Sequence[int], weak: bool, balance: bool) -> list[str]:
    """The names of what is done, in order."""
    orbits = [_orbit(name, max(counts)) for name in DISTRIBUTIONS] if balance and max(counts) > 1 else []
    return [*orbits, *(_step(scaling, ranks) for scaling, ranks in _jobs(counts, weak))]


def run_survey(
    scene: Scene, counts: Sequence[int], weak: bool, balance: bool, job: Job, progress: Callable[[str], None]
) -> SurveyResult:
    """Measure every rank count; one that fails takes no other along.

    Parameters
    ----------
    counts : of ranks, ascending
    weak : whether to measure weak scaling too
    balance : whether to compare distributions, on the largest count
    progress : told each of `steps_of` as it begins

    Raises
    ------
    ClustervizError
        Every count failed: the reason of the first.
    """
    points: dict[str, list[Point]] = {STRONG: [], WEAK: []}
    orbits, failed = _run_orbits(scene, max(counts), job, progress) if balance and max(counts) > 1 else ([], [])
    first: Image | None = None
    for scaling, ranks in _jobs(counts, weak):
        progress(_step(scaling, ranks))
        drawn = scene if scaling == STRONG else with_settings(scene, {"step": scene.quality.step / ranks})
        try:
            measured, picture = job(drawn, ranks)
        except ClustervizError as error:
            failed.append(FailedJob(scaling, ranks, str(error)))
            continue
        difference: Difference | None = None
        if scaling == STRONG:
            first = picture if first is None else first
            difference = compare(picture, first, TOLERANCE)
        points[scaling].append(make_point(scaling, measured, difference))
    if not points[STRONG] and not points[WEAK]:
        raise ClustervizError(failed[0].reason)
    if weak:
        # On one rank both are the same job.
        alone = [replace(point, scaling=WEAK, difference=None) for point in points[STRONG] if point.ranks == 1]
        points[WEAK] = [*alone, *points[WEAK]]
    strong, more = (tuple(with_efficiency(points[scaling])) for scaling in (STRONG, WEAK))
    return SurveyResult(strong, more, tuple(failed), tuple(orbits))


def _run_orbits(
    scene: Scene, ranks: int, job: Job, progress: Callable[[str], None]
) -> tuple[list[Balance], list[FailedJob]]:
    """One orbit by each distribution, and what failed."""
    found, failed = list[Balance](), list[FailedJob]()
    for name in DISTRIBUTIONS:
        progress(_orbit(name, ranks))
        try:
            measured, _ = job(with_settings(scene, SORT_LAST_SETTINGS | {"distribution": name}), ranks, orbit=True)
            found.append(make_balance(name, measured))
        except ClustervizError as error:
            failed.append(FailedJob(f"{name} distribution", ranks, str(error)))
    return found, failed


def _jobs(counts: Sequence[int], weak: bool) -> list[tuple[str, int]]:
    strong = [(STRONG, ranks) for ranks in counts]
    return [*strong, *((WEAK, ranks) for ranks in counts if ranks > 1)] if weak else strong


def _orbit(distribution: str, ranks: int) -> str:
    return f"{distribution} distribution, {ranks} ranks"


def _step(scaling: str, ranks: int) -> str:
    return f"{scaling} scaling, {ranks} rank{'s' * (ranks > 1)}"
