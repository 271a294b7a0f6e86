"""Transfer functions: points, steps, the range of float64, transparent intervals, opacity presets and 2-D tables."""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from clusterviz.content.complete import complete_scene
from clusterviz.content.transfer import transfer_function
from clusterviz.errors import SceneError
from clusterviz.scene import Volume, VolumeInfo, load_scene
from clusterviz.scene.transfer import OPAQUE, PRESETS, TransferFunction, interpolate, opacity_points, preset_points
from clusterviz.scene.transfer_2d import Transfer2d, load_table, read_table


def function(points: list[tuple[float, float]], unit: float = 1.0) -> TransferFunction:
    values, opacities = np.array(points, np.float64).T
    return TransferFunction(
        np.array([0.0, 1.0]), np.array([[0, 0, 0], [1, 0.5, 0]]), values, opacities, unit, (0.0, 1.0)
    )


def test_colours_are_linear_between_and_constant_beyond() -> None:
    colours = function([(0, 0)]).colour([[-1, 0.0], [0.5, 9]])
    assert colours.shape == (2, 2, 3)
    assert colours.tolist() == [[[0, 0, 0], [0, 0, 0]], [[0.5, 0.25, 0], [1, 0.5, 0]]]


def test_a_repeated_value_is_a_step_where_the_later_holds() -> None:
    f = function([(0, 0.2), (1, 0.4), (1, 0.9), (1, 0.6), (2, 0.8)])
    assert f.opacity_values.tolist() == [0, 1, 1, 2]
    assert f.opacity([np.nextafter(1, 0), 1, np.nextafter(1, 2)]) == pytest.approx([0.4, 0.6, 0.6])
    assert f.opacity(1.0) == 0.6


def test_steps_at_both_ends_hold_beyond_them() -> None:
    f = function([(0, 0.1), (0, 0.3), (1, 0.5), (1, 0.7)])
    assert f.opacity([-1, 0, 1, 2]).tolist() == [0.1, 0.3, 0.7, 0.7]


def test_nan_and_infinity() -> None:
    f = function([(0, 0.25), (1, 0.5)])
    assert f.opacity([math.nan, -math.inf, math.inf]).tolist() == [0, 0.25, 0.5]
    assert f.colour(math.nan).tolist() == [0, 0, 0]


@pytest.mark.parametrize(
    ("low", "high"), [(-1.79e308, 1.79e308), (0, 5e-324), (1e300, 1.7e308), (-5e-324, 1e308), (1, 1 + 2**-52)]
)
def test_the_ends_of_float64_neither_overflow_nor_vanish(low: float, high: float) -> None:
    with np.errstate(all="raise", under="ignore"):
        found = interpolate([low, high], np.array([low, high]), np.array([[0.0], [1.0]]))[:, 0]
    assert found.tolist() == [0, 1]


def test_the_middle_of_all_of_float64_is_half_way() -> None:
    assert interpolate(0.0, np.array([-1.7e308, 1.7e308]), np.array([[0.0], [1.0]])).tolist() == [0.5]


@given(
    st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=6, unique=True).map(sorted),
    st.lists(st.floats(0, 1), min_size=6, max_size=6),
    st.floats(-2e6, 2e6),
)
def test_interpolation_agrees_with_numpy(values: list[float], results: list[float], s: float) -> None:
    assume(min(np.diff(values)) > 1e-6)
    table = np.array(results[: len(values)])
    found = interpolate(s, np.array(values), table[:, None])[0]
    assert found == pytest.approx(np.interp(s, values, table), abs=1e-9)


def test_extinction_is_minus_log_of_transparency_by_unit() -> None:
    f = function([(0, 0), (1, 1e-8), (2, 0.5), (3, 1 - 1e-6), (4, 1), (5, 1 - 1e-8)], unit=2.0)
    most = 24 * math.log(2) / 2
    expected = [0, 1e-8 / 2 * (1 + 5e-9), math.log(2) / 2, -math.log(1e-6) / 2, most, most]
    assert f.extinction([0, 1, 2, 3, 4, 5]) == pytest.approx(expected, rel=1e-7)
    assert f.extinction(4.0) == -math.log1p(-OPAQUE) / 2


TENT = [(10.0, 0.0), (20.0, 0.0), (30.0, 1.0), (40.0, 0.0), (50.0, 0.0), (50.0, 0.5), (60.0, 0.5), (60.0, 0.0)]


@pytest.mark.parametrize(
    ("low", "high", "transparent"),
    [
        (-100, 5, True),
        (0, 20, True),
        (0, np.nextafter(20, 21), False),
        (25, 25, False),
        (0, 35, False),
        (20, 40, False),
        (40, 45, True),
        (45, 50, False),
        (45, np.nextafter(50, 0), True),
        (55, 56, False),
        (60, 60, True),
        (np.nextafter(60, 0), 60, False),
        (60, 1e300, True),
        (-math.inf, math.inf, False),
        (-math.inf, 20, True),
        (60, math.inf, True),
        (math.nan, 5, False),
        (5, math.nan, False),
        (math.inf, -math.inf, True),
    ],
)
def test_an_interval_is_transparent_iff_opacity_is_zero_on_all_of_it(
    low: float, high: float, transparent: bool
) -> None:
    assert bool(function(TENT).is_transparent(low, high)) is transparent


@given(
    st.lists(st.tuples(st.integers(0, 8), st.sampled_from([0.0, 0.0, 0.5])), min_size=1, max_size=7),
    st.lists(st.tuples(st.integers(-8, 40), st.integers(-8, 40)), min_size=1, max_size=9),
)
def test_transparency_agrees_with_dense_sampling(points: list[tuple[int, float]], ends: list[tuple[int, int]]) -> None:
    """Breaks at whole numbers, ends at quarters, samples at sixteenths: between samples nothing can hide."""
    f = function([(float(v), a) for v, a in sorted(points, key=lambda point: point[0])])
    low, high = np.sort(np.array(ends) / 4, axis=1).T
    samples = [np.arange(a * 16, b * 16 + 1) / 16 for a, b in zip(low, high, strict=True)]
    expected = [not f.opacity(s).any() for s in samples]
    assert f.is_transparent(low, high).tolist() == expected


def test_arrays_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="read-only"):
        function([(0, 0)]).opacities[0] = 1


BLACK = (np.zeros(1), np.zeros((1, 3)))


def table(name: str) -> np.ndarray:
    """The preset at PyVista's 256 places, in bytes."""
    places, opacities = preset_points(name)
    function = TransferFunction(*BLACK, places, opacities, 1.0, (0.0, 1.0))
    return function.opacity(np.linspace(0, 1, 256)) * 255


@pytest.mark.parametrize(("name", "reach"), [("sigmoid", 10), ("sigmoid_3", 3), ("sigmoid_10", 10), ("sigmoid_20", 20)])
def test_sigmoids_are_bytes_of_the_logistic_curve(name: str, reach: int) -> None:
    expected = np.array(1 / (1 + np.exp(-np.linspace(-reach, reach, 256))) * 255, np.uint8)
    np.testing.assert_allclose(table(name), expected, atol=1e-9)
    np.testing.assert_allclose(table(f"{name}_r"), expected[::-1], atol=1e-9)


def test_linear_and_geom_are_the_spaced_bytes() -> None:
    np.testing.assert_allclose(table("linear"), np.linspace(0, 255, 256, dtype=np.uint8), atol=1e-9)
    np.testing.assert_allclose(table("linear_r"), np.linspace(255, 0, 256, dtype=np.uint8), atol=1e-9)
    np.testing.assert_allclose(table("geom"), np.geomspace(1e-6, 255, 256, dtype=np.uint8), atol=1e-9)
    np.testing.assert_allclose(table("foreground"), [0] + [255] * 255, atol=1e-9)


def test_linear_needs_two_points_only() -> None:
    places, opacities = preset_points("linear")
    assert places.tolist() == [0, 1]
    assert opacities.tolist() == [0, 1]


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_covers_the_range_exactly(name: str) -> None:
    values, opacities = opacity_points(name, (-1.7e308, 1.7e308))
    assert (values[0], values[-1]) == (-1.7e308, 1.7e308)
    assert np.isfinite(values).all()
    assert (values[1:] > values[:-1]).all()
    assert opacities.min() >= 0
    assert opacities.max() <= 1


def test_numbers_and_points_are_kept() -> None:
    assert [part.tolist() for part in opacity_points(0.25, (1.0, 2.0))] == [[1.0], [0.25]]
    assert [part.tolist() for part in opacity_points(((5, 0), (5, 1)), (1.0, 2.0))] == [[5, 5], [0, 1]]


FACTS = VolumeInfo((4, 4, 4), (2.0, 4.0, 2.0), np.zeros((8, 3)), 0.0, 100.0, 10.0, 50.0)


def test_most_is_transparent_only_where_every_magnitude_is(tmp_path: Path) -> None:
    np.save(tmp_path / "t.npy", np.array([[0, 0, 0.5], [0, 0.25, 0]]))
    table = load_table(Transfer2d(path=str(tmp_path / "t.npy"), values=(10, 30), magnitudes=(0, 1)))
    assert table.colours is None
    assert [part.tolist() for part in table.max_opacity_points] == [[10, 20, 30], [0, 0.25, 0.5]]


def test_ranges_are_those_of_clim_and_of_a_quarter_of_it_a_voxel(tmp_path: Path) -> None:
    np.save(tmp_path / "t.npy", np.ones((2, 3, 4), np.float32))
    (tmp_path / "scene.yaml").write_text("volumes: [{path: a.npy, transfer_2d: {path: t.npy}}]")
    volume = complete_scene(load_scene(tmp_path / "scene.yaml"), FACTS).volumes[0]
    assert volume.transfer_2d == Transfer2d(path=str(tmp_path / "t.npy"), values=(10, 50), magnitudes=(0, 5))
    assert volume.opacity is None
    assert transfer_function(volume).opacity([9, 30, 99]).tolist() == [1, 1, 1]


@pytest.mark.parametrize(
    ("table", "problem"),
    [
        (np.ones(3), "not a table"),
        (np.ones((2, 3, 3)), "not a table"),
        (np.ones((0, 3)), "not a table"),
        (np.ones((2, 5000)), "not a table"),
        (np.ones((2, 3), bool), "not a table"),
        (np.full((2, 3), 1.5), "out of range"),
        (np.full((2, 3), np.nan), "out of range"),
        (np.array([["a"]], object), "not a .npy file"),
        (None, "cannot read"),
    ],
)
def test_what_is_no_table_is_refused(table: np.ndarray | None, problem: str, tmp_path: Path) -> None:
    if table is not None:
        np.save(tmp_path / "t.npy", table)
    (tmp_path / "scene.yaml").write_text("volumes: [{path: a.npy, transfer_2d: {path: t.npy}}]")
    with pytest.raises(SceneError, match=problem) as caught:
        load_scene(tmp_path / "scene.yaml")
    assert "volumes[0].transfer_2d.path" in str(caught.value)


def test_a_file_that_changes_is_read_again(tmp_path: Path) -> None:
    path = tmp_path / "t.npy"
    for turn, value in enumerate((0.25, 0.5)):
        np.save(path, np.full((1, 1), value))
        os.utime(path, ns=(turn, turn))
        assert read_table(str(path))[0].tolist() == [[value]]


def test_a_table_of_a_volume_that_is_not_completed() -> None:
    with pytest.raises(ValueError, match="completed"):
        load_table(Volume(path="a", transfer_2d={"path": "t.npy"}).transfer_2d)  # type: ignore[arg-type]
