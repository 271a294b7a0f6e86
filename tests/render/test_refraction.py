"""Rays that bend: both ray casters against float64, Snell's law, total reflection and a lens."""

from __future__ import annotations

from typing import Any

import moderngl
import numpy as np
import pytest
from render.scenes import camera_at, pieces_of, prepare

from clusterviz.content.volume.optics import IndexFunction
from clusterviz.data.source import Grid
from clusterviz.errors import InputError
from clusterviz.image.merge import merge_partials
from clusterviz.image.spectral import SpectralPicture
from clusterviz.reference import raycast, render_reference
from clusterviz.reference.refraction import Bent, snell
from clusterviz.render.cpu.device import cpu_caster
from clusterviz.render.opengl import opengl_caster
from clusterviz.render.refraction import MOMENTUM, POSITION, STATUS, Paths
from clusterviz.render.render_result import footprint, no_progress
from clusterviz.render.tall_picture import draw_tall_picture
from clusterviz.scene.values import Camera, ImageSettings, Quality, Scene, Volume

SHAPE = (11, 13, 15)
SMOOTH = [[0, 1.0, 1.0], [1, 1.3, 1.4]]
STEPS = [[0, 1.0, 1.0], [0.4, 1.0, 1.0], [0.4, 1.5, 1.55], [1, 1.5, 1.55]]
KM = {"absorption": [[0.2, 0, 0], [1, 0.2, 0.02]], "scattering": [[0.1, 0, 0], [1, 0.3, 0.1]]}


def bump(shape: tuple[int, ...] = SHAPE) -> np.ndarray:
    """A Gaussian in the middle, float32."""
    axes = np.meshgrid(*(np.linspace(-1, 1, n) for n in shape), indexing="ij")
    return np.exp(-2 * sum(axis**2 for axis in axes)).astype(np.float32)


def scene_of(camera: Camera, optics: dict[str, Any], size: tuple[int, int] = (6, 5), **keys: Any) -> Scene:
    step = keys.pop("step", 0.8)
    given = {"wavelengths": [450, 650], "refraction": True, **optics}
    volume = Volume(path="in memory", optics=given, **keys)  # type: ignore[arg-type]
    return Scene(volumes=(volume,), camera=camera, image=ImageSettings(size=size), quality=Quality(step=step))


def fluxes(
    where: moderngl.Context | None,
    scene: Scene,
    voxels: np.ndarray,
    grid: Grid,
    brick: int = 7,
    block: int | None = None,
) -> np.ndarray:
    """Fluxes (3, rays, wavelengths) that a caster draws."""
    prepared = prepare(scene, voxels, grid, brick)
    plan = prepared.plan
    caster = opengl_caster(where, plan, block) if where else cpu_caster(plan)
    caster.load(plan, dict(prepared.shown))
    results = draw_tall_picture(caster.draw, plan, pieces_of(prepared, 1), no_progress)
    merged = merge_partials([one.partial for one in results], plan.canvas_size, plan.blend_mode.operator)
    caster.release()
    found = SpectralPicture.of_pixels(merged, plan.spectrum.wavelengths).fluxes  # type: ignore[union-attr]
    return np.stack([np.asarray(one, np.float64).reshape(-1, one.shape[-1]) for one in found])


def ends(scene: Scene, voxels: np.ndarray, grid: Grid) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Status (rays,), position and momentum (rays, 3) at the end of the rays of the first wavelength."""
    prepared = prepare(scene, voxels, grid, 64)
    plan, (piece, *_) = prepared.plan.at_wavelength(0), pieces_of(prepared, 1)
    caster, paths = cpu_caster(plan), Paths.beginning(footprint(plan, piece))
    caster.load(plan, dict(prepared.shown))
    caster.draw(plan, [piece], carried=[paths])
    planes = paths.planes.reshape(len(paths.planes), -1).astype(np.float64)
    position, momentum = (planes[n : n + 6 : 2] + planes[n + 1 : n + 6 : 2] for n in (POSITION, MOMENTUM))
    return planes[STATUS], position.T, momentum.T


CASES: list[tuple[str, str, Grid, dict[str, Any], dict[str, Any]]] = [
    ("smooth", "outside", Grid(SHAPE), {"refractive_index": SMOOTH}, {}),
    ("cubic", "parallel", Grid(SHAPE, (1e-9, 2e-9, 1e-9)), {"refractive_index": SMOOTH}, {"interpolation": "cubic"}),
    ("inside", "inside", Grid(SHAPE, (1.3, 0.6, 2.0), (100.0, -50.0, 3.0)), {"refractive_index": SMOOTH}, {}),
    ("steps", "outside", Grid(SHAPE), {"refractive_index": STEPS}, {"step": 0.7}),
    ("below-1", "parallel", Grid(SHAPE), {"refractive_index": [[0, 0.95], [1, 0.8]]}, {}),
]


@pytest.mark.cover("cubic")
@pytest.mark.gl
@pytest.mark.parametrize(("camera", "grid", "index", "keys"), [row[1:] for row in CASES], ids=[row[0] for row in CASES])
def test_casters_draw_the_reference(
    context: moderngl.Context,
    monkeypatch: pytest.MonkeyPatch,
    camera: str,
    grid: Grid,
    index: dict[str, Any],
    keys: dict[str, Any],
) -> None:
    voxels, unit = bump(), min(grid.spacing)
    km = {key: [[row[0], *(each / unit for each in row[1:])] for row in rows] for key, rows in KM.items()}
    scene, made = scene_of(camera_at(camera, grid), km | index, **keys), list[Bent]()
    monkeypatch.setattr(raycast, "Bent", lambda *given: made.append(Bent(*given)) or made[-1])
    render_reference(scene, grid, voxels)
    expected = np.stack(made[0].fluxes)
    assert expected[0].max() > 0.1
    # OpenGL compiles for seconds; cubic interpolation is tested with straight rays.
    for where in (None, context) if keys.get("interpolation") != "cubic" else (None,):
        found = fluxes(where, scene, voxels, grid)
        np.testing.assert_allclose(found, expected, atol=1e-5)
        assert (found[0] + found[2] <= 1 + 1e-6).all()
    straight = fluxes(None, scene_of(camera_at(camera, grid), km | {"refraction": False}, **keys), voxels, grid)
    assert np.abs(straight - expected).max() > 1e-3  # rays bend


@pytest.mark.gl
def test_bricks_in_several_buffers_are_refused(context: moderngl.Context) -> None:
    """A ray would come back to those of a buffer that has been drawn."""
    grid = Grid(SHAPE)
    scene = scene_of(camera_at("outside", grid), KM | {"refractive_index": SMOOTH})
    with pytest.raises(InputError, match=r"too many bricks for rays that bend.*set cluster.memory_limit"):
        fluxes(context, scene, bump(), grid, block=6000)


@pytest.mark.parametrize("index", [1.0, 1.4])
def test_equal_indices_bend_nothing(index: float) -> None:
    voxels, grid = bump(), Grid(SHAPE)
    camera = camera_at("outside", grid)
    same = {"refractive_index": [[0, index]], "outside_index": index}
    straight = fluxes(None, scene_of(camera, KM | {"refraction": False}, step=0.3), voxels, grid)
    np.testing.assert_allclose(fluxes(None, scene_of(camera, KM | same, step=0.3), voxels, grid), straight, atol=1e-5)


@pytest.mark.parametrize("size", [(1, 1), (5, 4)])
def test_without_absorption_no_light_is_lost(size: tuple[int, int]) -> None:
    grid, voxels = Grid(SHAPE), bump()
    for scattering in (KM["scattering"], None):
        optics = {"refractive_index": STEPS, "scattering": scattering}
        front, _, through = fluxes(None, scene_of(camera_at("outside", grid), optics, size), voxels, grid)
        np.testing.assert_allclose(front + through, 1, atol=1e-5)
    alone = {"wavelengths": [550], "refractive_index": [[0, 1.5]]}
    assert fluxes(None, scene_of(camera_at("outside", grid), alone, size), voxels, grid)[2].min() == 1


def parallel(direction: tuple[float, float, float], at: tuple[float, float, float]) -> Camera:
    """A camera with one ray through a point."""
    position = tuple(np.array(at) - 40 * np.array(direction))
    return Camera(position=position, focal_point=at, view_up=(0, 1, 0), parallel_scale=1.0)


@pytest.mark.parametrize("index", [1.5, 0.9])
@pytest.mark.parametrize("degrees", [0.0, 20.0, 45.0, 52.0])
def test_flat_faces_follow_the_law_of_sines(index: float, degrees: float) -> None:
    angle = np.radians(degrees)
    grid, voxels = Grid((9, 33, 81), (0.5, 1.0, 2.0)), np.ones((9, 33, 81), np.float32)
    camera = parallel((np.sin(angle), 0.0, np.cos(angle)), (8.0, 16.0, 0.0))
    scene = scene_of(camera, {"refractive_index": [[0, index]]}, (1, 1))
    status, position, momentum = ends(scene, voxels, grid)
    inside = np.arcsin(np.sin(angle) / index)
    np.testing.assert_allclose(position[0] * grid.spacing, [8 + 16 * np.tan(inside), 16, 16], rtol=1e-6)
    np.testing.assert_allclose(momentum[0] / grid.spacing, [np.sin(angle), 0, np.cos(angle)], atol=1e-6)
    assert status[0] == 2


def test_rays_are_reflected_beyond_the_critical_angle() -> None:
    # From outside, off a volume that is less dense: nothing of it is seen.
    grid, voxels = Grid((9, 9, 65)), np.ones((9, 9, 65), np.float32)
    optics = {"refractive_index": [[0, 0.8]], "absorption": [[0, 9.0, 9.0]]}
    for degrees, through in ((50.0, 0.0), (55.0, 1.0)):  # critical: 53.1
        angle = np.radians(degrees)
        camera = parallel((np.sin(angle), 0.0, np.cos(angle)), (20.0, 4.0, 0.0))
        found = fluxes(None, scene_of(camera, optics, (1, 1)), voxels, grid)
        np.testing.assert_allclose(found[2], through, atol=1e-5)
    # Inside, where the index falls from 1.5 to 1 in the plane z = 4: critical at 41.8 degrees.
    ramp = np.broadcast_to(np.arange(9, dtype=np.float32)[:, None, None], (9, 9, 65)).copy()
    steps = {"refractive_index": [[0, 1.5], [4, 1.5], [4, 1.0], [8, 1.0]], "outside_index": 1.5}
    for degrees, up in ((38.0, 1), (45.0, -1)):
        angle = np.radians(degrees)
        scene = scene_of(parallel((np.sin(angle), 0.0, np.cos(angle)), (8.0, 4.0, 0.0)), steps, (1, 1))
        _, position, momentum = ends(scene, ramp, grid)
        turned = np.array([1.5 * np.sin(angle), 0, 1.5 * np.cos(angle) * up])
        np.testing.assert_allclose(momentum[0], turned, atol=1e-6)
        way = 4 * np.tan(angle) + 4 * (np.tan(np.arcsin(1.5 * np.sin(angle))) if up > 0 else np.tan(angle))
        np.testing.assert_allclose(position[0], [8 + way, 4, 4 + 4 * up], atol=1e-4)


def test_snell_keeps_the_tangential_part() -> None:
    rng = np.random.default_rng(3)
    for n_0, n_1 in ((1.0, 1.5), (1.5, 1.0), (1.0, 0.2), (2.0, 2.0)):
        v, normal = rng.normal(size=3), rng.normal(size=3)
        v, unit = n_0 * v / np.linalg.norm(v), normal / np.linalg.norm(normal)
        after, refracted = snell(v, normal, n_1**2 - n_0**2)
        np.testing.assert_allclose(np.cross(after, unit), np.cross(v, unit), atol=1e-12)
        assert np.linalg.norm(after) == pytest.approx(n_1 if refracted else n_0)
        assert refracted == (np.linalg.norm(np.cross(v, unit)) <= n_1)


def test_errors_fall_with_the_square_of_the_step() -> None:
    """In a fibre with n² = 2.25 − (0.1 y)², where rays are sine waves."""
    samples, length, y = 33, 128, 6.0
    grid = Grid((3, samples, length + 1), origin=(0.0, -16.0, 0.0))
    voxels = np.broadcast_to(np.arange(samples, dtype=np.float32)[:, None] - 16, grid.shape_zyx).copy()
    index = [[at, float(np.sqrt(2.25 - 0.01 * at**2))] for at in np.linspace(-7, 7, 14001)]
    camera = Camera(position=(-9, y, 1.0), focal_point=(0, y, 1.0), view_up=(0, 1, 0), parallel_scale=1.0)
    exact = y * np.cos(0.1 * length / np.sqrt(2.25 - 0.01 * y**2))
    errors = []
    for step in (2.0, 1.0):
        scene = scene_of(camera, {"wavelengths": [550], "refractive_index": index}, (1, 1), step=step)
        _, position, _ = ends(scene, voxels, grid)
        errors.append(abs(position[0, 1] - 16 - exact))
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.1)


def luneburg(samples: int, step: float) -> float:
    """Largest distance from the focus at which rays leave a Luneburg lens, in its radius."""
    spacing = 2 / (samples - 1)
    grid = Grid((samples,) * 3, (spacing,) * 3, (-1.0, -1.0, -1.0))
    axis = np.linspace(-1, 1, samples)
    voxels = (axis[:, None, None] ** 2 + axis[:, None] ** 2 + axis**2).astype(np.float32)
    squares = np.linspace(0, 1, 2049)
    index = [[r, float(np.sqrt(2 - r))] for r in squares]
    # Rays within 0.7 of the axis, which goes through the middle of the face behind.
    camera = Camera(position=(-5, 0.0, 0.0), focal_point=(0, 0, 0), view_up=(0, 0, 1), parallel_scale=0.7)
    scene = scene_of(camera, {"wavelengths": [550], "refractive_index": index}, (6, 6), step=step)
    _, position, _ = ends(scene, voxels, grid)
    world = position * spacing - 1
    assert np.abs(world[:, 0] - 1).max() < 1e-6
    return float(np.abs(world[:, 1:]).max())


def test_a_luneburg_lens_focuses_on_its_rim() -> None:
    """n² = 2 − r²: parallel rays meet in a point, the better the smaller voxels and steps are."""
    coarse, fine = luneburg(17, 0.5), luneburg(65, 0.5)
    assert fine < 2e-3
    assert coarse / fine > 3  # its index has a kink at the rim
    assert IndexFunction(np.array([0.0]), np.array([[1.5]]), 1.0).at(np.nan)[0] == 1.0
