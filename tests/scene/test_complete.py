"""Scene completion for ordinary and extreme data."""

from __future__ import annotations

import itertools
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clusterviz.content.complete import complete_scene
from clusterviz.content.transfer import transfer_function
from clusterviz.content.volume.info import default_clim
from clusterviz.content.volume.kind import default_unit_distance
from clusterviz.errors import SceneError
from clusterviz.scene import Scene, Volume, VolumeInfo
from clusterviz.scene.camera import MARGIN, Vector, bounding_sphere, project_points, sine

NAN = math.nan


def volume_info(
    shape: tuple[int, int, int] = (11, 21, 31),
    spacing: tuple[float, float, float] = (1.0, 1.0, 1.0),
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
    values: tuple[float, float, float, float] = (0.0, 255.0, 2.0, 200.0),
) -> VolumeInfo:
    last = (np.array(shape[::-1]) - 1) * np.array(spacing)
    corners = np.array(list(itertools.product((0, 1), repeat=3))) * last + np.array(origin)
    return VolumeInfo(shape, spacing, corners, *values)


def scene(camera: dict[str, object] | None = None, size: tuple[int, int] = (400, 300), **volume: object) -> Scene:
    return Scene.model_validate({"volumes": [{"path": "a", **volume}], "camera": camera or {}, "image": {"size": size}})


def test_everything_open_is_filled_and_everything_given_is_kept() -> None:
    done = complete_scene(scene(), volume_info())
    volume = done.volumes[0]
    assert volume.clim == (2, 200)
    assert volume.cmap is not None
    assert volume.opacity_unit_distance is not None
    assert None not in (done.camera.position, done.camera.focal_point, done.camera.view_up)
    assert complete_scene(done, volume_info()) == done
    given = scene(clim=[5, 6], cmap="jet", opacity=0.5, opacity_unit_distance=3)
    assert complete_scene(given, volume_info()).volumes == given.volumes


def test_an_empty_scene_gets_a_camera() -> None:
    assert complete_scene(Scene(), ()).camera.position is not None


def test_the_background_of_a_bare_file_is_transparent() -> None:
    """Air and noise, the lowest part of the range, must not veil the picture; the rest must be seen."""
    function = transfer_function(complete_scene(scene(), volume_info()).volumes[0])
    assert bool(function.is_transparent(-math.inf, 2 + 0.25 * 198))
    assert function.opacity(200.0) > 0.3


def test_the_opacity_of_a_preset_file_is_used(tmp_path: Path) -> None:
    path = tmp_path / "p.json"
    path.write_text(json.dumps([{"RGBPoints": [0, 0, 0, 0, 1, 1, 1, 1], "Points": [0, 1, 0.5, 0, 1, 0.25, 0.5, 0]}]))
    volume = complete_scene(scene(cmap=str(path), clim=[10, 20]), volume_info()).volumes[0]
    assert volume.opacity == ((10, 1), (20, 0.25))


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ((0, 10, 1, 9), (1, 9)),
        ((0, 10, 0, 0), (0, 10)),
        ((7, 7, 7, 7), (6.5, 7.5)),
        ((0, 0, 0, 0), (-0.5, 0.5)),
        ((NAN, NAN, NAN, NAN), (-0.5, 0.5)),
        ((math.inf, -math.inf, NAN, NAN), (-0.5, 0.5)),
        ((0, math.inf, 1, math.inf), (0.5, 1.5)),
        ((0, 5e-324, 0, 5e-324), (0, 5e-324)),
        ((1e-300,) * 4, (-0.5, 0.5)),
    ],
)
def test_the_default_range(values: tuple[float, float, float, float], expected: tuple[float, float]) -> None:
    assert default_clim(volume_info(values=values)) == expected


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_a_constant_volume_has_a_range_around_it(value: float) -> None:
    low, high = default_clim(volume_info(values=(value,) * 4))
    assert low < high
    assert low <= value <= high
    assert math.isfinite(low)
    assert math.isfinite(high)
    if abs(value) > 1e307:  # the range cannot reach past the end of float64 on both sides
        return
    volume = complete_scene(scene(), volume_info(values=(value,) * 4)).volumes[0]
    assert 0 < float(transfer_function(volume).opacity(value)) <= 1


def test_the_unit_distance_is_pyvistas() -> None:
    assert default_unit_distance((11, 21, 31), (1, 1, 1)) == pytest.approx(math.sqrt(10**2 + 20**2 + 30**2) / 20)
    assert default_unit_distance((1, 1, 1), (3, 2, 4)) == 2
    assert default_unit_distance((1, 1, 31), (2, 1, 1)) == pytest.approx(60 / 10)
    assert default_unit_distance((2, 2, 2), (1e-9,) * 3) == pytest.approx(math.sqrt(3) * 1e-9)


def test_a_clim_of_equal_ends_is_a_step() -> None:
    volume = complete_scene(scene(clim=[5, 5], opacity="linear", cmap="gray"), volume_info()).volumes[0]
    function = transfer_function(volume)
    assert function.opacity([4.9, 5, 6]).tolist() == [0, 1, 1]
    assert function.colour([4.9, 5])[:, 0].tolist() == [0, 1]


def test_a_volume_that_is_not_completed_has_no_transfer_function() -> None:
    with pytest.raises(ValueError, match="complete_scene first"):
        transfer_function(Volume(path="a"))


@given(
    st.tuples(st.integers(1, 500), st.integers(1, 65536)),
    st.floats(0.1, 100),
    st.sampled_from([1e-9, 1.0, 1e9]),
    st.sampled_from([None, "iso", "left", "inferior"]),
    st.sampled_from([{}, {"azimuth": 30.0}, {"elevation": -70.0, "roll": 20.0}, {"focal_point": (3.0, 4.0, 5.0)}]),
)
def test_the_box_just_fits(
    size: tuple[int, int], angle: float, unit: float, view: str | None, more: dict[str, object]
) -> None:
    """All corners are in the picture, and one of them lies on its margin unless the eye would be too near."""
    fact = volume_info(spacing=(unit, unit, unit))
    camera = complete_scene(scene({"view_angle": angle, "view": view, **more}, size), fact).camera
    pixels, ahead = project_points(camera, fact.corners, size)
    from_centre = np.abs(2 * pixels / size - 1).max()
    assert (ahead > 0).all()
    assert from_centre <= 1
    centre, radius = bounding_sphere(fact.corners, unit)
    near = math.dist(camera.position or (), camera.focal_point or ())
    off = math.dist(camera.focal_point or (), centre)
    assert from_centre == pytest.approx(1 - MARGIN, abs=1e-6) or near <= 1.06 * radius + off


@pytest.mark.parametrize(
    ("orientation", "word", "eye", "up"),
    [
        ("", None, (1, 1, 1), (0, 0, 1)),
        ("", "front", (0, -1, 0), (0, 0, 1)),
        ("", "left", (-1, 0, 0), (0, 0, 1)),
        ("", "top", (0, 0, 1), (0, 1, 0)),
        ("", "iso", (1, 1, 1), (0, 0, 1)),
        ("RAS", "front", (0, 1, 0), (0, 0, 1)),
        ("RAS", "anterior", (0, 1, 0), (0, 0, 1)),
        ("RAS", "left", (-1, 0, 0), (0, 0, 1)),
        ("RAS", "superior", (0, 0, 1), (0, 1, 0)),
        ("LPS", "posterior", (0, 1, 0), (0, 0, 1)),
        ("LPS", "right", (-1, 0, 0), (0, 0, 1)),
        ("LPS", "bottom", (0, 0, -1), (0, -1, 0)),
        ("LPS", "iso", (1, -1, 1), (0, 0, 1)),
        ("LPS", None, (1, -1, 1), (0, 0, 1)),
    ],
)
def test_a_view_by_a_word(orientation: str, word: str | None, eye: Vector, up: Vector) -> None:
    fact = replace(volume_info(), orientation=orientation)
    camera = complete_scene(scene({"view": word}), fact).camera
    offset = np.subtract(camera.position, camera.focal_point)
    np.testing.assert_allclose(offset / np.linalg.norm(offset), np.array(eye) / np.linalg.norm(eye), atol=1e-12)
    assert (camera.view_up, camera.view, camera.focal_point) == (up, None, (15, 10, 5))
    assert complete_scene(scene(camera.model_dump()), fact).camera == camera


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ({"azimuth": 90}, {"position": (10, 0, 0)}),
        ({"elevation": 30}, {"position": (0, -10 * math.sqrt(0.75), 5)}),
        ({"elevation": 90}, {"position": (0, 0, 10), "view_up": (0, 1, 0)}),
        ({"roll": 90}, {"view_up": (1, 0, 0)}),
        ({"zoom": 2}, {"view_angle": math.degrees(2 * math.atan(math.tan(math.radians(15)) / 2))}),
        ({"zoom": 2, "parallel_scale": 3}, {"parallel_scale": 1.5}),
    ],
)
def test_a_camera_is_turned_as_in_vtk(keys: dict[str, float], expected: dict[str, object]) -> None:
    start: dict[str, object] = {"position": [0, -10, 0], "focal_point": [0, 0, 0], "view_up": [0, 0, 1]}
    camera = complete_scene(scene({**start, **keys}), volume_info()).camera
    for name, value in {**start, "view_angle": 30.0, **expected}.items():
        np.testing.assert_allclose(getattr(camera, name), value, atol=1e-12)


@pytest.mark.parametrize(("distance", "least"), [(20.0, 30.5), (500.0, 30.0), (0.0, 90.0)])
def test_a_lone_position_crops_nothing(distance: float, least: float) -> None:
    fact = volume_info()
    centre = np.array([15, 10, 5])
    position = centre + distance * np.array([0.0, -1.0, 0.01])
    camera = complete_scene(scene({"position": position.tolist()}), fact).camera
    assert camera.position == tuple(position)
    assert camera.view_angle >= least
    if distance:
        pixels, _ = project_points(camera, fact.corners, (400, 300))
        assert (pixels >= 0).all()
        assert (pixels <= (400, 300)).all()
    given = complete_scene(scene({"position": position.tolist(), "view_angle": 30}), fact).camera
    assert given.view_angle == 30


def test_fit_keeps_the_direction_and_orbits_have_room() -> None:
    towards: dict[str, object] = {"position": [15, 10, 900], "view_up": [0, 1, 0]}
    fact = volume_info()
    fitted, orbit = (complete_scene(scene({**towards, "fit": fit}), fact).camera for fit in (True, "orbit"))
    for camera in (fitted, orbit):
        assert camera.focal_point == (15, 10, 5)
        assert (camera.position or ())[:2] == pytest.approx((15, 10))
    assert (fitted.position or ())[2] < (orbit.position or ())[2] < 200
    flat = complete_scene(scene({**towards, "fit": True, "parallel_scale": 1000}), fact).camera
    assert flat.parallel_scale == pytest.approx(15 / (1 - MARGIN) * 3 / 4)
    with pytest.raises(ValueError, match="position says where the eye is"):
        scene({"position": [1, 2, 3], "view": "front"})


@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), (1e9, -1e9, 1e9)])
@pytest.mark.parametrize("spacing", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 1, 9), (4, 1, 4)])
def test_flat_and_tiny_boxes_give_a_valid_camera(
    shape: tuple[int, int, int], spacing: float, origin: tuple[float, float, float]
) -> None:
    done = complete_scene(scene(), volume_info(shape, (spacing,) * 3, origin)).camera
    assert done.position is not None
    assert np.isfinite(done.position).all()
    assert done.position != done.focal_point
    offset = np.subtract(done.position, done.focal_point)
    np.testing.assert_allclose(offset / np.linalg.norm(offset), np.full(3, 1 / math.sqrt(3)), rtol=1e-3)


axis = st.sampled_from([-1.0, 0.0, 1.0])
vectors = st.tuples(axis, axis, axis)


@given(st.none() | vectors, st.none() | vectors, st.none() | vectors.filter(any))
def test_a_camera_given_in_part_keeps_that_part_and_is_never_degenerate(
    position: tuple[float, ...] | None, focal_point: tuple[float, ...] | None, view_up: tuple[float, ...] | None
) -> None:
    given_keys = {"position": position, "focal_point": focal_point, "view_up": view_up}
    try:
        start = scene(given_keys)
    except ValueError:
        return
    fact = volume_info((3, 3, 3), origin=(-1.0, -1.0, -1.0))  # centred, so that an eye can sit in the centre
    try:
        done = complete_scene(start, fact).camera
    except SceneError:
        # what is given leaves no choice: an eye, and an up that points at the centre
        assert position is not None
        assert view_up is not None
        return
    for key, value in given_keys.items():
        assert value is None or getattr(done, key) == value
    assert done.position is not None
    assert done.focal_point is not None
    assert done.view_up is not None
    assert sine(tuple(np.subtract(done.focal_point, done.position)), done.view_up) > 1e-6
