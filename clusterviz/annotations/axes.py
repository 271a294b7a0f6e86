"""What depends on the camera: axes grid with ticks, orientation marker, and scale bar."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from clusterviz.annotations.box import Box, adjacent_front_faces, edge_shares, projected
from clusterviz.annotations.canvas import Canvas, Colour, Rect, overlap, text_rect, text_width
from clusterviz.annotations.numbers import number_text, round_number, tick_labels, ticks
from clusterviz.annotations.scalar_bar import Style
from clusterviz.scene.camera import OPPOSITE, camera_axes, camera_vectors, half_height
from clusterviz.scene.values import Camera

Floats = NDArray[np.float64]
TICK, GAP = 0.4, 0.35
"""Length of a tick and distance of its label, in font sizes."""
TICK_DISTANCE = (4.0, 3.0)
"""Least distance of ticks from left to right, and from top to bottom, in font sizes."""
MOST_TICKS = 8
SHORTEST_EDGE = 3.0
"""Length of an edge with ticks, at least, in font sizes."""
AXIS_COLOURS: tuple[Colour, ...] = ((0.90, 0.25, 0.20), (0.15, 0.65, 0.25), (0.25, 0.45, 0.95))
"""Colours of x, y and z, red, green and blue as in ParaView."""
MARKER = 0.075
"""Length of the marker's axes, as a share of the picture's smaller side."""
SCALE_BAR = 0.22
"""Length of the scale bar, at most, as a share of the picture's width."""


class AxisTicks:
    """Ticks of the axes of a box with the world's directions.

    Parameters
    ----------
    box : with edges along x, y and z
    front : its faces that are turned to the eye, bool (3, 2)
    font : size of text, pixels
    side : side of the box with the ticks of upright axes

    Attributes
    ----------
    values : float64 (n,) of each axis, world
    shares : the same as shares of the edge
    """

    def __init__(
        self,
        box: Box,
        front: NDArray[np.bool_],
        camera: Camera,
        size: tuple[int, int],
        font: float,
        side: Literal["left", "right"],
    ) -> None:
        self._box, self._camera, self._size, self._font = box, camera, size, font
        self._outward = -1 if side == "left" else 1
        self._is_inside = not front.any()
        self.values: list[Floats] = []
        self.shares: list[Floats] = []
        self._edges: list[tuple[Floats, Floats] | None] = []
        for axis in range(3):
            edge = self._edge(axis, front)
            low, length = float(box.origin[axis]), float(box.edges[axis, axis])
            room = np.abs(edge[1][1] - edge[1][0]) / np.multiply(TICK_DISTANCE, font) if edge else np.zeros(2)
            most = min(MOST_TICKS, max(3, 1 + int(room.max())))
            values = ticks(low, low + length, most) if length > 0 else np.empty(0)
            self.values.append(values)
            self.shares.append((values - low) / length if length > 0 else values)
            self._edges.append(edge[:2] if edge else None)

    def draw(self, canvas: Canvas, style: Style, titles: Sequence[str], unit: str, rects: list[Rect]) -> None:
        """Draw ticks, labels and titles; labels that would overlap others, or leave the picture, are left out.

        `rects`: in use; those of the labels are added.
        """
        centre = self._centre()
        for axis, (values, edge) in enumerate(zip(self.values, self._edges, strict=True)):
            if edge is None or not len(values):
                continue
            ends, line = edge
            along = line[1] - line[0]
            outward = np.array([along[1], -along[0]]) / np.linalg.norm(along)
            if (outward @ (line.mean(axis=0) - centre) < 0) != self._is_inside:
                outward = -outward
            labels, factor = tick_labels(values)
            marks = np.repeat(ends[None, 0], len(values), axis=0)
            marks[:, axis] = values
            pixels, is_seen = projected(self._camera, np.stack([marks, marks], axis=1), self._size)
            reach = 0.0
            for (begin, _), label in zip(pixels, np.array(labels)[is_seen], strict=True):
                canvas.lines([[begin, begin + TICK * style.font * outward]], style.ink, style.line)
                away = _extent(label, style.font, outward)
                if self._put(canvas, style, label, begin + ((TICK + GAP) * style.font + away) * outward, rects):
                    reach = max(reach, 2 * away)
            title = ", ".join(part for part in (titles[axis], f"{factor} {unit}".strip()) if part)
            gap = (TICK + 2 * GAP) * style.font + reach + _extent(title, style.font, outward)
            self._put(canvas, style, title, line.mean(axis=0) + gap * outward, rects)

    def _edge(self, axis: int, front: NDArray[np.bool_]) -> tuple[Floats, Floats, float] | None:
        """Return the ends of the edge that has the ticks of an axis, world and pixels, and its length in pixels.

        It is on the outline of the projected box, at its lower side, or on the left or right. From inside of the box it
        is the longest that is seen.
        """
        shares = edge_shares(axis)
        if not self._is_inside:
            shares = shares[adjacent_front_faces(shares, front) == 1]
        ends = self._box.point(shares)
        pixels, is_seen = projected(self._camera, ends, self._size)
        lengths = np.linalg.norm(pixels[:, 1] - pixels[:, 0], axis=1)
        found = [
            (each, line, float(length))
            for each, line, length in zip(ends[is_seen], pixels, lengths, strict=True)
            if length >= SHORTEST_EDGE * self._font
        ]
        if not found:
            return None
        if self._is_inside:
            return max(found, key=lambda edge: edge[2])
        along = np.abs(found[0][1][1] - found[0][1][0])
        is_level = along[0] >= along[1]
        return max(
            found, key=lambda edge: float(edge[1][:, 1].mean() if is_level else self._outward * edge[1][:, 0].mean())
        )

    def _centre(self) -> Floats:
        every = np.concatenate([edge_shares(axis) for axis in range(3)])
        lines, _ = projected(self._camera, self._box.point(every), self._size)
        is_outline = len(lines) and not self._is_inside
        middle: Floats = lines.reshape(-1, 2).mean(axis=0) if is_outline else np.array(self._size) / 2
        return middle

    def _put(self, canvas: Canvas, style: Style, text: str, at: Floats, rects: list[Rect]) -> bool:
        """Draw text centred at a point if there is room; return whether there was."""
        rect = text_rect(at, text, style.font, "centre")
        is_inside = rect[0] >= 0 and rect[1] >= 0 and rect[2] <= canvas.size[0] and rect[3] <= canvas.size[1]
        if not text or not is_inside or overlap(rect, rects):
            return False
        rects.append(canvas.text(at, text, style.font, style.ink, "centre"))
        return True


def _extent(text: str, font: float, direction: Floats) -> float:
    """Return half the length of a text's rectangle along a direction, pixels."""
    return float(abs(direction[0]) * text_width(text, font) + abs(direction[1]) * font) / 2


def draw_orientation(canvas: Canvas, style: Style, camera: Camera, titles: Sequence[str], orientation: str) -> Rect:
    """Draw the marker of the world's directions in the lower left corner; return its rectangle.

    `orientation`: letters of the body's directions, such as "RAS"; "" if unknown.
    """
    right, up, forward = camera_axes(*camera_vectors(camera))
    length = max(MARKER * min(canvas.size), 2.2 * style.font)
    reach = length + 1.3 * style.font
    centre = np.array([style.font * 0.5 + reach, canvas.size[1] - 0.5 * style.font - reach])
    letters = orientation or titles
    for axis in np.argsort(-forward):  # the farthest first
        tip = np.array([right[axis], -up[axis]])
        seen = float(np.linalg.norm(tip))
        ends = [(1.0, letters[axis])] + ([(-1.0, OPPOSITE[letters[axis]])] if orientation else [])
        for sign, letter in sorted(ends, key=lambda end: end[0]):
            canvas.lines(
                [[centre, centre + sign * length * tip]], AXIS_COLOURS[axis], (2.6 if sign > 0 else 1.0) * style.line
            )
            if sign > 0 and seen > 0.2:
                _draw_head(canvas, centre + length * tip, tip / seen, 0.5 * style.font, AXIS_COLOURS[axis])
            if seen > 0.25:
                at = centre + sign * (length * tip + 0.9 * style.font * tip / seen)
                canvas.text(at, letter, style.font, style.ink, "centre", bold=sign > 0)
    return float(centre[0] - reach), float(centre[1] - reach), float(centre[0] + reach), float(centre[1] + reach)


def _draw_head(canvas: Canvas, tip: Floats, direction: Floats, size: float, colour: Colour) -> None:
    across = np.array([-direction[1], direction[0]])
    canvas.polygon([tip + 0.4 * size * direction, tip - size * direction + 0.5 * size * across,
                    tip - size * direction - 0.5 * size * across], colour)  # fmt: skip


def draw_scale_bar(canvas: Canvas, style: Style, camera: Camera, unit: str) -> Rect:
    """Draw a bar of a round length in the lower right corner; return its rectangle.

    In perspective, the length holds at the depth of the focal point.
    """
    width, height = canvas.size
    position, focal_point, _ = camera_vectors(camera)
    distance = np.array([math.dist(position, focal_point)])
    pixel = 2 * float(half_height(camera, distance)[0]) / height
    length = round_number(SCALE_BAR * width * pixel)
    half = length / pixel / 2
    y, tick = height - 0.9 * style.font, 0.35 * style.font
    right = width - 1.5 * style.font
    left, middle = right - 2 * half, right - half
    canvas.lines([[(left, y), (right, y)]], style.ink, 2.5 * style.line)
    canvas.lines([[(x, y - tick), (x, y + tick)] for x in (left, right)], style.ink, 1.5 * style.line)
    text = canvas.text(
        (middle, y - 0.95 * style.font), f"{number_text(length)} {unit}".rstrip(), style.font, style.ink, "centre"
    )
    return min(left, text[0]), text[1], max(right, text[2]), y + tick
