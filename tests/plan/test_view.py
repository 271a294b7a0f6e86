from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from clusterviz.data.source import Grid
from clusterviz.image.partial import EMPTY, Rect
from clusterviz.plan.view import View, make_view
from clusterviz.reference.rays import Rays, camera_rays, inside, to_index_space
from clusterviz.scene.values import Camera

TURN = ((0.8, -0.6, 0.0), (0.6, 0.8, 0.0), (0.0, 0.0, 1.0))
GRIDS = {
    "plain": Grid((8, 9, 10)),
    "anisotropic": Grid((8, 9, 10), (0.5, 2.0, 1.0), (3.0, -4.0, 5.0)),
    "turned": Grid((8, 9, 10), (0.5, 2.0, 1.0), (3.0, -4.0, 5.0), TURN),
    "mirrored": Grid((8, 9, 10), direction=((-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))),
    "sheared": Grid((8, 9, 10), direction=((1.0, 0.6, 0.0), (0.0, 0.8, 0.0), (0.0, 0.0, 1.0))),
}
CAMERAS = {
    "perspective": Camera(position=(40, 25, 30), focal_point=(4, 4, 4), view_up=(0, 0, 1), view_angle=25),
    "inside": Camera(position=(4, 3, 5), focal_point=(9, 7, 4), view_up=(0, 1, 0), view_angle=70),
    "parallel": Camera(position=(40, 25, 30), focal_point=(4, 4, 4), view_up=(0, 0, 1), parallel_scale=7),
    "off-axis": Camera(position=(40, 25, 30), focal_point=(4, 4, 4), view_up=(0, 0, 1), window_center=(0.4, -0.3)),
    "huge": Camera(position=(4e200, 2.5e200, 3e200), focal_point=(0, 0, 0), view_up=(0, 0, 1), view_angle=25),
}


def rays_of(view: View) -> Rays:
    """Every pixel's ray in index space, by the expression of ray.glsl, in float64."""
    (width, height), (column, row) = view.size, view.centre
    i, j = np.meshgrid(np.arange(width), np.arange(height))
    across, above = (
        ((i + 0.5 - column) * view.pixel).reshape(-1, 1),
        ((row - j - 0.5) * view.pixel).reshape(-1, 1),
    )
    eye, right, up, forward = (np.array(v) for v in (view.eye, view.right, view.up, view.forward))
    aside = across * right + above * up
    if view.parallel:
        return Rays(eye + aside, np.broadcast_to(forward, aside.shape))
    return Rays(np.broadcast_to(eye, aside.shape), (forward + aside) / np.sqrt(1 + across**2 + above**2))


@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS)
@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_ray_of_a_pixel_is_the_reference(camera: Camera, grid: Grid) -> None:
    for size in ((13, 9), (1, 1), (1, 7)):
        found, expected = rays_of(make_view(camera, size, grid)), to_index_space(camera_rays(camera, size), grid)
        scale = np.abs(expected.start).max()
        assert np.abs(found.start - expected.start).max() <= 1e-12 * scale
        assert np.abs(found.direction - expected.direction).max() <= 1e-12


def seen(view: View, begin: tuple[float, ...], end: tuple[float, ...]) -> Rect:
    """The smallest rectangle of all pixels whose rays meet the box, by trying every ray."""
    rays = rays_of(view)
    entry, leave = inside(Rays(rays.start - begin, rays.direction), np.subtract(end, begin))
    rows, columns = np.nonzero((leave > entry).reshape(view.size[::-1]))
    if rows.size == 0:
        return EMPTY
    return Rect(int(columns.min()), int(rows.min()), int(columns.max()) + 1, int(rows.max()) + 1)


def holds(outer: Rect, inner: Rect) -> bool:
    return outer.intersect(inner) == inner or inner.pixels == 0


coordinate = st.floats(-30, 40, allow_subnormal=False)


@settings(deadline=None, max_examples=150)
@given(
    position=st.tuples(coordinate, coordinate, coordinate),
    focal=st.tuples(coordinate, coordinate, coordinate),
    begin=st.tuples(*[st.integers(0, 6)] * 3),
    extent=st.tuples(*[st.integers(1, 9)] * 3),
    scale=st.one_of(st.none(), st.floats(0.5, 30)),
    grid=st.sampled_from(list(GRIDS.values())),
)
def test_footprint_holds_every_pixel_whose_ray_meets_the_box(
    position: tuple[float, float, float],
    focal: tuple[float, float, float],
    begin: tuple[int, int, int],
    extent: tuple[int, int, int],
    scale: float | None,
    grid: Grid,
) -> None:
    forward = np.subtract(focal, position)
    assume(np.linalg.norm(forward) > 1e-3 and np.linalg.norm(np.cross(forward, (0.1, 0.2, 1))) > 1e-3)
    camera = Camera(position=position, focal_point=focal, view_up=(0.1, 0.2, 1), parallel_scale=scale, view_angle=50)
    view = make_view(camera, (23, 17), grid)
    low, high = tuple(map(float, begin)), tuple(float(b + e) for b, e in zip(begin, extent, strict=True))
    assert holds(view.footprint(low, high), seen(view, low, high))


def test_footprint_is_tight_where_the_box_is_in_front() -> None:
    """A box whose projection is known: a square of 4 pixels a side around the centre, at 2 pixels a unit."""
    camera = Camera(position=(5, 5, -20), focal_point=(5, 5, 0), view_up=(0, 1, 0), parallel_scale=5)
    view = make_view(camera, (20, 20), Grid((11, 11, 11)))
    rect = view.footprint((4.0, 4.0, 0.0), (6.0, 6.0, 10.0))
    assert holds(rect, Rect(8, 8, 12, 12))
    assert rect.width <= 6
    assert rect.height <= 6


def test_box_behind_the_eye_or_beside_the_picture_covers_nothing() -> None:
    behind = make_view(Camera(position=(20, 4, 4), focal_point=(30, 4, 4), view_up=(0, 0, 1)), (16, 16), GRIDS["plain"])
    assert behind.footprint((0.0, 0.0, 0.0), (9.0, 8.0, 7.0)).pixels == 0
    beside = make_view(
        Camera(position=(-20, 4, 40), focal_point=(0, 4, 40), view_up=(0, 0, 1), view_angle=20),
        (16, 16),
        GRIDS["plain"],
    )
    assert beside.footprint((0.0, 0.0, 0.0), (9.0, 8.0, 7.0)).pixels == 0


def test_camera_inside_covers_the_whole_picture() -> None:
    view = make_view(CAMERAS["inside"], (16, 12), GRIDS["plain"])
    assert view.footprint((0.0, 0.0, 0.0), (9.0, 8.0, 7.0)) == Rect(0, 0, 16, 12)
