"""Survey of all rank counts of a scene: strong scaling, then weak scaling.

In weak scaling on n ranks the step is the scene's divided by n. That is possible for any scene, samples grow in
proportion to the ranks, and picture size, compositing, data and memory stay the same. A larger picture would increase
compositing too, and hide the losses by more ranks.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from clusterviz.errors import ClustervizError
from clusterviz.image.compare import Difference, compare
from clusterviz.pages.scale.measure import Image, Measured
from clusterviz.pages.scale.points import (
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
from clusterviz.scene.overrides import with_settings

TOLERANCE = 1e-5


@dataclass(frozen=True)
class FailedJob:
    """Job that failed, with the reason."""

    scaling: str
    ranks: int
    reason: str


SORT_LAST_SETTINGS: dict[str, object] = {"mode": "sort-last", "groups": None, "tiling": "auto"}
"""Settings of the jobs in which distributions are compared."""


@dataclass(frozen=True)
class SurveyResult:
    """Results of a survey: points by rank count, failed jobs, and distributions over an orbit."""

    strong: tuple[Point, ...]
    weak: tuple[Point, ...]
    failed: tuple[FailedJob, ...]
    balance: tuple[Balance, ...] = ()

    @property
    def points(self) -> tuple[Point, ...]:
        """All points; the point of one rank, which both scalings share, once."""
        return (*self.strong, *(point for point in self.weak if point.scaling == WEAK and point.ranks > 1))


class Job(Protocol):
    """Function that draws a scene on a number of ranks, optionally over an orbit; returns costs and last picture."""

    def __call__(self, scene: Scene, ranks: int, orbit: bool = False) -> tuple[Measured, Image]: ...


def steps_of(counts: Sequence[int], weak: bool, balance: bool) -> list[str]:
    """Return the names of the jobs in order."""
    orbits = [_orbit(name, max(counts)) for name in DISTRIBUTIONS] if balance and max(counts) > 1 else []
    return [*orbits, *(_step(scaling, ranks) for scaling, ranks in _jobs(counts, weak))]


def run_survey(
    scene: Scene, counts: Sequence[int], weak: bool, balance: bool, job: Job, progress: Callable[[str], None]
) -> SurveyResult:
    """Measure all rank counts; a failed job does not affect the others.

    Parameters
    ----------
    counts : numbers of ranks, ascending
    weak : whether to measure weak scaling
    balance : whether to compare distributions on the largest number of ranks
    progress : called with each of `steps_of` when it begins

    Raises
    ------
    ClustervizError
        All jobs failed; the reason is that of the first.
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
        # On one rank strong and weak scaling are the same job.
        alone = [replace(point, scaling=WEAK, difference=None) for point in points[STRONG] if point.ranks == 1]
        points[WEAK] = [*alone, *points[WEAK]]
    strong, more = (tuple(with_efficiency(points[scaling])) for scaling in (STRONG, WEAK))
    return SurveyResult(strong, more, tuple(failed), tuple(orbits))


def _run_orbits(
    scene: Scene, ranks: int, job: Job, progress: Callable[[str], None]
) -> tuple[list[Balance], list[FailedJob]]:
    """Measure an orbit with each distribution; return the results and the failed jobs."""
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
