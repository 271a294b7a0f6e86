"""Pictures of which something is known without a reference: closed forms, counts of samples, what must not matter."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import moderngl
import numpy as np
import pytest
from render.scenes import (
    FAINT,
    LIGHTS,
    LIT,
    SHAPE,
    TURNED,
    camera_at,
    clip_of,
    draw,
    drawn,
    noise,
    prepare,
    scene_of,
    smooth,
)

from clusterviz.data.source import Grid
from clusterviz.reference import render_reference
from clusterviz.reference.rays import pixel_shifts
from clusterviz.render.render_result import finish_projection
from clusterviz.scene.values import Camera, Clip, Light, Quality, Scene

pytestmark = pytest.mark.gl

GRID = Grid(SHAPE)
BOUND = 1e-5
ALONG = camera_at("parallel-along-an-axis", GRID)
SURFACE = LIT | {"blending": "isosurface"}
PREINTEGRATED = {"classification": "pre-integrated"}


@pytest.fixture
def pictures(context: moderngl.Context) -> Any:
    """`pictures(scene, voxels, …)`: (h, w, 4) by OpenGL, and by the CPU where it can draw the scene."""

    def draw_each(scene: Scene, voxels: np.ndarray, grid: Grid | None = None, brick: int = 16) -> list[np.ndarray]:
        prepared = prepare(scene, voxels, grid, brick)
        casters = (context, None)
        return [drawn(where, prepared)[0] for where in casters]

    return draw_each


@pytest.mark.parametrize("filter", ["exact", "hardware"])
def test_a_constant_field_has_the_opacity_of_its_thickness(pictures: Any, filter: str) -> None:
    for dtype in (np.uint8, np.int16, np.float32):
        scene = scene_of(np.full(SHAPE, 7, dtype), ALONG, clim=(6.5, 7.5), opacity=0.3, unit=8.0, filter=filter)
        for found in pictures(scene, np.full(SHAPE, 7, dtype)):
            assert found[..., 3].max() == pytest.approx(1 - 0.7 ** (25 / 8), abs=1e-6)


@pytest.mark.parametrize(("normal", "slabs"), [(1, 25 - 12), (-1, 13)])
def test_a_plane_on_midpoints_keeps_them(pictures: Any, normal: int, slabs: int) -> None:
    """Rays along x, midpoints at k + 1/2: a plane through one of them keeps it, whichever way it faces."""
    voxels, clip = np.full(SHAPE, 7, np.uint8), {"planes": [[[12.5, 0, 0], [normal, 0, 0]]]}
    for found in pictures(scene_of(voxels, ALONG, clim=(6.5, 7.5), opacity=0.3, unit=8.0, clip=clip), voxels):
        assert found[10, 12, 3] == pytest.approx(1 - 0.7 ** (slabs / 8), abs=1e-6)


@pytest.mark.parametrize(("threshold", "scalar"), [(80.0, 90.0), (100.0, 150.0), (200.0, 220.0), (230.0, 220.0)])
def test_the_threshold_of_a_local_maximum_is_in_data_values(pictures: Any, threshold: float, scalar: float) -> None:
    voxels = np.zeros(SHAPE, np.uint8)
    voxels[:, :, 5], voxels[:, :, 13], voxels[:, :, 21] = 90, 150, 220
    keys: dict[str, Any] = {"blending": "local-maximum", "threshold": threshold, "opacity": ((0, 0.0), (1, 1.0))}
    # Midpoints lie on the odd planes of samples.
    for found in pictures(scene_of(voxels, ALONG, clim=(0, 255), step=2 / 3, **keys), voxels):
        assert found[10, 12, 3] == pytest.approx(scalar / 255, abs=1e-5)


@pytest.mark.parametrize(("blending", "grey"), [("average", 0.4 * 0.5), ("additive", 0.4 * 0.5 * 25 / 40)])
def test_sums_over_a_constant_field_do_not_depend_on_the_step(pictures: Any, blending: str, grey: float) -> None:
    voxels = np.full(SHAPE, 0.5, np.float32)
    for step in (0.3, 1.0, 7.0):
        scene = scene_of(voxels, ALONG, clim=(0, 1), opacity=0.4, unit=40.0, step=step, blending=blending)
        for found in pictures(scene, voxels):
            assert found[10, 12] == pytest.approx([grey, grey, grey, 1.0], abs=1e-6), step


@pytest.mark.cover("cubic")
@pytest.mark.parametrize(
    ("voxels", "interpolation"),
    [(np.full(SHAPE, 77, np.uint8), "linear"), (np.full(SHAPE, 0.123, np.float32), "cubic")],
    ids=["linear", "cubic"],
)
def test_a_constant_field_has_ambient_light_only(pictures: Any, voxels: np.ndarray, interpolation: str) -> None:
    """Without caps, since the volume's faces have normals."""
    value = float(voxels[0, 0, 0])
    keys: dict[str, Any] = {"clim": (value - 0.3, value + 0.6), "opacity": 0.3, "interpolation": interpolation}
    scenes = [scene_of(voxels, camera_at("outside", GRID), clip=Clip(cap=False), **keys, **lit) for lit in (LIT, {})]
    for found, dark in zip(*(pictures(scene, voxels) for scene in scenes), strict=True):
        assert np.abs(found[..., :3] - 0.2 * dark[..., :3]).max() <= 1e-6
        assert np.abs(found[..., 3] - dark[..., 3]).max() <= 1e-6


@pytest.mark.cover
@pytest.mark.parametrize(
    ("keys", "same", "bound"),
    [
        ({"clip": clip_of(GRID, "nothing-cut")}, {}, 0.0),
        ({"gradient_opacity": ((0.1, 1.0),)}, {}, 2e-6),
        ({"isosurfaces": [(0.5, 1e-9)]}, {}, 1e-6),  # a slab that is cut in two absorbs as a whole one
        ({"step": 30.0} | PREINTEGRATED, {"step": 2.0} | PREINTEGRATED, 0.0),  # bricks have room for no more
        ({"step": 100.0, "isosurfaces": [(0.5, 0.4), (0.8, 1.0)]} | SURFACE, {"step": 2.0}, 0.0),
    ],
    ids=["clip of nothing", "factor of 1", "transparent surface", "slabs of 2 voxels at most", "surfaces at any step"],
)
def test_what_must_not_matter_does_not(pictures: Any, keys: dict[str, Any], same: dict[str, Any], bound: float) -> None:
    voxels = smooth()
    same = {key: keys[key] for key in keys if "step" in keys} | same
    scenes = [scene_of(voxels, camera_at("outside", GRID), **each) for each in (keys, same)]
    for found, plain in zip(*(pictures(scene, voxels) for scene in scenes), strict=True):
        assert plain.any()
        assert np.abs(found - plain).max() <= bound


@pytest.mark.parametrize("keys", [{"gradient_opacity": ((0.1, 0.0),)}, SURFACE | {"isosurfaces": [(0.5, 0.0)]}])
def test_factors_and_surfaces_without_opacity_are_an_empty_picture(pictures: Any, keys: dict[str, Any]) -> None:
    voxels = smooth()
    for found in pictures(scene_of(voxels, camera_at("outside", GRID), **keys), voxels):
        assert np.abs(found).max() <= 2e-6


@pytest.mark.parametrize("scale", [1e-25, 1e25])
def test_units_of_data_do_not_matter(pictures: Any, scale: float) -> None:
    scenes = []
    for voxels in (smooth((9, 8, 11), np.float64), smooth((9, 8, 11), np.float64) * scale):
        per = float(np.ptp(voxels))
        points = ((0.02 * per, 0.0), (0.1 * per, 0.3))
        scenes.append(pictures(scene_of(voxels, camera_at("outside", GRID), gradient_opacity=points), voxels))
    for near, far in zip(*scenes, strict=True):
        assert near.any()
        assert np.abs(near - far).max() <= BOUND


def test_steep_fields_have_normals(pictures: Any) -> None:
    voxels = smooth(dtype=np.float64)
    for low, high in ((0.5, 0.5 + 1e-12), (0.5, 0.5 + 1e-25 * 2**40)):
        scene = scene_of(voxels, camera_at("outside", GRID), clim=(low, high), opacity=0.5, **LIT)
        expected = render_reference(scene, GRID, voxels)
        for found in pictures(scene, voxels):
            assert np.abs(found - expected).max() <= 1e-3


def test_a_cone_ends_at_its_edge(pictures: Any) -> None:
    voxels = smooth(dtype=np.uint8)
    lamp = Light(position=(-20, 11, 9), focal_point=(12, 11, 9), positional=True, cone_angle=12.0)
    keys: dict[str, Any] = {"size": (48, 40)} | LIT | PREINTEGRATED
    scene, dark = (
        scene_of(voxels, camera_at("parallel", GRID), lights=(light,), **keys)
        for light in (lamp, Light(intensity=0, position=(1, 0, 0)))
    )
    expected = render_reference(scene, GRID, voxels)
    for found, unlit in zip(pictures(scene, voxels), pictures(dark, voxels), strict=True):
        # To float32, samples on the edge itself fall on either side.
        assert np.count_nonzero(np.abs(found - expected).max(axis=2) > BOUND) <= 4
        assert 0.1 < np.mean(np.abs(found - unlit).max(axis=2) < 0.02) < 0.9


def test_a_step_of_gradient_opacity_is_a_step(pictures: Any) -> None:
    voxels = smooth()
    per = float(np.ptp(voxels))
    points = tuple((m * per, factor) for m, factor in ((0.02, 0.0), (0.1, 0.3), (0.1, 0.6), (0.3, 1.0)))
    scene = scene_of(voxels, camera_at("outside", GRID), gradient_opacity=points)
    expected = render_reference(scene, GRID, voxels)
    for found in pictures(scene, voxels):
        wrong = np.abs(found - expected).max(axis=2) > BOUND
        assert np.count_nonzero(wrong) <= 2, "more than samples that lie on the step itself"


def plateaus() -> np.ndarray:
    """Two even tissues, steps between them, and next to nothing of a gradient inside."""
    z, y, x = np.indices(SHAPE)
    values = np.where((x - 12) ** 2 + (y - 11) ** 2 + (z - 9) ** 2 < 64, 160, 110).astype(np.uint8)
    values[::5, ::4] += (x % 2)[::5, ::4].astype(np.uint8)
    return values


@pytest.mark.cover("plain-pre-integrated")
@pytest.mark.parametrize("keys", [{}, PREINTEGRATED | {"size": (12, 10)}], ids=["post", "pre-integrated"])
@pytest.mark.parametrize(
    "grid", [GRID, Grid(SHAPE, origin=(-7.0, 3.0, 1.0), direction=TURNED)], ids=["plain", "turned"]
)
def test_cut_faces_are_lit_as_the_plane_is(pictures: Any, grid: Grid, keys: dict[str, Any]) -> None:
    voxels, even = plateaus(), np.full(SHAPE, 110, np.uint8)  # it has no gradient anywhere
    middle = tuple((grid.world_from_index @ (12, 11, 9, 1))[:3].tolist())
    keys = keys | {"clip": Clip(planes=((middle, (-1.0, -0.6, -0.3)),)), "lights": LIGHTS} | LIT
    scene, unlit = (
        scene_of(voxels, camera_at("outside", grid), clim=(100.0, 170.0), opacity=0.3, unit=2.0, **keys | more)
        for more in ({}, {"diffuse": 0.0, "specular": 0.0})
    )
    bright, dark = (render_reference(each, grid, even) for each in (scene, unlit))
    seen = bright[..., 3] > 0.5
    assert seen.any()
    assert np.median(bright[seen, :3].sum(-1) / dark[seen, :3].sum(-1)) > 1.5, "the cut is dark"
    expected = render_reference(scene, grid, voxels)
    for found in pictures(scene, voxels, grid, 5):
        assert np.abs(found - expected).max() <= BOUND


def test_shells_thinner_than_slabs_have_no_holes(pictures: Any) -> None:
    """Rays enter and leave them within a slab, whose ends are both outside."""
    z, y, x = np.indices((24, 24, 24)) - 11.5
    voxels = np.exp(-(((np.sqrt(x * x + y * y + z * z) - 7) / 0.7) ** 2)).astype(np.float32)
    grid, look = Grid(voxels.shape), {"blending": "isosurface", "isosurfaces": [(0.5, 1.0)], "shade": True}
    scenes = [scene_of(voxels, camera_at("outside", grid), step=step, **look) for step in (1.0, 0.1)]
    coarse, fine = (render_reference(scene, grid, voxels) for scene in scenes)
    assert fine[..., 3].max() > 0.3
    assert np.abs(coarse - fine).max() <= 1e-9
    for found in pictures(scenes[0], voxels, grid):
        assert np.count_nonzero(np.abs(found - fine).max(axis=-1) > 1e-4) <= 1


@pytest.mark.parametrize(
    ("keys", "drawn_bricks"),
    [
        ({"clip": {"planes": [[[41, 0, 0], [1, 0, 0]]]}}, [5, 6, 7]),
        ({"blending": "isosurface", "isosurfaces": [20.0]}, [2]),
    ],
    ids=["clipped", "one surface"],
)
def test_bricks_that_show_nothing_are_not_drawn(pictures: Any, keys: dict[str, Any], drawn_bricks: list[int]) -> None:
    voxels = np.broadcast_to(np.arange(64, dtype=np.uint8), (20, 20, 64)).copy()
    grid = Grid(voxels.shape)
    scene = scene_of(voxels, camera_at("outside", grid), clim=(0, 64), opacity=1.0, **keys)
    cost = prepare(scene, voxels, grid, brick=8).plan.cost
    assert np.flatnonzero((cost > 0).all(axis=(0, 1))).tolist() == drawn_bricks
    assert np.count_nonzero(cost) == len(drawn_bricks) * cost[..., 0].size
    expected = render_reference(scene, grid, voxels)
    for found in pictures(scene, voxels, grid, 8):
        assert np.abs(found - expected).max() <= 1e-4


def test_the_footprint_holds_all_that_is_drawn_and_little_more(context: moderngl.Context) -> None:
    voxels = noise(dtype="uint8")
    scene = scene_of(voxels, camera_at("outside", GRID), size=(64, 48), opacity=0.5)
    rect, other = (draw(where, prepare(scene, voxels)).partial.rect for where in (context, None))
    assert rect == other
    rows, columns = np.nonzero(render_reference(scene, GRID, voxels)[..., 3])
    spare = (columns.min() - rect.x_begin, rows.min() - rect.y_begin)
    spare += (rect.x_end - columns.max() - 1, rect.y_end - rows.max() - 1)
    # One pixel for rounding, and one or two whose centres a pointed corner misses.
    assert all(0 <= pixels <= 3 for pixels in spare), spare


def test_samples_are_counted_once_each(context: moderngl.Context) -> None:
    """All rays run along x: 25 cells are 50 slabs of half a cell, however opaque; one slab of 100 voxels is one."""
    voxels = noise(dtype="uint8")
    for opacity, step, slabs in ((1e-6, 0.5, 50), (0.5, 0.5, 50), (0.5, 100.0, 1)):
        prepared = prepare(scene_of(voxels, ALONG, opacity=opacity, unit=1.0, step=step, size=(12, 10)), voxels)
        for where in (context, None):
            found, samples = drawn(where, prepared)
            rays = np.count_nonzero(found[..., 3])
            assert rays > 0
            assert samples == rays * slabs


@pytest.mark.parametrize("points", [2, 1000])
def test_no_ray_is_cut_short_by_the_drivers_limit_of_loop_iterations(context: moderngl.Context, points: int) -> None:
    """Mesa's llvmpipe leaves all loops of an invocation after 65535 passes; 16 cells in steps of 1e-4 take 160000."""
    voxels = np.full((17, 17, 17), 0.5, np.float32)
    camera = Camera(position=(-50, 8, 8), focal_point=(8, 8, 8), view_up=(0, 0, 1), parallel_scale=2)
    close = 0.5 + np.linspace(-4e-5, 4e-5, points)  # all in one bucket of the transfer function
    opacity = ((0.0, 0.5), *((float(value), 0.5) for value in close), (1.0, 0.5))
    scene = scene_of(voxels, camera, clim=(0.0, 1.0), opacity=opacity, unit=16.0, step=1e-4, size=(3, 3))
    for where in (context, None):
        found, samples = drawn(where, prepare(scene, voxels))
        assert samples == 9 * 160_000
        assert np.abs(found[..., 3] - 0.5).max() <= 1e-6


@pytest.mark.cover
@pytest.mark.parametrize("residual", [0.01, 0.1, 0.5])
@pytest.mark.parametrize(
    "keys", [{}, PREINTEGRATED, SURFACE | {"isosurfaces": [0.4]}], ids=["post", "integrated", "surface"]
)
def test_early_termination_errs_by_the_residual_at_most_and_saves_samples(
    context: moderngl.Context, keys: dict[str, Any], residual: float
) -> None:
    voxels = smooth()
    for where in (context, None):
        (full, samples), (ended, fewer) = (
            drawn(
                where,
                prepare(scene_of(voxels, camera_at("outside", GRID), opacity=0.99, step=0.4, **keys, **early), voxels),
            )
            for early in ({}, {"early_termination": residual})
        )
        assert fewer < samples
        assert np.abs(full - ended).max() <= residual
        assert "isosurfaces" in keys or not np.array_equal(full, ended)


@pytest.mark.cover
@pytest.mark.parametrize(("filter", "bound"), [("exact", BOUND), ("hardware", 0.03)])
@pytest.mark.parametrize("shape", [(2, 3, 5000), (2, 5000, 3), (3000, 2, 2)], ids=["x", "y", "z"])
def test_volume_longer_than_a_texture_may_be(
    pictures: Any, shape: tuple[int, int, int], filter: str, bound: float
) -> None:
    """Drawn in bricks of any size; the far end is looked at, where a position has the most digits."""
    voxels = noise(shape, np.uint8)
    focal = (np.array(shape[::-1]) - 1) * 0.97
    camera = Camera(
        position=tuple((focal + np.array([3, 6, 5])).tolist()), focal_point=tuple(focal.tolist()), view_up=(0.1, 0, 1)
    )
    scene = scene_of(voxels, camera, unit=1.0, filter=filter)
    expected = render_reference(scene, Grid(shape), voxels)
    assert expected[..., 3].max() > 0.1
    for brick in (64, 1024):
        for found in pictures(scene, voxels, brick=brick):
            # Positions in a brick are float32: their error grows with the brick.
            assert np.abs(found - expected).max() <= bound * max(1, brick / 64)


@pytest.mark.long
def test_more_bricks_than_fit_beside_each_other_in_a_texture(pictures: Any) -> None:
    """3025 bricks of 3 samples a side; a texture has room for 682 beside each other where its side is 2048."""
    voxels = noise((3, 110, 110), np.uint8)
    scene = scene_of(voxels, camera_at("outside", Grid(voxels.shape)), filter="hardware", size=(16, 12))
    for found in pictures(scene, voxels, brick=2):
        assert np.abs(found - render_reference(scene, Grid(voxels.shape), voxels)).max() <= 0.03


BAND = ((0.0, 0.0), (0.45, 0.0), (0.5, 0.5), (0.55, 0.0), (1.0, 0.0))  # groups are skipped that do not reach it
LARGE = Grid((40, 35, 70))
SEAMS: dict[str, tuple[Any, dict[str, Any], float]] = {
    "faint": (noise, {"opacity": FAINT}, 1e-6),
    "lit": (smooth, LIT, BOUND),
    "cubic": (smooth, LIT | {"interpolation": "cubic", "opacity": BAND}, BOUND),
    "pre-integrated": (noise, PREINTEGRATED | {"opacity": FAINT, "step": 2.0}, 1e-6),
    "jittered": (noise, {"opacity": FAINT, "jitter": True, "step": 1.3}, 1e-6),
    "surfaces": (smooth, SURFACE | {"isosurfaces": [(140.0, 1.0), (178.0, 0.4)], "step": 2.0}, BOUND),
}


@pytest.mark.cover("lit", "faint", "cubic", "surfaces", "jittered")
@pytest.mark.parametrize("name", SEAMS)
def test_neither_the_size_of_bricks_nor_the_caster_changes_picture_or_samples(
    context: moderngl.Context, name: str
) -> None:
    fill, keys, bound = SEAMS[name]
    voxels = fill(LARGE.shape_zyx, "uint8")
    scene = scene_of(voxels, camera_at("outside", LARGE), **keys)
    first, samples = drawn(context, prepare(scene, voxels, LARGE, 70))
    assert first[..., 3].max() > 0.01
    for brick in (5, 33):
        for where in (context, None):
            found, taken = drawn(where, prepare(scene, voxels, LARGE, brick))
            assert np.abs(found - first).max() <= bound, brick
            # What is transparent is left out by groups of cells, and these begin with each brick.
            assert taken == samples or name in ("cubic", "surfaces")


@pytest.mark.parametrize("step", [0.02, 1e-3])
def test_short_slabs_at_the_faces_of_bricks_are_taken_once(context: moderngl.Context, step: float) -> None:
    """Where a slab is as short as the rounding of a position, faces between boxes are the hard case."""
    voxels, grid = noise((5, 6, 60), np.float32), Grid((5, 6, 60))
    prepared = prepare(
        scene_of(voxels, camera_at("outside", grid), opacity=FAINT, step=step, size=(5, 4)), voxels, brick=29
    )
    for where in (context, None):
        picture, samples = drawn(where, prepared)
        for parts in (2, 3):
            found, taken = drawn(where, prepared, parts)
            assert taken == samples
            assert np.abs(found - picture).max() <= 1e-6


def test_composited_pixels_are_finished_already() -> None:
    plan, merged = prepare(scene_of(noise(), ALONG), noise()).plan, np.zeros((20, 24, 4), np.float32)
    assert finish_projection(replace(plan), merged) is merged


def test_shifts_are_spread_evenly() -> None:
    assert Quality().jitter is False
    shifts = pixel_shifts((256, 128))
    assert 0 <= shifts.min() < 1e-3
    assert 0.999 < shifts.max() < 1
    assert abs(shifts.mean() - 0.5) < 5e-3
    assert abs(shifts.std() - 12**-0.5) < 5e-3
    rows = shifts.reshape(128, 256) - 0.5
    for beside in (rows[1:] * rows[:-1], rows[:, 1:] * rows[:, :-1]):
        assert abs(beside.mean()) < 2e-3, "neighbours are alike"
