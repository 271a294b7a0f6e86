"""Where rays are sampled: length of a slab, clipping planes, and starts by the last frame's hits.

The number of slabs of a ray is counted in 32 bits. `quality.frame_coherence` starts a ray some slabs before the last
frame's hit: the hits of four neighbouring rays bound a smooth surface between them but for its bulge, for which two
slabs are added. With nearest-voxel interpolation voxels are boxes, so their diagonal is added.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.bricks import BrickLayout
from clusterviz.data.source import Grid
from clusterviz.errors import InputError
from clusterviz.plan.encoding import FAR
from clusterviz.scene.values import Clip, Scene

MOST_SLABS = 1 << 30
"""On the diagonal of a volume; a jittered ray has one more, and the last batch of slabs may end behind them."""


def slab_length(step: float, grid: Grid, shortest: float = 1.0) -> float:
    """Return the length of a slab in world units.

    Parameters
    ----------
    step : length of a slab in units of the smallest spacing
    grid : of the volume, or of the box around several
    shortest : length of the shortest slab of all rays over the longest one

    Raises
    ------
    InputError
        A ray would have more than `MOST_SLABS` slabs.
    """
    diagonal, spacing = math.dist(*grid.corners[[0, 7]].tolist()), min(grid.spacing)
    if diagonal > MOST_SLABS * (step * spacing * shortest):
        raise InputError(
            "too short for this volume: a ray would have more than 2³⁰ slabs",
            where="quality.step",
            found=step,
            allowed=f"at least {diagonal / MOST_SLABS / spacing / shortest:.2g}",
        )
    return step * spacing


def slab_units(step_world: float, unit_distance: float) -> float:
    """Return the length of a slab in opacity unit distances, at most `FAR`, so that float32 holds it."""
    return min(step_world / unit_distance, FAR)


def clip_planes(clip: Clip, grid: Grid) -> NDArray[np.float64]:
    """Return the clipping planes of a scene in index space, those of its box included.

    Returns float64 (n, 4); a point p (x, y, z) in index space is kept where planes[:, :3] · p + planes[:, 3] ≥ 0.
    """
    pairs = [(np.array(point), np.array(normal)) for point, normal in clip.planes]
    if clip.box is not None:
        for axis in range(3):
            for side, sign in ((0, 1.0), (1, -1.0)):
                point, normal = np.zeros(3), np.zeros(3)
                point[axis], normal[axis] = clip.box[2 * axis + side], sign
                pairs.append((point, normal))
    planes = np.zeros((len(pairs), 4))
    for row, (point, direction) in zip(planes, pairs, strict=True):
        unit = direction / np.abs(direction).max()
        row[:3] = grid.world_from_index[:3, :3].T @ unit
        row[3] = unit @ (np.array(grid.origin) - point)
    return planes


def clipped_bricks(planes: NDArray[np.float64], layout: BrickLayout) -> NDArray[np.bool_]:
    """Return the bricks, bool (bz, by, bx), that lie wholly on the clipped side of a plane."""
    edges = [borders.astype(np.float64) for borders in layout.borders_zyx]
    clipped = np.zeros(layout.counts_zyx, bool)
    for *normal, offset in planes.tolist():
        # The corner farthest on the kept side, with a tolerance for the rounding of the shader's own test.
        ahead = [np.maximum(n * edge[:-1], n * edge[1:]) for n, edge in zip(normal[::-1], edges, strict=True)]
        size = abs(offset) + sum(abs(n) * float(edge[-1]) for n, edge in zip(normal[::-1], edges, strict=True))
        most = ahead[0][:, None, None] + ahead[1][None, :, None] + ahead[2][None, None, :] + offset
        clipped |= most < -1e-12 * size
    return clipped


BULGE = 2  # slabs


def make_frame_coherence(scene: Scene, grids: Sequence[Grid], step_world: float) -> int | None:
    """Return the slabs between a ray's start and the last frame's hit; None without frame coherence.

    `grids`: of the scene's volumes.
    """
    if not scene.quality.frame_coherence:
        return None
    pairs = zip(scene.drawn_as("samples").values(), grids, strict=True)
    boxes = [grid for section, grid in pairs if section.interpolation == "nearest"]
    juts = max((math.hypot(*grid.spacing) for grid in boxes), default=0.0)
    return BULGE + math.ceil(juts / step_world)
