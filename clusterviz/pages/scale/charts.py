"""Charts of the scaling report as SVG; hollow marks are oversubscribed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from clusterviz.pages.output import make_figure, svg_of
from clusterviz.pages.scale.forecast import PredictedFrame
from clusterviz.pages.scale.points import Balance, Point
from clusterviz.pages.scale.survey import SurveyResult

# Okabe and Ito's colours, distinguishable with colour vision deficiencies.
STRONG_COLOUR, WEAK_COLOUR, IDEAL = "#0072B2", "#D55E00", "#999999"
STAGE_COLOURS = {
    "render": "#0072B2",
    "readback": "#56B4E9",
    "encode": "#F0E442",
    "exchange": "#E69F00",
    "blend": "#D55E00",
    "collect": "#CC79A7",
    "other": "#CCCCCC",
}
"""Colours of the stages of a frame; stages done once a job are only in the table."""


def frame_chart(found: SurveyResult) -> str:
    """Return a chart of frame time and efficiency over ranks, as SVG."""
    figure = make_figure(9.5, 3.6)
    left, right = figure.subplots(1, 2)
    for points, colour, name in ((found.strong, STRONG_COLOUR, "strong"), (found.weak, WEAK_COLOUR, "weak")):
        if points:
            _line(left, points, [1e3 * point.total_seconds for point in points], colour, f"{name} scaling")
            _ideal(left, points)
            rated = [point for point in points if point.efficiency is not None]
            _line(right, rated, [100 * (point.efficiency or 0.0) for point in rated], colour, f"{name} scaling")
    left.set(xlabel="ranks", ylabel="a frame [ms]", xscale="log", yscale="log")
    right.set(xlabel="ranks", ylabel="parallel efficiency [%]", xscale="log")
    right.axhline(100, color=IDEAL, linewidth=1, linestyle="--")
    right.set_ylim(0, max(110, right.get_ylim()[1]))
    counts = sorted({point.ranks for point in (*found.strong, *found.weak)})
    for axes in (left, right):
        _count_ticks(axes, counts)
        _plain(axes)
    _plain_values(left)
    handles, labels = left.get_legend_handles_labels()
    known = dict(zip(labels, handles, strict=True))
    figure.legend(known.values(), known.keys(), loc="outside upper center", ncols=3, frameon=False)
    return svg_of(figure)


def stage_chart(found: SurveyResult) -> str:
    """Return a chart of the stages of a frame, one bar a point, as SVG."""
    groups = [(name, points) for name, points in (("strong", found.strong), ("weak", found.weak)) if points]
    figure = make_figure(9.5, 0.9 + 0.34 * max(len(points) for _, points in groups))
    row = figure.subplots(1, len(groups), squeeze=False)[0]
    for axes, (name, points) in zip(row, groups, strict=True):
        starts = [0.0] * len(points)
        places = list(range(len(points)))
        for stage, colour in STAGE_COLOURS.items():
            widths = [1e3 * _stage(point, stage) for point in points]
            axes.barh(places, widths, left=starts, color=colour, label=stage, height=0.7)
            starts = [start + width for start, width in zip(starts, widths, strict=True)]
        labels = [f"{point.ranks}{'*' * bool(point.crowded)}" for point in points]
        axes.set(yticks=places, yticklabels=labels, ylabel="ranks", xlabel=f"{name} scaling: a frame [ms]")
        axes.invert_yaxis()
        _plain(axes)
        axes.grid(False, axis="y")
    handles, labels = row[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), frameon=False)
    return svg_of(figure)


def balance_chart(found: SurveyResult) -> str:
    """Return a chart of imbalance and memory over ranks, as SVG."""
    figure = make_figure(9.5, 3.3)
    left, right = figure.subplots(1, 2)
    for points, colour, name in ((found.strong, STRONG_COLOUR, "strong"), (found.weak, WEAK_COLOUR, "weak")):
        if not points:
            continue
        _line(left, points, [point.imbalance_samples for point in points], colour, f"{name}: samples")
        for point in points:
            left.plot([point.ranks] * 2, [min(point.imbalance), max(point.imbalance)], color=colour, alpha=0.35, lw=4)
        _line(right, points, [max(point.peak_memory_bytes) / 2**20 for point in points], colour, f"{name} scaling")
    left.set(xlabel="ranks", ylabel="largest over mean", xscale="log")
    left.axhline(1, color=IDEAL, linewidth=1, linestyle="--")
    right.set(xlabel="ranks", ylabel="largest rank's memory [MiB]", xscale="log")
    right.set_ylim(bottom=0)
    counts = sorted({point.ranks for point in (*found.strong, *found.weak)})
    for axes in (left, right):
        _count_ticks(axes, counts)
        _plain(axes)
        axes.legend(frameon=False)
    return svg_of(figure)


def orbit_chart(balance: Sequence[Balance]) -> str:
    """Return a chart of imbalance over the frames of an orbit, one colour a distribution, as SVG."""
    figure = make_figure(9.5, 3.3)
    axes = figure.subplots()
    for one, colour in zip(balance, (STRONG_COLOUR, WEAK_COLOUR), strict=False):
        frames = range(len(one.imbalance_samples))
        axes.plot(frames, one.imbalance_samples, "o-", color=colour, lw=1.6, ms=4, label=f"{one.distribution}: samples")
        axes.plot(frames, one.imbalance, color=colour, lw=0.8, alpha=0.5, label=f"{one.distribution}: drawing times")
    axes.axhline(1, color=IDEAL, linewidth=1, linestyle="--")
    axes.set(xlabel="frame", ylabel="largest over mean")
    _plain(axes)
    axes.legend(frameon=False, ncols=2)
    return svg_of(figure)


def forecast_chart(
    found: SurveyResult,
    strong: Sequence[PredictedFrame],
    weak: Sequence[PredictedFrame],
    others: Mapping[str, Sequence[PredictedFrame]],
) -> str:
    """Return a chart of predicted curves and measured points, as SVG. `others`: name of another network -> forecast."""
    figure = make_figure(9.5, 4.6)
    row = figure.subplots(1, 2 if weak else 1, squeeze=False, sharey=True)[0]
    kinds = (("strong", strong, found.strong, STRONG_COLOUR), ("weak", weak, found.weak, WEAK_COLOUR))
    for axes, (name, expected, points, colour) in zip(row, kinds, strict=False):
        ranks = [one.ranks for one in expected]
        axes.plot(ranks, [1e3 * one.draw_seconds for one in expected], color="#009E73", lw=1.2, label="drawing")
        many = [one for one in expected if one.ranks > 1]
        times = [1e3 * one.compositing_seconds for one in many]
        axes.plot([one.ranks for one in many], times, color="#CC79A7", lw=1.2, label="compositing")
        for network, curve in others.items():
            many = [one for one in curve if one.ranks > 1]
            style = {"color": "#bbbbbb", "lw": 1, "ls": (0, (1, 1)) if network == min(others) else (0, (4, 2))}
            label = f"the same, {network}"
            axes.plot([o.ranks for o in many], [1e3 * o.compositing_seconds for o in many], label=label, **style)
        axes.plot(ranks, [1e3 * one.total_seconds for one in expected], color=colour, lw=2, label="a frame")
        _marks(axes, points, [1e3 * point.total_seconds for point in points], colour, "measured frame", "o")
        parts = [point for point in points if point.ranks > 1]
        _marks(axes, parts, [1e3 * p.compositing_seconds for p in parts], "#CC79A7", "measured compositing", "s")
        axes.set(xlabel=f"ranks, {name} scaling", xscale="log", yscale="log")
        axes.set_xticks([1, 8, 64, 512, 4096, 65_536], ["1", "8", "64", "512", "4,096", "65,536"])
        axes.minorticks_off()
        _plain(axes)
    row[0].set_ylabel("ms")
    for axes in row:
        _plain_values(axes)
    handles, labels = row[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3, frameon=False, fontsize=9)
    return svg_of(figure)


def _stage(point: Point, stage: str) -> float:
    if stage != "other":
        return point.seconds[stage]
    known = sum(point.seconds[name] for name in STAGE_COLOURS if name != "other")
    return max(0.0, point.total_seconds - known)


def _line(axes: Any, points: Sequence[Point], values: Sequence[float], colour: str, label: str) -> None:
    """Draw a line through all points, with hollow marks for oversubscribed ones."""
    axes.plot([point.ranks for point in points], values, color=colour, linewidth=1.2, label=label)
    _marks(axes, points, values, colour, "", "o")


def _marks(axes: Any, points: Sequence[Point], values: Sequence[float], colour: str, label: str, marker: str) -> None:
    for crowded in (False, True):
        some = [
            (point.ranks, value) for point, value in zip(points, values, strict=True) if bool(point.crowded) == crowded
        ]
        if some:
            name = f"{label}, oversubscribed" * bool(label) if crowded else label
            axes.plot(
                *zip(*some, strict=True), marker, color=colour, markerfacecolor="white" if crowded else colour,
                markersize=6, label=name or None, zorder=3,
            )  # fmt: skip


def _ideal(axes: Any, points: Sequence[Point]) -> None:
    first, ranks = points[0], [point.ranks for point in points]
    strong = first.scaling == "strong"
    times = [1e3 * first.total_seconds * (first.ranks / n if strong else 1.0) for n in ranks]
    axes.plot(ranks, times, color=IDEAL, linewidth=1, linestyle="--", label="ideal", zorder=1)


def _count_ticks(axes: Any, counts: Sequence[int]) -> None:
    axes.minorticks_off()
    axes.set_xticks(counts, [f"{count:,}" for count in counts])
    if len(counts) == 1:
        axes.set_xlim(counts[0] / 2, counts[0] * 2)


def _plain_values(axes: Any) -> None:
    """Label the y axis with plain numbers, and all ticks if it spans less than two decades."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    low, high = axes.get_ylim()
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 100 * low else (1.0,)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())


def _plain(axes: Any) -> None:
    axes.grid(True, color="#e6e6e6", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
