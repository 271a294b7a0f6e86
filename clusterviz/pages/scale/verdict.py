"""Conclusions of the scaling report, in sentences; the first names the bottleneck."""

from __future__ import annotations

from collections.abc import Sequence

from clusterviz.pages.scale.forecast import PredictedFrame, crossover_ranks, sufficient_ranks
from clusterviz.pages.scale.points import COMPOSITING, STRONG, Balance, Point
from clusterviz.pages.scale.survey import TOLERANCE, SurveyResult

MIN_CORE_SHARE = 0.8
"""Ranks that got less than this share of a core each were disturbed by other programs."""
MIN_LOSS = 0.05
"""Losses below this share of a frame are not mentioned."""


def verdict(found: SurveyResult, expected: Sequence[PredictedFrame], network: str) -> list[str]:
    """Return the sentences at the top of the page. `expected`: forecast of strong scaling."""
    points = found.strong or found.weak
    own = [point for point in points if not point.crowded]
    judged = max(own or points, key=lambda point: point.ranks)
    base = min(own or points, key=lambda point: point.ranks)
    sentences = [
        _bottleneck(judged, base),
        *_busy(own, judged, base),
        *_crowded(points, judged),
        *_balance(found.balance),
        *_beyond(expected, network),
        _pictures(found),
    ]
    if found.failed:
        sentences.append(
            "Not measured: " + ", ".join(f"{one.ranks} ranks ({one.scaling})" for one in found.failed) + "."
        )
    return sentences


def _bottleneck(point: Point, base: Point) -> str:
    """Return a sentence on the largest part of a frame, and on the main loss of efficiency."""
    parts = _parts(point)
    name = max(parts, key=lambda part: parts[part])
    share = parts[name] / point.total_seconds
    where = f"on {_ranks(point)}" + (" that take turns" if point.crowded else "")
    head = f"The bottleneck is {name}: {share:.0%} of a frame of {_milliseconds(point.total_seconds)} {where}"
    if point.efficiency is None or point.ranks == base.ranks:
        return head + "."
    tail = f"; parallel efficiency is {point.efficiency:.0%}"
    if point.efficiency > 1 + MIN_LOSS:
        return f"{head}{tail}: something slowed down the frames of {_ranks(base)}."
    losses = _losses(point, base)
    cause = max(losses, key=lambda loss: losses[loss])
    if losses[cause] > MIN_LOSS * point.total_seconds:
        tail += f", lost mostly to {cause} ({_milliseconds(losses[cause])} a frame)"
    return head + tail + "."


def _parts(point: Point) -> dict[str, float]:
    """Return the seconds of a frame by cause; imbalance is that of samples, which other programs do not disturb."""
    compositing = sum(point.seconds[stage] for stage in COMPOSITING)
    uneven = point.render_seconds * (1 - 1 / point.imbalance_samples)
    parts = {
        "drawing": point.render_seconds - uneven,
        "imbalance": uneven,
        "reading back": point.seconds["readback"],
        "compositing": min(compositing, point.total_seconds),
    }
    return parts | {"waiting for each other": max(0.0, point.total_seconds - sum(parts.values()))}


def _losses(point: Point, base: Point) -> dict[str, float]:
    """Return the seconds of a frame beyond ideal scaling, by cause."""
    more = point.ranks / base.ranks if point.scaling == STRONG else 1.0
    parts, before = _parts(point), _parts(base)
    samples = sum(base.samples) * (1.0 if point.scaling == STRONG else point.ranks / base.ranks)
    hidden = point.render_mean_seconds * max(0.0, 1 - samples / max(sum(point.samples), 1))
    slower = (
        "drawing that is slower in parts" if _share(point) >= MIN_CORE_SHARE else "drawing that other programs slowed"
    )
    return {
        "imbalance": point.render_seconds - point.render_mean_seconds,
        "samples behind what another rank shows opaque": hidden,
        slower: point.render_mean_seconds - hidden - base.render_mean_seconds / more,
        "reading back": parts["reading back"] - before["reading back"] / more,
        "compositing": parts["compositing"],
        "waiting": parts["waiting for each other"],
    }


def _share(point: Point) -> float:
    """Return the share of a core that each rank got while drawing, at most 1; 1 for GPUs."""
    drawn = point.ranks * point.render_mean_seconds
    return min(1.0, point.cpu_seconds / drawn) if point.software and drawn else 1.0


def _busy(points: Sequence[Point], judged: Point, base: Point) -> list[str]:
    """Return a sentence if other programs used the cores: software rendering keeps a core busy if it gets one."""
    least = min(map(_share, points), default=1.0)
    if least >= MIN_CORE_SHARE:
        return []
    said = f"Other programs were busy: the ranks got as little as {least:.0%} of a core each, so times are too long"
    if judged.ranks == base.ranks:
        return [said + "."]
    more = 1.0 if judged.scaling == STRONG else judged.ranks / base.ranks
    efficiency = base.cpu_seconds * more / judged.cpu_seconds
    return [f"{said}; by CPU time, which they do not lengthen, efficiency is {efficiency:.0%}."]


def _crowded(points: Sequence[Point], judged: Point) -> list[str]:
    """Return a sentence on oversubscribed rank counts."""
    crowded = [point for point in points if point.crowded]
    if not crowded:
        return []
    if judged.crowded:
        return [f"Every count is oversubscribed ({judged.crowded}): these times give no efficiency."]
    which = ", ".join(f"{_ranks(point)} ({point.crowded})" for point in crowded)
    return [f"Oversubscribed, and not used for efficiency: {which}."]


def _balance(balance: Sequence[Balance]) -> list[str]:
    """Return a sentence on the imbalance of the distributions at the end of an orbit."""
    values = " and ".join(f"{one.imbalance_samples[-1]:.2f} ({one.distribution})" for one in balance)
    if not values:
        return []
    ranks, frames = balance[0].ranks, len(balance[0].imbalance_samples)
    return [
        f"After {frames} frames of an orbit, the busiest of {ranks} ranks takes this multiple of the mean samples: "
        f"{values}."
    ]


def _beyond(expected: Sequence[PredictedFrame], network: str) -> list[str]:
    """Return a sentence on the forecast: where compositing exceeds drawing, and how many ranks suffice."""
    over, best = crossover_ranks(expected), sufficient_ranks(expected)
    last = expected[-1].ranks
    overtaken = f"compositing takes longer than drawing from {over:,} ranks on" if over else ""
    if not overtaken:
        overtaken = f"drawing takes longer than compositing up to {last:,} ranks"
    end = f", and more than {best.ranks:,} ranks make a frame hardly faster ({_milliseconds(best.total_seconds)})"
    return [f"By the time model on {network}, {overtaken}{end if best.ranks < last else ''}."]


def _pictures(found: SurveyResult) -> str:
    compared = [point for point in found.strong if point.difference]
    if len(compared) < 2:
        return "One rank count only: no pictures to compare."
    largest = max(point.difference.max for point in compared if point.difference)
    wrong = [point for point in compared if point.difference and point.difference.count]
    if wrong:
        return (
            f"THE PICTURES DISAGREE: by up to {largest:.1e} ({', '.join(map(_ranks, wrong))}); see clusterviz verify."
        )
    same = "are identical" if largest == 0 else f"differ by at most {largest:.1e} (allowed {TOLERANCE:.0e})"
    return f"The pictures of all rank counts {same}."


def _ranks(point: Point) -> str:
    return f"{point.ranks:,} rank{'s' * (point.ranks > 1)}"


def _milliseconds(seconds: float) -> str:
    return f"{1e3 * seconds:.3g} ms" if seconds < 1 else f"{seconds:.3g} s"
