"""Animation paths: closed orbits, interpolated key frames, and refused input."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clusterviz.errors import SceneError
from clusterviz.scene import Camera, Scene, Volume
from clusterviz.scene.animation import KeyFrames, centripetal, load_path, monotone, orbit, scenes_along

CAMERA = Camera(position=(5.0, 1.0, 2.0), focal_point=(1.0, 1.0, 1.0), view_up=(0.0, 0.0, 2.0))
SCENE = Scene(
    volumes=(Volume(path="field:gaussian:8", cmap="bone", clim=(0.0, 1.0), opacity=0.5, opacity_unit_distance=1.0),),
    camera=CAMERA,
)


def positions(cameras: list[Camera]) -> Any:
    return np.array([camera.position for camera in cameras])


def keys_of(**tracks: Any) -> KeyFrames:
    return KeyFrames.model_validate(tracks)


def test_a_full_orbit_ends_one_step_before_the_start() -> None:
    found = positions(orbit(CAMERA, 360.0, 4))
    assert np.allclose(found, [(5, 1, 2), (1, 5, 2), (-3, 1, 2), (1, -3, 2)])
    assert np.allclose(positions(orbit(CAMERA, -720.0, 4))[1], (-3, 1, 2))


def test_a_part_of_an_orbit_ends_at_its_end() -> None:
    found = positions(orbit(CAMERA, 90.0, 3))
    assert np.allclose(found[[0, 2]], [(5, 1, 2), (1, 5, 2)])
    assert np.allclose(np.linalg.norm(found - (1, 1, 2), axis=1), 4)
    assert orbit(CAMERA, 90.0, 1) == [CAMERA]


def test_an_orbit_turns_round_any_up() -> None:
    camera = CAMERA.model_copy(update={"view_up": (1.0, 2.0, -1.0)})
    arms = positions(orbit(camera, 360.0, 7)) - (1, 1, 1)
    assert np.allclose(np.linalg.norm(arms, axis=1), math.sqrt(17))
    assert np.allclose(arms @ (1, 2, -1), arms[0] @ (1, 2, -1))


numbers = st.floats(-1e3, 1e3)


@given(st.lists(st.tuples(st.floats(0.01, 10), numbers), min_size=2, max_size=6), st.floats(0, 1))
def test_numbers_meet_their_keys_and_stay_between_them(keys: list[tuple[float, float]], share: float) -> None:
    times = np.cumsum([step for step, _ in keys])
    values = np.array([[value] for _, value in keys])
    for time, value in zip(times, values, strict=True):
        assert monotone(times, values, float(time)) == pytest.approx(value)
    for i in range(len(keys) - 1):
        early, late = (monotone(times, values, times[i] + s * (times[i + 1] - times[i]))[0] for s in (share / 2, share))
        low, high = sorted((values[i, 0], values[i + 1, 0]))
        assert low <= early <= high
        # Monotone: the later one is nearer to the next key, up to rounding.
        assert abs(late - values[i + 1, 0]) <= abs(early - values[i + 1, 0]) + 1e-9 * (1 + high - low)


def test_two_keys_are_joined_by_a_line() -> None:
    assert monotone(np.array([0.0, 2.0]), np.array([[1.0], [3.0]]), 0.5) == pytest.approx([1.5])
    halfway = centripetal(np.array([0.0, 2.0]), np.array([[1.0, 0, 0], [3.0, 4, 0]]), 1.0)
    assert halfway == pytest.approx([2.0, 2.0, 0.0])


def test_a_curve_meets_its_points_is_smooth_and_rests_where_two_are_the_same() -> None:
    times = np.array([0.0, 1.0, 2.0, 3.0, 5.0])
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 0, 0], [1, 5, 0], [4, 5, 2]], float)
    for time, point in zip(times, points, strict=True):
        assert centripetal(times, points, float(time)) == pytest.approx(point, abs=1e-12)
    assert centripetal(times, points, 1.5) == pytest.approx([1, 0, 0])
    fine = np.array([centripetal(times, points, t) for t in np.linspace(2.0, 5.0, 3001)])
    speeds = np.diff(fine, axis=0) / 1e-3
    assert np.abs(np.diff(speeds, axis=0)).max() < 0.1  # no jump in speed


def test_a_circle_of_keys_gives_nearly_a_circle() -> None:
    angles = np.linspace(0, 2 * np.pi, 9)
    points = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    times = np.arange(9.0)
    radii = [np.linalg.norm(centripetal(times, points, t)) for t in np.linspace(1, 7, 200)]
    assert min(radii) > 0.98
    assert max(radii) < 1.01


def test_keys_set_what_they_name_and_leave_the_rest() -> None:
    keys = keys_of(
        camera=[{"time": 1, "position": [5, 1, 2]}, {"time": 3, "position": [1, 9, 2], "view_angle": 60}],
        transfer=[{"time": 1, "opacity": 0.1}, {"time": 2, "opacity": 0.3, "clim": [0, 3]}],
    )
    assert keys.frames(2.0) == 5
    scenes = scenes_along(SCENE, 5, keys=keys)
    assert [scene.camera.view_angle for scene in scenes][::4] == [30.0, 60.0]
    assert positions([scene.camera for scene in scenes])[[0, 4]] == pytest.approx(np.array([[5, 1, 2], [1, 9, 2]]))
    assert {scene.camera.focal_point for scene in scenes} == {(1.0, 1.0, 1.0)}
    assert all(np.linalg.norm(scene.camera.view_up) == pytest.approx(1) for scene in scenes)
    assert [scene.volumes[0].opacity for scene in scenes] == pytest.approx([0.1, 0.2, 0.3, 0.3, 0.3])
    assert [scene.volumes[0].clim for scene in scenes][::2] == [(0.0, 1.0), (0.0, 3.0), (0.0, 3.0)]
    assert {scene.volumes[0].cmap for scene in scenes} == {"bone"}
    assert {scene.image for scene in scenes} == {SCENE.image}


def test_points_move_and_an_orbit_takes_transfer_keys() -> None:
    keys = keys_of(
        transfer=[{"time": 0, "opacity": [[0, 0], [0.5, 0.2]]}, {"time": 1, "opacity": [[0.2, 0], [0.5, 0.8]]}]
    )
    scenes = scenes_along(SCENE, 3, 90.0, keys)
    assert scenes[1].volumes[0].opacity == ((0.1, 0.0), (0.5, 0.5))
    assert scenes[2].camera.position == pytest.approx((1, 5, 2))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("camera: [{time: 0, positon: [1, 2, 3]}]", "camera[0].positon: unknown key, did you mean position?"),
        ("camera: [{time: 0, position: [1, 2]}]", "camera[0].position: too few values"),
        ("camera: [{position: [1, 2, 3]}]", "camera[0].time: missing"),
        ("camera: [{time: 1}, {time: 1}]", "camera: keys out of order: time 1 after 1"),
        ("camera: [{time: 1, view_angle: 180}]", "camera[0].view_angle: too large; found 180; allowed less than 180"),
        ("transfer: [{time: 0, opacity: 2}]", "transfer[0].opacity: too large; found 2; allowed at most 1"),
        ("cameras: []\ncamera: [{time: 0}]", "unknown key, did you mean camera?"),
        ("camera: []", "no key frames"),
        ("- 1", "no key frames"),
        ("camera: [", "not YAML"),
    ],
)
def test_what_a_path_cannot_hold_is_refused(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "path.yaml").write_text(text)
    with pytest.raises(SceneError, match=re.escape(said)) as raised:
        load_path(tmp_path / "path.yaml")
    assert str(tmp_path / "path.yaml") in str(raised.value)


def test_a_path_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="cannot be read: No such file"):
        load_path(tmp_path / "none.yaml")


@pytest.mark.parametrize(
    ("keys", "degrees", "said"),
    [
        ({"camera": [{"time": 0}]}, 90.0, "camera keys and an orbit"),
        ({"camera": [{"time": 0, "parallel_scale": 2}, {"time": 1}]}, None, "in perspective and in parallel"),
        ({"camera": [{"time": 0, "view_up": [0, 0, 1]}, {"time": 1, "view_up": [0, 0, -1]}]}, None, "through zero"),
        ({"camera": [{"time": 0, "position": [1, 1, 9]}]}, None, "parallel to the direction of view"),
        ({"transfer": [{"time": 0, "opacity": 0.1}, {"time": 1, "opacity": "linear"}]}, None, "nothing lies between"),
        ({"transfer": [{"time": 0, "cmap": "bone"}, {"time": 1, "cmap": "gray"}]}, None, "nothing lies between"),
    ],
)
def test_keys_that_do_not_fit_are_refused(keys: dict[str, Any], degrees: float | None, said: str) -> None:
    with pytest.raises(SceneError, match=said):
        scenes_along(SCENE, 3, degrees, keys_of(**keys))
