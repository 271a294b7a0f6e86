"""`clusterviz info`: describe a data file and its value statistics."""

from __future__ import annotations

import json as json_text
import math
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from clusterviz.data.source import Source

BARS = " ▁▂▃▄▅▆▇█"
SPARK_WIDTH = 64
SHOWN_PERCENTILES = ("1", "5", "25", "50", "75", "95", "99")


def command(
    file: Annotated[str, typer.Argument(help="A data file, file.h5:/dataset, or field:NAME.")],
    array: Annotated[str | None, typer.Option(help="Which array, for files with several.")] = None,
    time: Annotated[int | None, typer.Option(help="Which time step, from 0; the first by default.", min=0)] = None,
    channel: Annotated[str | None, typer.Option(help="Which channel, by number or name; by default the first.")] = None,
    brick: Annotated[int, typer.Option(help="Voxels along the side of a brick.", min=2, max=1024)] = 64,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Show what a data file holds: format, grid, type, range, percentiles, histogram, bricks."""
    from rich.console import Console

    from clusterviz.data import open_source
    from clusterviz.data.axes import Subset

    source = open_source(file, subset=Subset(array, time, channel, first=True, spaced=True))
    with Console(stderr=True).status(f"reading {file}"):
        found = describe(source, brick)
    if json:
        print(json_text.dumps(found, indent=2, ensure_ascii=False))
        return
    for name, text in _rows(found):
        print(f"{name:12} {text}")


def describe(source: Source, brick: int) -> dict[str, Any]:
    """Return grid, type, value statistics and bricks of a volume, as JSON values.

    Parameters
    ----------
    source : the volume; all of it is read
    brick : samples along the side of a brick
    """
    from clusterviz.data.bricks import BrickLayout, read_bricks
    from clusterviz.data.summary import summarise

    grid, layout = source.grid, BrickLayout(source.grid.shape_zyx, brick)
    indices = [(z, y, x) for z, y, x in _indices(layout.counts_zyx)]
    summary = summarise(source.dtype, layout, lambda: read_bricks(source, layout, indices), lambda value: [value])
    samples, finite = math.prod(grid.shape_zyx), int(summary.histogram.sum())
    low, high = grid.corners.min(axis=0).tolist(), grid.corners.max(axis=0).tolist()
    return {
        "name": source.name,
        "format": format_name(source.name),
        "dtype": source.dtype.name,
        "shape_zyx": list(grid.shape_zyx),
        **_other_axes(source),
        "samples": samples,
        "bytes": samples * source.dtype.itemsize,
        "spacing": list(grid.spacing),
        "origin": list(grid.origin),
        "direction": [list(row) for row in grid.direction],
        "bounds": [low, high],
        "minimum": summary.value_range[0] if finite else None,
        "maximum": summary.value_range[1] if finite else None,
        "percentiles": {f"{q:g}": value for q, value in summary.percentiles} if finite else {},
        "not_finite": samples - finite,
        "histogram": summary.histogram.tolist(),
        "bricks": {"side": brick, "counts_zyx": list(layout.counts_zyx), "count": len(indices)},
    }


def format_name(name: str) -> str:
    """Return the format of a volume from its name: npy, nifti, …; field for a formula, slices for a folder."""
    from clusterviz.data import EXTENSIONS

    lower = name.lower()
    if lower.startswith("field:"):
        return "field"
    known = sorted(EXTENSIONS, key=len, reverse=True)
    extension = next((e for e in known if lower.endswith(e) or f"{e}:" in lower), None)
    return EXTENSIONS[extension].name if extension else "slices"


def _other_axes(source: Any) -> dict[str, Any]:
    """Return time steps and channels of the file, and the ones read."""
    while hasattr(source, "source"):  # wrapped by a guard or another grid
        source = source.source
    slab = getattr(source, "slab", None)
    found: dict[str, Any] = {}
    if slab is not None and slab.time_steps > 1:
        found |= {"time_steps": slab.time_steps, "time": slab.time}
    if slab is not None and slab.channels > 1:
        names = slab.channel_names or range(slab.channels)
        found |= {"channels": list(names), "channel": names[slab.channel]}
    return found


def sparkline(counts: list[int], width: int = SPARK_WIDTH) -> str:
    """Return a histogram as one line of bars with logarithmic heights; empty bins are blank."""
    per_bar = max(1, -(-len(counts) // width))
    sums = [sum(counts[i : i + per_bar]) for i in range(0, len(counts), per_bar)]
    top = math.log1p(max(sums, default=0))
    return "".join(BARS[math.ceil(math.log1p(n) / top * (len(BARS) - 1))] if n else BARS[0] for n in sums)


def _indices(counts: tuple[int, int, int]) -> list[tuple[int, int, int]]:
    nz, ny, nx = counts
    return [(z, y, x) for z in range(nz) for y in range(ny) for x in range(nx)]


def _rows(found: dict[str, Any]) -> list[tuple[str, str]]:
    """Return names and texts in the order of output."""
    z, y, x = found["shape_zyx"]
    bricks, percentiles = found["bricks"], found["percentiles"]
    counts = " × ".join(str(n) for n in bricks["counts_zyx"][::-1])
    rows = [
        ("name", found["name"]),
        ("format", found["format"]),
        ("samples", f"{x} × {y} × {z} (x, y, z), {found['dtype']}, {_size(found['bytes'])}"),
        ("spacing", _vector(found["spacing"])),
        ("bounds", f"{_vector(found['bounds'][0])}  to  {_vector(found['bounds'][1])}"),
        ("direction", "; ".join(_vector(row) for row in found["direction"])),
        ("bricks", f"{bricks['count']} of {bricks['side']}³ ({counts})"),
    ]
    if "channels" in found:
        rows.insert(3, ("channels", f"{', '.join(map(str, found['channels']))}; this is {found['channel']}"))
    if "time_steps" in found:
        rows.insert(3, ("time steps", f"{found['time_steps']}; this is {found['time']}"))
    if found["not_finite"]:
        rows.append(("not finite", f"{found['not_finite']} of {found['samples']} samples (NaN or infinite)"))
    if percentiles:
        rows += [
            ("range", f"{found['minimum']:g}  to  {found['maximum']:g}"),
            ("percentiles", "   ".join(f"{q}%: {percentiles[q]:g}" for q in SHOWN_PERCENTILES if q in percentiles)),
            ("histogram", f"{sparkline(found['histogram'])}  (logarithmic)"),
        ]
    return rows


def _vector(values: list[float]) -> str:
    return "(" + ", ".join(f"{value:g}" for value in values) + ")"


def _size(count: float) -> str:
    """Return a number of bytes with a binary unit."""
    for unit in ("bytes", "KiB", "MiB", "GiB", "TiB"):
        if count < 1024 or unit == "TiB":
            return f"{count:.0f} {unit}" if unit == "bytes" else f"{count:.1f} {unit}"
        count /= 1024
    raise AssertionError("the loop returns")
