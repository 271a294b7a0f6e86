"""How a volume is lit, as the shader reads it: its material, the lights, and how gradients become normals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.grid import Grid
from clusterviz.scene.checks import difference
from clusterviz.scene.values import Light, Volume

Triple = tuple[float, float, float]
HEADLIGHT = Light(type="headlight")


@dataclass(frozen=True)
class Lamp:
    """A light far away.

    Attributes
    ----------
    direction : unit vector towards it, in the world; None for one that shines from the eye
    strength : (r, g, b), colour times intensity
    """

    direction: Triple | None
    strength: Triple


@dataclass(frozen=True)
class Shading:
    """What lights a volume.

    Attributes
    ----------
    material : ambient, diffuse and specular share, and the highlight's power
    lights : one or more
    world_from_index : 3 × 3, row by row, times a factor that makes its largest entry 1
    normal_from_gradient : 3 × 3, times such a factor: its inverse transpose, which takes gradients to the world
    """

    material: tuple[float, float, float, float]
    lights: tuple[Lamp, ...]
    world_from_index: tuple[Triple, ...]
    normal_from_gradient: tuple[Triple, ...]

    def block(self) -> NDArray[np.float32]:
        """The block of lights.glsl, (7 + 2 · lights, 4): columns of both matrices, the material, two rows a light."""
        rows = np.zeros((7 + 2 * len(self.lights), 4), np.float32)
        rows[:3, :3] = np.transpose(self.world_from_index)
        rows[3:6, :3] = np.transpose(self.normal_from_gradient)
        rows[6] = self.material
        for number, light in enumerate(self.lights):
            rows[7 + 2 * number] = (0, 0, 0, 1) if light.direction is None else (*light.direction, 0)
            rows[8 + 2 * number, :3] = light.strength
        return rows


def make_shading(volume: Volume, lights: Sequence[Light], grid: Grid) -> Shading:
    """The light on a volume; a scene without lights has a headlight, as PyVista's and ParaView's have."""
    world_from_index = grid.world_from_index[:3, :3]
    return Shading(
        (volume.ambient, volume.diffuse, volume.specular, volume.specular_power),
        tuple(_lamp(light) for light in lights or (HEADLIGHT,)),
        _rows(world_from_index),
        _rows(np.linalg.inv(world_from_index / np.abs(world_from_index).max()).T),
    )


def _lamp(light: Light) -> Lamp:
    r, g, b = (channel * light.intensity for channel in light.color)
    if light.type == "headlight" or light.position is None:
        return Lamp(None, (r, g, b))
    toward = np.array(difference(light.position, light.focal_point))
    x, y, z = (toward / np.linalg.norm(toward)).tolist()
    return Lamp((x, y, z), (r, g, b))


def _rows(matrix: NDArray[np.float64]) -> tuple[Triple, ...]:
    scaled = matrix / np.abs(matrix).max()
    return tuple((float(x), float(y), float(z)) for x, y, z in scaled)
