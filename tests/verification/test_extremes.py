"""Extremes that only the whole renderer meets: data, defaults, several ranks and compositing together.

Every picture is drawn by the processor's vectors on one rank and by OpenGL on several, and each is held to the float64
reference at 1e-5 of its own largest value, so that faint pictures are judged as strictly as opaque ones.
docs/reference/extremes.md lists what was seen.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from verification.analytic import Record

from clusterviz.comm import run_loopback
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid
from clusterviz.frame import render_frame
from clusterviz.frame.run import Options
from clusterviz.image import compare
from clusterviz.reference import render_reference
from clusterviz.render.choice import Device
from clusterviz.scene import Scene, Volume
from clusterviz.scene.overrides import with_settings

pytestmark = pytest.mark.gl

BOUND = 1e-5
Jobs = tuple[tuple[int, Device], ...]
"""Ranks, and on what they draw."""
JOBS: Jobs = ((1, "cpu"), (3, 0))
SHAPE = (9, 10, 11)


def noise(shape: tuple[int, int, int] = SHAPE) -> np.ndarray[Any, Any]:
    """Random samples in [0, 1]."""
    return np.random.default_rng(7).random(shape)


def draw(
    voxels: Any, grid: Grid | None, ranks: int, settings: dict[str, Any], device: Device = None
) -> tuple[Any, Scene]:
    """The picture, float64, and the completed scene."""
    source = ArraySource(np.asarray(voxels), grid)
    scene = with_settings(Scene(volumes=(Volume(path="array"),)), {"size": (20, 16), "brick": 4} | settings)
    options = Options(device=device)
    rendered = run_loopback(ranks, lambda channel: render_frame(scene, channel, source, options=options))[0]
    assert rendered.image is not None
    return rendered.image.astype(np.float64), rendered.scene


def check(
    record: Record, voxels: Any, grid: Grid | None = None, *, jobs: Jobs = JOBS, bound: float = BOUND, **settings: Any
) -> np.ndarray[Any, Any]:
    """The reference's picture, which those of all jobs are close to and which is not empty."""
    voxels = np.asarray(voxels)
    pictures = [draw(voxels, grid, ranks, settings, device) for ranks, device in jobs]
    expected = render_reference(pictures[0][1], grid or Grid(voxels.shape), voxels)
    largest = float(expected.max())
    assert largest > 0
    error = max(compare(picture, expected).max / largest for picture, _ in pictures)
    record("error", error)
    assert error <= bound
    return expected


@pytest.mark.parametrize("unit", [1e-30, 1e-9, 1e9, 1e30])
def test_any_unit_of_length_with_every_default_gives_the_same_picture(record_property: Record, unit: float) -> None:
    """Camera, opacity unit distance and step come from the grid: nothing of the unit may be left in the picture."""
    grid = Grid(SHAPE, (unit, 1.5 * unit, 0.7 * unit), (3 * unit, 0.0, -unit))
    picture = check(record_property, noise(), grid)
    assert (
        np.abs(picture - check(record_property, noise(), Grid(SHAPE, (1.0, 1.5, 0.7), (3.0, 0.0, -1.0)))).max() < 1e-9
    )


@pytest.mark.parametrize("ratio", [1e-4, 1e4])
def test_spacings_far_apart(record_property: Record, ratio: float) -> None:
    """The step follows the smallest spacing: along the long side of the cells a ray takes 10⁴ slabs."""
    grid = Grid((3, 3, 3), (1.0, 1.0, ratio))
    middle, length = (1.0, 1.0, ratio), 2 * max(1.0, ratio)
    settings = {"position": (1.1, 1.2, -length), "focal_point": middle, "view_up": (0, 1, 0), "parallel_scale": 1.5}
    if ratio < 1:
        settings |= {"position": (-5, 1.1, 1.1 * ratio), "view_up": (0, 0, 1), "parallel_scale": 2 * ratio}
    check(
        record_property,
        noise((3, 3, 3)),
        grid,
        **settings,
        size=(6, 5),
        opacity=0.3,
        opacity_unit_distance=length,
        step=2.0,
    )


@pytest.mark.parametrize(
    "direction",
    [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, 0, -1), (1, 1, 0), (1, 2, 3)],
    ids=lambda d: "".join(map(str, d)),
)
@pytest.mark.parametrize("lens", ["far", "near"])
def test_looking_along_an_axis_and_from_afar(record_property: Record, direction: Any, lens: str) -> None:
    """From 10⁶ diagonals away the ranks are still sorted rightly, and a pixel still is where it should be."""
    centre, diagonal = np.array([5.0, 4.5, 4.0]), float(np.linalg.norm([10, 9, 8]))
    away, angle = (1e6, 2e-5) if lens == "far" else (1.5, 40.0)
    position = centre - away * diagonal * np.array(direction) / np.linalg.norm(direction)
    up = (0.1, 1.0, 0.2) if direction[2] else (0.1, 0.2, 1.0)
    lens_settings = {"view_angle": angle * (2.5 if lens == "far" else 1)}
    check(
        record_property, noise(), opacity=0.4, step=0.5, position=tuple(position.tolist()),
        focal_point=tuple(centre.tolist()), view_up=up, **lens_settings,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("position", "focal_point"),
    [((4, 4, 4), (5, 4, 4)), ((4, 2.2, 3.3), (4, 4, 4)), ((8, 8, 0), (4, 4, 5)), ((4, -20, 4), (4, 4, 4))],
    ids=["where-eight-meet", "in-a-plane", "on-an-edge", "outside-along-an-edge"],
)
def test_an_eye_in_the_planes_between_ranks(record_property: Record, position: Any, focal_point: Any) -> None:
    """Bricks are four cells: the planes are those at multiples of 4. Rays run in them, and no side is in front."""
    settings = {"position": position, "focal_point": focal_point, "view_up": (0.1, 0.2, 1), "view_angle": 70.0}
    check(record_property, noise(), opacity=0.4, step=0.5, size=(21, 15), **settings)


@pytest.mark.parametrize("opacity", [1e-8, 1e-4, 1 - 1e-8, 1.0])
@pytest.mark.parametrize("step", [0.3, 100.0])
def test_opacity_at_its_ends_over_several_ranks(record_property: Record, opacity: float, step: float) -> None:
    """1 − α of a faint part is 1 in float32, and that of an all but opaque one is 0."""
    check(record_property, noise(), opacity=opacity, step=step, opacity_unit_distance=1.0)


def test_ten_thousand_slabs_over_several_ranks(record_property: Record) -> None:
    """Eleven samples at a step of 10⁻³: ten thousand slabs along x, cut between ranks at no multiple of the step."""
    check(
        record_property, noise(), step=1e-3, opacity=0.3, size=(3, 3), position=(-40, 4.1, 4.2),
        focal_point=(5, 4, 4), view_up=(0, 0, 1), view_angle=8.0,
    )  # fmt: skip


INTEGERS = ("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64")


@pytest.mark.parametrize("dtype", INTEGERS)
def test_integers_at_both_ends_with_the_range_that_is_chosen(record_property: Record, dtype: str) -> None:
    info = np.iinfo(dtype)
    voxels = np.where(noise() < 0.5, np.array(info.min, dtype), np.array(info.max, dtype))
    voxels[2:4] = info.max // 2 + info.min // 2
    check(record_property, voxels, step=0.4)


@pytest.mark.parametrize(
    ("dtype", "scale"),
    [
        *(("float16", 6e-8 * 16), ("float16", 65504), ("float32", 1e-43), ("float32", 1e-40), ("float32", 3.4e38)),
        *(("float64", 5e-324 * 2**20), ("float64", 1e-310), ("float64", 1.7e308)),
    ],
)
@pytest.mark.parametrize("sign", ["positive", "both"])
def test_denormals_and_the_largest_floats_with_the_range_that_is_chosen(
    record_property: Record, dtype: str, scale: float, sign: str
) -> None:
    """The range from the lowest to the highest float is no float64 itself."""
    values = noise() if sign == "positive" else 2 * noise() - 1
    check(record_property, (values * scale).astype(dtype), step=0.4)


def test_the_last_bits_of_float64_are_drawn_like_any_others() -> None:
    """64 steps of the smallest number there is: too coarse for the reference, which interpolates in them.

    Times 2⁹⁰⁰ they must give the same picture. Control points are data values: only those at the ends are exact here.
    """
    pictures = []
    for quantum in (5e-324, 5e-324 * 2.0**900):
        ends = ((0.0, 1.0, 0.0, 0.2), (64 * quantum, 0.0, 1.0, 0.7))
        settings = {"step": 0.4, "opacity": 0.3, "cmap": ends, "clim": (0.0, 64 * quantum)}
        pictures.append(draw(np.round(64 * noise()) * quantum, None, 1, settings)[0])
    assert pictures[0].max() > 0
    assert compare(*pictures, BOUND).count == 0


@pytest.mark.parametrize("clim", [(100.0, 100.0), (0.0, 1e-300), (200.0, 200.0 + 2e-6), (-1e308, 1e308)], ids=str)
@pytest.mark.parametrize("blending", ["composite", "average"])
def test_ranges_that_small_integers_cannot_tell(record_property: Record, clim: Any, blending: str) -> None:
    """A step, and a range of which all voxels are one place: units of clim leave float32, or have no digits there."""
    voxels = (noise() * 255).astype(np.uint8)
    check(record_property, voxels, clim=clim, blending=blending, opacity="linear", step=0.4)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_invalid_voxels_on_the_planes_between_ranks(record_property: Record, value: float) -> None:
    """A voxel in the overlap is held by both ranks, and hides cells of both."""
    voxels = noise()
    voxels[4, 4, 4] = voxels[8, 4, 8] = voxels[4, 8, 3] = value
    check(record_property, voxels, clim=(0.0, 1.0), opacity=0.3, step=0.37)


@pytest.mark.parametrize("value", [-3.5e38, -1e-40, 0.0, 1e-300, 7.0, 1.7e308])
def test_constant_fields_with_the_range_that_is_chosen(record_property: Record, value: float) -> None:
    check(record_property, np.full(SHAPE, value), opacity=0.3)


@pytest.mark.parametrize("residual", [1e-3, 0.1, 0.5])
@pytest.mark.parametrize("ranks", [1, 4])
def test_early_termination_on_several_ranks_keeps_its_bound(
    record_property: Record, residual: float, ranks: int
) -> None:
    """A rank that ends its rays knows of no other: each errs by the residual of what still reaches it, r + r² + …"""
    settings = {"opacity": 0.9, "step": 0.5, "opacity_unit_distance": 1.0}
    full, _ = draw(noise(), None, ranks, settings)
    ended, _ = draw(noise(), None, ranks, settings | {"early_termination": residual})
    error = compare(full, ended).max
    record_property("error", error)
    assert 0 < error <= residual / (1 - residual) + BOUND


@pytest.mark.parametrize("size", [(1, 1), (3, 1), (1, 9), (65, 1)])
def test_pictures_with_fewer_pixels_than_ranks(record_property: Record, size: tuple[int, int]) -> None:
    voxels, settings = noise(), {"size": size, "opacity": 0.5}
    expected = check(record_property, voxels, **settings)
    for ranks in (5, 8):
        picture, _ = draw(voxels, None, ranks, settings, 0)
        assert compare(picture, expected, BOUND).count == 0


def test_bricks_of_two_cells_on_many_ranks(record_property: Record) -> None:
    """Most of the voxels of a brick are overlap then, and most ranks meet in edges and corners."""
    expected = check(record_property, noise(), opacity=0.4, brick=2, step=0.3)
    picture, _ = draw(noise(), None, 8, {"opacity": 0.4, "brick": 2, "step": 0.3})
    assert compare(picture, expected, BOUND).count == 0
