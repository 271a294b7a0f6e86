"""Volumes, lines and points that flows become: they are drawn as those of a scene are, and belong to no file.

Line integral convolution becomes four volumes on the grid of the vectors. The first three hold their components and are
not drawn; the fourth one holds the values of the convolution. Its opacity depends on the value and on the speed, its
colour on the speed, and it is lit by the direction of the lines.

References
----------
M. Zöckler, D. Stalling, H.-C. Hege: Interactive visualization of 3D-vector fields using illuminated stream lines, IEEE
Visualization 1996.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any, ClassVar

import numpy as np

from clusterviz.content.flow.section import LINES, FlowInfo, FlowSection
from clusterviz.content.geometry.section import LinesSection, PointsSection
from clusterviz.scene.background import background_rgb
from clusterviz.scene.colormaps import colour_points
from clusterviz.scene.transfer import interpolate, opacity_points
from clusterviz.scene.transfer_2d import MadeTable, TransferTable
from clusterviz.scene.values import Scene, Volume

VALUES = (0.0, 1.0)
"""Range of line integral convolution."""
DEFAULT_OPACITY = ((0.0, 0.0), (0.5, 0.0), (0.7, 0.9), (1.0, 0.9))
SLOW = 0.1
"""Share of the highest coloured speed from which on a LIC volume has its whole opacity."""
SPEED, VELOCITY = "speed", "velocity"
"""Names of the arrays of lines and points."""
ENTRIES = 256
"""Intervals of a table along values and speeds."""


class VectorVolume(Volume):
    """Volume of one component of vectors, which is not drawn."""

    of_flow: ClassVar[bool] = True
    is_hidden: ClassVar[bool] = True


class LicVolume(Volume):
    """Volume of line integral convolution, behind three volumes of the components of its vectors."""

    of_flow: ClassVar[bool] = True
    largest: float
    """Vectors in the shader have this unit."""

    @property
    def vector_unit(self) -> float:
        """The largest component."""
        return self.largest


class FlowLines(LinesSection):
    """Lines that follow a flow."""

    of_flow: ClassVar[bool] = True


class FlowPoints(PointsSection):
    """Arrows of a flow."""

    of_flow: ClassVar[bool] = True


class SpeedTable(MadeTable):
    """Table of opacity and colour over values of line integral convolution and speeds."""

    flow: FlowSection

    def table(self) -> TransferTable:
        """Return the table of a completed flow: products of both opacities, and the colour of the speed."""
        flow, top = self.flow, (self.magnitudes or (0.0, 1.0))[1]
        values, speeds = np.linspace(*VALUES, ENTRIES + 1), np.linspace(0.0, top, ENTRIES + 1)
        opacity = interpolate(values, *_columns(opacity_points(flow.opacity or 0.0, VALUES)))[:, 0]
        factor = np.ones(ENTRIES + 1)
        if flow.speed_opacity:
            points = np.array(flow.speed_opacity, np.float64).T
            factor = interpolate(speeds, *_columns((points[0], points[1])))[:, 0]
        colours = interpolate(speeds, *colour_points(flow.cmap, flow.clim or (0.0, 1.0)))
        if flow.color_by == "color":
            colours = np.broadcast_to(background_rgb(flow.color) or (1.0, 1.0, 1.0), colours.shape)
        each = np.repeat(colours[:, None], ENTRIES + 1, axis=1)
        return TransferTable(factor[:, None] * opacity, each, VALUES, (0.0, top))


def _columns(points: tuple[Any, Any]) -> tuple[Any, Any]:
    return points[0], points[1][:, None]


def with_flows(scene: Scene, infos: Sequence[FlowInfo]) -> Scene:
    """Return a scene with completed flows, and with what they become behind its own volumes, lines and points.

    What flows became earlier is replaced.
    """
    if not scene.flows:
        return scene
    flows = tuple(completed_flow(*each) for each in zip(scene.flows, infos, strict=True))
    found: dict[str, Any] = {"flows": flows}
    for name in ("volumes", "lines", "points"):
        found[name] = [each for each in getattr(scene, name) if not each.of_flow]
    for number, (flow, info) in enumerate(zip(flows, infos, strict=True)):
        key = f"flows[{number}]"
        if flow.show == "lic":
            found["volumes"] += volumes_of(flow, info, key)
        elif flow.show in LINES:
            found["lines"].append(FlowLines(**_geometry_keys(flow, key), **_line_keys(flow)))
        elif flow.show == "glyphs":
            found["points"].append(FlowPoints(**_geometry_keys(flow, key), **_arrow_keys(flow, info)))
    return scene.model_copy(update={name: tuple(entries) for name, entries in found.items()})


def without_flows(scene: Scene, hidden: Collection[str] | None = None) -> Scene:
    """Return a scene without what its flows, or those with keys such as flows[0], have become."""
    shown = [n for n in range(len(scene.flows)) if hidden is not None and f"flows[{n}]" not in hidden]
    key_of = {f"flows[{number}]": f"flows[{n}]" for n, number in enumerate(shown)}
    found = {}
    for name in ("volumes", "lines", "points"):
        entries = (each for each in getattr(scene, name) if not each.of_flow or each.path in key_of)
        found[name] = tuple(
            each.model_copy(update={"path": key_of[each.path]}) if each.of_flow else each for each in entries
        )
    return scene.model_copy(update=found)


def completed_flow(flow: FlowSection, info: FlowInfo) -> FlowSection:
    """Return a flow with clim and opacities."""
    clim = flow.clim or (0.0, info.fastest or 1.0)
    found: dict[str, object] = {"clim": clim}
    if flow.show == "lic":
        if flow.opacity is None:
            found["opacity"] = DEFAULT_OPACITY
        if flow.speed_opacity is None:
            found["speed_opacity"] = ((0.0, 0.0), (SLOW * clim[1], 1.0)) if clim[1] > 0 else ((0.0, 1.0),)
    elif flow.opacity is None and flow.show != "surface-lic":
        found["opacity"] = 1.0
    return flow.model_copy(update=found)


def volumes_of(flow: FlowSection, info: FlowInfo, key: str) -> list[Volume]:
    """Return the volumes of a completed flow that is shown by line integral convolution."""
    # A power of two, which changes no bit of the vectors.
    largest = float(2.0 ** np.ceil(np.log2(info.fastest))) if info.fastest > 0 else 1.0
    component = VectorVolume(path=key, clim=(0.0, largest), opacity=0.0, cmap="gray")
    component = component.model_copy(update={"blending": "isosurface"})
    fastest = max(flow.clim[1] if flow.clim else 0.0, *(speed for speed, _ in flow.speed_opacity or ((0.0, 0.0),)))
    table = SpeedTable(path=key, values=VALUES, magnitudes=(0.0, fastest or largest), flow=flow)
    names = ("opacity_unit_distance", "shade", "ambient", "diffuse", "specular", "specular_power")
    lic = LicVolume(path=key, array="lic", clim=VALUES, cmap="gray", largest=largest)
    of_flow = {name: getattr(flow, name) for name in names}
    return [component, component, component, lic.model_copy(update={**of_flow, "transfer_2d": table})]


def _geometry_keys(flow: FlowSection, key: str) -> dict[str, Any]:
    names = ("cmap", "clim", "opacity", "color", "shade", "ambient", "diffuse", "specular", "specular_power")
    found = {name: getattr(flow, name) for name in names}
    return {"path": key, **found}


def _arrow_keys(flow: FlowSection, info: FlowInfo) -> dict[str, Any]:
    found: dict[str, Any] = {"style": "arrows", "direction": VELOCITY}
    found |= {"radius": flow.radius} if flow.radius else {}
    found |= {"scale": flow.length / (info.fastest or 1.0)} if flow.length else {}
    needs_speed = flow.color_by == "speed" or not isinstance(flow.opacity, float)
    return found | ({"scalars": VELOCITY} if needs_speed else {})


def _line_keys(flow: FlowSection) -> dict[str, Any]:
    by = {"speed": "scalars"}.get(flow.color_by, flow.color_by)
    needs_speed = by == "scalars" or not isinstance(flow.opacity, float)
    return {"color_by": by, "radius": flow.radius} | ({"scalars": SPEED} if needs_speed else {})
