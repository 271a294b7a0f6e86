"""Reference of adaptive sampling in three dimensions, in float64: the pseudo code of the pyramidal lock-step algorithm.

Slabs between a pixel's samples are integrated exactly, by quadrature between the control points.

Reference: M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section
4.3.1, figure 4.12.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.source import Grid
from clusterviz.reference.lighting import SAMPLERS
from clusterviz.reference.preintegrated import integrate
from clusterviz.reference.pyramid import convolve
from clusterviz.reference.rays import Floats, camera_frame, camera_rays, inside, to_index_space
from clusterviz.reference.transfer import transfer_function
from clusterviz.scene.values import Scene

FARTHEST = 65536.0


def render_adaptively(
    scene: Scene, grid: Grid, voxels: NDArray[Any], distances: NDArray[Any], block: int, coarsest: int
) -> tuple[Floats, int]:
    """Return the picture, float64 (h, w, 4), premultiplied, and the number of samples in the volume.

    `scene`: complete, one composited volume without light or clipping, seen by a camera outside of it; `voxels`: (z, y,
    x), finite; `distances`: (z, y, x), sampling distances in blocks, in cells; `block`: cells along the side of a
    block; `coarsest`: the coarsest level of the pyramid.
    """
    width, height = scene.image.size
    camera, classify = scene.camera, transfer_function(scene.volumes[0])
    right, up, forward = camera_frame(camera)
    last = np.array(voxels.shape[::-1]) - 1.0
    rays = camera_rays(camera, (width, height))
    way = rays.direction.reshape(height, width, 3)
    way = way / (way @ forward)[..., None]  # of a depth of 1
    oblique = np.linalg.norm(way, axis=-1)
    parallel = camera.parallel_scale is not None
    half = 0.0 if parallel else math.tan(math.radians(camera.view_angle) / 2)
    pixel_size = 2 * (camera.parallel_scale or half) / height
    shift_right, shift_up = camera.window_center
    farthest = half * (1 + abs(shift_up)), half * (1 + abs(shift_right)) * width / height
    distance = scene.quality.step * min(grid.spacing) / math.hypot(1.0, *farthest)
    depths = (grid.corners - np.array(camera.position)) @ forward
    slices = math.ceil((depths.max() - depths.min()) / distance)
    unit = max(distance, pixel_size * (1.0 if parallel else depths.min() + slices * distance))
    entry, leave = inside(to_index_space(rays, grid), last)
    first, end = (
        ((t / np.linalg.norm(way, axis=-1).ravel() - depths.min()) / distance - 0.5).reshape(height, width)
        for t in (np.where(leave > entry, entry, 0.0), np.where(leave > entry, leave, 0.0))
    )
    meets = (leave > entry).reshape(height, width)
    scalars = [np.zeros((-(-height >> level), -(-width >> level))) for level in range(coarsest + 1)]
    wanted = [np.zeros(each.shape) for each in scalars]
    before, since = np.zeros((height, width)), np.full((height, width), -1.0)
    rgba, samples = np.zeros((height, width, 4)), 0
    to_index = np.linalg.inv(grid.world_from_index[:3, :3])

    def sample(level: int, pixels: NDArray[np.bool_], depth: float) -> tuple[Floats, Floats, int]:
        rows, columns = np.nonzero(pixels)
        side, scale = 2**level, pixel_size * (1.0 if parallel else depth)
        across = ((columns + 0.5) * side - width / 2 * (1 - shift_right))[:, None] * right
        above = (height / 2 * (1 + shift_up) - (rows + 0.5) * side)[:, None] * up
        points = np.array(camera.position) + depth * forward + scale * (across + above)
        place = (points - np.array(grid.origin)) @ to_index.T
        near = np.clip(place, 0, last)
        away = np.abs(place - near).max(axis=1)
        cells = np.minimum((near / block).astype(int), np.array(distances.shape[::-1]) - 1)
        found = distances[tuple(cells.T[::-1])] * (min(grid.spacing) / unit)
        found = np.where(found > 1, np.minimum(found, FARTHEST), 1.0) + away * (min(grid.spacing) / unit)
        return found, SAMPLERS["linear"](voxels, *near.T)[0], int((away <= 1e-3).sum())

    def synthesized(coarser: Floats, shape: tuple[int, ...]) -> Floats:
        return convolve("doo-sabin", coarser[..., None], shape)[..., 0]

    for number in range((-(-slices >> coarsest) << coarsest) + 1):
        depth = depths.min() + (number + 0.5) * distance
        of_slice = max(level for level in range(coarsest + 1) if number % 2**level == 0)
        for level in range(of_slice, -1, -1):
            due = (wanted[level] < 2 ** (of_slice + 1)) | (of_slice == coarsest)
            if level < of_slice:
                shape = wanted[level].shape
                wanted[level] = np.where(due, synthesized(wanted[level + 1], shape), wanted[level])
                scalars[level] = np.where(due, synthesized(scalars[level + 1], shape), scalars[level])
            taken = (wanted[level] < 2 ** (level + 1)) | (level == coarsest)
            wanted[level][taken], scalars[level][taken], count = sample(level, taken, depth)
            samples += count
        from_ = np.maximum(np.where(since < 0, np.minimum(first, number), since), first)
        to = np.minimum(number, end)
        some = due & meets & (to > from_)
        begin = np.where(since < 0, np.minimum(first, number), since)
        span = np.maximum(number - begin, 1e-20)
        front_of = np.where(since < 0, scalars[0], before)
        front, back = ((front_of + (at - begin) / span * (scalars[0] - front_of))[some] for at in (from_, to))
        emitted, passed = integrate(classify, front, back, ((to - from_) * distance * oblique)[some], attenuated=False)
        alpha = -np.expm1(-passed)
        colour = emitted / np.where(passed > 0, passed, 1.0)[:, None]
        rgba[some] += (1 - rgba[some][:, 3:]) * alpha[:, None] * np.column_stack([colour, np.ones(len(alpha))])
        before, since = np.where(due, scalars[0], before), np.where(due, float(number), since)
    return rgba, samples
