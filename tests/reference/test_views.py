"""The reference from every place: cameras in and on the box, and motions that must not change the picture."""

from __future__ import annotations

import math

import numpy as np
import pytest
from reference.scenes import SHAPE, along_x, one_volume, parallel, perspective, random_voxels, x_ramp

from clusterviz.data.source import Grid
from clusterviz.reference import render_reference
from clusterviz.scene.values import Camera


def rotation(axis: tuple[float, float, float], degrees: float) -> np.ndarray:
    """Rodrigues' formula."""
    x, y, z = np.array(axis) / math.hypot(*axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = math.radians(degrees)
    return np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross


def triples(matrix: np.ndarray) -> tuple[tuple[float, float, float], ...]:
    return tuple(tuple(row) for row in matrix.tolist())


def chord(eye: np.ndarray, ray: np.ndarray, size: np.ndarray) -> float:
    """How far a ray from inside a box [0, size] goes until it leaves."""
    return min(((s if r > 0 else 0) - e) / r for e, r, s in zip(eye, ray, size, strict=True) if r)


@pytest.mark.parametrize("eye", [(2.5, 2, 1.5), (1, 0.25, 3), (0, 2, 1.5), (0, 0, 1), (0, 0, 0)])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_camera_inside_or_on_the_box_sees_from_its_eye_on(eye: tuple[float, float, float], axis: int) -> None:
    ahead, up = np.eye(3)[axis], np.eye(3)[axis - 1]
    camera = perspective(eye, tuple(np.array(eye) + ahead), tuple(up), angle=90)
    scene = one_volume(camera, opacity=0.2, size=(3, 3))
    alpha = render_reference(scene, Grid(SHAPE), np.full(SHAPE, 0.5), 0.7)[..., 3]
    right = np.cross(ahead, up)
    for row, column in np.ndindex(3, 3):
        ray = ahead + (column - 1) * 2 / 3 * right + (1 - row) * 2 / 3 * up
        ray /= np.linalg.norm(ray)
        length = max(0, chord(np.array(eye, float), ray, np.array([5.0, 4, 3])))
        assert alpha[row, column] == pytest.approx(1 - 0.8**length, abs=1e-13)


def test_parallel_rays_start_at_the_plane_through_the_position() -> None:
    for x, length in ((-1, 5), (0, 5), (2, 3), (4.5, 0.5), (5, 0), (6, 0)):
        scene = one_volume(parallel((x, 2, 1), (x + 1, 2, 1)), opacity=0.2, size=(1, 1))
        alpha = render_reference(scene, Grid(SHAPE), np.full(SHAPE, 0.5))[0, 0, 3]
        assert alpha == pytest.approx(1 - 0.8**length, abs=1e-14)


@pytest.mark.parametrize(
    ("y", "z", "length"),
    [(0, 0, 5), (4, 3, 5), (0, 1.5, 5), (4, 1.5, 5), (2, 3, 5), (4.000001, 1, 0), (-1e-9, 1, 0), (2, 3.1, 0)],
)
def test_rays_along_an_axis_in_faces_and_edges(y: float, z: float, length: float) -> None:
    scene = one_volume(parallel((-1, y, z), (0, y, z), scale=1e-12), opacity=0.2, size=(1, 1))
    alpha = render_reference(scene, Grid(SHAPE), np.full(SHAPE, 0.5))[0, 0, 3]
    assert alpha == pytest.approx(1 - 0.8**length, abs=1e-12)


@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 5, 6), (4, 1, 6), (4, 5, 1), (1, 1, 6)])
def test_a_box_without_thickness_draws_nothing(shape: tuple[int, int, int]) -> None:
    for camera in (along_x(y=0, z=0), perspective((9, -6, 7), (0, 0, 0)), perspective((-9, 0, 0), (0, 0, 0))):
        rgba = render_reference(one_volume(camera, opacity=1.0), Grid(shape), np.ones(shape))
        assert rgba.shape == (5, 7, 4)
        assert not rgba.any()


def moved(camera: Camera, turn: np.ndarray, shift: np.ndarray) -> Camera:
    return perspective(
        tuple(turn @ camera.position + shift), tuple(turn @ camera.focal_point + shift), tuple(turn @ camera.view_up)
    )


def test_a_rotated_grid_equals_a_rotated_camera() -> None:
    turn, shift = rotation((1, -2, 0.5), 77), np.array([30.0, -4, 9])
    camera = perspective((12, -9, 8), (2.5, 2, 1.5))
    plain = Grid(SHAPE, spacing=(0.9, 1.1, 1.3))
    turned = Grid(SHAPE, spacing=(0.9, 1.1, 1.3), origin=tuple(shift), direction=triples(turn))
    a = render_reference(one_volume(camera), plain, random_voxels())
    b = render_reference(one_volume(moved(camera, turn, shift)), turned, random_voxels())
    assert a[..., 3].max() > 0.5
    assert np.abs(a - b).max() < 1e-12


def test_a_mirrored_grid_with_mirrored_voxels_is_the_same_volume() -> None:
    scene = one_volume(perspective((12, -9, 8), (2.5, 2, 1.5)))
    mirrored = Grid(SHAPE, origin=(5, 0, 0), direction=((-1, 0, 0), (0, 1, 0), (0, 0, 1)))
    a = render_reference(scene, Grid(SHAPE), random_voxels())
    b = render_reference(scene, mirrored, random_voxels()[:, :, ::-1])
    assert np.abs(a - b).max() < 1e-12


def test_permuted_axes_with_transposed_voxels_are_the_same_volume() -> None:
    scene = one_volume(perspective((12, -9, 8), (2.5, 2, 1.5)))
    swapped = Grid(SHAPE[::-1], direction=((0, 0, 1), (0, 1, 0), (1, 0, 0)))
    a = render_reference(scene, Grid(SHAPE), random_voxels())
    b = render_reference(scene, swapped, random_voxels().transpose())
    assert np.abs(a - b).max() < 1e-12


def test_a_sheared_grid_has_the_length_of_its_slanted_box() -> None:
    """Index z leans towards world x: a ray along world x is as long inside as before, but enters at x = z."""
    half = math.sqrt(0.5)
    grid = Grid(SHAPE, direction=((1, 0, half), (0, 1, 0), (0, 0, half)))
    scene = one_volume(along_x(z=1.0), size=(1, 1))
    for x, length in ((-1, 5), (1, 5), (2, 4), (5.5, 0.5), (6, 0)):
        camera = parallel((x, 1, 1), (x + 1, 1, 1), scale=1e-9)
        uniform = one_volume(camera, opacity=0.2, size=(1, 1))
        alpha = render_reference(uniform, grid, np.full(SHAPE, 0.5))[0, 0, 3]
        assert alpha == pytest.approx(1 - 0.8**length, abs=1e-12)
    unslanted = render_reference(scene, Grid(SHAPE), x_ramp())
    assert np.abs(render_reference(scene, grid, x_ramp()) - unslanted).max() < 1e-12


@pytest.mark.parametrize("unit", [1e-9, 1e9])
def test_the_unit_of_length_does_not_matter(unit: float) -> None:
    def scaled(vector: tuple[float, float, float]) -> tuple[float, float, float]:
        return tuple(unit * x for x in vector)

    a = one_volume(perspective((12, -9, 8), (2.5, 2, 1.5)))
    b = one_volume(perspective(scaled((12, -9, 8)), scaled((2.5, 2, 1.5))), unit=unit)
    grid = Grid(SHAPE, spacing=(unit, unit, unit))
    difference = render_reference(a, Grid(SHAPE), random_voxels()) - render_reference(b, grid, random_voxels())
    assert np.abs(difference).max() < 1e-12


def test_from_a_million_diagonals_perspective_looks_parallel() -> None:
    ahead, centre = np.array([-0.8, 0.5, -0.33]), np.array([2.5, 2, 1.5])
    eye = centre - 7e6 * ahead / np.linalg.norm(ahead)
    far = perspective(tuple(eye), tuple(centre), angle=math.degrees(2 * math.atan(4 / 7e6)))
    near = parallel(tuple(centre - 20 * ahead), tuple(centre), scale=4)
    a, b = (render_reference(one_volume(c), Grid(SHAPE), random_voxels()) for c in (far, near))
    assert a[..., 3].max() > 0.5
    assert np.abs(a - b).max() < 1e-4


def test_row_0_is_the_top_and_column_0_the_left() -> None:
    """Seen along +y with z up, x runs to the right: a block in the corner of high x and z is top right."""
    voxels = np.zeros((9, 9, 9))
    voxels[6:, :, 6:] = 1
    scene = one_volume(parallel((4, -5, 4), (4, 4, 4), scale=4), opacity=((0.0, 0.0), (1.0, 0.5)), size=(3, 3))
    alpha = render_reference(scene, Grid(voxels.shape), voxels)[..., 3]
    assert alpha[0, 2] > 0.9
    assert np.count_nonzero(alpha) == 1
