"""Warnings about volumes that are not visible, found without reading voxels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import PurePath

import numpy as np

from clusterviz.scene.blend_modes import BLEND_MODES
from clusterviz.scene.camera import project_points
from clusterviz.scene.colormaps import follows_clim
from clusterviz.scene.complete import VolumeInfo, transfer_function
from clusterviz.scene.values import Scene, Volume

SMALL = 2.0
"""Pixels; a scene is too small if its width and height are below this and a quarter of the picture's."""


def visibility_warnings(scene: Scene, infos: Sequence[VolumeInfo], is_blank: bool) -> dict[str, str]:
    """Return warnings about volumes that the picture does not show.

    Parameters
    ----------
    scene : a completed scene
    infos : information on each volume
    is_blank : whether all pixels of the picture are transparent

    Returns
    -------
    warnings : subject -> one line; frames of an animation report a subject once
    """
    if not scene.volumes:
        return {"volumes": "the scene has no volumes: nothing is drawn"}
    found: dict[str, str] = {}
    for number, (volume, info) in enumerate(zip(scene.volumes, infos, strict=True)):
        reason = _unseen_volume(volume, info)
        if reason:
            name = "" if volume.path == "array" else f" ({PurePath(volume.path).name})"
            found[f"volumes[{number}]"] = f"volumes[{number}]{name}: {reason}"
    beyond = _out_of_sight(scene, np.concatenate([info.corners for info in infos]))
    if beyond:
        found["camera"] = beyond
    if is_blank and not found:
        first, info = scene.volumes[0], infos[0]
        found["picture"] = (
            f"the picture is empty: check opacity, clip, blending; data {_span(info.minimum, info.maximum)}, "
            f"clim {_span(*(first.clim or (math.nan, math.nan)))}"
        )
    return found


def _unseen_volume(volume: Volume, info: VolumeInfo) -> str:
    """Return why a volume is invisible from all cameras, or ""."""
    z, y, x = info.shape_zyx
    if not info.finite:
        return f"all {x * y * z} samples are NaN or infinite: nothing is drawn"
    if min(x, y, z) == 1:
        thin = ", ".join(axis for axis, n in zip("xyz", (x, y, z), strict=True) if n == 1)
        return (
            f"{x} × {y} × {z} samples, one along {thin}, as of a 2-D array: a volume fills the box from its "
            "first to its last sample, and this one has no depth: nothing is drawn"
        )
    data, clim = f"the data's range {_span(info.minimum, info.maximum)}", volume.clim
    found = []
    values = [surface if isinstance(surface, (int, float)) else surface[0] for surface in volume.isosurfaces]
    if values and not any(info.minimum <= value <= info.maximum for value in values):
        found.append(f"no isosurface, since {', '.join(f'{value:g}' for value in values)} lies beyond {data}")
    if not BLEND_MODES[volume.blending].only_surfaces and clim is not None:
        beyond = clim[0] > info.maximum or clim[1] < info.minimum
        where = f"clim {_span(*clim)} lies beyond {data}" if beyond else f"opacity is 0 all over {data}"
        if not (values and not found) and transfer_function(volume).is_transparent(info.minimum, info.maximum).all():
            found.append(f"{where}: nothing is drawn")
        elif beyond and follows_clim(volume.cmap or ""):
            found.append(f"{where}: all of it has one colour")
    return "; ".join(found)


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
