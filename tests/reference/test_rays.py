"""Rays: VTK's camera in numbers, and cameras that have no picture."""

from __future__ import annotations

import math

import numpy as np
import pytest

from clusterviz.data.source import Grid
from clusterviz.errors import InputError
from clusterviz.reference.rays import Rays, camera_rays, inside, to_index_space
from clusterviz.scene.values import Camera


def looking_north(**changes: object) -> Camera:
    """A camera at (0, −5, 0) that looks along +y."""
    return Camera.model_validate({"position": (0, -5, 0), "focal_point": (0, 0, 0), "view_up": (0, 0, 1)} | changes)


def test_the_view_angle_spans_the_height_of_the_picture() -> None:
    rays = camera_rays(looking_north(view_angle=90), (4, 2))
    assert np.allclose(np.linalg.norm(rays.direction, axis=1), 1, rtol=0, atol=1e-15)
    assert (rays.start == [0, -5, 0]).all()
    slopes = rays.direction / rays.direction[:, 1:2]
    across, upward = np.meshgrid([-1.5, -0.5, 0.5, 1.5], [0.5, -0.5])
    assert np.allclose(slopes[:, 0], across.ravel(), rtol=0, atol=1e-15)
    assert np.allclose(slopes[:, 2], upward.ravel(), rtol=0, atol=1e-15)


def test_parallel_scale_is_half_the_height() -> None:
    rays = camera_rays(Camera(position=(1, 2, 3), focal_point=(1, 2, 9), view_up=(0, 7, 0), parallel_scale=3), (1, 3))
    assert np.allclose(rays.start, [[1, 4, 3], [1, 2, 3], [1, 0, 3]], rtol=0, atol=1e-14)
    assert (rays.direction == [0, 0, 1]).all()


def test_view_up_need_not_be_square_to_the_view_nor_a_unit() -> None:
    a = camera_rays(looking_north(), (3, 3))
    b = camera_rays(looking_north(view_up=(0, 1e9, 2e9)), (3, 3))
    assert np.allclose(a.direction, b.direction, rtol=0, atol=1e-15)


@pytest.mark.parametrize("unit", [1e-200, 1.0, 1e200])
def test_extreme_units_of_length_keep_the_direction(unit: float) -> None:
    rays = camera_rays(looking_north(position=(0, -3 * unit, 4 * unit)), (1, 1))
    assert rays.direction[0] == pytest.approx([0, 0.6, -0.8], abs=1e-15)


def test_t_is_world_length_in_index_space_too() -> None:
    grid = Grid((5, 5, 5), spacing=(0.5, 2, 4), origin=(1, 1, 1), direction=((0, 1, 0), (1, 0, 0), (0, 0, -1)))
    rays = to_index_space(Rays(np.array([[1.0, 1, 1]]), np.array([[0.6, 0, -0.8]])), grid)
    assert rays.start[0] == pytest.approx([0, 0, 0])
    assert rays.direction[0] == pytest.approx([0, 0.3, 0.2])


def test_where_rays_enter_and_leave() -> None:
    start = np.array([[-2.0, 1, 1], [1, 1, 1], [5, 1, 1], [-2, 4, 1], [1, -2, 1], [-1, -1, 1]])
    ray = np.array([[1.0, 0, 0], [1, 0, 0], [1, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    entry, leave = inside(Rays(start, ray), np.array([3.0, 3, 3]))
    assert (entry[[0, 1, 4, 5]] == [2, 0, 2, 1]).all()
    assert (leave[[0, 1, 4, 5]] == [5, 2, 5, 4]).all()
    assert (leave[[2, 3]] <= entry[[2, 3]]).all()


def test_negative_zero_is_a_direction_along_the_faces_too() -> None:
    entry, leave = inside(Rays(np.array([[-2.0, 0, 3]]), np.array([[1.0, -0.0, 0.0]])), np.array([3.0, 3, 3]))
    assert (entry[0], leave[0]) == (2, 5)


def test_cameras_without_a_picture_are_refused() -> None:
    # Scenes refuse these as well; the reference checks for itself.
    for camera, key in (
        (Camera.model_construct(position=(1, 1, 1), focal_point=(1, 1, 1), view_up=(0, 0, 1)), "position"),
        (Camera.model_construct(position=(1, 1, 1), focal_point=(1, 1, 2), view_up=(0, 0, -3)), "view_up"),
        (Camera.model_construct(position=(1, 1, 1), focal_point=(1, 1, 2), view_up=(0, 0, 0)), "view_up"),
        (Camera.model_construct(position=(math.nan, 1, 1), focal_point=(1, 1, 2), view_up=(0, 1, 0)), "position"),
        (Camera(), "focal_point"),
    ):
        with pytest.raises(InputError, match=key):
            camera_rays(camera, (2, 2))


def test_a_grid_whose_axes_lie_in_a_plane_is_refused() -> None:
    grid = Grid((2, 2, 2), spacing=(1e-9, 1, 1e9), direction=((1, 0, 1), (0, 1, 0), (0, 0, 0)))
    with pytest.raises(InputError, match="direction"):
        to_index_space(Rays(np.zeros((1, 3)), np.ones((1, 3))), grid)
