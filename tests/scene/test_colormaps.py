"""Colour maps by name, by ParaView preset and by points."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cmap
import matplotlib
import numpy as np
import pytest
from matplotlib.colors import LinearSegmentedColormap, ListedColormap

from clusterviz.errors import SceneError
from clusterviz.scene import Scene, Volume
from clusterviz.scene.colormaps import (
    colour_points,
    interpolate_colours,
    lab_from_rgb,
    named_colour_points,
    read_preset,
    rgb_from_lab,
)
from clusterviz.scene.overrides import with_settings
from clusterviz.scene.transfer import interpolate

COOL = [0.0, 0.23137254902, 0.298039215686, 0.752941176471]
WARM = [1.0, 0.705882352941, 0.0156862745098, 0.149019607843]


def preset(folder: Path, **keys: Any) -> str:
    path = folder / "preset.json"
    path.write_text(json.dumps([{"Name": "a", "NanColor": [1, 1, 0], **keys}]))
    return str(path)


def sampled(name: str, n: int = 256) -> np.ndarray:
    places, colours = named_colour_points(name)
    return interpolate(np.linspace(0, 1, n), places, colours)


@pytest.mark.parametrize(
    "name", ["viridis", "bone", "gray", "coolwarm", "jet", "hot", "plasma", "RdBu", "Set1", "tab10"]
)
def test_names_give_matplotlibs_colours(name: str) -> None:
    middles = (np.arange(matplotlib.colormaps[name].N) + 0.5) / matplotlib.colormaps[name].N
    ours = interpolate(middles, *named_colour_points(name))
    theirs = matplotlib.colormaps[name](np.arange(len(middles)))[:, :3]
    np.testing.assert_allclose(ours, theirs, atol=0.02)


def test_names_with_r_are_reversed() -> None:
    np.testing.assert_allclose(sampled("viridis_r"), sampled("viridis")[::-1], atol=1e-12)


TWO = ListedColormap(["red", "blue"], "two")


@pytest.mark.parametrize(
    ("colormap", "expected"),
    [
        (matplotlib.colormaps["viridis"], "viridis"),
        (matplotlib.colormaps["magma_r"], "magma_r"),
        (matplotlib.colormaps["tab10"], "tab10"),
        (cmap.Colormap("coolwarm"), "matplotlib:coolwarm"),
        (matplotlib.colormaps["viridis"].resampled(5), None),
        (LinearSegmentedColormap.from_list("mine", ["red", "yellow", "blue"]), None),
        (LinearSegmentedColormap.from_list("bone", ["red", "blue"]), None),
        (TWO, None),
        (cmap.Colormap([(0, "black"), (0.2, "red"), (1, "white")]), None),
    ],
)
def test_colour_maps_of_matplotlib_are_taken(colormap: Any, expected: str | None) -> None:
    volume = Volume(path="a.npy", cmap=colormap)
    assert volume.cmap is not None
    assert expected is None or volume.cmap == expected
    count = getattr(colormap, "N", 64)
    middles = (np.arange(count) + 0.5) / count
    found = interpolate(20 + 200 * middles, *colour_points(volume.cmap, (20.0, 220.0)))
    np.testing.assert_allclose(found, colormap(middles)[:, :3], atol=0.02)
    with_settings(Scene(volumes=(Volume(path="a.npy"),)), {"cmap": colormap})


def test_flat_colours_stay_flat() -> None:
    values, colours = colour_points(Volume(path="a.npy", cmap=TWO).cmap or "", (0.0, 10.0))
    assert interpolate(np.array([0, 4.98, 5.02, 10.0]), values, colours).tolist() == [[1, 0, 0]] * 2 + [[0, 0, 1]] * 2


@pytest.mark.parametrize(
    ("cmap", "clim", "values", "colours"),
    [
        ([[0, 0, 0], [1, 0, 0], [1, 1, 1]], (2.0, 6.0), [2, 4, 6], [[0, 0, 0], [1, 0, 0], [1, 1, 1]]),  # evenly
        ("gray", (20.0, 220.0), [20, 220], [[0, 0, 0], [1, 1, 1]]),
        (((3, 0, 0, 1), (4, 1, 0, 0)), (0.0, 1.0), [3, 4], [[0, 0, 1], [1, 0, 0]]),  # where they are
    ],
)
def test_points_of_a_colour_map(cmap: Any, clim: tuple[float, float], values: Any, colours: Any) -> None:
    found = colour_points(Volume(path="a.npy", cmap=cmap).cmap or "", clim)
    assert [part.tolist() for part in found] == [values, colours]


def test_an_unknown_name_gets_near_ones() -> None:
    with pytest.raises(
        SceneError, match=r"unknown colour map; found virdis; allowed a name that .* lists, for example viridis"
    ):
        colour_points("virdis", (0.0, 1.0))
    with pytest.raises(SceneError, match="for example viridis, bone, gray"):
        colour_points("\n", (0.0, 1.0))


def test_an_rgb_preset_is_exact_and_spreads_over_clim(tmp_path: Path) -> None:
    path = preset(tmp_path, ColorSpace="RGB", RGBPoints=[-1, 0, 0, 0.5, 1, 1, 0, 0.25, 3, 1, 1, 1])
    values, colours = colour_points(path, (0.0, 100.0))
    assert values.tolist() == [0, 50, 100]
    assert colours.tolist() == [[0, 0, 0.5], [1, 0, 0.25], [1, 1, 1]]


def test_a_diverging_preset_is_morelands_cool_to_warm(tmp_path: Path) -> None:
    """Two ends in Msh space give the published table, which matplotlib's coolwarm holds at 33 points."""
    places, colours, _ = read_preset(preset(tmp_path, ColorSpace="Diverging", RGBPoints=COOL + WARM))
    ours = interpolate(np.linspace(0, 1, 33), places, colours)
    theirs = matplotlib.colormaps["coolwarm"](np.linspace(0, 1, 33))[:, :3]
    np.testing.assert_allclose(ours, theirs, atol=0.02)


@pytest.mark.parametrize("space", ["HSV", "Lab", "Diverging", "CIELAB"])
def test_a_resampled_preset_keeps_its_nodes_and_is_fine(tmp_path: Path, space: str) -> None:
    middle = [0.3, 0.2, 0.9, 0.1]
    places, colours, _ = read_preset(preset(tmp_path, ColorSpace=space, RGBPoints=COOL + middle + WARM))
    assert len(places) >= 256
    assert (np.diff(places) > 0).all()
    for node in (COOL, middle, WARM):
        np.testing.assert_allclose(interpolate(node[0], places, colours), node[1:], atol=1e-3)


def test_lab_has_known_values_and_comes_back() -> None:
    np.testing.assert_allclose(lab_from_rgb(np.array([1.0, 0.0, 0.0])), [53.24, 80.09, 67.20], atol=0.05)
    np.testing.assert_allclose(lab_from_rgb(np.ones(3)), [100, 0, 0], atol=0.02)
    colours = np.random.default_rng(1).random((50, 3))
    np.testing.assert_allclose(rgb_from_lab(lab_from_rgb(colours)), colours, atol=2e-4)


def test_hsv_goes_the_short_way_round_unless_told_not_to() -> None:
    first, second, half = np.array([1.0, 0.0, 0.1]), np.array([1.0, 0.1, 0.0]), np.array([0.5])
    short, long = (
        interpolate_colours("HSV", first, second, half),
        interpolate_colours("HSV", first, second, half, wrap=False),
    )
    assert short[0, 0] == pytest.approx(1)
    assert long[0, 0] < 0.5


def test_a_step_preset_has_the_colour_of_the_right_node(tmp_path: Path) -> None:
    path = preset(tmp_path, ColorSpace="Step", RGBPoints=[0, 1, 0, 0, 1, 0, 1, 0, 2, 0, 0, 1])
    places, colours, _ = read_preset(path)
    assert interpolate([0.25, 0.75], places, colours).tolist() == [[0, 1, 0], [0, 0, 1]]


def test_opacity_of_a_preset_is_read(tmp_path: Path) -> None:
    path = preset(tmp_path, RGBPoints=[0, 0, 0, 0, 10, 1, 1, 1], Points=[0, 0, 0.5, 0, 5, 0.1, 0.5, 0, 10, 1, 0.5, 0])
    assert read_preset(path)[2] == ((0.0, 0.0), (0.5, 0.1), (1.0, 1.0))


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({}, "RGBPoints cannot be used"),
        ({"RGBPoints": [0, 0, 0]}, "4 a point"),
        ({"RGBPoints": ["a", 0, 0, 0]}, "finite numbers"),
        ({"RGBPoints": [1, 0, 0, 0, 0, 1, 1, 1]}, "sorted by value"),
        ({"RGBPoints": [0, 0, 0, 0, 1, 2, 1, 1]}, "out of range"),
        ({"RGBPoints": [0, 0, 0, 0]}, "covers no range"),
        ({"RGBPoints": [0, 0, 0, 0, 0, 1, 1, 1]}, "covers no range"),
        ({"RGBPoints": COOL + WARM, "ColorSpace": "Oklab"}, "unknown ColorSpace; found Oklab; allowed RGB"),
        ({"RGBPoints": COOL + WARM, "UseLogScale": 1}, "logarithmic"),
        ({"RGBPoints": COOL + WARM, "Points": [0, 0, 0.2, 0, 1, 1, 0.5, 0]}, "midpoints and sharpness"),
    ],
)
def test_a_preset_that_cannot_be_used_says_why(tmp_path: Path, keys: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        read_preset(preset(tmp_path, **keys))


@pytest.mark.parametrize("text", ["", "{", "[]", "3", '["a"]', "[[]]"])
def test_a_file_that_is_no_preset_is_an_error(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(SceneError, match="preset"):
        read_preset(str(tmp_path / "a.json"))
