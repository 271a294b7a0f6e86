"""Arrows at points, as triangles with normals.

An arrow of length 1 begins at its point and has the proportions of VTK's: the tip is 0.35 long, the shaft's radius is
0.03, and the tip's is 10/3 of it. Around the axis a there are twelve sides; the first lies towards a × e, where e is
the coordinate axis along which a is shortest.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.geometry import Points
from clusterviz.data.primitives import NO_RADII, DrawnPrimitives
from clusterviz.errors import InputError

SIDES = 12
TIP_LENGTH, SHAFT_RADIUS, TIP_RADIUS = 0.35, 0.03, 10 / 3
"""Shares of the length, of the length, and of the shaft's radius."""
LONGEST = 1 / 20
"""Length of the longest arrow, if no scale is given, as a share of the diagonal of the points' box."""
Floats = NDArray[np.float64]


def arrows(
    points: Points,
    direction: str,
    length: float | str | None = None,
    scale: float | None = None,
    radius: float | str | None = None,
    key: str = "",
) -> DrawnPrimitives:
    """Return the triangles of arrows, with normals, of points that have a vector.

    Arrays of the points become arrays of the triangles, with the magnitude in place of the vectors.

    Parameters
    ----------
    direction : array of vectors
    length : of all arrows, or the array of their lengths; None: the magnitude
    scale : factor of the lengths; None: 1 for one length, else such that the longest is `LONGEST`
    radius : of all shafts, or the array of their radii; None: `SHAFT_RADIUS` of the length

    Raises
    ------
    InputError
        There is no such array.
    """
    vectors = _array(points, direction, 3, f"{key}.direction")
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        size = np.abs(vectors).max(axis=1, initial=0)
        scaled = vectors / np.where(size > 0, size, 1)[:, None]  # whose squares float64 holds
        magnitude = size * np.linalg.norm(scaled, axis=1)
    lengths = magnitude
    if length is not None:
        lengths = _of_each(points, length, f"{key}.length")
    drawn = points.finite & (magnitude > 0) & np.isfinite(magnitude) & (lengths > 0) & np.isfinite(lengths)
    if scale is None and not isinstance(length, float):
        placed = points.positions[points.finite].astype(np.float64)
        diagonal = float(np.linalg.norm(np.ptp(placed, axis=0))) if len(placed) else 0.0
        extent = diagonal or float(np.abs(placed).max(initial=0.0)) or 1.0
        scale = LONGEST * extent / lengths[drawn].max(initial=0.0) if drawn.any() else 1.0
    lengths = lengths * (scale or 1.0)
    radii = SHAFT_RADIUS * lengths
    if radius is not None:
        radii = _of_each(points, radius, f"{key}.radius")
        drawn &= (radii > 0) & np.isfinite(radii)
    rows = np.flatnonzero(drawn)
    axes = scaled[rows] / np.linalg.norm(scaled[rows], axis=1, keepdims=True)
    vertices, normals = _placed(points.positions[rows], axes, lengths[rows], radii[rows])
    triangles = (CORNERS + len(RADIUS) * np.arange(len(rows))[:, None, None]).reshape(-1, 3)
    return DrawnPrimitives(
        "triangle",
        vertices.astype(points.positions.dtype),
        triangles.astype(np.uint32),
        NO_RADII,
        len(drawn) - len(rows),
        {"Normals": normals.astype(np.float32)},
        {**points.attributes, direction: magnitude},
        np.repeat(rows, len(CORNERS)),
    )


def _array(points: Points, name: str, components: int, where: str) -> Floats:
    known = {n: 1 if array.ndim == 1 else array.shape[1] for n, array in points.attributes.items()}
    if known.get(name) != components:
        found = f"{name}, {known[name]} components" if name in known else name
        allowed = ", ".join(n for n, count in known.items() if count == components) or "none: there are none"
        noun = "vectors" if components == 3 else "numbers"
        raise InputError(f"no such array of {noun}", where=where, found=found, allowed=allowed)
    array = points.attributes[name].astype(np.float64)
    return array if components == 3 else array.reshape(-1)


def _of_each(points: Points, given: float | str, where: str) -> Floats:
    return _array(points, given, 1, where) if isinstance(given, str) else np.full(len(points.positions), given)


def _placed(positions: NDArray[np.floating], axes: Floats, lengths: Floats, radii: Floats) -> tuple[Floats, Floats]:
    across = np.cross(axes, np.eye(3)[np.abs(axes).argmin(axis=1)])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    up = np.cross(axes, across)
    outward = COSINE[:, None] * across[:, None] + SINE[:, None] * up[:, None]
    along = lengths[:, None] * SHARE
    vertices = positions[:, None] + (radii[:, None] * RADIUS)[..., None] * outward + along[..., None] * axes[:, None]
    # Across the slope of the tip.
    tip = np.stack([TIP_LENGTH * lengths, TIP_RADIUS * radii])
    tip /= np.linalg.norm(tip, axis=0)
    aside = np.where(IS_TIP, tip[0][:, None], OUTWARD)
    ahead = np.where(IS_TIP, tip[1][:, None], FORWARD)
    normals = aside[..., None] * outward + ahead[..., None] * axes[:, None]
    return vertices.reshape(-1, 3), normals.reshape(-1, 3)


def _template() -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the vertices of an arrow, float64 (k, 7), and its triangles, int64 (m, 3).

    Of a vertex: cosine and sine of its angle; share of the shaft's radius, and of the length; normal outward and along
    the axis; and whether it belongs to the tip's slope.
    """
    rows: list[tuple[float, ...]] = []
    begins = []
    angle = 2 * np.pi * np.arange(SIDES) / SIDES
    middle = angle + np.pi / SIDES
    rings = [  # angles, radius, share of the length, normal, is tip
        (angle, 1.0, 0.0, 0.0, -1.0, 0.0),
        (angle, 1.0, 0.0, 1.0, 0.0, 0.0),
        (angle, 1.0, 1 - TIP_LENGTH, 1.0, 0.0, 0.0),
        (angle, 1.0, 1 - TIP_LENGTH, 0.0, -1.0, 0.0),
        (angle, TIP_RADIUS, 1 - TIP_LENGTH, 0.0, -1.0, 0.0),
        (angle, TIP_RADIUS, 1 - TIP_LENGTH, 0.0, 0.0, 1.0),
        (middle, 0.0, 1.0, 0.0, 0.0, 1.0),
    ]
    for angles, *rest in rings:
        begins.append(len(rows))
        rows += [(float(np.cos(a)), float(np.sin(a)), *rest) for a in angles]
    base, low, high, inner, outer, rim, apex = begins
    triangles = [(base, base + n + 1, base + n) for n in range(1, SIDES - 1)]
    for n in range(SIDES):
        m = (n + 1) % SIDES
        triangles += [(low + n, low + m, high + m), (low + n, high + m, high + n)]
        triangles += [(inner + n, inner + m, outer + m), (inner + n, outer + m, outer + n)]
        triangles.append((rim + n, rim + m, apex + n))
    return np.array(rows), np.array(triangles)


_ROWS, CORNERS = _template()
ARROW_TRIANGLES = len(CORNERS)
COSINE, SINE, RADIUS, SHARE, OUTWARD, FORWARD, IS_TIP = _ROWS.T
