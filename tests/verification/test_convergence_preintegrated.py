"""Pre-integrated slabs: exact where the scalar is linear along a ray, and of second order where it is not.

The transfer function does not enter the order: jumps and narrow peaks, which cost midpoints theirs, are integrated.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from verification.analytic import (
    BY_OPENGL,
    Record,
    Way,
    box_of,
    by_reference,
    lengths,
    orders,
    ramp_blue,
    ramp_transmittance,
    scene_along,
)

from clusterviz.data.field import marschner_lobb
from clusterviz.scene.values import Scene

ALONG_X = (1.0, 0.0, 0.0)
ASLANT = (0.64, 0.48, 0.6)
RAMP = ((0.0, 0.0), (1.0, 0.7))
JUMP = ((0.0, 0.0), (0.5, 0.0), (0.5, 0.5), (1.0, 0.5))
# Over the values of the waves, 0.08 to 0.39.
SMOOTH = ((0.05, 0.0), (0.4, 0.6))
STEP = ((0.0, 0.0), (0.22, 0.0), (0.22, 0.3), (1.0, 0.3))
PEAKS = tuple((p + d, a) for p in (0.15, 0.22, 0.3) for d, a in ((-0.01, 0.0), (0.0, 0.6), (0.01, 0.0)))


def between(scene: Scene) -> Scene:
    """The scene with its slabs classified between their ends."""
    return scene.model_copy(update={"quality": scene.quality.model_copy(update={"classification": "pre-integrated"})})


@pytest.mark.cover
@BY_OPENGL
@pytest.mark.parametrize("step", [0.3, 1.0, 2.0])
def test_ramps_have_no_error_at_any_step(way: Way, step: float) -> None:
    """Of opacities, and of colours; the last slab is cut short."""
    source = box_of(lambda x, y, z: x / 64, (2, 2, 64), (0, 0, 0), (64, 2, 2))
    scene = scene_along(ALONG_X, (32, 1, 1), opacity=RAMP, unit=40.0, step=step)
    assert way(between(scene), source)[0, 0, 3] == pytest.approx(1 - ramp_transmittance(0.7, 64, 40.0), abs=1e-6)
    scene = scene_along(ALONG_X, (32, 1, 1), opacity=0.8, unit=20.0, step=step)
    assert way(between(scene), source)[0, 0, 2] == pytest.approx(ramp_blue(0.8, 64, 20.0), abs=1e-6)


@pytest.mark.cover
@BY_OPENGL
@pytest.mark.parametrize("step", [0.3, 1.0, 2.0])
def test_a_jump_of_opacity_has_no_error_at_any_step(way: Way, step: float) -> None:
    begin, middle, end = (0.0,) * 3, (32.0, 0.0, 0.0), (64.0,) * 3
    source = box_of(lambda x, y, z: x / 64 + 0 * (y + z), (8, 8, 64), begin, end)
    scene = scene_along(ASLANT, (32,) * 3, opacity=JUMP, unit=40.0, step=step, size=(8, 8), scale=12)
    truth = 1 - 0.5 ** (lengths(scene, middle, end) / 40.0)
    assert np.abs(way(between(scene), source)[..., 3].ravel() - truth).max() <= 1e-6


@pytest.mark.cover("peaks-reference", "peaks-OpenGL", "jump-OpenGL")
@BY_OPENGL
@pytest.mark.parametrize(
    ("opacity", "midpoints"), [(SMOOTH, 2.0), (STEP, 1.0), (PEAKS, None)], ids=["smooth", "jump", "peaks"]
)
def test_order_against_the_step_whatever_the_transfer_function(
    way: Way, opacity: Any, midpoints: float | None, record_property: Record
) -> None:
    """Aslant through waves between voxels: a ramp misses their curvature. Against the reference at a step of 1/32.

    The orders are those of three halvings together: where kinks of the field fall in slabs makes single ones uneven.
    """
    source = box_of(marschner_lobb, (24,) * 3, (0.35,) * 3, (0.6,) * 3)

    def scene(step: float) -> Scene:
        return scene_along(ASLANT, (0.475,) * 3, opacity=opacity, unit=0.05, step=step, size=(6, 6), scale=0.05)

    truth = by_reference(between(scene(1 / 32)), source)
    rms = lambda found: math.sqrt(np.mean((found - truth) ** 2))  # noqa: E731
    steps = (2.0, 1.0, 1 / 2, 1 / 4)
    errors = [rms(way(between(scene(step)), source)) for step in steps]
    plain = [rms(way(scene(step), source)) for step in steps]
    for name, found in (("pre-integrated", errors), ("midpoints", plain)):
        record_property(f"{name}: errors", found)
        record_property(f"{name}: orders", [round(order, 3) for order in orders(found)])
    assert math.log2(errors[0] / errors[-1]) / 3 == pytest.approx(2.0, abs=0.25)
    if midpoints is not None:
        assert math.log2(plain[0] / plain[-1]) / 3 == pytest.approx(midpoints, abs=0.25)
    if midpoints != 2.0:
        assert max(np.divide(errors, plain)) < 0.4
