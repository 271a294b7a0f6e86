"""Unstructured grids as a kind of content: how they are opened, completed and described."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path, PurePath

from clusterviz.content.contract import Corners, Kind, LegendEntry
from clusterviz.content.description import (
    legend_of_transfer,
    name_of,
    placed_warnings,
    transfer_summary,
    unseen_scalars,
)
from clusterviz.content.facts import box_corners, range_around
from clusterviz.content.grid.bricks import KnownCells
from clusterviz.content.grid.section import GridInfo, GridSection, KBuffer
from clusterviz.content.transfer import default_opacity, transfer_function
from clusterviz.data import read_grid, read_piece
from clusterviz.data.grid_files import GridFile, grid_files
from clusterviz.data.unstructured import UnstructuredGrid
from clusterviz.errors import SceneError
from clusterviz.frame.run import Run
from clusterviz.scene.values import Scene

LEFT_OUT = "cells are left out: a corner or value is not finite, or they have no volume"
OVERLAP = "cells overlap others: of these, a ray shows the one that it enters first"


def open_grids(
    run: Run, scene: Scene, keyed: Sequence[tuple[str, GridSection]], given: Sequence[UnstructuredGrid | None]
) -> list[KnownCells]:
    """Open unstructured grids; collective."""

    def opened(key: str, section: GridSection, data: UnstructuredGrid | None) -> KnownCells:
        path = Path(section.path)
        if data is None:
            return KnownCells(section, key, partial(grid_files, path, section.time), read_piece, run.channel)
        return KnownCells(section, key, lambda: [GridFile(path)], lambda _: data, run.channel)

    with run.local("open", "load"):
        return [opened(key, section, data) for (key, section), data in zip(keyed, given, strict=True)]


def complete_grid(section: GridSection, info: GridInfo) -> GridSection:
    """Return an unstructured grid with the name of its array, clim, opacity and unit distance."""
    low, high = info.scalars or (0.0, 1.0)
    clim = section.clim or ((low, high) if low < high else range_around(low))
    found: dict[str, object] = {"clim": clim, "array": section.array or info.array or None}
    if section.opacity is None:
        found["opacity"] = default_opacity(section.cmap, clim)
    if section.opacity_unit_distance is None:
        found["opacity_unit_distance"] = info.cell_size or 1.0
    return section.model_copy(update=found)


def legend(section: GridSection) -> LegendEntry:
    """Return how a completed grid is listed."""
    return legend_of_transfer(name_of(section), transfer_function(section))


def warnings(key: str, section: GridSection, info: GridInfo, others: Sequence[Corners]) -> dict[str, str]:
    """Return what cannot be drawn of a grid, whether it is apart from all else, and why its scalars are invisible."""
    name = PurePath(section.path).name
    found = placed_warnings(key, section, info, box_corners(info.box), others, LEFT_OUT)
    if info.overlaps:
        found[f"{key}: overlap"] = f"{key} ({name}): {OVERLAP}"
    if info.scalars and (reason := unseen_scalars(section, *info.scalars)):
        found[key] = f"{key} ({name}): {reason}"
    return found


def check(scene: Scene) -> None:
    """Refuse a k-buffer beside anything else."""
    for number, grid in enumerate(scene.grids):
        beside = [key for key in scene.drawn_as("samples", "fragments", "segments") if key != f"grids[{number}]"]
        beside += ["image.layers"] if scene.image.layers else []
        beside += [f"grids[{number}].shade"] if grid.shade else []
        if isinstance(grid.visibility, KBuffer) and beside:
            text, where = "a k-buffer draws one unstructured grid, and nothing else", f"grids[{number}].visibility"
            raise SceneError(text, where=where, found=f"{{k: {grid.visibility.k}}} and {beside[0]}", allowed="exact")


def _referenced(section: GridSection, grid: UnstructuredGrid) -> object:
    # Few commands need the reference.
    from clusterviz.reference.cells import place_cells

    return place_cells(section, grid)


GRID = Kind(
    name="grids",
    sections=("grids",),
    facts=GridInfo,
    changing=(
        *("cmap", "clim", "opacity", "opacity_unit_distance"),
        *("ambient", "diffuse", "specular", "specular_power", "visibility"),
    ),
    open=open_grids,
    complete=complete_grid,
    summary=lambda key, section: f"{key} {transfer_summary(section.clim, section.cmap, section.opacity)}",
    legend=legend,
    warnings=warnings,
    check=check,
    must_fit=True,
    read=lambda section: read_grid(section.path, section.time),
    referenced=_referenced,
    unchecked=lambda section: "" if section.visibility == "exact" else "shows no grids by a k-buffer",
    faint=("opacity_unit_distance=null",),
)
