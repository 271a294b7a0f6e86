"""Annotation of a finished picture."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from clusterviz.annotations.axes import AxisTicks, draw_orientation, draw_scale_bar
from clusterviz.annotations.box import Box, adjacent_front_faces, box_of, edge_shares, grid_lines, projected
from clusterviz.annotations.canvas import Canvas, Colour, Overlay, Rect
from clusterviz.annotations.fixed import draw_fixed, time_text
from clusterviz.annotations.scalar_bar import Style
from clusterviz.content.complete import content_corners
from clusterviz.content.facts import Facts, box_corners
from clusterviz.content.sections import CONTENT_SECTIONS
from clusterviz.content.summary import legends_of
from clusterviz.content.table import entries_of
from clusterviz.scene.annotations import Annotations, AxesGrid, ScalarBar, section_of
from clusterviz.scene.background import background_rgb
from clusterviz.scene.values import Scene

LEAST_SIDE = 128
"""Smallest side of a picture with text, pixels; smaller ones have outline and grid lines alone."""
LEAST_FONT = 9.0
"""Smallest size of text, pixels."""
OUTLINE, GRID = 0.85, 0.3
"""Opacity of the outline and of grid lines."""
INKS: tuple[Colour, Colour] = ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))


def annotated(picture: NDArray[np.float32], scene: Scene, infos: Sequence[Facts]) -> NDArray[np.float32]:
    """Return a picture with the annotations of its scene.

    Lines in front of the data are blended over the picture, lines behind it under it (see `annotations.box`), and text
    over both, on a halo of the background's colour. Everything is part of the picture, before its background.

    Parameters
    ----------
    picture : float32 (h, w, 4), premultiplied, before the background; it is not changed
    scene : completed
    infos : on its volumes, geometry and grids

    Returns
    -------
    annotated : float32 (h, w, 4), premultiplied; `picture` itself if nothing is to be drawn

    Raises
    ------
    ClustervizError
        matplotlib is not installed.
    """
    settings = scene.annotations
    if settings.is_empty or not picture.size:
        return picture
    height, width = picture.shape[:2]
    style = _style(settings, background_rgb(scene.image.background), min(width, height))
    scene = _with_names(scene, infos)
    has_text = min(width, height) >= LEAST_SIDE
    fixed, rects = _fixed(scene, (width, height), style) if has_text else (None, ())
    behind, front, text = _of_camera(scene, infos, (width, height), style, list(rects), has_text)
    found = picture.copy()
    for overlay in behind:
        overlay.blend_under(found)
    for overlay in (*front, *text, *([fixed] if fixed is not None else [])):
        overlay.blend_over(found)
    return found


def _with_names(scene: Scene, infos: Sequence[Facts]) -> Scene:
    """Return a scene whose entries name the arrays that they show."""

    def named(section: Any, info: Facts) -> Any:
        return section.model_copy(update={"array": info.array}) if info.array and not section.shown_array else section

    return scene.with_entries({each.key: named(each.section, each.info) for each in entries_of(scene, infos)})


def _style(settings: Annotations, background: Colour | None, side: int) -> Style:
    font = max(LEAST_FONT, settings.font_size * side)
    if settings.color is not None:
        ink = background_rgb(settings.color) or INKS[0]
        return Style(font, ink, background or _contrasting(ink))
    # Text on a transparent background is readable on any by its halo.
    ink = INKS[0] if background is None else _contrasting(background)
    return Style(font, ink, background or _contrasting(ink))


def _contrasting(colour: Colour) -> Colour:
    """Return black or white, whichever has more contrast."""
    return max(INKS, key=lambda ink: contrast(ink, colour))


def contrast(a: Colour, b: Colour) -> float:
    """Return the contrast ratio of two sRGB colours, 1 to 21.

    References
    ----------
    W3C, Web Content Accessibility Guidelines 2.2: relative luminance and contrast ratio; text needs 4.5.
    """
    low, high = sorted(_luminance(colour) for colour in (a, b))
    return (high + 0.05) / (low + 0.05)


def _luminance(colour: Colour) -> float:
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in colour]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def _fixed(scene: Scene, size: tuple[int, int], style: Style) -> tuple[Overlay, tuple[Rect, ...]]:
    """Return the overlay of what does not depend on the camera, and the rectangles in use; it is kept for later."""
    shown = Scene(annotations=scene.annotations).model_copy(
        update={name: getattr(scene, name) for name in CONTENT_SECTIONS}
    )
    return _kept_fixed(shown, size, style)


@lru_cache(maxsize=4)
def _kept_fixed(scene: Scene, size: tuple[int, int], style: Style) -> tuple[Overlay, tuple[Rect, ...]]:
    canvas = Canvas(size)
    rects = draw_fixed(canvas, style, scene.annotations, legends_of(scene), time_text(scene))
    return canvas.overlay(style.halo, 0.13 * style.font), rects


def _of_camera(
    scene: Scene, infos: Sequence[Facts], size: tuple[int, int], style: Style, rects: list[Rect], has_text: bool
) -> tuple[list[Overlay], list[Overlay], list[Overlay]]:
    settings, camera = scene.annotations, scene.camera
    axes = section_of(settings.axes, AxesGrid)
    behind, front, text = (Canvas(size) for _ in range(3))
    orientation = next((info.orientation for info in infos if info.orientation), "")
    titles = axes.titles if axes else AxesGrid().titles
    if has_text and settings.orientation:
        rects.append(draw_orientation(text, style, camera, titles, orientation))
    if has_text and settings.scale_bar:
        rects.append(draw_scale_bar(text, style, camera, settings.unit))
    corners = content_corners(scene, infos)
    if len(corners) and (settings.outline or axes):
        box, aligned = box_of(corners), box_of(box_corners(np.stack([corners.min(axis=0), corners.max(axis=0)])))
        faces = aligned.front_faces(camera)
        boxes = [box] if settings.outline else []
        if axes and not (settings.outline and box.is_aligned):
            boxes.append(aligned)
        for one in boxes:
            _draw_edges(one, scene, size, style, behind, front)
        if axes:
            bars = section_of(settings.scalar_bar, ScalarBar) or ScalarBar()
            side: Literal["left", "right"] = "left" if bars.position == "right" else "right"
            along = AxisTicks(aligned, faces, camera, size, style.font, side)
            if axes.grid:
                shares = grid_lines(along.shares, faces)
                behind.lines(projected(camera, aligned.point(shares), size)[0], style.ink, style.line, GRID)
            if has_text:
                along.draw(text if faces.any() else behind, style, titles, settings.unit, rects)
    halo = style.halo, 0.13 * style.font
    return [behind.overlay()], [front.overlay()], [text.overlay(*halo)]


def _draw_edges(box: Box, scene: Scene, size: tuple[int, int], style: Style, behind: Canvas, front: Canvas) -> None:
    edges = np.concatenate([edge_shares(axis) for axis in range(3)])
    is_front = adjacent_front_faces(edges, box.front_faces(scene.camera)) > 0
    for canvas, chosen in ((behind, edges[~is_front]), (front, edges[is_front])):
        lines, _ = projected(scene.camera, box.point(chosen), size)
        canvas.lines(lines, style.ink, 1.3 * style.line, OUTLINE)
