"""Files of a survey of k-buffers: a self-contained HTML page, its numbers as JSON, and the entries that pixels need."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from clusterviz.pages.kbuffer.measure import DIFFERS, Report
from clusterviz.pages.output import make_figure, numbers_of, svg_of, write_page
from clusterviz.pages.pictures import file_url, thumbnail_url
from clusterviz.scene import background_rgb

KIND, PICTURE, NEEDED = "kbuffer", "kbuffer.png", "kbuffer.npy"
COLOURS = {"sorted": "#0072B2", "unsorted": "#D55E00", "": "#444444"}


def write_files(folder: Path, name: str, report: Report) -> None:
    """Write the page, the numbers, the entries that pixels need and their picture."""
    np.save(folder / NEEDED, np.stack([view.needs.needed for view in report.views]).astype(np.uint16))
    needed_figure(report).savefig(folder / PICTURE, dpi=120)
    numbers = as_json(report)
    write_page(
        folder,
        KIND,
        numbers,
        report.scene,
        name=name,
        report=report,
        numbers=numbers,
        picture=thumbnail_url(report.picture, background_rgb(report.scene.image.background)),
        needed=file_url(folder / PICTURE),
        times=svg_of(times_figure(report)),
        differs=DIFFERS,
        saved=saved(report),
        needed_name=NEEDED,
        picture_name=PICTURE,
    )


def as_json(report: Report) -> dict[str, Any]:
    """Return the contents of the JSON file."""
    return numbers_of(
        report.scene,
        renderer=report.renderer,
        tetrahedra=report.tetrahedra,
        faces=report.faces,
        boundary=report.boundary,
        views=[
            {
                "name": view.name,
                "position": view.camera.position,
                "fragments": int(view.needs.fragments.sum()),
                "longest": int(view.needs.fragments.max()),
                "covered": int((view.needs.fragments > 0).sum()),
                "needed": int(view.needs.needed.max()),
                "wrong": {k: view.needs.wrong(k) for k in report.wrong},
            }
            for view in report.views
        ],
        wrong=report.wrong,
        drawings=[asdict(drawing) for drawing in report.drawings],
    )


def saved(report: Report) -> list[dict[str, Any]]:
    """Return, for each k, what the sorted buffer saves of the unsorted one's comparisons and CPU time, as shares."""
    by_k = dict[int, dict[str, Any]]()
    for drawing in report.drawings[1:-1]:
        by_k.setdefault(drawing.k, {})[drawing.entries] = drawing
    rows = []
    for k, both in by_k.items():
        first, last = both["unsorted"], both["sorted"]
        rows.append(
            {
                "k": k,
                "limit": (k - 1) / (2 * k - 1),
                "comparisons": 1 - last.counts.comparisons / max(1, first.counts.comparisons),
                "time": 1 - last.cpu_seconds / first.cpu_seconds,
                "unsorted": first,
                "sorted": last,
            }
        )
    return rows


def needed_figure(report: Report) -> Any:
    """Return the entries that the pixels of all views need, in false colours; pixels without fragments are white."""
    import matplotlib as mpl
    from matplotlib.colors import BoundaryNorm

    most = max(3, min(33, int(max(view.needs.needed.max() for view in report.views))))
    norm = BoundaryNorm(np.arange(1.5, most + 1), 256)
    width, height = report.scene.image.size
    figure = make_figure(12.0, min(12.0, 0.8 + 2 * (11 / 7 * height / width + 0.3)))
    grid = figure.subplots(2, 7)
    for axes, view in zip(grid.ravel(), report.views, strict=True):
        shown = np.ma.masked_equal(np.minimum(view.needs.needed, most), 0)
        image = axes.imshow(shown, cmap=mpl.colormaps["viridis"], norm=norm, interpolation="nearest")
        axes.set(xticks=[], yticks=[])
        axes.set_title(f"{view.name}: at most {view.needs.needed.max()}", fontsize=8)
    figure.colorbar(image, ax=grid, label="entries that a pixel needs", ticks=range(2, most + 1, max(1, most // 10)))
    return figure


def times_figure(report: Report) -> Any:
    """Return CPU time and wrong pixels by k."""
    figure = make_figure(9.5, 3.6)
    times, wrong = figure.subplots(1, 2)
    exact, *buffers, _ = report.drawings
    times.axhline(1e3 * exact.cpu_seconds, color=COLOURS[""], linestyle=":", label="exact")
    for entries in ("unsorted", "sorted"):
        own = [drawing for drawing in buffers if drawing.entries == entries]
        ks = [drawing.k for drawing in own]
        times.plot(
            ks, [1e3 * each.cpu_seconds for each in own], marker="o", ms=3, color=COLOURS[entries], label=entries
        )
    times.set(xlabel="entries k", ylabel="CPU time of a frame [ms]", ylim=(0, None))
    times.legend(frameon=False)
    pixels = len(report.views) * report.scene.image.size[0] * report.scene.image.size[1]
    wrong.plot(list(report.wrong), [100 * each / pixels for each in report.wrong.values()], marker="o", ms=3)
    wrong.set(xlabel="entries k", ylabel="wrong pixels [%]", ylim=(0, None))
    for axes in (times, wrong):
        axes.xaxis.get_major_locator().set_params(integer=True)
        axes.spines[["top", "right"]].set_visible(False)
    return figure
