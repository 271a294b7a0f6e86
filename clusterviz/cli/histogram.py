"""Histograms of a data file as a picture: `clusterviz info --plot`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clusterviz.errors import OutputError
from clusterviz.image.replace import check_replaceable, replacing
from clusterviz.pages.output import make_figure

BINS, MAX_PANELS = 256, 12
LABEL_SHARE = 0.045
"""Share of the axis that a label takes."""
MARKED = (1.0, 25.0, 50.0, 75.0, 99.0)
"""Percentiles that are marked."""


@dataclass(frozen=True)
class Histogram:
    name: str
    low: float
    high: float
    counts: Sequence[int]
    percentiles: Mapping[float, float]


def histograms_of(arrays: Mapping[str, Any]) -> list[Histogram]:
    """Return the histograms of arrays by name, of vectors those of their magnitudes; none of arrays without numbers."""
    found = []
    for name, array in arrays.items():
        values = np.asarray(array, np.float64)
        values = np.linalg.norm(values.reshape(len(values), -1), axis=1) if values.ndim > 1 else values
        values = values[np.isfinite(values)]
        if values.size:
            low, high = float(values.min()), float(values.max())
            counts = np.histogram(values, BINS, (low, high))[0] if low < high else np.array([values.size])
            marked = dict(zip(MARKED, np.percentile(values, MARKED).tolist(), strict=True))
            found.append(Histogram(name, low, high, counts.tolist(), marked))
    return found


def check_plot(path: Path) -> None:
    """Check before reading that a plot can be written.

    Raises OutputError: not a .png, or the folder is missing or cannot be written.
    """
    if path.suffix.lower() != ".png":
        raise OutputError("not a name for the plot", where="--plot", found=path.name, allowed="a .png")
    check_replaceable(path)


def write_plot(path: Path, title: str, histograms: Sequence[Histogram]) -> None:
    """Draw histograms with logarithmic counts and marked percentiles, one below the other.

    Raises OutputError: there is no histogram, or the file cannot be written.
    """
    if not histograms:
        raise OutputError("nothing to plot", where="--plot", found="no finite values", allowed="a file with some")
    shown = histograms[:MAX_PANELS]
    figure = make_figure(8.0, 0.6 + 2.6 * len(shown))
    left = f" (the first {MAX_PANELS} of {len(histograms)} arrays)" if len(histograms) > MAX_PANELS else ""
    figure.suptitle(title + left, fontsize=10)
    for axes, each in zip(figure.subplots(len(shown), squeeze=False)[:, 0], shown, strict=True):
        half = 0.0 if each.low < each.high else max(0.5, abs(each.low) * 2.0**-20)
        edges = np.linspace(each.low - half, each.high + half, len(each.counts) + 1)
        axes.stairs(each.counts, edges, fill=True, color="#4c78a8")
        axes.set_yscale("log")
        axes.set_ylim(bottom=0.5)
        axes.set_xlabel(each.name)
        axes.set_ylabel("samples")
        free_from, width = -math.inf, float(edges[-1] - edges[0])
        for q, value in sorted(each.percentiles.items()):
            if q in MARKED and math.isfinite(value):
                axes.axvline(value, color="#d62728", linewidth=0.8)
                if value >= free_from:  # labels do not overlap
                    place = axes.get_xaxis_transform()
                    axes.text(value, 1.01, f"{q:g} %", transform=place, ha="center", va="bottom", fontsize=7)
                    free_from = value + LABEL_SHARE * width
    with replacing(path) as temporary, temporary.open("wb") as file:
        figure.savefig(file, format="png", dpi=120)
