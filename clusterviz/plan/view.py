"""The camera in index space: rays of pixels, and footprints of boxes on the screen.

In index space, sample i has coordinate i, so its unit is a voxel. Ray parameters stay world lengths, because the map
from the world is affine. All numbers are float64.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.source import Grid
from clusterviz.image.partial import Rect
from clusterviz.scene.camera import camera_axes, camera_vectors
from clusterviz.scene.values import Camera

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class View:
    """VTK's camera over one grid; vectors (x, y, z) are in index space and one world unit long.

    `right`, `up`, `forward`: the camera's axes. `pixel`: distance of neighbouring pixel centres, in world units; in
    perspective on the plane one unit in front of the eye.
    """

    size: tuple[int, int]  # (width, height) in pixels
    eye: Vector  # the camera's position
    right: Vector
    up: Vector
    forward: Vector
    pixel: float
    parallel: bool  # parallel projection; rays start on the plane through `eye`
    window_center: tuple[float, float] = (0.0, 0.0)  # as in `Camera`

    @property
    def centre(self) -> tuple[float, float]:
        """Column and row of the line of sight, in pixels from the picture's top left corner."""
        (width, height), (right, up) = self.size, self.window_center
        return width / 2 * (1 - right), height / 2 * (1 + up)

    @property
    def eye_point(self) -> Vector | None:
        """Common origin of all rays; None in parallel projection."""
        return None if self.parallel else self.eye

    @property
    def corner_cosine(self) -> float:
        """Cosine of the angle between the view direction and the ray through the picture's corner."""
        farthest = (max(at, pixels - at) for at, pixels in zip(self.centre, self.size, strict=True))
        return 1.0 if self.parallel else 1 / math.hypot(1.0, *(self.pixel * pixels for pixels in farthest))

    def depths(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the distances (n,) of points (n, 3) ahead of the eye along the view direction, in world units."""
        return self._camera_coordinates(points)[0]

    @property
    def depth_gradient(self) -> NDArray[np.float64]:
        """Change of the depth for each voxel along x, y and z, (3,), in world units."""
        return np.asarray(np.linalg.inv(self._axes)[2])

    @property
    def clip_from_index(self) -> NDArray[np.float64]:
        """Matrix (4, 4) from homogeneous points in index space to OpenGL's clip coordinates, whose z is 0."""
        to_camera = np.linalg.inv(self._axes)
        width, height = self.size
        rows = np.zeros((4, 4))
        rows[0, :3], rows[1, :3] = to_camera[0] * 2 / (width * self.pixel), to_camera[1] * 2 / (height * self.pixel)
        rows[3, :3] = 0.0 if self.parallel else to_camera[2]
        rows[:, 3] = -rows[:, :3] @ np.array(self.eye)
        rows[3, 3] += float(self.parallel)
        right, up = self.window_center
        rows[:2] -= np.outer((right, up), rows[3])
        return rows

    def footprint(self, begin_cells: Vector, end_cells: Vector) -> Rect:
        """Return the pixels whose rays may meet the box of cells [begin, end], (x, y, z).

        The rectangle is at most one pixel too large on each side. It is the whole picture if a part of the box is
        beside or behind the eye.
        """
        (sides,) = self.footprints(np.array([begin_cells]), np.array([end_cells])).tolist()
        return Rect(*sides)

    def footprints(self, begin_cells: NDArray[np.float64], end_cells: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return the footprints of boxes (n, 3): int64 (n, 4), x_begin, y_begin, x_end, y_end; all 0 if empty."""
        ends = np.stack([begin_cells, end_cells], axis=1)
        corners = np.stack([ends[:, [b & 1, b >> 1 & 1, b >> 2], range(3)] for b in range(8)], axis=1)
        ahead, aside = (part.reshape(len(ends), 8, -1) for part in self._camera_coordinates(corners.reshape(-1, 3)))
        nearest, farthest = ahead.min(axis=(1, 2)), ahead.max(axis=(1, 2))
        hidden = farthest < 0
        beside = ~hidden & (not self.parallel) & (nearest <= 1e-6 * np.abs(ahead).max(axis=(1, 2)))
        if not self.parallel:
            aside = aside / np.where((hidden | beside)[:, None, None], 1.0, ahead)
        pixels = np.array(self.centre) + aside * np.array([1, -1]) / self.pixel
        low = np.clip(np.floor(pixels.min(axis=1) - 0.5), 0, self.size).astype(np.int64)
        high = np.clip(np.ceil(pixels.max(axis=1) + 0.5), 0, self.size).astype(np.int64)
        rects = np.concatenate([low, high], axis=1)
        rects[hidden | (low >= high).any(axis=1)] = 0
        rects[beside] = (0, 0, *self.size)
        return rects

    @property
    def _axes(self) -> NDArray[np.float64]:
        return np.array([self.right, self.up, self.forward]).T

    def _camera_coordinates(self, points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the distances ahead (n,) and to the right and up (n, 2) of the eye, in world units."""
        coordinates = np.linalg.solve(self._axes, (points - np.array(self.eye)).T).T
        return coordinates[:, 2], coordinates[:, :2]


def make_view(camera: Camera, size: tuple[int, int], grid: Grid) -> View:
    """The view of a completed camera (position, focal_point and view_up given) over a grid.

    References
    ----------
    VTK, vtkCamera: view_angle is vertical; parallel_scale is half the height of the picture in world units.
    """
    position, focal_point, view_up = camera_vectors(camera)
    right, up, forward = camera_axes(position, focal_point, view_up)
    parallel = camera.parallel_scale is not None
    half_height = (
        camera.parallel_scale if camera.parallel_scale is not None else np.tan(np.radians(camera.view_angle) / 2)
    )
    index_from_world = np.linalg.inv(grid.world_from_index[:3, :3])
    eye = index_from_world @ (np.array(position) - np.array(grid.origin))
    return View(
        size,
        _triple(eye),
        _triple(index_from_world @ right),
        _triple(index_from_world @ up),
        _triple(index_from_world @ forward),
        float(2 * half_height / size[1]),
        parallel,
        camera.window_center,
    )


def _triple(vector: NDArray[np.float64]) -> Vector:
    x, y, z = (float(v) for v in vector)
    return x, y, z
