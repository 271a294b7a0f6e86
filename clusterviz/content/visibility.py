"""Warnings about content that is not visible, found without reading voxels or primitives."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clusterviz.content.description import box_text, point_text, span
from clusterviz.content.facts import Facts
from clusterviz.content.table import drawn_entries
from clusterviz.scene.camera import project_points
from clusterviz.scene.values import Scene

SMALL = 2.0
"""Pixels; a scene is too small if its width and height are below this and a quarter of the picture's."""


def visibility_warnings(scene: Scene, infos: Sequence[Facts], is_blank: bool) -> dict[str, str]:
    """Return warnings about content that the picture does not show, and about geometry far from all else.

    Parameters
    ----------
    is_blank : whether all pixels of the picture are transparent

    Returns
    -------
    warnings : subject -> one line; frames of an animation report a subject once
    """
    if not scene.has_content:
        return {"volumes": "the scene has no volumes: nothing is drawn"}
    entries, found = drawn_entries(scene, infos), dict[str, str]()
    boxes = [entry.kind.corners(entry.section, entry.info) for entry in entries]
    for number, entry in enumerate(entries):
        others = boxes[:number] + boxes[number + 1 :]
        found |= entry.kind.warnings(entry.key, entry.section, entry.info, others)
    corners = np.concatenate(boxes) if boxes else np.empty((0, 3))
    if len(corners) and (beyond := _out_of_sight(scene, corners)):
        found["camera"] = beyond
    if is_blank and not found:
        # The advice of the only kind, or the general one.
        entry = entries[0] if entries[0].kind is entries[-1].kind else entries[-1]
        found["picture"] = f"the picture is empty: {entry.kind.blank(entry.section, entry.info)}"
    return found


def _out_of_sight(scene: Scene, corners: np.ndarray) -> str:
    """Return why the scene's box is outside the picture or too small, or ""."""
    camera, (width, height) = scene.camera, scene.image.size
    pixels, ahead = project_points(camera, corners, scene.image.size)
    if (ahead <= 0).all():
        return (
            f"the camera looks away: from {point_text(camera.position)} towards {point_text(camera.focal_point)} "
            f"all of {box_text(corners)} lies behind the eye"
        )
    if (ahead <= 0).any():
        return ""
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    if (high <= 0).any() or (low >= (width, height)).any():
        return (
            f"the scene lies beside the picture: {box_text(corners)} would be at pixels {span(low[0], high[0])}, "
            f"{span(low[1], high[1])} of {width} × {height}"
        )
    if (high - low < np.minimum(SMALL, 0.25 * np.array([width, height]))).all():
        far, wide = float(ahead.mean()), float(np.ptp(corners, axis=0).max())
        across = " × ".join(f"{side:.2g}" for side in high - low)
        return f"the scene covers {across} pixels: the eye is {far:g} away from a box {wide:g} wide"
    return ""
