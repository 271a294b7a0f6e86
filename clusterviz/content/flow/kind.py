"""Flows as a kind of content: they are drawn as volumes, lines or points, or paint surfaces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from clusterviz.content.contract import Kind, LegendEntry, Painter
from clusterviz.content.description import legend_of, name_of, transfer_summary
from clusterviz.content.flow.expansion import with_flows
from clusterviz.content.flow.opening import OpenedFlow, open_all
from clusterviz.content.flow.section import FlowInfo, FlowSection
from clusterviz.frame.run import Run
from clusterviz.scene.values import Scene


def _painter(run: Run, scene: Scene, opened: Sequence[OpenedFlow]) -> Painter | None:
    if all(flow.show != "surface-lic" for flow in scene.flows):
        return None
    # Few scenes need it, and what it imports.
    from clusterviz.content.flow.surface_lic import SurfacePainter

    return SurfacePainter(run, opened)


def legend(flow: FlowSection) -> LegendEntry:
    """Return how a completed flow is listed."""
    name = name_of(flow)
    if flow.color_by == "speed":
        name = f"speed of {flow.array}" if flow.array and "," not in flow.array else "speed"
    # Lines and a volume of the same vectors share a bar.
    return replace(legend_of(flow, name, flow.color_by), shared=(name, flow.cmap, flow.clim, flow.color))


FLOW = Kind(
    name="flows",
    sections=("flows",),
    facts=FlowInfo,
    changing=(
        *("cmap", "clim", "opacity", "speed_opacity", "opacity_unit_distance", "color"),
        *("ambient", "diffuse", "specular", "specular_power"),
    ),
    open=open_all,
    becomes=with_flows,
    painter=_painter,
    free=OpenedFlow.free,
    complete=lambda flow, _: flow,
    corners=lambda *_: np.empty((0, 3)),
    visible=lambda *_: np.empty((0, 3)),
    summary=lambda key, flow: f"{key} {flow.show}, {transfer_summary(flow.clim, flow.cmap, flow.opacity)}",
    legend=legend,
    panel=lambda *_: {},
    warnings=lambda *_: {},
    unchecked=lambda flow: "shows no flow on surfaces" if flow.show == "surface-lic" else "",
)
