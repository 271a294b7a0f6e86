"""Small scenes of one volume, and voxels for them, that the tests of the reference share."""

from __future__ import annotations

import numpy as np

from clusterviz.scene.values import Camera, ImageSettings, Quality, Scene, Volume

Vector = tuple[float, float, float]
SHAPE = (4, 5, 6)  # (z, y, x): the box is 5 × 4 × 3 cells
RAMP = ((0.0, 0.1), (1.0, 0.8))  # opacity from 0.1 to 0.8
RED_TO_BLUE = ((0.0, 1.0, 0.25, 0.0), (1.0, 0.0, 0.25, 1.0))


def one_volume(
    camera: Camera,
    *,
    opacity: float | tuple[tuple[float, float], ...] = RAMP,
    cmap: tuple[tuple[float, float, float, float], ...] = RED_TO_BLUE,
    unit: float = 1.0,
    interpolation: str = "linear",
    size: tuple[int, int] = (7, 5),
    step: float = 1.0,
) -> Scene:
    """A scene of one volume whose interesting values lie in [0, 1]."""
    volume = Volume(
        path="in memory",
        cmap=cmap,
        clim=(0.0, 1.0),
        opacity=opacity,
        opacity_unit_distance=unit,
        interpolation=interpolation,
    )
    return Scene(volumes=(volume,), camera=camera, image=ImageSettings(size=size), quality=Quality(step=step))


def perspective(position: Vector, focal_point: Vector, view_up: Vector = (0, 0, 1), angle: float = 30) -> Camera:
    """A camera with one eye."""
    return Camera(position=position, focal_point=focal_point, view_up=view_up, view_angle=angle)


def parallel(position: Vector, focal_point: Vector, view_up: Vector = (0, 0, 1), scale: float = 1) -> Camera:
    """A camera whose picture is 2 · scale high."""
    return Camera(position=position, focal_point=focal_point, view_up=view_up, parallel_scale=scale)


def along_x(scale: float = 1e-6, y: float = 1.3, z: float = 1.6) -> Camera:
    """Parallel rays along x, all within `scale` of (y, z)."""
    return parallel((-1, y, z), (0, y, z), scale=scale)


def random_voxels(shape: tuple[int, int, int] = SHAPE) -> np.ndarray:
    return np.random.default_rng(11).random(shape)


def x_ramp(shape: tuple[int, int, int] = SHAPE) -> np.ndarray:
    return np.broadcast_to(np.linspace(0, 1, shape[2]), shape)
