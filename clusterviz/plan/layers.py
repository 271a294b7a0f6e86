"""Layers of a picture beside its colours: what depends on the content of the scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.source import Grid
from clusterviz.plan.blend_mode import BlendMode
from clusterviz.scene.values import Scene


@dataclass(frozen=True, eq=False)
class LayeredContent:
    """A volume or an entry of geometry, as the layers `normal` and `object` show it.

    Attributes
    ----------
    normal_from_gradient : float64 (3, 3), maps gradients in index space to normals in the world, of any length; those
        of geometry are in the world
    objects : its number in the picture's layer, and those of a volume's visible isosurfaces by ascending value
    """

    normal_from_gradient: NDArray[np.float64]
    objects: tuple[int, ...]


def make_layers(scene: Scene, grids: Sequence[Grid], blend_modes: Sequence[BlendMode]) -> tuple[LayeredContent, ...]:
    """Return the content of a scene with layers; empty if it has none.

    Objects are numbered through the scene: each volume, and after it its isosurfaces as they are listed; then each
    mesh, entry of lines and of points.
    """
    found: list[LayeredContent] = []
    first = 0
    for volume, grid, mode in zip(scene.volumes, grids, blend_modes, strict=True):
        matrix = grid.world_from_index[:3, :3]
        normals = np.linalg.inv(matrix / np.abs(matrix).max()).T
        found.append(LayeredContent(normals, (first, *(first + surface.number for surface in mode.surfaces))))
        first += 1 + len(volume.isosurfaces)
    found += [LayeredContent(np.eye(3), (first + number,)) for number in range(len(scene.geometry))]
    return tuple(found) if scene.needs_layers else ()
