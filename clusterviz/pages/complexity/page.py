"""Files of the depth complexity: a self-contained HTML page, its numbers as JSON, counts as an array and a picture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.pages.complexity.measure import FrameComplexity, Report
from clusterviz.pages.output import make_figure, numbers_of, svg_of, write_page
from clusterviz.pages.pictures import file_url, thumbnail_url
from clusterviz.render.abuffer.fills import FRAGMENT, PAGE_SHIFT, WORD
from clusterviz.render.abuffer.resolves import LARGEST, MOST_SIZE, SMALLEST
from clusterviz.scene import background_rgb

KIND, PICTURE, COUNTS = "complexity", "complexity.png", "complexity.npy"
CMAP = "viridis"
BARS = 512
"""Bars of a histogram, at most."""
LINE = "#D55E00"


def write_files(folder: Path, name: str, report: Report) -> None:
    """Write the page, the numbers, the counts and their picture."""
    np.save(folder / COUNTS, report.counts)
    complexity_figure(report.counts).savefig(folder / PICTURE, dpi=150)
    write_page(
        folder,
        KIND,
        as_json(report),
        report.scene,
        name=name,
        report=report,
        first=report.frames[0],
        most=max(report.frames, key=lambda frame: frame.fragments),
        several=len(report.frames) > 1,
        picture=thumbnail_url(report.picture, background_rgb(report.scene.image.background)),
        counts=file_url(folder / PICTURE),
        histogram=svg_of(histogram_figure(report.frames[0])),
        orbit=svg_of(orbit_figure(report.frames)) if len(report.frames) > 1 else "",
        fragment=FRAGMENT,
        word=WORD,
        page=1 << PAGE_SHIFT["pages"],
        smallest=SMALLEST,
        largest=LARGEST,
        most_size=MOST_SIZE,
        counts_name=COUNTS,
        picture_name=PICTURE,
    )


def as_json(report: Report) -> dict[str, Any]:
    """Return the contents of the JSON file."""
    frames = [_numbers(frame) for frame in report.frames]
    return numbers_of(report.scene, ranks=report.ranks, renderer=report.renderer, degrees=report.degrees, frames=frames)


def _numbers(frame: FrameComplexity) -> dict[str, Any]:
    occurring = np.flatnonzero(frame.histogram)
    return {
        "seconds": frame.seconds,
        "pixels": frame.pixels,
        "covered": frame.covered,
        "fragments": frame.fragments,
        "max": frame.maximum,
        "mean": frame.mean,
        "classes": frame.classes,
        "histogram": np.stack([occurring, frame.histogram[occurring]], axis=1).tolist(),
        "fill_bytes": frame.fill_bytes,
        "resolve": frame.resolve,
    }


def complexity_figure(counts: NDArray[np.int32]) -> Any:
    """Return the counts in false colours, on a logarithmic scale; pixels without fragments are white."""
    from matplotlib.colors import LogNorm
    from matplotlib.ticker import LogLocator, NullLocator

    height, width = counts.shape
    figure = make_figure(8.0, min(12.0, 0.8 + 6.8 * height / width))
    axes = figure.subplots()
    most = max(2, int(counts.max()))
    shown = np.ma.masked_equal(counts, 0)
    image = axes.imshow(shown, cmap=CMAP, norm=LogNorm(1, most), interpolation="nearest")
    axes.set(xticks=[], yticks=[])
    bar = figure.colorbar(image, ax=axes, label=f"fragments, at most {counts.max():,}", format="{x:.0f}")
    bar.ax.yaxis.set_minor_locator(NullLocator())
    bar.ax.yaxis.set_major_locator(LogLocator(2))
    return figure


def histogram_figure(frame: FrameComplexity) -> Any:
    """Return the histogram of the covered pixels, linear and logarithmic, with the limits of the classes."""
    figure = make_figure(9.5, 3.3)
    width = -(-max(1, frame.maximum) // BARS)
    begins = np.arange(1, max(2, len(frame.histogram)), width)
    bars = np.add.reduceat(frame.histogram[1:], begins - 1) if frame.maximum else np.zeros(1)
    for axes, scale in zip(figure.subplots(1, 2), ("linear", "log" if frame.covered else "linear"), strict=True):
        axes.stairs(bars, np.append(begins, begins[-1] + width) - 0.5, fill=True, color="#0072B2")
        of = f" of {width} numbers" if width > 1 else ""
        axes.set(xlabel="fragments", ylabel=f"pixels{of}", yscale=scale)
        axes.xaxis.get_major_locator().set_params(integer=True)
        if scale == "log":
            axes.set_ylim(bottom=0.7)
        for limit in frame.classes:
            if limit < frame.maximum:
                axes.axvline(limit + 0.5, color="#999999", linewidth=0.8, linestyle=":")
        axes.spines[["top", "right"]].set_visible(False)
    return figure


def orbit_figure(frames: tuple[FrameComplexity, ...]) -> Any:
    """Return the shares of the classes in the picture as stacked bars over frames, with the times of frames."""
    import matplotlib as mpl

    figure = make_figure(9.5, 3.8)
    axes = figure.subplots()
    sizes, numbers = sorted({size for frame in frames for size in frame.classes}), range(1, len(frames) + 1)
    bottom = np.zeros(len(frames))
    for size, colour in zip(sizes, mpl.colormaps[CMAP](np.linspace(0.1, 0.95, len(sizes))), strict=True):
        shares = np.array([100 * frame.classes.get(size, 0) / frame.pixels for frame in frames])
        label = f"{size // 2 + 1 if size > SMALLEST else 1} to {size}"
        axes.bar(numbers, shares, 0.9, bottom, color=colour, label=label)
        bottom += shares
    axes.set(xlabel="frame", ylabel="pixels [%]", xlim=(0.4, len(frames) + 0.6))
    axes.xaxis.get_major_locator().set_params(integer=True)
    times = axes.twinx()
    times.plot(numbers, [1e3 * frame.seconds["total"] for frame in frames], color=LINE, marker="o", ms=3, label="time")
    times.set(ylim=(0, None))
    times.set_ylabel("a frame [ms]", color=LINE)
    for one in (axes, times):
        one.spines["top"].set_visible(False)
    figure.legend(loc="outside upper center", ncols=len(sizes) + 1, frameon=False, title="fragments")
    return figure
