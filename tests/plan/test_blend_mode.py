from __future__ import annotations

from typing import get_args

import numpy as np
import pytest

from clusterviz.image.merge import MERGES
from clusterviz.plan.blend_mode import (
    BlendMode,
    is_preintegrated,
    make_blend_mode,
    margin_of,
    spread_of,
    step_of,
)
from clusterviz.plan.encoding import FAR
from clusterviz.scene import TransferFunction
from clusterviz.scene.blend_modes import BLEND_MODES, Blending
from clusterviz.scene.values import Volume

BAND = TransferFunction(
    np.array([0.0]), np.ones((1, 3)), np.array([2.0, 3.0, 4.0, 5.0]), np.array([0, 1, 1, 0.0]), 1.0, (0.0, 10.0)
)
LOW, HIGH = np.array([0.0, 1.0, 6.0, 0.0, np.inf]), np.array([1.5, 3.0, 8.0, 9.0, -np.inf])


@pytest.mark.parametrize(
    ("blending", "hidden"),
    [
        ("composite", [True, False, True, False, True]),
        ("maximum", [True, False, False, False, True]),
        ("minimum", [False, False, True, False, True]),
        ("average", [False, False, False, False, True]),
        ("additive", [False, False, False, False, True]),
        ("local-maximum", [False, False, False, False, True]),
        ("first-hit", [True, False, False, False, True]),
        ("two-flux", [True, False, True, False, True]),
    ],
)
def test_only_what_cannot_matter_is_hidden(blending: str, hidden: list[bool]) -> None:
    assert BlendMode(blending, threshold=0.25).hides(BAND, LOW, HIGH).tolist() == hidden


def test_threshold_is_in_units_of_clim() -> None:
    volume = Volume(path="a", blending="local-maximum", threshold=5.0)
    assert make_blend_mode(volume, BAND, None).threshold == 0.5
    assert make_blend_mode(Volume(path="a"), BAND, None).operator == "over"


def test_surfaces_take_their_looks_from_the_transfer_function() -> None:
    volume = Volume(path="a", blending="isosurface", isosurfaces=(4.5, (1.0, 0.25), 2.0, 3.0))
    surfaces = make_blend_mode(volume, BAND, None).surfaces
    # The one at 2.0 is wholly transparent.
    assert [(s.value, s.units, s.opacity) for s in surfaces] == [(1.0, 0.1, 0.25), (3.0, 0.3, 1.0), (4.5, 0.45, 0.5)]
    hidden = BlendMode("isosurface", surfaces=surfaces).hides(BAND, LOW, HIGH)
    assert hidden.tolist() == [False, False, True, False, True]


def test_values_beyond_float32_stay_finite_and_beyond_all_voxels() -> None:
    volume = Volume(path="a", blending="isosurface", isosurfaces=((1e300, 0.5),))
    with np.errstate(over="raise"):
        assert FAR < make_blend_mode(volume, BAND, None).surface_block()[0, 0] < np.inf
        below = make_blend_mode(Volume(path="a", blending="local-maximum", threshold=-1e300), BAND, None).threshold
    assert -np.inf < np.float32(below) < -FAR


def test_margin_grows_with_what_a_volume_shows() -> None:
    surfaces = {"path": "a", "blending": "isosurface", "isosurfaces": (1.0,)}
    assert margin_of(Volume(path="a")) == 0
    assert margin_of(Volume(path="a", shade=True)) == 1
    assert margin_of(Volume(path="a", shade=True, blending="maximum")) == 0
    assert margin_of(Volume(path="a", gradient_opacity=((1.0, 0.5),))) == 1
    assert margin_of(Volume(**surfaces)) == 1
    assert margin_of(Volume(**surfaces, shade=True)) == 2


def test_slabs_that_are_classified_between_their_ends_reach_a_cell_further() -> None:
    volume, how = Volume(path="a"), "pre-integrated"
    assert (margin_of(volume, how), spread_of(volume, how), step_of(volume, 5.0, how)) == (1, 1, 2.0)
    assert (margin_of(volume), spread_of(volume), step_of(volume, 5.0)) == (0, 0, 5.0)
    assert margin_of(Volume(path="a", shade=True), how) == 2
    for other in ({"interpolation": "nearest"}, {"blending": "maximum"}, {"isosurfaces": (1.0,)}):
        assert not is_preintegrated(Volume(path="a", **other), how)


def test_every_blending_is_in_the_table_and_has_an_operator_that_merges() -> None:
    assert get_args(Blending) == tuple(BLEND_MODES)
    assert {mode.operator for mode in BLEND_MODES.values()} == set(MERGES)
