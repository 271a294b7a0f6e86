"""Reference fields by the scene's name of their interpolation: scalars and gradients."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from clusterviz.reference.lighting import nearest_gradient, trilinear_gradient
from clusterviz.reference.rays import Floats
from clusterviz.reference.sample import cubic, cubic_gradient, nearest, trilinear
from clusterviz.scene.values import Volume

SAMPLERS = {"linear": trilinear, "nearest": nearest, "cubic": cubic}
_GRADIENTS = {"linear": trilinear_gradient, "nearest": nearest_gradient, "cubic": cubic_gradient}


def gradient_at(volume: Volume, voxels: NDArray[Any], point: Floats) -> Floats:
    """Return the gradient by which a volume is lit, float64 (n, 3), per voxel along (x, y, z)."""
    kernel = cubic_gradient if volume.gradient == "smooth" else _GRADIENTS[volume.interpolation]
    return kernel(voxels, point)
