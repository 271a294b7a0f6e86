"""Static object-space tiling: a repeated pattern of groups on the faces of the volume.

The pattern rotates with the volume, so that no group is assigned to empty parts of the screen, and near parts of a
perspective picture have more pixels per group. A ray belongs to the group at its entry point. The pattern is sampled
once per tile, so small tiles follow its borders closely.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clusterviz.partition.screen.tiles import ScreenPartition, interleaved_tiles, partition_of_tiles, tile_counts
from clusterviz.plan.view import View

Points = NDArray[np.float64]
# Positions in a tile at which rays are traced; the first that meets the volume decides.
PLACES = ((0.5, 0.5), (0.0, 0.0), (1.0, 1.0), (0.0, 1.0), (1.0, 0.0), (0.5, 0.0), (0.5, 1.0), (0.0, 0.5), (1.0, 0.5))


def pattern_tiles(
    view: View, extent: tuple[float, float, float], groups: int, side: int, repetitions: int
) -> ScreenPartition:
    """Return the static object-space tiling.

    When to use: no cost is known, and the volume fills little of the picture, or is seen from near. When not: with few
    repetitions it is as uneven as the volume; with many it equals interleaved tiles.

    Tiles of which no asked ray meets the volume are interleaved.

    Reference: M. Strengert 2010, section 5.2.3, static, and figure 5.3; P. Chang, R. Jain: A multi-processor system for
    hidden-surface-removal, Computer Graphics 15(4), 1981.

    `extent`: last sample of the volume in x, y, z; `repetitions`: repetitions of the pattern along each side of a face,
    1 or more.
    """
    rows, columns = tile_counts(view.size, side)
    owner = np.full((rows, columns), -1)
    for down, across in PLACES:
        left = np.flatnonzero(owner.ravel() < 0)
        row, column = np.divmod(left, columns)
        ends = np.minimum(np.stack([column + 1, row + 1], axis=1) * side, view.size)
        begins = np.stack([column, row], axis=1) * side
        pixels = begins + (ends - begins) * np.array([across, down]) - 0.5
        owner.ravel()[left] = _painted(*_entries(view, pixels, extent), groups, repetitions)
    apart = interleaved_tiles(view.size, groups, side).owner()[::side, ::side]
    return partition_of_tiles(np.where(owner < 0, apart, owner), view.size, side, groups)


def _entries(view: View, pixels: Points, extent: tuple[float, float, float]) -> tuple[NDArray[np.int64], Points]:
    """Return the axis of the face through which each ray enters (−1 for a miss), and the point (n, 3), in 0 … 1.

    For rays that begin inside, the face through which they leave is used.
    """
    offsets = (pixels + 0.5 - np.array(view.centre)) * view.pixel * np.array([1, -1])
    aside = offsets @ np.array([view.right, view.up])
    forward = np.array(view.forward)
    origin = np.array(view.eye) + aside if view.parallel else np.broadcast_to(np.array(view.eye), aside.shape)
    direction = np.broadcast_to(forward, aside.shape) if view.parallel else forward + aside
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = -origin / direction, (np.array(extent) - origin) / direction
    inside = (origin >= 0) & (origin <= extent)
    along = direction == 0
    near = np.where(along, np.where(inside, -np.inf, np.inf), np.fmin(first, second))
    far = np.where(along, np.where(inside, np.inf, -np.inf), np.fmax(first, second))
    begin, end = near.max(axis=1), far.min(axis=1)
    hit = np.maximum(begin, 0.0) <= end
    axis = np.where(begin > 0, near.argmax(axis=1), far.argmin(axis=1))
    points = origin + direction * np.where(hit, np.where(begin > 0, begin, end), 0.0)[:, None]
    return np.where(hit, axis, -1), np.clip(points / np.maximum(np.array(extent), 1e-300), 0.0, 1.0)


def _painted(axis: NDArray[np.int64], points: Points, groups: int, repetitions: int) -> NDArray[np.int64]:
    """Return the group at points of faces: columns of nearly equal numbers of groups, of proportional width."""
    columns = max(1, round(groups**0.5))
    counts = np.diff(np.arange(columns + 1) * groups // columns)
    ends = np.cumsum(counts)
    first = np.where(axis == 0, 1, 0)
    second = np.where(axis == 2, 1, 2)
    index = np.arange(len(points))
    u, v = (np.minimum(points[index, which] * repetitions % 1.0, 1 - 1e-12) for which in (first, second))
    column = np.searchsorted(ends, u * groups, side="right").clip(max=columns - 1)
    return np.where(axis < 0, -1, ends[column] - counts[column] + (v * counts[column]).astype(np.int64))
