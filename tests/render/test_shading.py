"""Lit volumes against the reference. Lights and gradients are float32: the bound is four times that of unlit ones."""

from __future__ import annotations

from typing import Any

import moderngl
import numpy as np
import pytest
from render.scenes import SHAPE, camera_at, drawn_by_each, error, noise, picture, pictures, prepare, scene_of, whole
from render.test_independence import in_parts
from render.test_raycast import GRIDS

from clusterviz.data.source import Grid
from clusterviz.reference import render_reference
from clusterviz.scene.values import Clip, Light

pytestmark = pytest.mark.gl

GRID = Grid(SHAPE)
BOUND = 4e-5
SIZE = (24, 20)
LIT = {"shade": True, "ambient": 0.2, "diffuse": 0.8, "specular": 0.4, "specular_power": 12.0}
LIGHTS = (
    Light(position=(3, 1, 2), color=(1, 0.5, 0.2)),
    Light(position=(-1e9, 2e9, -3e8), intensity=0.4),
    Light(type="headlight", color=(0.1, 0.3, 0.5)),
)


def smooth(shape: tuple[int, int, int] = SHAPE, dtype: Any = np.float32) -> np.ndarray:
    """Waves with some noise: gradients of every direction, and few that vanish."""
    z, y, x = np.indices(shape)
    waves = np.sin(0.5 * x + 0.2) * np.cos(0.4 * y) + np.sin(0.3 * z + 0.1 * x)
    values = (waves + 2 + 0.2 * noise(shape)) / 4.2
    return values.astype(dtype) if np.dtype(dtype).kind == "f" else (values * np.iinfo(dtype).max).astype(dtype)


def lit_scene(voxels: np.ndarray, camera: str, grid: Grid = GRID, lights: Any = (), **keys: Any) -> Any:
    look = LIT | keys.pop("look", {})
    return scene_of(voxels, camera_at(camera, grid), look=look, parts={"lights": lights}, **keys)


@pytest.mark.parametrize("lights", [(), LIGHTS, LIGHTS[:1]], ids=["headlight", "three", "one"])
@pytest.mark.parametrize("dtype", ["uint8", "int16", "float32"])
def test_lit_picture_is_that_of_the_reference(context: moderngl.Context, dtype: str, lights: Any) -> None:
    voxels = smooth(dtype=dtype)
    for camera in ("outside", "inside", "parallel"):
        scene = lit_scene(voxels, camera, lights=lights)
        expected = render_reference(scene, GRID, voxels)
        dark = render_reference(scene_of(voxels, camera_at(camera, GRID)), GRID, voxels)
        assert np.abs(expected - dark).max() > 0.05, "the light changes nothing"
        assert error(context, expected, scene, voxels, brick=7) <= BOUND, camera


@pytest.mark.parametrize("dtype", ["uint8", "float32"])
def test_smooth_gradients_are_those_of_the_reference(context: moderngl.Context, dtype: str) -> None:
    voxels = smooth(dtype=dtype)
    keys: dict[str, Any] = {"look": {"gradient": "smooth"}}
    if dtype == "float32":
        voxels[np.random.default_rng(1).random(SHAPE) < 0.02] = np.nan
        keys |= {"clim": (0.1, 0.9), "classification": "pre-integrated", "size": (12, 10)}
    scene = lit_scene(voxels, "outside", **keys)
    expected = render_reference(scene, GRID, voxels)
    central = lit_scene(voxels, "outside", **keys | {"look": {}})
    assert np.abs(expected - render_reference(central, GRID, voxels)).max() > 0.01
    assert error(context, expected, scene, voxels, brick=7) <= BOUND
    if dtype == "float32":
        assert error(context, render_reference(central, GRID, voxels), central, voxels, brick=7) <= BOUND
    else:
        texture = lit_scene(voxels, "outside", filter="hardware", **keys)
        assert np.abs(picture(context, texture, voxels, brick=7) - expected).max() <= 0.05


def places(grid: Grid) -> tuple[Light, ...]:
    """A light in the volume, one beside it that fades, a wide cone, a light far away and a headlight."""
    corners = grid.corners
    inside, beside = (tuple((corners[0] * (1 - s) + corners[7] * s).tolist()) for s in (0.6, -0.3))
    unit = min(grid.spacing)
    return (
        Light(position=inside, positional=True, cone_angle=90, color=(1, 0.5, 0.2)),
        Light(position=beside, positional=True, cone_angle=90, attenuation=(0.5, 0.02 / unit, 1e-3 / unit**2)),
        Light(position=beside, focal_point=inside, positional=True, cone_angle=89, exponent=3.0, color=(0, 0.6, 1)),
        Light(position=(-1e9, 2e9, -3e8), intensity=0.2),
        Light(type="headlight", color=(0.1, 0.3, 0.2)),
    )


@pytest.mark.parametrize("name", ["turned-and-anisotropic", "nanometres", "gigametres", "far-from-the-origin"])
def test_lights_shine_from_their_places(context: moderngl.Context, name: str) -> None:
    voxels, grid = smooth(dtype=np.uint8), GRIDS[name]
    look = {"isosurfaces": (120.0,)} if name == "nanometres" else {}
    scene = lit_scene(voxels, "outside", grid, places(grid), unit=8 * min(grid.spacing), look=look)
    expected = render_reference(scene, grid, voxels)
    far = tuple(light.model_copy(update={"positional": False}) for light in places(grid))
    assert np.abs(expected - render_reference(scene.model_copy(update={"lights": far}), grid, voxels)).max() > 0.05
    assert error(context, expected, scene, voxels, grid, brick=7) <= BOUND


def test_a_cone_ends_at_its_edge(context: moderngl.Context) -> None:
    voxels = smooth(dtype=np.uint8)
    lamp = Light(position=(-20, 11, 9), focal_point=(12, 11, 9), positional=True, cone_angle=12.0)
    scene = lit_scene(voxels, "parallel", lights=(lamp,), size=(48, 40), classification="pre-integrated")
    dark = lit_scene(voxels, "parallel", lights=(Light(intensity=0, position=(1, 0, 0)),), size=(48, 40))
    expected, unlit = render_reference(scene, GRID, voxels), picture(context, dark, voxels)
    for found in pictures(context, scene, voxels, brick=7):
        # To float32, samples on the edge itself fall on either side.
        assert np.count_nonzero(np.abs(found - expected).max(axis=2) > BOUND) <= 4
        assert 0.1 < np.mean(np.abs(found - unlit).max(axis=2) < 0.02) < 0.9


@pytest.mark.parametrize("power", [0.0, 1.0, 200.0])
def test_every_power_of_the_highlight(context: moderngl.Context, power: float) -> None:
    voxels = smooth()
    scene = lit_scene(voxels, "outside", look={"specular_power": power, "specular": 1.0})
    assert error(context, render_reference(scene, GRID, voxels), scene, voxels) <= BOUND


@pytest.mark.parametrize("name", GRIDS)
def test_normals_are_those_of_the_world(context: moderngl.Context, name: str) -> None:
    voxels, grid = smooth(dtype=np.uint16), GRIDS[name]
    scene = lit_scene(voxels, "outside", grid, LIGHTS, unit=8 * min(grid.spacing))
    assert error(context, render_reference(scene, grid, voxels), scene, voxels, grid) <= BOUND


def test_nearest_voxels_are_lit_by_their_own_gradient(context: moderngl.Context) -> None:
    voxels = smooth()
    scene = lit_scene(voxels, "outside", interpolation="nearest", step=0.7)
    assert error(context, render_reference(scene, GRID, voxels), scene, voxels) <= BOUND


def test_texture_filter_lights_as_far_as_its_weights_go(context: moderngl.Context) -> None:
    voxels = smooth()
    scene = lit_scene(voxels, "outside", filter="hardware")
    assert error(context, render_reference(scene, GRID, voxels), scene, voxels) <= 0.05


@pytest.mark.parametrize("interpolation", ["linear", "nearest"])
def test_invalid_voxels_do_not_bend_the_normals_beside_them(context: moderngl.Context, interpolation: str) -> None:
    voxels = smooth()
    voxels[np.random.default_rng(1).random(SHAPE) < 0.03] = np.nan
    scene = lit_scene(voxels, "outside", clim=(0.1, 0.9), interpolation=interpolation, step=0.7, unit=3.0)
    expected = render_reference(scene, GRID, voxels)
    assert np.isfinite(expected).all()
    assert error(context, expected, scene, voxels, brick=7) <= BOUND


@pytest.mark.parametrize("value", [7, 250])
def test_constant_field_has_ambient_light_only(context: moderngl.Context, value: int) -> None:
    voxels = np.full(SHAPE, value, np.uint8)
    keys: dict[str, Any] = {"clim": (0.0, 255.0), "opacity": 0.3}
    dark = picture(context, scene_of(voxels, camera_at("outside", GRID), **keys), voxels)
    scene = lit_scene(voxels, "outside", **keys).model_copy(update={"clip": Clip(cap=False)})
    found = picture(context, scene, voxels)
    assert np.abs(found[..., :3] - 0.2 * dark[..., :3]).max() <= 1e-6
    assert np.abs(found[..., 3] - dark[..., 3]).max() <= 1e-6


def test_steep_fields_have_normals(context: moderngl.Context) -> None:
    voxels = smooth(dtype=np.float64)
    for low, high in ((0.5, 0.5 + 1e-12), (0.5, 0.5 + 1e-25 * 2**40)):
        scene = lit_scene(voxels, "outside", clim=(low, high), opacity=0.5)
        assert error(context, render_reference(scene, GRID, voxels), scene, voxels) <= 1e-3


@pytest.mark.parametrize("brick", [5, 16, 33, 64])
def test_bricks_leave_no_seams(context: moderngl.Context, brick: int) -> None:
    voxels = smooth((40, 35, 70), np.uint8)
    grid = Grid(voxels.shape)
    scene = lit_scene(voxels, "outside", grid)
    for one, other in zip(
        *(drawn_by_each(context, prepare(scene, voxels, grid, side)) for side in (70, brick)), strict=True
    ):
        assert other.samples == one.samples
        assert np.abs(whole(other.partial, SIZE) - whole(one.partial, SIZE)).max() <= 1e-5


def test_parts_drawn_apart_make_the_whole(context: moderngl.Context) -> None:
    voxels = smooth(dtype=np.uint8)
    scene = lit_scene(voxels, "outside")
    prepared = prepare(scene, voxels, brick=7)
    for where, drawn in zip((context, None), drawn_by_each(context, prepared), strict=True):
        for parts in (3, 5):
            found, samples = in_parts(where, scene, prepared, parts)
            assert samples == drawn.samples
            assert np.abs(found - whole(drawn.partial, SIZE)).max() <= 1e-5


@pytest.mark.parametrize(("interpolation", "lights"), [("linear", LIGHTS * 5), ("cubic", ())])
def test_no_ray_is_cut_short_by_the_loops_of_light(context: moderngl.Context, interpolation: str, lights: Any) -> None:
    """A driver may leave all loops of an invocation after 65535 passes, those over lights and voxels included."""
    voxels = smooth((9, 8, 11))
    grid = Grid(voxels.shape)
    keys: dict[str, Any] = {"opacity": 0.3, "unit": 3.0, "step": 8e-3, "size": (4, 4), "interpolation": interpolation}
    scene = lit_scene(voxels, "outside", grid, lights, **keys)
    assert error(context, render_reference(scene, grid, voxels), scene, voxels, grid) <= BOUND


def plateaus() -> np.ndarray:
    """Two even tissues, steps between them, and next to nothing of a gradient inside."""
    z, y, x = np.indices(SHAPE)
    values = np.where((x - 12) ** 2 + (y - 11) ** 2 + (z - 9) ** 2 < 64, 160, 110).astype(np.uint8)
    values[::5, ::4] += (x % 2)[::5, ::4].astype(np.uint8)
    return values


@pytest.mark.parametrize("classification", ["post", "pre-integrated"])
@pytest.mark.parametrize("name", ["plain", "turned"])
def test_cut_faces_are_lit_as_the_plane_is(context: moderngl.Context, classification: str, name: str) -> None:
    grid, voxels = GRIDS.get(name, GRID), plateaus()
    middle = tuple((grid.world_from_index @ (12, 11, 9, 1))[:3].tolist())
    cut = Clip(planes=((middle, (-1.0, -0.6, -0.3)),))
    keys: dict[str, Any] = {"clim": (100.0, 170.0), "opacity": 0.3, "unit": 2.0, "classification": classification}
    keys |= {"size": (12, 10)} if classification == "pre-integrated" else {}
    scene = lit_scene(voxels, "outside", grid, LIGHTS, **keys).model_copy(update={"clip": cut})
    expected = render_reference(scene, grid, voxels)
    ambient = {"diffuse": 0.0, "specular": 0.0}
    unlit = lit_scene(voxels, "outside", grid, LIGHTS, look=ambient, **keys).model_copy(update={"clip": cut})
    even = np.full(SHAPE, 110, np.uint8)  # it has no gradient anywhere
    bright, dark = (render_reference(each, grid, even) for each in (scene, unlit))
    seen = bright[..., 3] > 0.5
    assert seen.any()
    assert np.median(bright[seen, :3].sum(-1) / dark[seen, :3].sum(-1)) > 1.5, "the cut is dark"
    for brick in (5, 11):
        assert error(context, expected, scene, voxels, grid, brick=brick) <= BOUND
