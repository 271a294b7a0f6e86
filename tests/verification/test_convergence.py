"""The error falls with the step and the voxel at the order that theory gives, and at no other.

Each case halves one parameter three or four times. Steps are long enough that truncation is measured, not float32: the
renderer is held to the same bands as the float64 reference. docs/measurements/accuracy.md lists what was seen.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from verification.analytic import (
    EACH_WAY,
    OPENGL_TOO,
    Record,
    Way,
    box_of,
    check_orders,
    gaussian_transmittance,
    lengths,
    marschner_lobb_opacity,
    ramp_blue,
    ramp_transmittance,
    scene_along,
)

from clusterviz.data.field import marschner_lobb

SECOND = 2.0, 0.12
"""Order and the band round it: midpoint rule, and trilinear interpolation."""
ALONG_X = (1.0, 0.0, 0.0)
UP_TO_90 = ((0.0, 0.0), (1.0, 0.9))


@EACH_WAY
@pytest.mark.parametrize("step", [0.1, 1.0, 3.7, 30.0])
def test_a_homogeneous_slab_has_no_error_at_any_step(way: Way, step: float) -> None:
    """e^{−κd} of each slab is exact, so their product is, whatever the last one's length."""
    source = box_of(lambda x, y, z: 0.5 + 0 * x, (2, 2, 16), (0, 0, 0), (16, 2, 2))
    red = ((0.0, 1.0, 0.0, 0.0), (1.0, 1.0, 0.0, 0.0))
    rgba = way(scene_along(ALONG_X, (8, 1, 1), opacity=0.3, unit=4.0, step=step, cmap=red), source)[0, 0]
    alpha = 1 - 0.7 ** (16 / 4)
    assert rgba == pytest.approx([alpha, 0, 0, alpha], abs=5e-7)


@EACH_WAY
def test_a_ramp_of_opacities_against_the_step(way: Way, record_property: Record) -> None:
    source = box_of(lambda x, y, z: x / 64, (2, 2, 64), (0, 0, 0), (64, 2, 2))
    truth = 1 - ramp_transmittance(0.7, 64, 40.0)
    errors = []
    for step in (32, 16, 8, 4, 2):
        scene = scene_along(ALONG_X, (32, 1, 1), opacity=((0.0, 0.0), (1.0, 0.7)), unit=40.0, step=step)
        errors.append(abs(way(scene, source)[0, 0, 3] - truth))
    check_orders(record_property, errors, *SECOND)


@EACH_WAY
def test_a_ramp_of_colours_against_the_step(way: Way, record_property: Record) -> None:
    source = box_of(lambda x, y, z: x / 64, (2, 2, 64), (0, 0, 0), (64, 2, 2))
    truth = ramp_blue(0.8, 64, 20.0)
    scenes = [scene_along(ALONG_X, (32, 1, 1), opacity=0.8, unit=20.0, step=step) for step in (16, 8, 4, 2, 1)]
    check_orders(record_property, [abs(way(scene, source)[0, 0, 2] - truth) for scene in scenes], *SECOND)


@pytest.mark.cover
@OPENGL_TOO
def test_a_gaussian_against_the_step(way: Way, record_property: Record) -> None:
    """From the middle to 1.5 σ: between two zeros the midpoint rule converges faster than by any power.

    The voxels are 256 to a σ: their own error is far below.
    """
    sigma = 256.0
    source = box_of(lambda x, y, z: np.exp(-(x**2) / (2 * sigma**2)), (2, 2, 384), (0, 0, 0), (384, 2, 2))
    truth = 1 - gaussian_transmittance(0.9, sigma, 0, 384, 300.0)
    errors = []
    for step in (96, 48, 24, 12, 6):
        scene = scene_along(ALONG_X, (192, 1, 1), opacity=UP_TO_90, unit=300.0, step=step)
        errors.append(abs(way(scene, source)[0, 0, 3] - truth))
    check_orders(record_property, errors, *SECOND)


@EACH_WAY
def test_a_gaussian_against_the_voxel(way: Way, record_property: Record) -> None:
    """σ = 0.4 over [−1, 1], along a line of voxels; the step shrinks with the voxel, and stays 1/8 of it."""
    sigma = 0.4
    field = lambda x, y, z: np.exp(-(x**2 + y**2 + z**2) / (2 * sigma**2))  # noqa: E731
    truth = 1 - gaussian_transmittance(0.9, sigma, -1, 1, 0.5)
    errors = []
    for cells in (8, 16, 32, 64):
        source = box_of(field, (cells // 4, cells // 4, cells), (-1, -0.25, -0.25), (1, 0.25, 0.25))
        scene = scene_along(ALONG_X, (0, 0, 0), opacity=UP_TO_90, unit=0.5, step=1 / 8, scale=1e-6)
        errors.append(abs(way(scene, source)[0, 0, 3] - truth))
    check_orders(record_property, errors, *SECOND)


@pytest.mark.cover("OpenGL")
@OPENGL_TOO
def test_marschner_lobb_against_the_voxel(way: Way, record_property: Record) -> None:
    """A picture of 8 × 8 rays aslant through a part of the field with two waves; rms over its pixels."""
    begin, end, direction = (0.35,) * 3, (0.6,) * 3, (0.64, 0.48, 0.6)
    errors = []
    for cells in (8, 16, 32, 64):
        scene = scene_along(
            direction, (0.475,) * 3, opacity=UP_TO_90, unit=0.2, step=1 / 8, size=(8, 8), scale=0.05
        )  # fmt: skip
        difference = way(scene, box_of(marschner_lobb, (cells,) * 3, begin, end))[..., 3].ravel()
        difference -= marschner_lobb_opacity(scene, begin, end, 0.9, 0.2)
        errors.append(math.sqrt(np.mean(difference**2)))
    check_orders(record_property, errors, *SECOND)


@EACH_WAY
def test_a_jump_of_opacity_against_the_step(way: Way, record_property: Record) -> None:
    """Of each ray one slab holds the jump, and is wrong by a part of its opacity: order 1, in the mean of many rays."""
    begin, middle, end = (0.0,) * 3, (32.0, 0.0, 0.0), (64.0,) * 3
    source = box_of(lambda x, y, z: x / 64 + 0 * (y + z), (8, 8, 64), begin, end)
    jump = ((0.0, 0.0), (0.5, 0.0), (0.5, 0.5), (1.0, 0.5))
    errors = []
    for step in (4, 2, 1, 1 / 2, 1 / 4):
        scene = scene_along((0.64, 0.48, 0.6), (32,) * 3, opacity=jump, unit=40.0, step=step, size=(16, 16), scale=12)
        truth = 1 - 0.5 ** (lengths(scene, middle, end) / 40.0)
        errors.append(math.sqrt(np.mean((way(scene, source)[..., 3].ravel() - truth) ** 2)))
    check_orders(record_property, errors, 1.0, 0.3)
