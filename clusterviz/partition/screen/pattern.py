"""The object-space pattern: the volume's front faces are cut into equal parts for the groups, and that is repeated.

A pattern that is painted on the volume turns with it, so nothing is dealt to where the volume is not, and near parts of
a perspective picture get the larger shares of the screen. What a ray finds where it enters says who draws it. Rays are
asked tile by tile, since windows are rectangles: small tiles follow the painted lines closely.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import InputError
from clusterviz.partition.screen.interleaved import interleaved_tiles
from clusterviz.partition.screen.mosaic import Mosaic, mosaic_of, tile_counts
from clusterviz.plan.view import View

Points = NDArray[np.float64]
# Where in a tile rays are asked, the first that meets the volume deciding.
PLACES = ((0.5, 0.5), (0.0, 0.0), (1.0, 1.0), (0.0, 1.0), (1.0, 0.0), (0.5, 0.0), (0.5, 1.0), (0.0, 0.5), (1.0, 0.5))


def pattern_tiles(view: View, extent: tuple[float, float, float], groups: int, side: int, repetitions: int) -> Mosaic:
    """The static object-space tiling.

    When to use: no cost is known, and the volume fills little of the picture, or is seen from near. When not: with few
    repetitions it is as uneven as the volume is; with many it is as interleaved tiles are.

    Parameters
    ----------
    view : the camera
    extent : the volume's last sample in x, y, z
    groups : who share the screen, 1 or more
    side : of the tiles at which the pattern is looked up, in pixels
    repetitions : of the pattern along each side of a face, 1 or more

    Returns
    -------
    mosaic : tiles of which no asked ray meets the volume are interleaved

    Raises
    ------
    InputError
        Something below 1.

    References
    ----------
    M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 5.2.3,
    static, and figure 5.3; P. Chang, R. Jain: A multi-processor system for hidden-surface-removal, Computer Graphics
    15(4), 1981.
    """
    if repetitions < 1:
        raise InputError("no pattern", where="repetitions", found=repetitions, allowed="1 or more")
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
    return mosaic_of(np.where(owner < 0, apart, owner), view.size, side, groups)


def _entries(view: View, pixels: Points, extent: tuple[float, float, float]) -> tuple[NDArray[np.int64], Points]:
    """Through which face each ray enters the volume, by its axis, −1 where it misses; and where (n, 3), in 0 … 1.

    Rays that begin inside enter nowhere, and are told by the face through which they leave.
    """
    offsets = (pixels - (np.array(view.size) - 1) / 2) * view.pixel * np.array([1, -1])
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
    """The group painted at points of faces: columns of nearly equal numbers of groups, as wide as these are many."""
    columns = max(1, round(groups**0.5))
    counts = np.diff(np.arange(columns + 1) * groups // columns)
    ends = np.cumsum(counts)
    first = np.where(axis == 0, 1, 0)
    second = np.where(axis == 2, 1, 2)
    index = np.arange(len(points))
    u, v = (np.minimum(points[index, which] * repetitions % 1.0, 1 - 1e-12) for which in (first, second))
    column = np.searchsorted(ends, u * groups, side="right").clip(max=columns - 1)
    return np.where(axis < 0, -1, ends[column] - counts[column] + (v * counts[column]).astype(np.int64))
