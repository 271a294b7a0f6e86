"""Words and colours with which several kinds of content describe their entries."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path, PurePath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.content.contract import Corners, LegendEntry
from clusterviz.content.transfer import transfer_function
from clusterviz.errors import public_address
from clusterviz.scene.background import background_rgb
from clusterviz.scene.colormaps import colour_points, follows_clim
from clusterviz.scene.transfer import TransferFunction, rescale

RAMP = 24
"""Colours of a transfer function in the legend."""
OPACITY_VARIES = 0.01


def name_of(section: Any) -> str:
    """Return the name of the array that a section shows, or of its file."""
    if section.shown_array is not None:
        return str(section.shown_array)
    if section.path.startswith("field:"):
        return str(section.path).split(":")[1]
    file = re.split(r":/", section.path)[-1] if "://" not in section.path else public_address(section.path)
    return Path(file).name.split(".")[0] or section.path


def legend_of(
    section: Any, name: str, by: str, opacity: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
) -> LegendEntry:
    """Return how a section is listed, coloured by direction, color, or scalars; without opacities all is visible."""
    if by == "direction":
        return LegendEntry(name, np.eye(3))
    if by == "color" or section.clim is None:
        return LegendEntry(name, np.array([background_rgb(section.color) or (0.5, 0.5, 0.5)]))
    low, high = section.clim
    domain = (low, high) if low < high else (low - 0.5, high + 0.5)
    colours, visible = colour_points(section.cmap, section.clim), opacity or (np.zeros(1), np.ones(1))
    return legend_of_transfer(name, TransferFunction(*colours, *visible, 1.0, domain))


def legend_of_transfer(name: str, transfer: TransferFunction) -> LegendEntry:
    """Return how a section with a transfer function is listed."""
    return LegendEntry(name, ramp(transfer), transfer, (), bool(np.ptp(transfer.opacities) > OPACITY_VARIES))


def ramp(transfer: TransferFunction) -> NDArray[np.float64]:
    """Return colours of the visible scalars, float64 (RAMP, 3); of all if none is visible."""
    scalars = rescale(np.linspace(0, 1, 1024), transfer.domain)
    visible = scalars[transfer.opacity(scalars) > OPACITY_VARIES]
    chosen = visible if len(visible) else scalars
    return transfer.colour(chosen[np.linspace(0, len(chosen) - 1, RAMP).astype(int)])


def transfer_summary(clim: tuple[float, float] | None, cmap: Any, opacity: Any) -> str:
    """Return a transfer function in a few words."""
    low, high = clim or (0.0, 0.0)
    colours = cmap if isinstance(cmap, str) else f"{len(cmap or ())} colours"
    if isinstance(opacity, tuple):
        opacity = " ".join(f"{value:g}:{alpha:g}" for value, alpha in abbreviated(opacity))
    return f"clim {low:g} to {high:g} ({colours}), opacity {opacity}"


def value_text(value: Any) -> str:
    """Return a colour, an opacity, a radius or a name in a few words."""
    if isinstance(value, tuple):
        return f"{len(value)} points" if isinstance(value[0], tuple) else f"({', '.join(f'{v:g}' for v in value)})"
    return value if isinstance(value, str) else f"{value:g}"


def abbreviated(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return the points at both ends of a transfer function."""
    return list(points) if len(points) <= 6 else [*points[:3], *points[-3:]]


def unseen_scalars(section: Any, low: float, high: float, has_surfaces: bool = False) -> str:
    """Return why the transfer function shows nothing, or one colour, of a range of scalars, or ""."""
    data, clim = f"the data's range {span(low, high)}", section.clim
    if clim is None:
        return ""
    beyond = clim[0] > high or clim[1] < low
    where = f"clim {span(*clim)} lies beyond {data}" if beyond else f"opacity is 0 all over {data}"
    if not has_surfaces and transfer_function(section).is_transparent(low, high).all():
        return f"{where}: nothing is drawn"
    return f"{where}: all of it has one colour" if beyond and follows_clim(section.cmap or "") else ""


def placed_warnings(
    key: str, section: Any, info: Any, mine: Corners, others: Sequence[Corners], left_out: str, more: str = ""
) -> dict[str, str]:
    """Return what cannot be drawn of an entry with primitives or cells, and whether its box is apart from all others.

    `left_out` says what is, and why, and `more` is said where nothing is drawn.
    """
    name, found = key if section.path == key else f"{key} ({PurePath(section.path).name})", dict[str, str]()
    if info.left_out:
        found[f"{key}: left out"] = f"{name}: {info.left_out} of {info.left_out + info.drawn} {left_out}"
    if not info.count:
        return found | {key: f"{name}: nothing is drawn{more}"}
    return found | _apart(key, name, mine, others)


def _apart(key: str, name: str, mine: Corners, others: Sequence[Corners]) -> dict[str, str]:
    low, high = mine.min(axis=0), mine.max(axis=0)
    boxes = [(other.min(axis=0), other.max(axis=0)) for other in others if len(other)]
    gaps = [np.linalg.norm(np.maximum(0, np.maximum(low - box[1], box[0] - high))) for box in boxes]
    if not gaps or min(gaps) <= np.linalg.norm(high - low):
        return {}
    return {key: f"{name}: {box_text(mine)} lies apart from all other content: check the units (mm or m) and transform"}


def span(low: float, high: float) -> str:
    """Return a range in words."""
    return f"{low:g} to {high:g}"


def point_text(point: Sequence[float] | None, digits: int = 6) -> str:
    """Return a point of the world in brackets."""
    return f"({', '.join(f'{value:.{digits}g}' for value in point or ())})"


def box_text(corners: Corners) -> str:
    """Return the box around corners in words."""
    return f"the box {point_text(corners.min(axis=0).tolist())} to {point_text(corners.max(axis=0).tolist())}"
