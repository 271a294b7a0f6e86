"""Meshes, lines and points as a kind of content: how they are opened, completed and described."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

import numpy as np

from clusterviz.content.contract import Corners, Kind, LegendEntry
from clusterviz.content.description import legend_of, name_of, placed_warnings, value_text
from clusterviz.content.facts import box_corners, range_around
from clusterviz.content.flow.expansion import FlowLines
from clusterviz.content.geometry.bricks import KnownGeometry, part_of
from clusterviz.content.geometry.section import (
    GEOMETRY_SECTIONS,
    GeometryInfo,
    GeometrySection,
    LinesSection,
    MeshSection,
    PointsSection,
    is_arrows,
    own_colours,
)
from clusterviz.data import read_geometry
from clusterviz.data.geometry import Geometry
from clusterviz.frame.run import Run
from clusterviz.scene.transfer import opacity_points
from clusterviz.scene.values import Scene

RADIUS_OF_DIAGONAL: dict[type[GeometrySection], float] = {
    FlowLines: 1 / 250,
    LinesSection: 1 / 500,
    PointsSection: 1 / 200,
}
"""Radius of tubes and spheres, if none is given, as a share of the diagonal of their box."""
LEFT_OUT: dict[type[GeometrySection], str] = {
    MeshSection: "triangles are left out: a vertex is not finite, or they have no area",
    LinesSection: "segments are left out: an end is not finite, or they have no length",
    PointsSection: "points are left out: they are not finite, or have no positive radius or no direction",
}


def open_geometry(
    run: Run, scene: Scene, keyed: Sequence[tuple[str, GeometrySection]], given: Sequence[Geometry | None]
) -> list[KnownGeometry]:
    """Open entries of meshes, lines and points; collective."""

    def load(section: GeometrySection, data: Geometry | None) -> Geometry:
        return data or read_geometry(section.path)

    with run.local("open", "load"):
        return [
            KnownGeometry(section, key, partial(load, section, data), run.channel)
            for (key, section), data in zip(keyed, given, strict=True)
        ]


def complete_geometry(section: GeometrySection, info: GeometryInfo) -> GeometrySection:
    """Return meshes, lines or points with clim, a radius, the file's own colours and the width of edges."""
    found: dict[str, object] = {}
    if colours := own_colours(section, info.arrays):
        found["scalars"] = colours
    if section.clim is None and section.scalars is not None and info.scalars is not None:
        low, high = info.scalars
        found["clim"] = (low, high) if low < high else range_around(low)
    size = (math.dist(*info.box) if len(info.box) else 0.0) or float(np.abs(info.box).max(initial=0.0)) or 1.0
    share = next((one for kind, one in RADIUS_OF_DIAGONAL.items() if isinstance(section, kind)), 0.0)
    has_radius = info.has_radii or isinstance(getattr(section, "radius", None), float)
    if share and not has_radius and not is_arrows(section):
        found["radius"] = share * size
    if isinstance(section, MeshSection) and section.edges and section.edges.width is None:
        found["edges"] = section.edges.model_copy(update={"width": size / 1000})
    if isinstance(section, LinesSection) and section.color_by is None:
        found["color_by"] = "scalars" if found.get("scalars", section.scalars) else "color"
    return section.model_copy(update=found)


def summary(key: str, section: GeometrySection) -> str:
    """Return how completed meshes, lines or points look, in one line."""
    radius = f", radius {value_text(section.radius)}" if isinstance(section, (LinesSection, PointsSection)) else ""
    return f"{key} {value_text(section.scalars or section.color)}, opacity {value_text(section.opacity)}{radius}"


def legend(section: GeometrySection) -> LegendEntry:
    """Return how completed meshes, lines or points are listed."""
    by = getattr(section, "color_by", None) or "scalars"
    if by == "scalars" and section.scalars is None:
        by = "color"
    visible = opacity_points(section.opacity, section.clim) if section.clim is not None else None
    return legend_of(section, name_of(section), by, visible)


def warnings(key: str, section: GeometrySection, info: GeometryInfo, others: Sequence[Corners]) -> dict[str, str]:
    """Return what cannot be drawn of meshes, lines or points, and whether they are apart from all else."""
    left_out = next(text for kind, text in LEFT_OUT.items() if isinstance(section, kind))
    key, other = (
        section.path if section.of_flow else key,
        f": the file holds {', '.join(info.other)}" * bool(info.other),
    )
    return placed_warnings(key, section, info, box_corners(info.grown_box(section)), others, left_out, other)


GEOMETRY = Kind(
    name="geometry",
    sections=tuple(GEOMETRY_SECTIONS),
    facts=GeometryInfo,
    changing=(
        *("color", "cmap", "clim", "opacity", "culling", "edges"),
        *("ambient", "diffuse", "specular", "specular_power"),
    ),
    open=open_geometry,
    complete=complete_geometry,
    summary=summary,
    legend=legend,
    warnings=warnings,
    must_fit=True,
    read=lambda section: read_geometry(section.path),
    referenced=lambda section, data: (section, part_of(section, data)),
)
