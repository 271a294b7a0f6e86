"""The witness against closed forms, one plain ray at a time, and motions that must not change the picture."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from clusterviz.data.grid import Grid
from clusterviz.errors import InputError
from clusterviz.reference import raycast, render_reference
from clusterviz.scene.values import Camera, ImageSettings, Quality, Scene, Volume

Vector = tuple[float, float, float]
OrderOf = Callable[[Callable[[float], float], float, int], list[float]]
SHAPE = (4, 5, 6)  # (z, y, x): the box is 5 × 4 × 3 cells
ALPHA_MAX = 1 - 2.0**-24
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


def rotation(axis: tuple[float, float, float], degrees: float) -> np.ndarray:
    """Rodrigues' formula."""
    x, y, z = np.array(axis) / math.hypot(*axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = math.radians(degrees)
    return np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross


def triples(matrix: np.ndarray) -> tuple[tuple[float, float, float], ...]:
    return tuple(tuple(row) for row in matrix.tolist())


def one_pixel(scene: Scene, grid: Grid, voxels: np.ndarray, row: int, column: int) -> list[float]:
    """One ray, one number after another, in Python floats; axis-aligned grids and perspective only."""
    camera, (width, height) = scene.camera, scene.image.size
    volume, h = scene.volumes[0], scene.quality.step * min(grid.spacing)
    forward = np.subtract(camera.focal_point, camera.position) / math.dist(camera.focal_point, camera.position)
    right = np.cross(forward, camera.view_up)
    right /= math.hypot(*right)
    half = math.tan(math.radians(camera.view_angle / 2))
    u, v = (2 * (column + 0.5) / width - 1) * half * width / height, (1 - 2 * (row + 0.5) / height) * half
    ray = forward + u * right + v * np.cross(right, forward)
    ray /= math.hypot(*ray)
    last = [(n - 1) * s for n, s in zip(grid.shape_zyx[::-1], grid.spacing, strict=True)]
    hits = [
        sorted(((o - p) / r, (o + e - p) / r))
        for o, e, p, r in zip(grid.origin, last, camera.position, ray, strict=True)
    ]
    entry, leave = max(0.0, *(a for a, _ in hits)), min(b for _, b in hits)
    red, alpha, light, k = 0.0, 0.0, 1.0, 0
    while entry + k * h < leave:
        begin, end = entry + k * h, min(entry + (k + 1) * h, leave)
        point = [
            (p + (begin + end) / 2 * r - o) / s
            for p, r, o, s in zip(camera.position, ray, grid.origin, grid.spacing, strict=True)
        ]
        cell = [min(int(x), n - 2) for x, n in zip(point, grid.shape_zyx[::-1], strict=True)]
        scalar = 0.0
        for corner in np.ndindex(2, 2, 2):
            weight = math.prod((x - c) if o else 1 - (x - c) for x, c, o in zip(point, cell, corner, strict=True))
            scalar += weight * voxels[cell[2] + corner[2], cell[1] + corner[1], cell[0] + corner[0]]
        opacity = float(np.interp(scalar, *np.transpose(volume.opacity)))
        opaque = 1 - (1 - opacity) ** ((end - begin) / volume.opacity_unit_distance)
        red += light * opaque * float(np.interp(scalar, *np.transpose(volume.cmap)[:2]))
        alpha += light * opaque
        light *= 1 - opaque
        k += 1
    return [red, alpha]


@pytest.mark.parametrize("step", [0.3, 1.0, 2.0])
def test_every_pixel_equals_a_ray_marched_by_hand(step: float) -> None:
    grid = Grid(SHAPE, spacing=(0.5, 0.75, 1.25), origin=(3, -2, 1))
    camera = perspective((9, -6, 7), (4, -0.5, 2.9), angle=40)
    scene = one_volume(camera, size=(8, 6), step=step, unit=0.7)
    rgba = render_reference(scene, grid, random_voxels())
    drawn = 0
    for row, column in np.ndindex(6, 8):
        expected = one_pixel(scene, grid, random_voxels(), row, column)
        assert rgba[row, column, [0, 3]] == pytest.approx(expected, rel=1e-12, abs=1e-14)
        drawn += expected[1] > 0
    assert 10 < drawn < 48


@pytest.mark.parametrize("step", [1e-3, 0.3, 1.0, 2.5, 100.0])
def test_a_homogeneous_slab_is_exact_at_every_step(step: float) -> None:
    scene = one_volume(along_x(), opacity=0.3, unit=2.0, size=(1, 1))
    rgba = render_reference(scene, Grid(SHAPE), np.full(SHAPE, 0.25), step)[0, 0]
    alpha = 1 - 0.7 ** (5 / 2)
    assert rgba == pytest.approx(np.array([0.75, 0.25, 0.25, 1]) * alpha, rel=1e-12)


@pytest.mark.parametrize("opacity", [1e-8, 0.5, 1 - 1e-8, 1.0])
def test_opacities_at_both_ends_keep_all_digits(opacity: float) -> None:
    scene = one_volume(along_x(), opacity=opacity, unit=5.0, size=(1, 1))
    alpha = render_reference(scene, Grid(SHAPE), np.full(SHAPE, 0.25), 0.125)[0, 0, 3]
    assert alpha == pytest.approx(min(opacity, ALPHA_MAX), rel=1e-13, abs=0)


def test_opacity_0_draws_nothing_at_all() -> None:
    scene = one_volume(along_x(), opacity=0.0)
    assert not render_reference(scene, Grid(SHAPE), random_voxels()).any()


def test_ten_thousand_thin_slabs_do_not_drift() -> None:
    scene = one_volume(along_x(), opacity=1e-8, unit=5.0, size=(1, 1))
    alpha = render_reference(scene, Grid(SHAPE), np.full(SHAPE, 0.25), 5e-4)[0, 0, 3]
    assert alpha == pytest.approx(1e-8, rel=1e-11, abs=0)


def opacity_of_the_ramp() -> float:
    """∫ −ln(1 − u) du = (1 − u) ln(1 − u) + u over the ramp of opacities, stretched over 5 units of length."""
    (_, a), (_, b) = RAMP
    depth = 5 / (b - a) * sum(sign * ((1 - u) * math.log(1 - u) + u) for sign, u in ((1, b), (-1, a)))
    return -math.expm1(-depth)


def test_a_ramp_of_opacities_converges_with_order_2(order_of: OrderOf) -> None:
    scene = one_volume(along_x(), size=(1, 1))
    orders = order_of(
        lambda h: abs(render_reference(scene, Grid(SHAPE), x_ramp(), h)[0, 0, 3] - opacity_of_the_ramp()), 1.0, 5
    )
    assert orders == pytest.approx([2] * 5, abs=0.05)


def test_a_ramp_of_colours_converges_with_order_2(order_of: OrderOf) -> None:
    """With constant κ over length L, blue = ∫ t/L κ e^{−κt} dt = (1 − (1 + κL) e^{−κL}) / κL."""
    depth = -math.log1p(-0.4) * 5
    blue = (1 - (1 + depth) * math.exp(-depth)) / depth
    scene = one_volume(along_x(), opacity=0.4, size=(1, 1))
    orders = order_of(lambda h: abs(render_reference(scene, Grid(SHAPE), x_ramp(), h)[0, 0, 2] - blue), 1.0, 5)
    assert orders == pytest.approx([2] * 5, abs=0.05)


def test_a_smooth_field_seen_aslant_converges_with_order_2(order_of: OrderOf) -> None:
    """Random voxels have kinks at the cells' faces, where the midpoint rule is of order 2 only on average."""
    scene = one_volume(perspective((12, -9, 8), (2.5, 2, 1.5)), size=(6, 6))
    finest = render_reference(scene, Grid(SHAPE), random_voxels(), 1 / 512)
    orders = order_of(lambda h: np.abs(render_reference(scene, Grid(SHAPE), random_voxels(), h) - finest).mean(), 1, 5)
    assert 1.7 < sum(orders) / 5 < 2.3


def test_the_last_slab_is_cut_and_sampled_at_its_own_midpoint() -> None:
    scene = one_volume(along_x(), opacity=1.0, unit=1e-6, size=(1, 1))
    rgba = render_reference(scene, Grid((4, 5, 6)), x_ramp(), 100.0)[0, 0]
    assert rgba == pytest.approx([0.5, 0.25, 0.5, 1], abs=1e-12)
    only_the_far_end = one_volume(along_x(), opacity=((0.0, 0.0), (0.79, 0.0), (0.8, 1.0)), unit=1e-6, size=(1, 1))
    rgba = render_reference(only_the_far_end, Grid((4, 5, 6)), x_ramp(), 4.0)[0, 0]
    assert rgba == pytest.approx([0.1, 0.25, 0.9, 1], abs=1e-12)


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


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_cells_that_touch_a_bad_voxel_are_transparent_and_no_others(bad: float) -> None:
    voxels = np.full((4, 4, 8), 0.5)
    voxels[1, 1, 3] = bad
    for y, length in ((1.5, 5), (0.5, 5), (2.5, 7), (2.0000001, 7), (1.9999999, 5)):
        scene = one_volume(along_x(1e-9, y=y, z=0.5), opacity=0.2, size=(1, 1))
        rgba = render_reference(scene, Grid(voxels.shape), voxels, 0.25)[0, 0]
        assert rgba[3] == pytest.approx(1 - 0.8**length, abs=1e-12)
        assert np.isfinite(rgba).all()


def test_nearest_loses_only_the_half_cells_around_a_bad_voxel() -> None:
    voxels = np.full((4, 4, 8), 0.5)
    voxels[1, 1, 3] = math.nan
    for y, length in ((1.4, 6), (1.6, 7), (0.6, 6), (0.4, 7)):
        scene = one_volume(along_x(1e-9, y=y, z=0.75), opacity=0.2, size=(1, 1), interpolation="nearest")
        alpha = render_reference(scene, Grid(voxels.shape), voxels, 0.25)[0, 0, 3]
        assert alpha == pytest.approx(1 - 0.8**length, abs=1e-12)


def test_nearest_shows_blocks_of_constant_scalar() -> None:
    scene = one_volume(along_x(1e-9, y=1.4, z=0.6), size=(1, 1), interpolation="nearest")
    voxels = random_voxels()
    alpha = render_reference(scene, Grid(SHAPE), voxels, 0.125)[0, 0, 3]
    opacity = np.interp(voxels[1, 1], *np.transpose(RAMP))
    lengths = np.array([0.5, 1, 1, 1, 1, 0.5])
    assert alpha == pytest.approx(1 - np.prod((1 - opacity) ** lengths), rel=1e-12)


@pytest.mark.parametrize("dtype", ["i1", "u1", ">i2", "u2", "i4", "u4", "<i8", "u8", "f2", ">f4", "f4", ">f8"])
def test_every_type_and_byte_order_draws_its_values(dtype: str) -> None:
    voxels = np.random.default_rng(2).integers(0, 100, SHAPE)
    points = tuple((s * 100, a) for s, a in RAMP)
    colours = tuple((s * 100, *rgb) for s, *rgb in RED_TO_BLUE)
    scene = one_volume(perspective((12, -9, 8), (2.5, 2, 1.5)), opacity=points, cmap=colours)
    a = render_reference(scene, Grid(SHAPE), voxels.astype(dtype))
    b = render_reference(scene, Grid(SHAPE), voxels.astype(np.float64))
    assert a[..., 3].max() > 0.5
    assert np.array_equal(a, b)


def test_a_nearly_black_ray_may_end_but_nothing_changes(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = one_volume(perspective((12, -9, 8), (2.5, 2, 1.5)), opacity=((0.0, 0.0), (1.0, 1.0)), unit=0.1, step=0.1)
    a = render_reference(scene, Grid(SHAPE), random_voxels())
    monkeypatch.setattr(raycast, "DARK", -1)
    assert np.abs(a - render_reference(scene, Grid(SHAPE), random_voxels())).max() < 1e-15


def test_how_many_rays_are_marched_at_once_does_not_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = one_volume(perspective((12, -9, 8), (2.5, 2, 1.5)))
    a = render_reference(scene, Grid(SHAPE), random_voxels())
    monkeypatch.setattr(raycast, "RAYS_AT_ONCE", 6)
    assert np.array_equal(a, render_reference(scene, Grid(SHAPE), random_voxels()))


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (9, 1)])
def test_pictures_of_one_pixel_row_or_column(size: tuple[int, int]) -> None:
    rgba = render_reference(
        one_volume(perspective((12, -9, 8), (2.5, 2, 1.5)), size=size), Grid(SHAPE), random_voxels()
    )
    assert rgba.shape == (size[1], size[0], 4)
    assert rgba[size[1] // 2, size[0] // 2, 3] > 0.5


def test_a_scene_without_volumes_is_transparent() -> None:
    scene = Scene(camera=along_x())
    assert not render_reference(scene, Grid(SHAPE), random_voxels()).any()


@pytest.mark.parametrize("step", [0.0, -1.0, math.nan, math.inf])
def test_impossible_steps_are_refused(step: float) -> None:
    with pytest.raises(InputError, match="step"):
        render_reference(one_volume(along_x()), Grid(SHAPE), random_voxels(), step)


def test_voxels_of_another_shape_are_refused() -> None:
    with pytest.raises(InputError, match=r"\(4, 5, 6\)"):
        render_reference(one_volume(along_x()), Grid(SHAPE), random_voxels()[1:])
