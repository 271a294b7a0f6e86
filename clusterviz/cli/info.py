"""`clusterviz info`: describe a volume and its value statistics, meshes, lines and points, or an unstructured grid."""

from __future__ import annotations

import json as json_text
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console

from clusterviz.cli.console import print_document
from clusterviz.data import open_source, read_geometry, read_grid
from clusterviz.data.axes import Subset, first_parts
from clusterviz.data.bricks import BrickLayout, read_bricks
from clusterviz.data.faces import find_neighbours
from clusterviz.data.formats import EXTENSIONS, grid_format_of, mesh_format_of
from clusterviz.data.geometry import Attributes, Geometry, Lines, Mesh, Points
from clusterviz.data.source import Source, levels_of
from clusterviz.data.summary import kept_summary, summarise
from clusterviz.data.tetrahedra import COUNTS, make_tetrahedra
from clusterviz.data.unstructured import UnstructuredGrid
from clusterviz.data.vectors import open_vectors
from clusterviz.errors import DataError, OutputError, escaped, public_address
from clusterviz.flow.lic import SpeedSource
from clusterviz.image.replace import check_replaceable, replacing
from clusterviz.pages.output import make_figure

BARS = " ▁▂▃▄▅▆▇█"
SPARK_WIDTH = 64
SHOWN_PERCENTILES = ("1", "5", "25", "50", "75", "95", "99")


def command(
    file: Annotated[str, typer.Argument(help="A data file, file.h5:/dataset, or field:NAME.")],
    array: Annotated[str | None, typer.Option(help="Which array, for files with several.")] = None,
    time: Annotated[int | None, typer.Option(help="Which time step, from 0; the first by default.", min=0)] = None,
    channel: Annotated[str | None, typer.Option(help="Which channel, by number or name; by default the first.")] = None,
    brick: Annotated[int, typer.Option(help="Voxels along the side of a brick.", min=2, max=1024)] = 64,
    points: Annotated[bool, typer.Option("--points", help="Read a .npy file (n, 3 or more) as points.")] = False,
    plot: Annotated[
        Path | None, typer.Option(metavar="FILE.png", help="Draw the histogram, with logarithmic counts.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Show what a data file holds.

    Of a volume: format, grid, type, range, percentiles, histogram, bricks. Of meshes, lines and points: counts, bounds,
    arrays, and whether a mesh is closed. Of unstructured grids: cells, tetrahedra, bounds, arrays, and flaws.
    """
    arrays: dict[str, Any] = {}
    if plot:
        check_plot(plot)
    with Console(stderr=True).status(f"reading {escaped(public_address(file))}"):
        mesh_format, grid_format = mesh_format_of(Path(file)), grid_format_of(Path(file))
        if points or mesh_format:
            geometry = read_geometry(file)
            arrays = _arrays_of(geometry)
            found = {"name": file, "format": mesh_format.name if mesh_format else "npy"} | describe_geometry(geometry)
        elif grid_format:
            found = {"name": file, "format": grid_format.name}
            try:
                grid = read_grid(file, time)
                arrays = {**grid.point_arrays, **grid.cell_arrays}
                found |= {"grid": describe_grid(grid)}
            except DataError:
                geometry = read_geometry(file)  # a surface, or the same error
                arrays = _arrays_of(geometry)
                found |= describe_geometry(geometry)
        else:
            try:
                source, _, _ = first_parts(partial(open_source, file, None), Subset(array, time, channel))
            except DataError as error:
                source = _speeds_of(file, array, time, error)
            found = describe(source, brick) | _vectors_of(file, array)
    if plot:
        histograms = histograms_of(arrays)
        if found.get("percentiles"):
            percentiles = {float(q): value for q, value in found["percentiles"].items()}
            whole = found["minimum"], found["maximum"], found["histogram"], percentiles
            histograms = [Histogram(f"value ({found['dtype']})", *whole)]
        write_plot(plot, Path(public_address(file)).name, histograms)
    if json:
        print_document(json_text.dumps(found, indent=2, ensure_ascii=False) + "\n")
        return
    rows = _rows if "samples" in found else _grid_rows if "grid" in found else _geometry_rows
    for name, text in rows(found):
        print(f"{name:12} {text}")


def _speeds_of(file: str, array: str | None, time: int | None, error: DataError) -> Source:
    """Return the speeds of a file that has no scalars but vectors; raise the error if it has neither."""
    try:
        return SpeedSource(first_parts(lambda part: open_vectors(file, part.array, part.time), Subset(array, time))[0])
    except DataError:
        raise error from None


def _vectors_of(file: str, array: str | None) -> dict[str, Any]:
    """Return the array of vectors of a file as `flows` shows it; nothing if there is none, or several."""
    try:
        return {"vectors": open_vectors(file, array).name.removeprefix(file).strip(":") or "the only array"}
    except DataError:
        return {}


def _arrays_of(geometry: Geometry) -> dict[str, Any]:
    mesh, lines, points = geometry.mesh, geometry.lines, geometry.points
    found: dict[str, Any] = {}
    for part in (
        *((mesh.vertex_attributes, mesh.triangle_attributes) if mesh else ()),
        *((lines.point_attributes, lines.line_attributes) if lines else ()),
        *((points.attributes,) if points else ()),
    ):
        found |= part
    return found


def describe_geometry(geometry: Geometry) -> dict[str, Any]:
    """Return counts, bounds and arrays of the meshes, lines and points of a file, as JSON values."""
    found: dict[str, Any] = {}
    if geometry.mesh:
        found["mesh"] = _mesh(geometry.mesh)
    if geometry.lines:
        found["lines"] = _lines(geometry.lines)
    if geometry.points:
        found["points"] = _points(geometry.points)
    return found


def _mesh(mesh: Mesh) -> dict[str, Any]:
    boundary, crowded = mesh.edge_counts()
    drawn, invalid = int(mesh.drawable.sum()), ~mesh.finite
    return {
        "vertices": len(mesh.vertices),
        "triangles": len(mesh.triangles),
        "dtype": mesh.vertices.dtype.name,
        "bounds": mesh.bounds,
        "closed": drawn > 0 and boundary == 0 and crowded == 0,
        "boundary_edges": boundary,
        "non_manifold_edges": crowded,
        "not_finite": int(invalid.sum()),
        "degenerate": len(mesh.triangles) - drawn - int(invalid[mesh.triangles].any(axis=1).sum()),
        "drawn": drawn,
        "vertex_arrays": _arrays(mesh.vertex_attributes),
        "triangle_arrays": _arrays(mesh.triangle_attributes),
    }


def _lines(lines: Lines) -> dict[str, Any]:
    return {
        "lines": len(lines.offsets) - 1,
        "points": len(lines.points),
        "dtype": lines.points.dtype.name,
        "bounds": lines.bounds,
        "not_finite": int((~lines.finite).sum()),
        "point_arrays": _arrays(lines.point_attributes),
        "line_arrays": _arrays(lines.line_attributes),
    }


def _points(points: Points) -> dict[str, Any]:
    return {
        "points": len(points.positions),
        "dtype": points.positions.dtype.name,
        "bounds": points.bounds,
        "not_finite": int((~points.finite).sum()),
        "arrays": _arrays(points.attributes),
    }


def describe_grid(grid: UnstructuredGrid) -> dict[str, Any]:
    """Return counts, bounds, arrays and flaws of an unstructured grid, as JSON values."""
    whole = replace(grid, point_arrays={"any": np.zeros(len(grid.points), np.float32)}, cell_arrays={})
    tetrahedra = make_tetrahedra(whole)
    faces = find_neighbours(tetrahedra.corners, len(tetrahedra.points))
    flaws = {key: count for key, count in tetrahedra.counts.items() if key != "invalid"}
    return {
        "cells": {kind: len(corners) for kind, corners in grid.cells.items()},
        "points": len(grid.points),
        "dtype": grid.points.dtype.name,
        "bounds": tetrahedra.bounds,
        "tetrahedra": len(tetrahedra.corners),
        "boundary_faces": faces.boundary,
        **flaws,
        "overlapping": faces.crowded,
        "ignored": grid.ignored,
        "curved": dict(grid.curved),
        "point_arrays": _arrays(grid.point_arrays),
        "cell_arrays": _arrays(grid.cell_arrays),
    }


def _arrays(arrays: Attributes) -> dict[str, Any]:
    """Return type, number of components and range of finite numbers of arrays by name."""
    found = {}
    for name, array in arrays.items():
        finite = array[np.isfinite(array)]
        found[name] = {
            "dtype": array.dtype.name,
            "components": array.shape[1] if array.ndim > 1 else 1,
            "minimum": finite.min().item() if finite.size else None,
            "maximum": finite.max().item() if finite.size else None,
            "not_finite": array.size - finite.size,
        }
    return found


def describe(source: Source, brick: int) -> dict[str, Any]:
    """Return grid, type, value statistics and bricks of a volume, as JSON values.

    Parameters
    ----------
    source : the volume; all of it is read, unless it keeps its summary
    brick : samples along the side of a brick
    """
    grid, layout = source.grid, BrickLayout(source.grid.shape_zyx, brick)
    nz, ny, nx = layout.counts_zyx
    indices = [(z, y, x) for z in range(nz) for y in range(ny) for x in range(nx)]
    summary = kept_summary(source, layout) or summarise(
        source.dtype, layout, lambda: read_bricks(source, layout, indices), lambda value: [value]
    )
    samples, finite = math.prod(grid.shape_zyx), int(summary.histogram.sum())
    low, high = grid.corners.min(axis=0).tolist(), grid.corners.max(axis=0).tolist()
    return {
        "name": source.name,
        "format": getattr(_innermost(source), "format", "") or format_name(source.name),
        "dtype": source.dtype.name,
        "shape_zyx": list(grid.shape_zyx),
        **_other_axes(source),
        **_stored(source),
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
    lower = name.lower()
    if lower.startswith("field:"):
        return "field"
    if "://" in lower or ".zarr/" in lower:
        return "ome-zarr"
    known = sorted(EXTENSIONS, key=len, reverse=True)
    extension = next((e for e in known if lower.endswith(e) or f"{e}:" in lower), None)
    return EXTENSIONS[extension].name if extension else "slices"


def _other_axes(source: Any) -> dict[str, Any]:
    """Return time steps and channels of the file, and the ones read; levels of a store."""
    slab = getattr(source, "slab", None)
    levels, found = levels_of(source), dict[str, Any]()
    if levels is not None:
        each = [(levels.level(n).grid.shape_zyx, levels.bounds(n)) for n in range(levels.levels)]
        found["levels"] = [
            {"level": n, "shape_zyx": list(shape), "bricks": bounds[0].size, "error": float(bounds[2].max())}
            for n, (shape, bounds) in enumerate(each)
        ]
    if slab is not None and slab.time_steps > 1:
        found |= {"time_steps": slab.time_steps, "time": slab.time}
    if slab is not None and slab.channels > 1:
        names = slab.channel_names or range(slab.channels)
        found |= {"channels": list(names), "channel": names[slab.channel]}
    return found


def _innermost(source: Any) -> Any:
    """Return the source that others wrap: a guard, another grid, or a lattice."""
    while hasattr(source, "source"):
        source = source.source
    return source


def _stored(source: Any) -> dict[str, Any]:
    """Return the samples of a file whose coordinates are uneven; see `clusterviz.data.rectilinear`."""
    stored = _innermost(source).grid.shape_zyx
    return {} if stored == source.grid.shape_zyx else {"stored_zyx": list(stored)}


def sparkline(counts: list[int]) -> str:
    """Return a histogram as one line of bars with logarithmic heights; empty bins are blank."""
    per_bar = max(1, -(-len(counts) // SPARK_WIDTH))
    sums = [sum(counts[i : i + per_bar]) for i in range(0, len(counts), per_bar)]
    top = math.log1p(max(sums, default=0))
    return "".join(BARS[math.ceil(math.log1p(n) / top * (len(BARS) - 1))] if n else BARS[0] for n in sums)


def _rows(found: dict[str, Any]) -> list[tuple[str, str]]:
    z, y, x = found["shape_zyx"]
    bricks, percentiles = found["bricks"], found["percentiles"]
    counts = " × ".join(str(n) for n in bricks["counts_zyx"][::-1])
    rows = [
        ("name", found["name"]),
        ("format", found["format"]),
        ("samples", f"{x} × {y} × {z} (x, y, z), {found['dtype']}, {_size(found['bytes'])}"),
        *([("vectors", f"{found['vectors']}, drawn by flows")] if "vectors" in found else []),
        ("spacing", _vector(found["spacing"])),
        ("bounds", f"{_vector(found['bounds'][0])}  to  {_vector(found['bounds'][1])}"),
        ("direction", "; ".join(_vector(row) for row in found["direction"])),
        ("bricks", f"{bricks['count']} of {bricks['side']}³ ({counts})"),
    ]
    if "stored_zyx" in found:
        stored = " × ".join(str(n) for n in found["stored_zyx"][::-1])
        rows.insert(3, ("stored", f"{stored} samples at uneven coordinates; the others lie between them"))
    if "channels" in found:
        rows.insert(3, ("channels", f"{', '.join(map(str, found['channels']))}; this is {found['channel']}"))
    if "time_steps" in found:
        rows.insert(3, ("time steps", f"{found['time_steps']}; this is {found['time']}"))
    for level in found.get("levels", ()):
        size = " × ".join(str(n) for n in level["shape_zyx"][::-1])
        rows.append((f"level {level['level']}", f"{size}, {level['bricks']} bricks, error at most {level['error']:g}"))
    if found["not_finite"]:
        rows.append(("not finite", f"{found['not_finite']} of {found['samples']} samples (NaN or infinite)"))
    if percentiles:
        rows += [
            ("range", f"{found['minimum']:g}  to  {found['maximum']:g}"),
            ("percentiles", "   ".join(f"{q}%: {percentiles[q]:g}" for q in SHOWN_PERCENTILES if q in percentiles)),
            ("histogram", f"{sparkline(found['histogram'])}  (logarithmic)"),
        ]
    return rows


def _geometry_rows(found: dict[str, Any]) -> list[tuple[str, str]]:
    rows = [("name", found["name"]), ("format", found["format"])]
    for kind in ("mesh", "lines", "points"):
        part = found.get(kind)
        if part is None:
            continue
        counts = [f"{part[key]} {key}" for key in ("triangles", "vertices", "lines", "points") if key in part]
        rows.append((kind, f"{', '.join(counts)}, {part['dtype']}"))
        if part["bounds"]:
            rows.append(("bounds", f"{_vector(part['bounds'][0])}  to  {_vector(part['bounds'][1])}"))
        else:
            rows.append(("bounds", "none: there is nothing to draw"))
        if kind == "mesh":
            edges = [f"{part[f'{key}_edges']} {key.replace('_', '-')}" for key in ("boundary", "non_manifold")]
            rows.append(("closed", "yes" if part["closed"] else f"no: {' and '.join(edges)} edges"))
            if part["degenerate"]:
                rows.append(
                    ("degenerate", f"{part['degenerate']} of {part['triangles']} triangles, which are not drawn")
                )
        if part["not_finite"]:
            rows.append(("not finite", f"{part['not_finite']} positions (NaN or infinite); what has them is not drawn"))
        for key in ("vertex_arrays", "triangle_arrays", "point_arrays", "line_arrays", "arrays"):
            rows += [
                (key.replace("_arrays", " array").replace("arrays", "array"), _array(n, a))
                for n, a in part.get(key, {}).items()
            ]
    return rows if len(rows) > 2 else [*rows, ("holds", "nothing to draw")]


def _grid_rows(found: dict[str, Any]) -> list[tuple[str, str]]:
    grid = found["grid"]
    cells = ", ".join(f"{count} {kind}" for kind, count in grid["cells"].items()) or "none"
    rows = [("name", found["name"]), ("format", found["format"]), ("cells", cells)]
    rows.append(("points", f"{grid['points']}, {grid['dtype']}"))
    bounds = grid["bounds"]
    within = f"{_vector(bounds[0])}  to  {_vector(bounds[1])}" if bounds else "none: there is nothing to draw"
    rows.append(("bounds", within))
    rows.append(("tetrahedra", f"{grid['tetrahedra']}, with {grid['boundary_faces']} faces at the boundary"))
    told = COUNTS | {
        "overlapping": "faces of cells that overlap others there; a ray shows the one that it enters first",
        "ignored": "points, lines and surfaces of the file, which are not drawn",
    }
    rows += [(key, f"{grid[key]} {text}") for key, text in told.items() if grid.get(key)]
    if grid["curved"]:
        away = ", ".join(f"{name or 'positions'} {value:g}" for name, value in grid["curved"].items())
        rows.append(("curved", f"cells are subdivided; largest differences along their edges: {away}"))
    for key in ("point_arrays", "cell_arrays"):
        rows += [(key.replace("_arrays", " array"), _array(name, array)) for name, array in grid[key].items()]
    return rows


def _array(name: str, array: dict[str, Any]) -> str:
    components = f" × {array['components']}" if array["components"] > 1 else ""
    within = "nothing finite" if array["minimum"] is None else f"{array['minimum']:g}  to  {array['maximum']:g}"
    invalid = f", {array['not_finite']} not finite" if array["not_finite"] else ""
    return f"{name}: {array['dtype']}{components}, {within}{invalid}"


def _vector(values: list[float]) -> str:
    return "(" + ", ".join(f"{value:g}" for value in values) + ")"


def _size(count: float) -> str:
    for unit in ("bytes", "KiB", "MiB", "GiB", "TiB"):
        if count < 1024 or unit == "TiB":
            return f"{count:.0f} {unit}" if unit == "bytes" else f"{count:.1f} {unit}"
        count /= 1024
    raise AssertionError("the loop returns")


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
