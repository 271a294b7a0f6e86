"""Warnings about content that is not visible, found without reading voxels or primitives."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import PurePath

import numpy as np
from numpy.typing import NDArray

from clusterviz.content.flow.expansion import VectorVolume
from clusterviz.content.geometry.section import GeometryInfo, GeometrySection, LinesSection
from clusterviz.content.grid.section import GridInfo, GridSection
from clusterviz.errors import public_address
from clusterviz.scene.blend_modes import BLEND_MODES
from clusterviz.scene.camera import project_points
from clusterviz.scene.colormaps import follows_clim
from clusterviz.scene.complete import Info, VolumeInfo, box_corners, divided_infos, transfer_function
from clusterviz.scene.values import Scene, Volume

SMALL = 2.0
"""Pixels; a scene is too small if its width and height are below this and a quarter of the picture's."""


def visibility_warnings(scene: Scene, infos: Sequence[Info], is_blank: bool) -> dict[str, str]:
    """Return warnings about content that the picture does not show, and about geometry far from all else.

    Parameters
    ----------
    scene : a completed scene
    infos : information on each volume, entry of geometry and unstructured grid
    is_blank : whether all pixels of the picture are transparent

    Returns
    -------
    warnings : subject -> one line; frames of an animation report a subject once
    """
    if not scene.has_content:
        return {"volumes": "the scene has no volumes: nothing is drawn"}
    each, known, gridded = divided_infos(infos)
    keyed = zip(scene.geometry_keys, scene.geometry, known, strict=True)
    entries: list[Entry] = [(section.path if section.of_flow else key, section, info) for key, section, info in keyed]
    keys = [f"grids[{number}]" for number in range(len(scene.grids))]
    entries += zip(keys, scene.grids, gridded, strict=True)
    found = _entry_warnings(entries, each)
    for key, section, one in zip(keys, scene.grids, gridded, strict=True):
        if one.scalars and (reason := _unseen_scalars(section, *one.scalars)):
            found[key] = f"{key} ({PurePath(section.path).name}): {reason}"
    for number, (volume, info) in enumerate(zip(scene.volumes, each, strict=True)):
        reason = _unseen_volume(volume, info)
        if reason and isinstance(volume, VectorVolume):
            continue
        if reason and volume.of_flow:
            found[volume.path] = f"{volume.path}: {reason}"
        elif reason:
            name = "" if volume.path == "array" else f" ({PurePath(public_address(volume.path)).name})"
            found[f"volumes[{number}]"] = f"volumes[{number}]{name}: {reason}"
    boxes = [box_corners(_box_of(*entry)) for entry in entries]
    corners = np.concatenate([*(info.corners for info in each), *boxes])
    beyond = _out_of_sight(scene, corners) if len(corners) else ""
    if beyond:
        found["camera"] = beyond
    if is_blank and not found and entries:
        found["picture"] = "the picture is empty: check opacity, culling and clip"
    if is_blank and not found:
        first, info = scene.volumes[0], each[0]
        found["picture"] = (
            f"the picture is empty: check opacity, clip, blending; data {_span(info.minimum, info.maximum)}, "
            f"clim {_span(*(first.clim or (math.nan, math.nan)))}"
        )
    return found


LEFT_OUT = {
    "meshes": "triangles are left out: a vertex is not finite, or they have no area",
    "lines": "segments are left out: an end is not finite, or they have no length",
    "points": "points are left out: they are not finite, or have no positive radius or no direction",
    "grids": "cells are left out: a corner or value is not finite, or they have no volume",
}
Entry = tuple[str, GeometrySection | GridSection, GeometryInfo | GridInfo]


def _box_of(_: str, section: GeometrySection | GridSection, info: GeometryInfo | GridInfo) -> NDArray[np.float64]:
    if isinstance(info, GridInfo) or isinstance(section, GridSection):
        return info.box
    return info.grown_box(section)


def _entry_warnings(entries: Sequence[Entry], volumes: Sequence[VolumeInfo]) -> dict[str, str]:
    """Return warnings about what cannot be drawn, and entries farther from all others than they are long."""
    found: dict[str, str] = {}
    boxes = [np.stack([info.corners.min(axis=0), info.corners.max(axis=0)]) for info in volumes]
    boxes += [_box_of(*entry) for entry in entries]
    for number, (key, section, info) in enumerate(entries):
        name = key if section.path == key else f"{key} ({PurePath(section.path).name})"
        if info.left_out:
            share, kind = f"{info.left_out} of {info.left_out + info.drawn}", key.partition("[")[0]
            kind = kind if kind in LEFT_OUT else "lines" if isinstance(section, LinesSection) else "points"
            found[f"{key}: left out"] = f"{name}: {share} {LEFT_OUT[kind]}"
        if isinstance(info, GridInfo) and info.overlaps:
            found[f"{key}: overlap"] = (
                f"{name}: cells overlap others: of these, a ray shows the one that it enters first"
            )
        if not info.count:
            other = f": the file holds {', '.join(info.other)}" if isinstance(info, GeometryInfo) and info.other else ""
            found[key] = f"{name}: nothing is drawn{other}"
            continue
        mine = boxes[len(volumes) + number]
        others = [box for n, box in enumerate(boxes) if n != len(volumes) + number and len(box)]
        gaps = [np.linalg.norm(np.maximum(0, np.maximum(mine[0] - box[1], box[0] - mine[1]))) for box in others]
        if gaps and min(gaps) > np.linalg.norm(mine[1] - mine[0]):
            text = f"{_box(mine)} lies apart from all other content"
            found[key] = f"{name}: {text}: check the units (mm or m) and transform"
    return found


def _unseen_volume(volume: Volume, info: VolumeInfo) -> str:
    """Return why a volume is invisible from all cameras, or ""."""
    if not info.finite:
        return f"all {math.prod(info.shape_zyx)} samples are NaN or infinite: nothing is drawn"
    data = f"the data's range {_span(info.minimum, info.maximum)}"
    found = []
    values = [surface if isinstance(surface, (int, float)) else surface[0] for surface in volume.isosurfaces]
    if values and not any(info.minimum <= value <= info.maximum for value in values):
        found.append(f"no isosurface, since {', '.join(f'{value:g}' for value in values)} lies beyond {data}")
    if not BLEND_MODES[volume.blending].only_surfaces:
        found.append(_unseen_scalars(volume, info.minimum, info.maximum, has_surfaces=bool(values and not found)))
    return "; ".join(filter(None, found))


def _unseen_scalars(section: Volume | GridSection, low: float, high: float, has_surfaces: bool = False) -> str:
    """Return why the transfer function shows nothing, or one colour, of a range of scalars, or ""."""
    data, clim = f"the data's range {_span(low, high)}", section.clim
    if isinstance(section, Volume) and section.optics is not None:
        empty = transfer_function(section).is_transparent(low, high).all()
        return f"optics absorb and scatter nothing all over {data}: nothing is drawn" if empty else ""
    if clim is None:
        return ""
    beyond = clim[0] > high or clim[1] < low
    where = f"clim {_span(*clim)} lies beyond {data}" if beyond else f"opacity is 0 all over {data}"
    if not has_surfaces and transfer_function(section).is_transparent(low, high).all():
        return f"{where}: nothing is drawn"
    return f"{where}: all of it has one colour" if beyond and follows_clim(section.cmap or "") else ""


def _out_of_sight(scene: Scene, corners: np.ndarray) -> str:
    """Return why the scene's box is outside the picture or too small, or ""."""
    camera, (width, height) = scene.camera, scene.image.size
    pixels, ahead = project_points(camera, corners, scene.image.size)
    if (ahead <= 0).all():
        return (
            f"the camera looks away: from {_point(camera.position)} towards {_point(camera.focal_point)} all of "
            f"{_box(corners)} lies behind the eye"
        )
    if (ahead <= 0).any():
        return ""
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    if (high <= 0).any() or (low >= (width, height)).any():
        return (
            f"the scene lies beside the picture: {_box(corners)} would be at pixels {_span(low[0], high[0])}, "
            f"{_span(low[1], high[1])} of {width} × {height}"
        )
    if (high - low < np.minimum(SMALL, 0.25 * np.array([width, height]))).all():
        far, wide = float(ahead.mean()), float(np.ptp(corners, axis=0).max())
        across = " × ".join(f"{side:.2g}" for side in high - low)
        return f"the scene covers {across} pixels: the eye is {far:g} away from a box {wide:g} wide"
    return ""


def _span(low: float, high: float) -> str:
    return f"{low:g} to {high:g}"


def _point(point: Sequence[float] | None) -> str:
    return f"({', '.join(f'{value:g}' for value in point or ())})"


def _box(corners: np.ndarray) -> str:
    return f"the box {_point(corners.min(axis=0).tolist())} to {_point(corners.max(axis=0).tolist())}"
