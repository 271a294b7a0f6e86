"""Starts against an analytic ball: never behind what the next view sees of it, and seldom far before it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clusterviz.data.source import Grid
from clusterviz.image.partial import Rect
from clusterviz.plan.view import View, make_view
from clusterviz.render.frame_coherence import Box, is_coherent, project, rays_of, reproject
from clusterviz.scene.values import Camera

GRID = Grid((41, 41, 41))
BOX = Box((0.0, 0.0, 0.0), (40.0, 40.0, 40.0))
CENTRE, RADIUS = np.array([22.0, 19.0, 18.0]), 12.0
SIZE = (96, 80)
WHOLE = Rect(0, 0, *SIZE)


def view_at(degrees: float, parallel: bool = False, **keys: Any) -> View:
    angle = np.radians(degrees + 20.0)
    place = 20.0 + 90.0 * np.array([np.cos(angle), np.sin(angle), 0.3])
    lens: dict[str, Any] = {"parallel_scale": 30.0} if parallel else {"view_angle": 30.0}
    usual: dict[str, Any] = {"position": tuple(place), "focal_point": (20.0, 20.0, 20.0), "view_up": (0.0, 0.0, 1.0)}
    return make_view(Camera(**usual | lens | keys), SIZE, GRID)


def ball(view: View) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where each pixel's ray meets the ball, (3, h, w), and how deep that is in the view; NaN where it does not."""
    matrix = rays_of(view)
    x, y = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    across, above = (x - SIZE[0] / 2) * view.pixel, (SIZE[1] / 2 - y) * view.pixel
    aside = matrix[:3, 1, None, None] * across + matrix[:3, 2, None, None] * above
    ahead = np.broadcast_to(matrix[:3, 3, None, None], aside.shape)
    begin = matrix[:3, 0, None, None] + (aside if view.parallel else 0.0)
    by = ahead if view.parallel else aside + ahead
    off = begin - CENTRE[:, None, None]
    a, b, c = (by * by).sum(0), (off * by).sum(0), (off * off).sum(0) - RADIUS**2
    with np.errstate(invalid="ignore"):
        depth = (-b - np.sqrt(b * b - a * c)) / a
    return begin + by * depth, depth


def starts_of(last: View, view: View, hits: NDArray[np.float64], rect: Rect = WHOLE) -> NDArray[np.float32]:
    starts = np.full(SIZE[::-1], np.inf, np.float32)
    cut = np.ascontiguousarray(hits[:, rect.y_begin : rect.y_end, rect.x_begin : rect.x_end], np.float32)
    reproject((last, view), (rect, WHOLE), BOX, 2.0, cut, starts)
    return starts


@pytest.mark.parametrize("parallel", [False, True], ids=["perspective", "parallel"])
@pytest.mark.parametrize("degrees", [0.0, 0.5, 3.0])
def test_no_start_is_behind_what_is_seen(degrees: float, parallel: bool) -> None:
    last, view = view_at(0.0, parallel), view_at(degrees, parallel)
    assert is_coherent(last, view, BOX)
    starts, (_, depth) = starts_of(last, view, ball(last)[0]), ball(view)
    seen = np.isfinite(depth)
    # What bulges between hits that are alike is what the offset is for: the sagitta of a cell of the ball.
    assert np.max((starts - depth)[seen]) < 0.3
    assert np.median((depth - starts)[seen]) < 1.0
    assert np.isinf(starts).mean() > 0.5, "most rays meet nothing"


def test_what_the_last_picture_did_not_show_starts_at_once() -> None:
    """Half the ball lay beyond the last rectangle, as if the picture had ended there."""
    last, view = view_at(0.0), view_at(2.0)
    rect = Rect(0, 0, 48, SIZE[1])
    starts, (_, depth) = starts_of(last, view, ball(last)[0], rect), ball(view)
    seen = np.isfinite(depth)
    assert np.max((starts - depth)[seen]) < 0.3


def test_projection_and_rays_are_inverse() -> None:
    view = view_at(11.0)
    hits, depth = ball(view)
    found = project(view, hits.reshape(3, -1).T).T.reshape(3, *SIZE[::-1])
    seen = np.isfinite(depth)
    x, y = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    for got, expected in zip(found, (x, y, depth), strict=True):
        assert np.allclose(got[seen], expected[seen], atol=1e-9)


@pytest.mark.parametrize(
    "other",
    [
        view_at(60.0),
        view_at(0.0, parallel=True),
        view_at(0.0, position=(20.0, 20.0, 20.0), focal_point=(0.0, 0.0, 0.0)),
    ],
    ids=["a jump", "the other projection", "inside"],
)
def test_frames_that_have_little_in_common_are_not_coherent(other: View) -> None:
    assert not is_coherent(view_at(0.0), other, BOX)
    assert not is_coherent(other, view_at(0.0), BOX)


def test_a_side_that_comes_into_view_is_not_coherent() -> None:
    """What was behind it may have been hidden by nothing but the side itself; one that goes hides nothing new."""
    both, one = view_at(56.0), view_at(58.0)
    assert is_coherent(both, one, BOX)
    assert not is_coherent(one, both, BOX)
