"""Volumes as a kind of content: how they are completed and described."""

from __future__ import annotations

import math
from pathlib import PurePath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.content.automatic import classify_values
from clusterviz.content.contract import Kind, LegendEntry
from clusterviz.content.description import OPACITY_VARIES, name_of, ramp, span, transfer_summary, unseen_scalars
from clusterviz.content.facts import LARGEST
from clusterviz.content.transfer import default_opacity, transfer_function
from clusterviz.content.volume.info import VolumeInfo, default_clim
from clusterviz.content.volume.opening import open_volumes
from clusterviz.content.volume.section import Volume
from clusterviz.data import open_volume
from clusterviz.errors import public_address
from clusterviz.scene.blend_modes import BLEND_MODES
from clusterviz.scene.transfer_2d import Transfer2d, load_table

DEFAULT_CMAP = "bone"
MOST_BINS = 256
"""Bins of a histogram that clients of the viewer are told, at most."""


def complete_volume(volume: Volume, info: VolumeInfo) -> Volume:
    """Return a volume with its part of the file, and colour map, clim, opacity and unit distance in place of optics."""
    parts = {key: part for key, part in info.parts.items() if getattr(volume, key) is None}
    volume = volume.model_copy(update=parts)
    if volume.optics is not None:
        return volume
    clim = volume.clim or default_clim(info)
    cmap = DEFAULT_CMAP if volume.cmap is None else volume.cmap
    found: dict[str, object] = {"clim": clim, "cmap": cmap}
    if volume.transfer_2d is not None:
        found["transfer_2d"] = _completed_table(volume.transfer_2d, clim, min(info.spacing))
    elif volume.opacity is None:
        found["opacity"] = 1.0 if volume.shader is not None else default_opacity(cmap, clim)
    if volume.opacity_unit_distance is None:
        found["opacity_unit_distance"] = default_unit_distance(info.shape_zyx, info.spacing)
    if BLEND_MODES[volume.blending].threshold and volume.threshold is None:
        found["threshold"] = clim[0] / 2 + clim[1] / 2
    return volume.model_copy(update=found)


def visible_corners(volume: Volume, info: VolumeInfo) -> NDArray[np.float64]:
    """Return the corners, float64 (n, 3), of all blocks of a completed volume that are not transparent."""
    mode = BLEND_MODES[volume.blending]
    if info.blocks is None or mode.shows_transparent or min(info.shape_zyx) == 1:
        return info.corners
    low, high = info.blocks
    surfaces = [each[0] if isinstance(each, tuple) else each for each in volume.isosurfaces]
    seen = np.zeros(low.shape, bool)
    if not mode.only_surfaces:
        seen |= ~transfer_function(volume).is_transparent(low, high)
    for value in surfaces:
        seen |= (low <= value) & (value <= high)
    is_end = np.zeros([side + 1 for side in seen.shape], bool)
    for z, y, x in np.ndindex(2, 2, 2):
        is_end[z : z + seen.shape[0], y : y + seen.shape[1], x : x + seen.shape[2]] |= seen
    ends = np.argwhere(is_end)
    shares = np.minimum(1.0, ends * info.block_sides / (np.array(info.shape_zyx) - 1.0))
    # Corners are in x-fastest order, so corners 1, 2 and 4 end the three edges from the first corner.
    first, edges = info.corners[0], info.corners[[1, 2, 4]] - info.corners[0]
    return np.asarray(first + shares[:, ::-1] @ edges)


def default_unit_distance(shape_zyx: tuple[int, int, int], spacing: tuple[float, float, float]) -> float:
    """Return PyVista's default, diagonal / (mean dimension − 1), or the smallest spacing for a single sample.

    References
    ----------
    PyVista, `Plotter.add_volume`, parameter `opacity_unit_distance`.
    """
    steps = sum(shape_zyx) / 3 - 1
    diagonal = math.hypot(*((n - 1) * s for n, s in zip(shape_zyx[::-1], spacing, strict=True)))
    distance = diagonal / steps if steps > 0 else 0.0
    return distance if 0 < distance < math.inf else min(spacing)


def _completed_table(settings: Transfer2d, clim: tuple[float, float], spacing: float) -> Transfer2d:
    """Return a table with both ranges; magnitudes end at a quarter of clim a voxel, as in VTK."""
    steepest = min(0.25 * (clim[1] / 2 - clim[0] / 2) / (spacing / 2), LARGEST)
    magnitudes = settings.magnitudes or (0.0, steepest)
    return settings.model_copy(update={"values": settings.values or clim, "magnitudes": magnitudes})


def summary(_: str, volume: Volume) -> str:
    """Return how a completed volume looks, in one line."""
    opacity: Any = volume.opacity
    if volume.optics is not None:
        at = volume.optics.wavelengths
        return f"optics at {len(at)} wavelengths, {at[0]:g} to {at[-1]:g} nm"
    if volume.transfer_2d is not None:
        opacity = "of transfer_2d"
    elif BLEND_MODES[volume.blending].only_surfaces:
        opacity = f"of isosurfaces {', '.join(f'{_surface_value(each):g}' for each in volume.isosurfaces)}"
    return transfer_summary(volume.clim, volume.shader or volume.cmap, opacity)


def _surface_value(surface: Any) -> float:
    return float(surface[0] if isinstance(surface, tuple) else surface)


def legend(volume: Volume) -> LegendEntry:
    """Return how a completed volume is listed."""
    name = name_of(volume)
    if volume.shader is not None or volume.optics is not None:
        return LegendEntry(name, np.empty((0, 3)))
    transfer, mode = transfer_function(volume), BLEND_MODES[volume.blending]
    values = [each if isinstance(each, tuple) else (each, float(transfer.opacity(each))) for each in volume.isosurfaces]
    table = load_table(volume.transfer_2d) if volume.transfer_2d is not None else None
    has_opacity = not mode.only_surfaces and np.ptp(transfer.opacities) > OPACITY_VARIES
    return LegendEntry(name, ramp(transfer), transfer, tuple(values), bool(has_opacity), table)


def panel(_: Volume, info: VolumeInfo) -> dict[str, Any]:
    """Return shape, statistics and box of a volume."""
    counts = info.histogram if info.histogram is not None else np.zeros(0, np.int64)
    return {
        "shape_zyx": list(info.shape_zyx),
        "spacing": list(info.spacing),
        "is_integer": info.is_integer,
        "minimum": info.minimum,
        "maximum": info.maximum,
        "percentiles": {"1": info.percentile_1, "99": info.percentile_99},
        "histogram": {"low": info.minimum, "high": info.maximum, "counts": counts[:MOST_BINS].tolist()},
        "corners": info.corners.tolist(),
        "orientation": info.orientation,
    }


def warnings(key: str, volume: Volume, info: VolumeInfo, _: Any = ()) -> dict[str, str]:
    """Return why a volume is invisible from all cameras; components of a flow's vectors are meant to be."""
    reason = "" if volume.is_hidden else _unseen(volume, info)
    if not reason:
        return {}
    if volume.of_flow:
        return {volume.path: f"{volume.path}: {reason}"}
    name = "" if volume.path == "array" else f" ({PurePath(public_address(volume.path)).name})"
    return {key: f"{key}{name}: {reason}"}


def _blank(volume: Volume, info: VolumeInfo) -> str:
    clim = span(*(volume.clim or (math.nan, math.nan)))
    return f"check opacity, clip, blending; data {span(info.minimum, info.maximum)}, clim {clim}"


def _unseen(volume: Volume, info: VolumeInfo) -> str:
    if not info.finite:
        return f"all {math.prod(info.shape_zyx)} samples are NaN or infinite: nothing is drawn"
    data = f"the data's range {span(info.minimum, info.maximum)}"
    found = []
    values = [surface if isinstance(surface, (int, float)) else surface[0] for surface in volume.isosurfaces]
    if values and not any(info.minimum <= value <= info.maximum for value in values):
        found.append(f"no isosurface, since {', '.join(f'{value:g}' for value in values)} lies beyond {data}")
    if not BLEND_MODES[volume.blending].only_surfaces:
        found.append(_unseen_values(volume, info.minimum, info.maximum, has_surfaces=bool(values and not found)))
    return "; ".join(filter(None, found))


def _unseen_values(volume: Volume, low: float, high: float, has_surfaces: bool) -> str:
    """Return why optics or the transfer function show nothing, or one colour, of a range of values, or ""."""
    if volume.optics is None:
        return unseen_scalars(volume, low, high, has_surfaces)
    empty = transfer_function(volume).is_transparent(low, high).all()
    return (
        f"optics absorb and scatter nothing all over the data's range {span(low, high)}: nothing is drawn"
        if empty
        else ""
    )


def _unchecked(volume: Volume) -> str:
    """Return that the reference compiles no shaders, and takes no slopes between levels."""
    if volume.shader:
        return f"does not read shaders such as {volume.shader}"
    slopes = volume.shade or volume.gradient_opacity or volume.transfer_2d or volume.interpolation == "cubic"
    return "has no gradients of coarser levels" if volume.detail != "full" and slopes else ""


VOLUME = Kind(
    name="volumes",
    sections=("volumes",),
    facts=VolumeInfo,
    opened=("path", "array", "channel", "detail", "labels", "spacing", "origin", "direction"),
    open=open_volumes,
    complete=complete_volume,
    corners=lambda _, info: info.corners,
    visible=visible_corners,
    summary=summary,
    legend=legend,
    panel=panel,
    warnings=warnings,
    blank=_blank,
    read=open_volume,
    unchecked=_unchecked,
    faint=(
        "gradient_opacity=[]",
        "transfer_2d=null",
        "opacity_unit_distance=null",
        "blending=composite",
        "optics=null",
    ),
    preset=lambda volume, info: volume.preset or classify_values(info),
)
