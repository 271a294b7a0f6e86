"""Every open choice gets a good value, for ordinary data and for the strangest."""

from __future__ import annotations

import itertools
import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clusterviz.errors import SceneError
from clusterviz.scene import Scene, Volume, VolumeFacts, complete_scene, transfer_function
from clusterviz.scene.checks import sine
from clusterviz.scene.complete import default_clim, default_unit_distance

NAN = math.nan


def facts(
    shape: tuple[int, int, int] = (11, 21, 31),
    spacing: tuple[float, float, float] = (1.0, 1.0, 1.0),
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
    values: tuple[float, float, float, float] = (0.0, 255.0, 2.0, 200.0),
) -> VolumeFacts:
    last = (np.array(shape[::-1]) - 1) * np.array(spacing)
    corners = np.array(list(itertools.product((0, 1), repeat=3))) * last + np.array(origin)
    return VolumeFacts(shape, spacing, corners, *values)


def scene(camera: dict[str, object] | None = None, size: tuple[int, int] = (400, 300), **volume: object) -> Scene:
    return Scene.model_validate({"volumes": [{"path": "a", **volume}], "camera": camera or {}, "image": {"size": size}})


def test_everything_open_is_filled_and_everything_given_is_kept() -> None:
    done = complete_scene(scene(), facts())
    volume = done.volumes[0]
    assert volume.clim == (2, 200)
    assert volume.cmap is not None
    assert volume.opacity_unit_distance is not None
    assert None not in (done.camera.position, done.camera.focal_point, done.camera.view_up)
    assert complete_scene(done, facts()) == done
    given = scene(clim=[5, 6], cmap="jet", opacity=0.5, opacity_unit_distance=3)
    assert complete_scene(given, facts()).volumes == given.volumes


def test_an_empty_scene_gets_a_camera() -> None:
    assert complete_scene(Scene(), ()).camera.position is not None


def test_the_background_of_a_bare_file_is_transparent() -> None:
    """Air and noise, the lowest part of the range, must not veil the picture; the rest must be seen."""
    function = transfer_function(complete_scene(scene(), facts()).volumes[0])
    assert bool(function.is_transparent(-math.inf, 2 + 0.25 * 198))
    assert function.opacity(200.0) > 0.3


def test_the_opacity_of_a_preset_file_is_used(tmp_path: Path) -> None:
    path = tmp_path / "p.json"
    path.write_text(json.dumps([{"RGBPoints": [0, 0, 0, 0, 1, 1, 1, 1], "Points": [0, 1, 0.5, 0, 1, 0.25, 0.5, 0]}]))
    volume = complete_scene(scene(cmap=str(path), clim=[10, 20]), facts()).volumes[0]
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
    assert default_clim(facts(values=values)) == expected


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_a_constant_volume_has_a_range_around_it(value: float) -> None:
    low, high = default_clim(facts(values=(value,) * 4))
    assert low < high
    assert low <= value <= high
    assert math.isfinite(low)
    assert math.isfinite(high)
    if abs(value) > 1e307:  # the range cannot reach past the end of float64 on both sides
        return
    volume = complete_scene(scene(), facts(values=(value,) * 4)).volumes[0]
    assert 0 < float(transfer_function(volume).opacity(value)) <= 1


def test_the_unit_distance_is_pyvistas() -> None:
    assert default_unit_distance((11, 21, 31), (1, 1, 1)) == pytest.approx(math.sqrt(10**2 + 20**2 + 30**2) / 20)
    assert default_unit_distance((1, 1, 1), (3, 2, 4)) == 2
    assert default_unit_distance((1, 1, 31), (2, 1, 1)) == pytest.approx(60 / 10)
    assert default_unit_distance((2, 2, 2), (1e-9,) * 3) == pytest.approx(math.sqrt(3) * 1e-9)


def test_a_clim_of_equal_ends_is_a_step() -> None:
    volume = complete_scene(scene(clim=[5, 5], opacity="linear", cmap="gray"), facts()).volumes[0]
    function = transfer_function(volume)
    assert function.opacity([4.9, 5, 6]).tolist() == [0, 1, 1]
    assert function.colour([4.9, 5])[:, 0].tolist() == [0, 1]


def test_a_volume_that_is_not_completed_has_no_transfer_function() -> None:
    with pytest.raises(ValueError, match="complete_scene first"):
        transfer_function(Volume(path="a"))


def inside_view(done: Scene, centre: np.ndarray, radius: float) -> float:
    """The sphere's angular radius as a share of the narrower half angle of view; 1 fits exactly."""
    distance = math.dist(done.camera.position or (), centre)
    vertical = math.radians(done.camera.view_angle) / 2
    horizontal = math.atan(math.tan(vertical) * done.image.size[0] / done.image.size[1])
    return math.asin(min(1.0, radius / distance)) / min(vertical, horizontal)


@given(
    st.tuples(st.integers(1, 500), st.integers(1, 65536)),
    st.floats(0.1, 179),
    st.sampled_from([1e-9, 1.0, 1e9]),
)
def test_the_bounding_sphere_fits_the_narrower_angle(size: tuple[int, int], angle: float, unit: float) -> None:
    fact = facts(spacing=(unit, unit, unit))
    done = complete_scene(scene({"view_angle": angle}, size), fact)
    centre = fact.corners.mean(axis=0)
    share = inside_view(done, centre, math.dist(centre, fact.corners[0]))
    assert share == pytest.approx(1, abs=2e-3)


def test_the_default_view_is_isometric() -> None:
    done = complete_scene(scene(), facts()).camera
    assert done.view_up == (0, 0, 1)
    assert done.focal_point == (15, 10, 5)
    offset = np.subtract(done.position, done.focal_point)
    np.testing.assert_allclose(offset / np.linalg.norm(offset), np.full(3, 1 / math.sqrt(3)))


@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), (1e9, -1e9, 1e9)])
@pytest.mark.parametrize("spacing", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 1, 9), (4, 1, 4)])
def test_flat_and_tiny_boxes_give_a_valid_camera(
    shape: tuple[int, int, int], spacing: float, origin: tuple[float, float, float]
) -> None:
    done = complete_scene(scene(), facts(shape, (spacing,) * 3, origin)).camera
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
    fact = facts((3, 3, 3), origin=(-1.0, -1.0, -1.0))  # centred, so that an eye can sit in the centre
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
