"""The page's camera against clusterviz's own: the browser must move, fit and project as `render` does."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from clusterviz.scene import Scene
from clusterviz.scene.animation import KeyFrames, scenes_along
from clusterviz.scene.camera import camera_axes, fitted_camera, project_points
from clusterviz.scene.values import Camera

if TYPE_CHECKING:
    from playwright.sync_api import Page

pytestmark = pytest.mark.browser
SIZE = (97, 61)
KEYS = ("position", "focal_point", "view_up", "view_angle", "parallel_scale")
CORNERS = np.array([[x, y, z] for z in (-3.0, 8.0) for y in (0.0, 5.0) for x in (1.0, 13.0)])
BOUNDS = [[1, 0, -3], [13, 5, 8]]


def random_cameras() -> list[Camera]:
    """Cameras in all directions, near and far, half of them parallel."""
    random = np.random.default_rng(18)
    return [
        Camera(
            position=tuple(random.normal(size=3) * 10 ** random.uniform(0, 3)),
            focal_point=tuple(random.normal(size=3)),
            view_up=tuple(random.normal(size=3)),
            view_angle=random.uniform(5, 120),
            parallel_scale=random.uniform(0.1, 9) if i % 2 else None,
        )
        for i in range(8)
    ]


def as_json(camera: Camera) -> dict[str, Any]:
    return {key: getattr(camera, key) for key in KEYS}


def in_page(page: Page, body: str, *arguments: Any) -> Any:
    """Run JavaScript on `m`, the camera module, and `a`, the arguments."""
    return page.evaluate(f"async (a) => {{ const m = await import('./camera.js'); {body} }}", list(arguments))


def frame(camera: dict[str, Any] | Camera) -> np.ndarray:
    """Return position, focal point and axes, float64 (5, 3): all that a picture depends on, besides angle and scale."""
    given = as_json(camera) if isinstance(camera, Camera) else camera
    axes = camera_axes(given["position"], given["focal_point"], given["view_up"])
    return np.array([given["position"], given["focal_point"], *axes])


def assert_same_view(found: dict[str, Any], expected: Camera) -> None:
    distance = math.dist(found["position"], found["focal_point"])
    np.testing.assert_allclose(frame(found), frame(expected), rtol=1e-9, atol=1e-9 * distance)
    assert found["view_angle"] == pytest.approx(expected.view_angle)
    assert found["parallel_scale"] == pytest.approx(expected.parallel_scale)


def test_moves_fits_and_projections_are_those_of_clusterviz(module_page: Page) -> None:
    body = """
      return a[0].map((camera) => ({
        turned: m.roll(m.orbit(camera, 33, 21), -17),
        pixels: a[1].map((point) => m.projected(camera, point, ...a[2])),
        fitted: m.fitted(camera, a[1], a[2][0] / a[2][1]),
      }));
    """
    cameras = random_cameras()
    found = in_page(module_page, body, [as_json(camera) for camera in cameras], CORNERS.tolist(), SIZE)
    for camera, got in zip(cameras, found, strict=True):
        # Rotations are about the axes that are seen, so view_up is made one of them first.
        up = tuple(float(v) for v in frame(camera)[3])
        turns = {"view_up": up, "azimuth": 33.0, "elevation": 21.0, "roll": -17.0}
        assert_same_view(got["turned"], fitted_camera(camera.model_copy(update=turns), CORNERS, 1.0, SIZE))
        centre = CORNERS.mean(axis=0)
        moved = {"focal_point": tuple(centre), "position": tuple(centre + frame(camera)[0] - frame(camera)[1])}
        fit = camera.model_copy(update={**moved, "fit": True})
        assert_same_view(got["fitted"], fitted_camera(fit, CORNERS, 1.0, SIZE))
        pixels, ahead = project_points(camera, CORNERS, SIZE)
        seen = ahead > 0
        np.testing.assert_allclose(np.array(got["pixels"])[seen, :2], pixels[seen], rtol=1e-9, atol=1e-6)
        np.testing.assert_allclose(np.array(got["pixels"])[:, 2], ahead, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("orientation", ["", "RAS", "LPS", "SAR"])
def test_named_views_are_those_of_clusterviz(module_page: Page, orientation: str) -> None:
    names = ["front", "back", "left", "right", "top", "bottom"]
    body = """
      const start = {
        position: [0, 0, 1], focal_point: [0, 0, 0], view_up: [0, 1, 0], view_angle: 30, parallel_scale: null,
      };
      return a[0].map((name) => {
        const {toward, up} = m.namedView(name, a[2]);
        return m.fitted(start, m.boxCorners(a[1]), 97 / 61, toward, up);
      });
    """
    for name, found in zip(names, in_page(module_page, body, names, BOUNDS, orientation), strict=True):
        assert_same_view(found, fitted_camera(Camera(view=name), CORNERS, 1.0, SIZE, orientation))


def test_what_the_cursor_holds_stays_under_it(module_page: Page) -> None:
    """Zoom and pan about a point of the focal plane, both projections, and back; a path's ends are its key frames."""
    body = """
      return a[0].map((camera) => {
        const [width, height] = a[1];
        const [x, y] = [70, 11];
        const ray = m.pixelRay(camera, x, y, width, height);
        const {forward} = m.cameraAxes(camera);
        const offset = m.subtract(camera.focal_point, ray.origin);
        const held = m.addScaled(ray.origin, ray.direction, m.dot(offset, forward) / m.dot(ray.direction, forward));
        const at = (moved) => m.projected(moved, held, width, height).slice(0, 2);
        const share = [(x - width / 2) / height, (y - height / 2) / height];
        const middle = m.interpolateCamera(camera, m.orbit(camera, 180, 0), 0.5);
        return {
          zoomed: at(m.zoom(camera, 2.5, ...share)),
          panned: at(m.pan(camera, 7 / height, -5 / height)),
          other: at(m.otherProjection(camera)),
          back: m.otherProjection(m.otherProjection(camera)),
          ends: [0, 1].map((each) => m.interpolateCamera(camera, a[0][0], each)),
          distances: [m.eyeDistance(camera), m.eyeDistance(middle)],
        };
      });
    """
    cameras = random_cameras()
    for camera, found in zip(cameras, in_page(module_page, body, [as_json(c) for c in cameras], SIZE), strict=True):
        assert found["zoomed"] == pytest.approx([70, 11])
        assert found["panned"] == pytest.approx([77, 6])
        assert found["other"] == pytest.approx([70, 11])
        if camera.parallel_scale is None:
            assert_same_view(found["back"], camera)
            assert_same_view(found["ends"][0], camera.model_copy(update={"parallel_scale": cameras[0].parallel_scale}))
        assert_same_view(found["ends"][1], cameras[0])
        assert found["distances"][0] == pytest.approx(found["distances"][1])


def test_an_orbit_over_the_pole_is_smooth(module_page: Page) -> None:
    """72 steps of 5° upwards go once round through both poles, without a flip or a jump of any axis."""
    body = """
      let camera = {
        position: [0, -10, 0], focal_point: [0, 0, 0], view_up: [0, 0, 1], view_angle: 30, parallel_scale: null,
      };
      return Array.from({length: 72}, () => (camera = m.orbit(camera, 0, 5)));
    """
    frames = [frame(camera) for camera in in_page(module_page, body)]
    turns = [np.linalg.norm(after[2:] - before[2:]) for before, after in pairwise(frames)]
    assert max(turns) < 2 * math.radians(5)
    np.testing.assert_allclose(frames[-1][0], [0, -10, 0], atol=1e-9)


@pytest.mark.parametrize("parallel", [False, True])
def test_a_path_is_played_as_animate_draws_it(module_page: Page, parallel: bool) -> None:
    """Uneven times, a camera that rests between two key frames, and the ends."""
    cameras = random_cameras()[parallel::2]
    poses = [as_json(cameras[n]) for n in (0, 1, 1, 2, 3)]
    keys = [{"time": time, **pose} for time, pose in zip((0.0, 0.5, 2.0, 2.25, 4.0), poses, strict=True)]
    scenes = scenes_along(Scene(camera=cameras[0]), 17, keys=KeyFrames.model_validate({"camera": keys}))
    body = "const p = await import('./path.js'); return a[1].map((time) => p.cameraOnPath(a[0], time));"
    times = [4.0 * number / 16 for number in range(17)]
    path = [{"time": key["time"], "camera": pose} for key, pose in zip(keys, poses, strict=True)]
    for found, expected in zip(in_page(module_page, body, path, times), scenes, strict=True):
        assert_same_view(found, expected.camera)
