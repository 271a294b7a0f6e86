"""Reference of ambient light, and of its occlusion by the volume within a radius."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.source import Grid
from clusterviz.reference.lighting import SAMPLERS, lit
from clusterviz.reference.rays import Floats
from clusterviz.reference.transfer import transfer_function
from clusterviz.scene.values import Scene, Volume


def ambient_light(volume: Volume, voxels: NDArray[Any], point: Floats, scene: Scene, grid: Grid) -> Floats:
    """Return the share of ambient light that points reflect, (n, 1), less of it where the volume absorbs around them.

    Opacity is gathered on 14 ways of `ambient_occlusion.radius`, along the world's axes and the diagonals between them,
    from four samples each, and averaged. A step at a face of the volume, or at a clipping plane, counts by the part
    inside of a step across that face.

    `point`: float64 (n, 3), (x, y, z) in samples.

    Reference: F. Hernell, P. Ljung, A. Ynnerman: Local ambient occlusion in direct volume rendering, IEEE TVCG 16(4),
    2010.
    """
    if volume.ambient_occlusion is None:
        return np.full((len(point), 1), volume.ambient)
    transfer, index_from_world = transfer_function(volume), np.linalg.inv(grid.world_from_index[:3, :3])
    step, last = volume.ambient_occlusion.radius / 4, np.array(voxels.shape[::-1]) - 1.0
    normals = [sign * index_from_world[axis] for axis in range(3) for sign in (1, -1)]
    corners = [grid.world_from_index[:3, :3] @ end + grid.origin for _ in range(3) for end in (np.zeros(3), last)]
    for origin, normal in scene.clip.planes:
        normals.append(np.array(normal))
        corners.append(np.array(origin))
    for n, side in enumerate(scene.clip.box or ()):
        normals.append((-1) ** n * np.eye(3)[n // 2])
        corners.append(np.full(3, side))
    lost = np.zeros(len(point))
    cube = [np.array(way) - 1.0 for way in np.ndindex(3, 3, 3)]
    for way in (way / np.linalg.norm(way) for way in cube if np.abs(way).sum() in (1, 3)):
        depth = np.zeros(len(point))
        for k in range(4):
            at = point + (k + 0.5) * step * (index_from_world @ way)
            world = at @ grid.world_from_index[:3, :3].T + grid.origin
            kept_share = np.ones(len(point))
            for corner, normal in zip(corners, normals, strict=True):
                distance = (world - corner) @ (normal / np.linalg.norm(normal))
                kept_share = np.minimum(kept_share, np.clip(0.5 + distance / step, 0, 1))
            scalar, valid = SAMPLERS[volume.interpolation](voxels, *np.clip(at, 0, last).T)
            depth += kept_share * np.where(valid, transfer.extinction(scalar), 0) * step
        lost -= np.expm1(-depth) / 14
    share: Floats = volume.ambient * (1 - volume.ambient_occlusion.strength * lost)
    return share[:, None]


def lit_volume(
    field: tuple[Volume, NDArray[Any], Grid],
    scene: Scene,
    colour: Floats,
    gradient: Floats | None,
    point: Floats,
    ray: Floats,
    box: tuple[int, ...] = (),
) -> Floats:
    """Return straight colours (n, 3) under the scene's lights, as they are if the volume is not lit; see `lit`."""
    volume, voxels, grid = field
    if not volume.shade or gradient is None:
        return colour
    ambient = ambient_light(volume, voxels, point, scene, grid)
    return lit(colour, gradient, point, ray, volume, scene, grid, box, ambient)
