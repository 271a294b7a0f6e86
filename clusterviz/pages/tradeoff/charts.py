"""Charts of error over cost as SVG: one colour a setting, the Pareto front as a line."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from clusterviz.pages.output import make_figure, svg_of
from clusterviz.pages.tradeoff.ground_truth import GroundTruth
from clusterviz.pages.tradeoff.rating import LEVEL, RatedSetting, by_rms, pareto_front

# Okabe and Ito's colours, distinguishable with colour vision deficiencies.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
MARKERS = "os^DvpX"  # one more than colours, so that no two settings have the same style
SCENE, TOGETHER, FRONT = "#000000", "#999999", "#444444"
LOWEST = 1e-9
"""Error at which 0 is drawn on the logarithmic axis."""


@dataclass(frozen=True)
class Axis:
    """Axis of a chart; `value` of a setting is in the unit of the label."""

    label: str
    value: Callable[[RatedSetting], float]


TOTAL = Axis("a frame [ms]", lambda one: 1e3 * one.cost.total_seconds)
RENDER = Axis("drawing [ms]", lambda one: 1e3 * one.cost.render_seconds)
SAMPLES = Axis("samples a frame [10⁶]", lambda one: 1e-6 * one.cost.samples)
MEMORY = Axis("largest rank's memory [MiB]", lambda one: one.cost.peak_memory_bytes / 2**20)
SENT = Axis("sent a frame [MiB]", lambda one: one.cost.bytes_sent / 2**20)
MAX = Axis("largest error", lambda one: one.max)
RMS = Axis("rms error", lambda one: one.rms)
UNLIKE = Axis("1 − SSIM", lambda one: 1 - one.ssim)
SMALL_CHARTS = ((TOTAL, RMS), (TOTAL, UNLIKE), (RENDER, MAX), (SAMPLES, MAX), (MEMORY, MAX), (SENT, MAX))


def main_chart(rated: Sequence[RatedSetting], truth: GroundTruth) -> str:
    """Return the chart of error over time of a frame, as SVG; points of the front are numbered as in the table."""
    figure = make_figure(9.5, 5.4)
    axes = figure.subplots()
    error, floor = (RMS, truth.rms) if by_rms(truth) else (MAX, truth.max)
    _draw(axes, rated, TOTAL, error, floor, [one.front > 0 for one in rated])
    for one in rated:
        spread = [1e3 * one.cost.total_seconds_min, 1e3 * one.cost.total_seconds_max]
        height = max(floor, LOWEST, error.value(one))
        axes.plot(spread, 2 * [height], color="#bbbbbb", linewidth=1, zorder=1)
        if one.front:
            axes.annotate(
                str(one.front), (TOTAL.value(one), height), xytext=(-5, -5), textcoords="offset points", ha="right",
                va="top", weight="bold",
            )  # fmt: skip
    for level, name in ((LEVEL, "1 level of 8 bits"), (2 * LEVEL, "2 levels")):
        if not axes.get_ylim()[0] < level < axes.get_ylim()[1]:
            continue
        axes.axhline(level, color="#bbbbbb", linewidth=0.8, linestyle=":")
        axes.annotate(name, (0.005, level), xycoords=("axes fraction", "data"), ha="left", va="bottom", color="#777777")
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=4, frameon=False)
    return svg_of(figure)


def small_charts(rated: Sequence[RatedSetting], truth: GroundTruth) -> str:
    """Return charts of the other costs and errors, as SVG; constant costs are left out."""
    shown = ((TOTAL, MAX), *SMALL_CHARTS[1:]) if by_rms(truth) else SMALL_CHARTS
    pairs = [pair for pair in shown if len({pair[0].value(one) for one in rated}) > 1]
    floors = {MAX.label: truth.max, RMS.label: truth.rms}
    if not pairs:
        return ""
    rows = -(-len(pairs) // 2)
    figure = make_figure(9.5, 3.3 * rows)
    all_axes = figure.subplots(rows, 2, squeeze=False).flatten()
    for axes, (cost, error) in zip(all_axes, pairs, strict=False):
        _draw(axes, rated, cost, error, floors.get(error.label, 0.0))
    for axes in all_axes[len(pairs) :]:
        axes.remove()
    return svg_of(figure)


def _draw(
    axes: Any, rated: Sequence[RatedSetting], cost: Axis, error: Axis, floor: float, best: Sequence[bool] | None = None
) -> None:
    """Draw one chart; errors below the ground truth's own are drawn at the edge of a grey band.

    `rated`: settings with cost and error. `floor`: the ground truth's own error. `best`: which settings are on the
    front; computed if None.
    """
    lowest = max(floor, LOWEST)
    points = [(cost.value(one), max(lowest, error.value(one))) for one in rated]
    front = sorted(point for point, on in zip(points, best or pareto_front(points), strict=True) if on)
    axes.step(*zip(*front, strict=True), where="post", color=FRONT, linewidth=1, zorder=1, label="Pareto front")
    for label, colour, marker, members in _groups(rated):
        axes.scatter(
            *zip(*(points[i] for i in members), strict=True),
            s=140 if marker == "*" else 34, color=colour, marker=marker, label=label, edgecolor="white", linewidth=0.6,
            zorder=3 if marker == "*" else 2,
        )  # fmt: skip
    axes.set(xlabel=cost.label, ylabel=error.label, yscale="log")
    if max(x for x, _ in points) > 3 * min(x for x, _ in points) > 0:
        axes.set_xscale("log")
    _plain_ticks(axes)
    errors = [y for _, y in points]
    axes.set_ylim(min(errors) / 2, 2 * max(errors))
    if floor > 0:
        axes.axhspan(min(errors) / 2, floor, color="#eeeeee", zorder=0, linewidth=0)
    axes.grid(True, color="#e6e6e6", linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)


def _groups(rated: Sequence[RatedSetting]) -> list[tuple[str, str, str, list[int]]]:
    """Return label, colour, marker and members of each group of points, in the order of the legend."""
    knobs = list(dict.fromkeys(next(iter(one.setting.changes)) for one in rated if _alone(one)))
    groups = [("together", TOGETHER, "o", [i for i, one in enumerate(rated) if one.setting.kind == "together"])]
    for number, knob in enumerate(knobs):
        members = [i for i, one in enumerate(rated) if _alone(one) and knob in one.setting.changes]
        groups.append((knob, COLOURS[number % len(COLOURS)], MARKERS[number % len(MARKERS)], members))
    groups.append(("as the scene is", SCENE, "*", [i for i, one in enumerate(rated) if one.setting.kind == "scene"]))
    return [group for group in groups if group[3]]


def _alone(one: RatedSetting) -> bool:
    return len(one.setting.changes) == 1


def _plain_ticks(axes: Any) -> None:
    """Label the cost axis with plain numbers instead of powers of ten, and few of them if it is linear."""
    from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

    if axes.get_xscale() == "log":
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    else:
        axes.xaxis.set_major_locator(MaxNLocator(5))
