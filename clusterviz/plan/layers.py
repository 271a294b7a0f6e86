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

    `normal_from_gradient`: float64 (3, 3), maps gradients in index space to normals in the world, of any length; those
    of geometry are in the world. `objects`: its number in the picture's layer, and those of a volume's visible
    isosurfaces by ascending value.
    """

    normal_from_gradient: NDArray[np.float64]
    objects: tuple[int, ...]


def make_layers(scene: Scene, grids: Sequence[Grid], blend_modes: Sequence[BlendMode]) -> tuple[LayeredContent, ...]:
    """Return the content of a scene with layers, whose objects are numbered through the scene; empty without layers."""
    if not scene.needs_layers:
        return ()
    found, first, volumes = list[LayeredContent](), 0, zip(grids, blend_modes, strict=True)
    for section in scene.entries.values():
        if section.drawn_as == "samples":
            grid, mode = next(volumes)
            matrix = grid.world_from_index[:3, :3]
            normals = np.linalg.inv(matrix / np.abs(matrix).max()).T
            found.append(LayeredContent(normals, (first, *(first + surface.number for surface in mode.surfaces))))
        elif section.objects:
            found.append(LayeredContent(np.eye(3), (first,)))
        first += section.objects
    return tuple(found)
