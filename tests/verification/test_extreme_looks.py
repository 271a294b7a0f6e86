"""Looks at the ends of what numbers can: types, units of length, opacities, thousands of slabs, few pixels.

Each is drawn with the range that the renderer chooses, by the processor's vectors on one rank and by OpenGL on two, and
held to the float64 reference at 1e-5 of the picture's own largest value, as in `test_extremes.py`.
docs/reference/extremes.md lists what was seen.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from verification.analytic import Record
from verification.test_extremes import BOUND, SHAPE, Jobs, noise
from verification.test_extremes import check as held_to_reference

from clusterviz.data.source import Grid

pytestmark = pytest.mark.gl

JOBS: Jobs = ((1, "cpu"), (2, 0))
LIT: dict[str, Any] = {"shade": True, "specular": 0.4}
LOOKS: dict[str, dict[str, Any]] = {
    "pre-integrated": {"classification": "pre-integrated"},
    "shade": LIT,
    "cubic": LIT | {"interpolation": "cubic"},
    "maximum": {"blending": "maximum"},
    "minimum": {"blending": "minimum", "opacity": "linear_r"},
    "local-maximum": {"blending": "local-maximum"},
    "average": {"blending": "average"},
    "additive": {"blending": "additive", "opacity_unit_distance": 30.0},
}
EACH_LOOK = pytest.mark.parametrize("look", LOOKS)
HIGHEST = {"float16": 65504.0, "float32": 3.4e38, "float64": 1.7e308}
DENORMAL = {"float16": 6e-8 * 16, "float32": 1e-43, "float64": 5e-324 * 2**20}


def ball() -> np.ndarray[Any, Any]:
    """0 to 1, round about the middle: every ray meets a surface of it twice or never."""
    z, y, x = np.meshgrid(*(np.linspace(-1, 1, n) for n in SHAPE), indexing="ij")
    return np.exp(-2 * (x * x + 1.3 * y * y + 0.8 * z * z))


def over_all_of(dtype: str) -> np.ndarray[Any, Any]:
    """The ball over an integer type, from its lowest to its highest."""
    info = np.iinfo(dtype)
    width = int(info.max) - int(info.min)
    values = [info.min + int(part * 2**52) * width // 2**52 for part in ball().ravel().tolist()]
    return np.array(values, dtype).reshape(SHAPE)


def around_0(dtype: str, scale: float) -> np.ndarray[Any, Any]:
    """The ball from −scale to scale: neither the range nor a difference of two voxels need be a number of the type."""
    return ((2 * ball() - 1) * scale).astype(dtype)


def surfaces(*values: float) -> dict[str, Any]:
    return LIT | {"blending": "isosurface", "isosurfaces": [(value, 0.6) for value in values]}


def check(record: Record, voxels: Any, grid: Grid | None = None, bound: float = BOUND, **settings: Any) -> None:
    """Pictures of two ranks at most, small ones, since looks cost more."""
    settings = {"size": (16, 12), "step": 0.4} | settings
    held_to_reference(record, voxels, grid, jobs=JOBS, bound=bound, **settings)


@EACH_LOOK
def test_integers_at_both_ends(record_property: Record, look: str) -> None:
    check(record_property, over_all_of("int64"), **LOOKS[look])


@EACH_LOOK
@pytest.mark.parametrize("ends", [DENORMAL, HIGHEST], ids=["denormal", "highest"])
def test_denormals_and_the_largest_floats(record_property: Record, look: str, ends: dict[str, float]) -> None:
    check(record_property, around_0("float64", ends["float64"]), **LOOKS[look])


@pytest.mark.parametrize("dtype", ["int8", "uint16", "int32", "uint64"])
def test_surfaces_in_integers_at_both_ends(record_property: Record, dtype: str) -> None:
    info = np.iinfo(dtype)
    values = [float(info.min + int(part * (int(info.max) - int(info.min)))) for part in (0.4, 0.7)]
    check(record_property, over_all_of(dtype), **surfaces(*values))


@pytest.mark.parametrize("dtype", HIGHEST)
@pytest.mark.parametrize("ends", [DENORMAL, HIGHEST], ids=["denormal", "highest"])
def test_surfaces_in_denormals_and_the_largest_floats(
    record_property: Record, dtype: str, ends: dict[str, float]
) -> None:
    scale = ends[dtype]
    check(record_property, around_0(dtype, scale), **surfaces(-0.2 * scale, 0.4 * scale))


@pytest.mark.parametrize("unit", [1e-30, 1e9])
@pytest.mark.parametrize("look", ["pre-integrated", "shade", "cubic", "average", "isosurface"])
def test_any_unit_of_length(record_property: Record, look: str, unit: float) -> None:
    """A gradient is per length: 10³⁰ times as steep in a unit of 10⁻³⁰, and the light on it the same."""
    grid = Grid(SHAPE, (unit, 1.5 * unit, 0.7 * unit), (3 * unit, 0.0, -unit))
    check(record_property, ball(), grid, **LOOKS.get(look, surfaces(0.5)))


@pytest.mark.parametrize("opacity", [1e-8, 1e-4, 1 - 1e-8, 1.0])
@pytest.mark.parametrize("ramp", [False, True], ids=["everywhere", "ramp"])
def test_pre_integrated_opacity_at_its_ends(record_property: Record, opacity: float, ramp: bool) -> None:
    """Sums of κ over the segments of a slab neither cancel nor overflow.

    A slab that holds all colours and all of the light is known in its mean colour and its lean: 4e-3 in such a slab,
    and 5e-3 of the largest seen from here.
    """
    camera = {"position": (22.5, 22.0, 21.5), "focal_point": (5.0, 4.5, 4.0), "view_angle": 30.0}
    points = ((0.0, 0.0), (1.0, opacity)) if ramp else opacity
    settings = {"classification": "pre-integrated", "opacity_unit_distance": 1.0, "clim": (0.0, 1.0), **camera}
    bound = 5e-3 if ramp and opacity > 0.5 else BOUND
    check(record_property, noise(), bound=bound, opacity=points, step=1.7, **settings)


@pytest.mark.parametrize("look", ["local-maximum", "average"])
def test_ten_thousand_slabs(record_property: Record, look: str) -> None:
    """Sums and extremes of ten thousand samples, over several dispatches and ranks."""
    check(
        record_property, ball(), step=1e-3, size=(2, 2), position=(-40, 4.1, 4.2), focal_point=(5, 4, 4),
        view_up=(0, 0, 1), view_angle=8.0, **{"opacity": 0.3} | LOOKS[look],
    )  # fmt: skip


@EACH_LOOK
def test_constant_fields(record_property: Record, look: str) -> None:
    """No gradient, no ramp, and no sample that is larger than another."""
    check(record_property, np.full(SHAPE, 1.7e308), **LOOKS[look] | {"opacity": 0.3})


@EACH_LOOK
def test_a_picture_of_one_pixel(record_property: Record, look: str) -> None:
    check(record_property, ball(), size=(1, 1), **LOOKS[look])
