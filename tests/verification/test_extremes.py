"""Extremes that only the whole renderer meets: data, defaults, several ranks and compositing together.

Every picture is drawn by the CPU on one rank and by OpenGL on several, and each is held to the float64 reference at
1e-5 of its own largest value, so that faint pictures are judged as strictly as opaque ones.
docs/reference/extremes.md lists what was seen.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from verification.analytic import Record

from clusterviz.comm import run_loopback
from clusterviz.data import override_grid
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid
from clusterviz.frame import render_frame
from clusterviz.frame.run import Options
from clusterviz.gl.devices import Device
from clusterviz.image import compare
from clusterviz.reference import render_reference
from clusterviz.scene import Scene, Volume
from clusterviz.scene.overrides import with_settings

pytestmark = pytest.mark.gl

BOUND = 1e-5
Jobs = tuple[tuple[int, Device], ...]
"""Ranks, and on what they draw."""
THREE: Jobs = ((1, "cpu"), (3, 0))
TWO: Jobs = ((1, "cpu"), (2, 0))
SHAPE = (9, 10, 11)
Voxels = np.ndarray[Any, Any]


@dataclass(frozen=True)
class Case:
    """A volume, how it is drawn, and the largest error as a share of the picture's largest value."""

    voxels: Voxels
    settings: dict[str, Any] = field(default_factory=dict)
    grid: Grid | None = None
    jobs: Jobs = THREE
    bound: float = BOUND


def noise(shape: tuple[int, int, int] = SHAPE) -> Voxels:
    """Random samples in [0, 1]."""
    return np.random.default_rng(7).random(shape)


def ball() -> Voxels:
    """0 to 1, round about the middle: every ray meets a surface of it twice or never."""
    z, y, x = np.meshgrid(*(np.linspace(-1, 1, n) for n in SHAPE), indexing="ij")
    return np.exp(-2 * (x * x + 1.3 * y * y + 0.8 * z * z))


def over_all_of(dtype: str) -> Voxels:
    """The ball over an integer type, from its lowest to its highest."""
    info = np.iinfo(dtype)
    width = int(info.max) - int(info.min)
    values = [info.min + int(part * 2**52) * width // 2**52 for part in ball().ravel().tolist()]
    return np.array(values, dtype).reshape(SHAPE)


def around_0(dtype: str, scale: float) -> Voxels:
    """The ball from −scale to scale: neither the range nor a difference of two voxels need be a number of the type."""
    return ((2 * ball() - 1) * scale).astype(dtype)


def both_ends(dtype: str) -> Voxels:
    info = np.iinfo(dtype)
    voxels = np.where(noise() < 0.5, np.array(info.min, dtype), np.array(info.max, dtype))
    voxels[2:4] = info.max // 2 + info.min // 2
    return voxels


def with_invalid(value: float) -> Voxels:
    """Voxels in the overlap, which are held by both ranks, hide cells of both."""
    voxels = noise()
    voxels[4, 4, 4] = voxels[8, 4, 8] = voxels[4, 8, 3] = value
    return voxels


def in_units_of(unit: float) -> Grid:
    return Grid(SHAPE, (unit, 1.5 * unit, 0.7 * unit), (3 * unit, 0.0, -unit))


def from_afar(direction: tuple[int, int, int], far: bool) -> dict[str, Any]:
    """A camera 1.5 or 10⁶ diagonals away."""
    centre, diagonal = np.array([5.0, 4.5, 4.0]), float(np.linalg.norm([10, 9, 8]))
    position = centre - (1e6 if far else 1.5) * diagonal * np.array(direction) / np.linalg.norm(direction)
    up = (0.1, 1.0, 0.2) if direction[2] else (0.1, 0.2, 1.0)
    angle = 5e-5 if far else 40.0
    return {
        "position": tuple(position.tolist()), "focal_point": tuple(centre.tolist()), "view_up": up, "view_angle": angle
    }  # fmt: skip


LIT: dict[str, Any] = {"shade": True, "specular": 0.4}
INTEGRATED = {"classification": "pre-integrated"}
MODES: dict[str, dict[str, Any]] = {
    "pre-integrated": INTEGRATED,
    "shade": LIT,
    "cubic": LIT | {"interpolation": "cubic"},
    "maximum": {"blending": "maximum"},
    "minimum": {"blending": "minimum", "opacity": "linear_r"},
    "local-maximum": {"blending": "local-maximum"},
    "average": {"blending": "average"},
    "additive": {"blending": "additive", "opacity_unit_distance": 30.0},
}
HIGHEST = {"float16": 65504.0, "float32": 3.4e38, "float64": 1.7e308}
DENORMAL = {"float16": 6e-8 * 16, "float32": 1e-43, "float64": 5e-324 * 2**20}
INTEGERS = ("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64")
AT_X = {"position": (-40, 4.1, 4.2), "focal_point": (5, 4, 4), "view_up": (0, 0, 1), "view_angle": 8.0}
SMALL = {"size": (16, 12), "step": 0.4}
PLAIN = {"opacity": 0.4, "step": 0.5}
# Bricks are four cells: the planes between ranks are at multiples of 4. Rays run in them, and no side is in front.
EYES = {
    "where eight meet": ((4, 4, 4), (5, 4, 4)),
    "in a plane": ((4, 2.2, 3.3), (4, 4, 4)),
    "on an edge": ((8, 8, 0), (4, 4, 5)),
    "outside along an edge": ((4, -20, 4), (4, 4, 4)),
}
# The step follows the smallest spacing: along the long side of the cells a ray takes 10⁴ slabs.
THIN = {"position": (-5, 1.1, 1.1e-4), "focal_point": (1, 1, 1e-4), "view_up": (0, 0, 1), "parallel_scale": 2e-4}
LONG = {"position": (1.1, 1.2, -2e4), "focal_point": (1, 1, 1e4), "view_up": (0, 1, 0), "parallel_scale": 1.5}
COARSE = {"size": (6, 5), "opacity": 0.3, "step": 2.0}


def surfaces(*values: float) -> dict[str, Any]:
    return LIT | {"blending": "isosurface", "isosurfaces": [(value, 0.6) for value in values]}


def within(dtype: str) -> dict[str, Any]:
    """Surfaces at two shares of an integer type."""
    info = np.iinfo(dtype)
    return surfaces(*(float(info.min + int(share * (int(info.max) - int(info.min)))) for share in (0.4, 0.7)))


def of_mode(voxels: Voxels, settings: dict[str, Any], grid: Grid | None = None, bound: float = BOUND) -> Case:
    """Pictures of two ranks at most, small ones, since modes cost more."""
    return Case(voxels, SMALL | settings, grid, TWO, bound)


def integrated_at(opacity: float, ramp: bool) -> Case:
    """Sums of κ over the segments of a slab neither cancel nor overflow.

    A slab that holds all colours and all of the light is known in its mean colour and its lean: 4e-3 in such a slab,
    and 5e-3 of the largest seen from here.
    """
    eye = {"position": (22.5, 22.0, 21.5), "focal_point": (5.0, 4.5, 4.0), "view_angle": 30.0}
    keys = {"opacity": ((0.0, 0.0), (1.0, opacity)) if ramp else opacity, "clim": (0.0, 1.0), "step": 1.7}
    settings = INTEGRATED | eye | keys | {"opacity_unit_distance": 1.0}
    return of_mode(noise(), settings, bound=5e-3 if ramp and opacity > 0.5 else BOUND)


OPACITIES = (1e-8, 1e-4, 1 - 1e-8, 1.0)
CASES: dict[str, Case] = {
    "spacing of 1e-4": Case(
        noise((3, 3, 3)), THIN | COARSE | {"opacity_unit_distance": 2.0}, Grid((3, 3, 3), (1.0, 1.0, 1e-4))
    ),
    "spacing of 1e4": Case(
        noise((3, 3, 3)), LONG | COARSE | {"opacity_unit_distance": 2e4}, Grid((3, 3, 3), (1.0, 1.0, 1e4))
    ),
    **{
        f"along {direction}, far: {far}": Case(noise(), PLAIN | from_afar(direction, far))
        for direction in ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, 0, -1), (1, 1, 0), (1, 2, 3))
        for far in (True, False)
    },
    **{
        f"eye {name}": Case(
            noise(),
            PLAIN
            | {"position": eye, "focal_point": focal, "view_up": (0.1, 0.2, 1), "view_angle": 70, "size": (21, 15)},
        )
        for name, (eye, focal) in EYES.items()
    },
    # 1 − α of a faint part is 1 in float32, and that of an all but opaque one is 0.
    **{
        f"opacity {opacity}, step {step}": Case(
            noise(), {"opacity": opacity, "step": step, "opacity_unit_distance": 1.0}
        )
        for opacity in OPACITIES
        for step in (0.3, 100.0)
    },
    # Cut between ranks at no multiple of the step.
    "10,000 slabs": Case(noise(), {"step": 1e-3, "opacity": 0.3, "size": (3, 3)} | AT_X),
    **{f"both ends of {dtype}": Case(both_ends(dtype), {"step": 0.4}) for dtype in INTEGERS},
    # The range from the lowest to the highest float is no float64 itself.
    **{
        f"{dtype} times {scale}, {sign}": Case((values * scale).astype(dtype), {"step": 0.4})
        for dtype, scales in (
            ("float16", (6e-8 * 16, 65504)),
            ("float32", (1e-43, 1e-40, 3.4e38)),
            ("float64", (5e-324 * 2**20, 1e-310, 1.7e308)),
        )
        for scale in scales
        for sign, values in (("positive", noise()), ("both signs", 2 * noise() - 1))
    },
    # A step, and ranges of which all voxels are one place: units of clim leave float32, or have no digits there.
    **{
        f"clim {clim}, {blending}": Case(
            (noise() * 255).astype(np.uint8), {"clim": clim, "blending": blending, "opacity": "linear", "step": 0.4}
        )
        for clim in ((100.0, 100.0), (0.0, 1e-300), (200.0, 200.0 + 2e-6), (-1e308, 1e308))
        for blending in ("composite", "average")
    },
    **{
        f"{value} between ranks": Case(with_invalid(value), {"clim": (0.0, 1.0), "opacity": 0.3, "step": 0.37})
        for value in (np.nan, np.inf, -np.inf)
    },
    **{
        f"constant {value}": Case(np.full(SHAPE, value), {"opacity": 0.3})
        for value in (-3.5e38, -1e-40, 0.0, 1e-300, 7.0, 1.7e308)
    },
    **{
        f"{size} pixels": Case(noise(), {"size": size, "opacity": 0.5}, jobs=(*THREE, (5, 0), (8, 0)))
        for size in ((1, 1), (3, 1), (1, 9), (65, 1))
    },
    # Most of the voxels of a brick are overlap then, and most ranks meet in edges and corners.
    **{  # with a thickness, where there is one sample along an axis
        f"shape {shape}": Case(noise(shape), {"opacity": 0.3}, jobs=TWO)
        for shape in ((1, 1, 1), (1, 8, 8), (8, 1, 8), (8, 8, 1), (2, 2, 2))
    },
    "more ranks than bricks": Case(noise((5, 5, 9)), {"opacity": 0.3}, jobs=((5, 0),)),
    "bricks of two cells": Case(noise(), {"opacity": 0.4, "brick": 2, "step": 0.3}, jobs=(*THREE, (8, None))),
    **{f"int64, {name}": of_mode(over_all_of("int64"), keys) for name, keys in MODES.items()},
    **{f"denormal, {name}": of_mode(around_0("float64", DENORMAL["float64"]), keys) for name, keys in MODES.items()},
    **{f"largest, {name}": of_mode(around_0("float64", HIGHEST["float64"]), keys) for name, keys in MODES.items()},
    **{f"{t}, surfaces": of_mode(over_all_of(t), within(t)) for t in ("int8", "uint16", "int32", "uint64")},
    **{
        f"{dtype} times {scale}, surfaces": of_mode(around_0(dtype, scale), surfaces(-0.2 * scale, 0.4 * scale))
        for ends in (DENORMAL, HIGHEST)
        for dtype, scale in ends.items()
    },
    # A gradient is per length: 10³⁰ times as steep in a unit of 10⁻³⁰, and the light on it the same.
    **{
        f"unit {unit:g}, {name}": of_mode(ball(), MODES.get(name, surfaces(0.5)), in_units_of(unit))
        for unit in (1e-30, 1e9)
        for name in ("pre-integrated", "shade", "cubic", "average", "isosurface")
    },
    **{
        f"pre-integrated, opacity {opacity}, ramp: {ramp}": integrated_at(opacity, ramp)
        for opacity in OPACITIES
        for ramp in (False, True)
    },
    # Sums and extremes of ten thousand samples, over several dispatches and ranks.
    **{
        f"10,000 slabs, {name}": of_mode(ball(), {"opacity": 0.3} | MODES[name] | AT_X | {"step": 1e-3, "size": (2, 2)})
        for name in ("local-maximum", "average")
    },
    # No gradient, no ramp, and no sample that is larger than another.
    **{f"constant, {name}": of_mode(np.full(SHAPE, 1.7e308), keys | {"opacity": 0.3}) for name, keys in MODES.items()},
    **{f"one pixel, {name}": of_mode(ball(), keys | {"size": (1, 1)}) for name, keys in MODES.items()},
}


def draw(case: Case, ranks: int, device: Device = None) -> tuple[Voxels, Scene]:
    """The picture, float64, and the completed scene."""
    source = ArraySource(case.voxels, case.grid)
    scene = with_settings(Scene(volumes=(Volume(path="array"),)), {"size": (20, 16), "brick": 4} | case.settings)
    options = Options(device=device)
    rendered = run_loopback(ranks, lambda channel: render_frame(scene, channel, source, options=options))[0]
    assert rendered.image is not None
    return rendered.image.astype(np.float64), rendered.scene


def check(record: Record, case: Case) -> Voxels:
    """The reference's picture, which those of all jobs are close to and which is not empty."""
    pictures = [draw(case, ranks, device) for ranks, device in case.jobs]
    completed = pictures[0][1]
    shown = override_grid(ArraySource(case.voxels, case.grid), completed.volumes[0])
    expected = render_reference(completed, shown.grid, shown.read((0, 0, 0), shown.grid.shape_zyx))
    largest = float(expected.max())
    assert largest > 0
    error = max(compare(picture, expected).max / largest for picture, _ in pictures)
    record("error", error)
    assert error <= case.bound
    return expected


USUAL = (
    "along (1, 0, 0), far: True",
    "along (1, 2, 3), far: True",
    *(f"eye {name}" for name in ("where eight meet", "on an edge")),
    "opacity 1e-08, step 0.3",
    "opacity 1.0, step 100.0",
    *(f"both ends of {dtype}" for dtype in ("uint8", "int64")),
    "float16 times 9.6e-07, both signs",
    "float32 times 3.4e+38, both signs",
    "float64 times 1e-310, positive",
    "float64 times 1.7e+308, both signs",
    "clim (100.0, 100.0), composite",
    "clim (0.0, 1e-300), average",
    "clim (200.0, 200.000002), composite",
    "clim (-1e+308, 1e+308), composite",
    *(f"{value} between ranks" for value in (np.nan, -np.inf)),
    *(f"constant {value}" for value in (0.0, 1.7e308)),
    "(1, 1) pixels",
    *(f"shape {shape}" for shape in ((1, 1, 1), (1, 8, 8), (8, 8, 1))),
    "more ranks than bricks",
    "int64, maximum",
    "denormal, shade",
    "denormal, additive",
    "largest, pre-integrated",
    "largest, local-maximum",
    "float16 times 65504.0, surfaces",
    "unit 1e-30, shade",
    "unit 1e+09, pre-integrated",
    "pre-integrated, opacity 1e-08, ramp: True",
    "pre-integrated, opacity 1.0, ramp: True",
    "10,000 slabs, local-maximum",
    "constant, average",
    "one pixel, minimum",
)
"""An extreme of each sort; the others are long."""
assert set(USUAL) <= set(CASES)
ROWS = [name if name in USUAL else pytest.param(name, marks=pytest.mark.long) for name in CASES]


@pytest.mark.parametrize("name", ROWS)
def test_pictures_of_several_ranks_are_those_of_the_reference(record_property: Record, name: str) -> None:
    check(record_property, CASES[name])


def test_any_unit_of_length_with_every_default_gives_the_same_picture(record_property: Record) -> None:
    """Camera, opacity unit distance and step come from the grid: nothing of the unit may be left in the picture."""
    plain, *others = (check(record_property, Case(noise(), {}, in_units_of(u))) for u in (1, 1e-30, 1e-9, 1e9, 1e30))
    for picture in others:
        assert np.abs(picture - plain).max() < 1e-9


def test_the_last_bits_of_float64_are_drawn_like_any_others() -> None:
    """64 steps of the smallest number there is: too coarse for the reference, which interpolates in them.

    Times 2⁹⁰⁰ they must give the same picture. Control points are data values: only those at the ends are exact here.
    """
    pictures = []
    for quantum in (5e-324, 5e-324 * 2.0**900):
        ends = ((0.0, 1.0, 0.0, 0.2), (64 * quantum, 0.0, 1.0, 0.7))
        settings = {"step": 0.4, "opacity": 0.3, "cmap": ends, "clim": (0.0, 64 * quantum)}
        pictures.append(draw(Case(np.round(64 * noise()) * quantum, settings), 1)[0])
    assert pictures[0].max() > 0
    assert compare(*pictures, BOUND).count == 0


@pytest.mark.cover
@pytest.mark.parametrize("residual", [1e-3, 0.1, 0.5])
@pytest.mark.parametrize("ranks", [1, 4])
def test_early_termination_on_several_ranks_keeps_its_bound(
    record_property: Record, residual: float, ranks: int
) -> None:
    """A rank that ends its rays knows of no other: each errs by the residual of what still reaches it, r + r² + …"""
    settings = {"opacity": 0.9, "step": 0.5, "opacity_unit_distance": 1.0}
    full, ended = (draw(Case(noise(), settings | early), ranks)[0] for early in ({}, {"early_termination": residual}))
    error = compare(full, ended).max
    record_property("error", error)
    assert 0 < error <= residual / (1 - residual) + BOUND
