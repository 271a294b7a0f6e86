"""Contents of a scene as scalar bars and the legend show them: names, colours and opacity."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clusterviz.content.flow.section import FlowSection
from clusterviz.content.geometry.section import GeometrySection, LinesSection
from clusterviz.content.grid.section import GridSection
from clusterviz.errors import public_address
from clusterviz.scene.background import background_rgb
from clusterviz.scene.blend_modes import BLEND_MODES
from clusterviz.scene.colormaps import colour_points
from clusterviz.scene.complete import transfer_function
from clusterviz.scene.transfer import TransferFunction, opacity_points, rescale
from clusterviz.scene.transfer_2d import TransferTable, load_table
from clusterviz.scene.values import Scene, Volume

RAMP = 24
"""Colours of a transfer function in the legend."""
DIRECTIONS = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
OPACITY_VARIES = 0.01


@dataclass(frozen=True, eq=False)
class Content:
    """Content of a scene.

    Attributes
    ----------
    colours : float64 (n, 3), straight, for the legend; (0, 3) if they are not known
    transfer : transfer function; None without scalars, and if a shader gives the colours
    surfaces : scalars and opacities of isosurfaces
    has_opacity : whether opacity is a function of the scalars beside the surfaces
    table : two-dimensional transfer function
    """

    name: str
    colours: NDArray[np.float64]
    transfer: TransferFunction | None = None
    surfaces: tuple[tuple[float, float], ...] = ()
    has_opacity: bool = False
    table: TransferTable | None = None


def contents_of(scene: Scene) -> list[Content]:
    """Return the contents of a completed scene: volumes, meshes, lines, points, grids and flows, in this order."""
    return [
        *(_volume(volume) for volume in scene.volumes if not volume.of_flow),
        *(_geometry(section) for section in scene.geometry if not section.of_flow),
        *(_of_transfer(name_of(grid), transfer_function(grid)) for grid in scene.grids),
        # Lines and a volume of the same vectors share a bar.
        *({(_flow_name(flow), flow.cmap, flow.clim, flow.color): _flow(flow) for flow in scene.flows}.values()),
    ]


def name_of(section: Volume | GeometrySection | GridSection | FlowSection) -> str:
    """Return the name of the array that a section shows, or of its file."""
    array = section.scalars if isinstance(section, GeometrySection) else section.array
    if array is not None and not (isinstance(section, GeometrySection) and section.clim is None):
        return array
    if section.path.startswith("field:"):
        return section.path.split(":")[1]
    file = re.split(r":/", section.path)[-1] if "://" not in section.path else public_address(section.path)
    return Path(file).name.split(".")[0] or section.path


def _volume(volume: Volume) -> Content:
    name = name_of(volume)
    if volume.shader is not None or volume.optics is not None:
        return Content(name, np.empty((0, 3)))
    transfer, mode = transfer_function(volume), BLEND_MODES[volume.blending]
    values = [each if isinstance(each, tuple) else (each, float(transfer.opacity(each))) for each in volume.isosurfaces]
    table = load_table(volume.transfer_2d) if volume.transfer_2d is not None else None
    has_opacity = not mode.only_surfaces and np.ptp(transfer.opacities) > OPACITY_VARIES
    return Content(name, _ramp(transfer), transfer, tuple(values), bool(has_opacity), table)


def _geometry(section: GeometrySection) -> Content:
    name = name_of(section)
    if isinstance(section, LinesSection) and section.color_by == "direction":
        return Content(name, np.array(DIRECTIONS))
    has_scalars = section.scalars is not None and section.clim is not None
    if not has_scalars or (isinstance(section, LinesSection) and section.color_by == "color"):
        return Content(name, np.array([background_rgb(section.color) or (0.5, 0.5, 0.5)]))
    assert section.clim is not None
    colours, opacities = colour_points(section.cmap, section.clim), opacity_points(section.opacity, section.clim)
    low, high = section.clim
    domain = (low, high) if low < high else (low - 0.5, high + 0.5)
    return _of_transfer(name, TransferFunction(*colours, *opacities, 1.0, domain))


def _flow(flow: FlowSection) -> Content:
    name = _flow_name(flow)
    if flow.color_by == "direction":
        return Content(name, np.array(DIRECTIONS))
    if flow.color_by == "color" or flow.clim is None:
        return Content(name, np.array([background_rgb(flow.color) or (0.5, 0.5, 0.5)]))
    colours, visible = colour_points(flow.cmap, flow.clim), (np.zeros(1), np.ones(1))
    low, high = flow.clim
    domain = (low, high) if low < high else (low - 0.5, high + 0.5)
    return _of_transfer(name, TransferFunction(*colours, *visible, 1.0, domain))


def _flow_name(flow: FlowSection) -> str:
    if flow.color_by != "speed":
        return name_of(flow)
    return f"speed of {flow.array}" if flow.array and "," not in flow.array else "speed"


def _of_transfer(name: str, transfer: TransferFunction) -> Content:
    return Content(name, _ramp(transfer), transfer, (), bool(np.ptp(transfer.opacities) > OPACITY_VARIES))


def _ramp(transfer: TransferFunction) -> NDArray[np.float64]:
    """Return colours of the visible scalars, float64 (RAMP, 3); of all if none is visible."""
    scalars = rescale(np.linspace(0, 1, 1024), transfer.domain)
    visible = scalars[transfer.opacity(scalars) > OPACITY_VARIES]
    chosen = visible if len(visible) else scalars
    return transfer.colour(chosen[np.linspace(0, len(chosen) - 1, RAMP).astype(int)])
