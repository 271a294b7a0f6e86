"""Scene completion: unset keys are filled from facts on the content."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clusterviz.content.automatic import automatic_scene
from clusterviz.content.contract import Entry
from clusterviz.content.facts import Facts, box_corners
from clusterviz.content.table import KINDS, drawn_entries, entries_of, infos_of
from clusterviz.scene.camera import DEFAULT_ORIENTATION, MARGIN, fitted_camera, is_completed
from clusterviz.scene.values import Scene

AXES_LABELS = 7.5
"""Margin of a fitted scene with an axes grid, whose labels are outside of the box, as a multiple of the font size."""


def complete_scene(scene: Scene, infos: Sequence[Facts] | Facts) -> Scene:
    """Return a scene in which no key that rendering needs is unset.

    The function is pure: ranks with equal information get equal scenes.

    Values that are set are kept. Facts are in the order of `content.table.entries_of`, with those that flows become.

    Returns
    -------
    scene : volumes and grids have cmap, clim, opacity and unit distance, geometry clim and a radius; the camera has
        position, focal_point and view_up; with refraction ranks share the screen
    """
    infos = (infos,) if isinstance(infos, Facts) else infos
    for kind in KINDS:
        scene = kind.becomes(scene, infos_of(kind, infos)) if kind.becomes else scene
    scene = automatic_scene(scene, infos)
    entries = [replace(one, section=one.kind.complete(one.section, one.info)) for one in entries_of(scene, infos)]
    scene = scene.with_entries({entry.key: entry.section for entry in entries})
    if scene.refracts:
        # Rays bend, so that any rank may need any brick.
        scene = scene.model_copy(update={"cluster": scene.cluster.model_copy(update={"mode": "sort-first"})})
    if is_completed(scene.camera):
        return scene
    return _with_camera(scene, [entry for entry in entries if entry.kind.becomes is None])


def _with_camera(scene: Scene, entries: Sequence[Entry]) -> Scene:
    boxes = [entry.kind.corners(entry.section, entry.info) for entry in entries]
    seen = [entry.kind.visible(entry.section, entry.info) for entry in entries]
    if scene.annotations.outline or scene.annotations.axes or not any(map(len, seen)):
        seen += boxes
    corners = np.concatenate(seen or [np.zeros((1, 3))])
    corners = corners if len(corners) else np.zeros((1, 3))
    # The size of a volume of one sample.
    spacing = min((entry.info.smallest_spacing for entry in entries if entry.info.smallest_spacing), default=0.0)
    orientation = next((entry.info.orientation for entry in entries if entry.info.orientation), "")
    margin = min(0.5, AXES_LABELS * scene.annotations.font_size) if scene.annotations.axes else MARGIN
    axes = {entry.info.axes for entry in entries}
    up = axes.pop() if len(axes) == 1 else ""
    size = scene.image.size
    camera = fitted_camera(scene.camera, corners, spacing, size, orientation, margin, up or DEFAULT_ORIENTATION)
    return scene.model_copy(update={"camera": camera})


def content_corners(scene: Scene, infos: Sequence[Facts]) -> NDArray[np.float64]:
    """Return the corners of a box around all content of a completed scene, float64 (8, 3), x fastest; (0, 3) of none.

    The box of a single entry has its own directions, any other the world's.
    """
    boxes = [entry.kind.corners(entry.section, entry.info) for entry in drawn_entries(scene, infos)]
    if len(infos) == len(boxes) == 1:
        return boxes[0]
    points = np.concatenate([np.empty((0, 3)), *boxes])
    return box_corners(np.stack([points.min(axis=0), points.max(axis=0)]) if len(points) else points)
