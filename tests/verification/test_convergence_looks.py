"""Reconstruction, light, surfaces and control points: each error falls at the order that theory gives.

The pictures are held to formulas, not to samples of them; docs/measurements/accuracy.md lists what was seen.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from verification.analytic import (
    EACH_WAY,
    OPENGL_TOO,
    Picture,
    Record,
    Way,
    box_of,
    by_reference,
    check_orders,
    gaussian_transmittance,
    scene_along,
)

from clusterviz.reference.rays import camera_rays
from clusterviz.scene.overrides import with_settings
from clusterviz.scene.values import Clip, Scene

EACH_FIELD = pytest.mark.parametrize("interpolation", ["linear", "cubic"])
ALONG_X = (1.0, 0.0, 0.0)
ASLANT = (0.64, 0.48, 0.6)
GREY = ((0.0, 1.0, 1.0, 1.0), (1.0, 1.0, 1.0, 1.0))
DULL = {"shade": True, "ambient": 0.0, "diffuse": 1.0, "specular": 0.0}
"""Brightness is the cosine between the gradient and the ray."""


def rms(difference: Picture) -> float:
    return math.sqrt(np.mean(difference**2))


def coefficients(samples: Picture) -> Picture:
    """What the B-splines of a field through `samples` along x are multiplied with; ends as the renderer takes them."""
    count = samples.shape[2]
    system = (np.diag(np.full(count, 4.0)) + np.eye(count, k=1) + np.eye(count, k=-1)) / 6
    system[0, 0] = system[-1, -1] = 5 / 6
    return np.linalg.solve(system, samples.reshape(-1, count).T).T.reshape(samples.shape)


@pytest.mark.cover("False-2.0-0.12-OpenGL")
@OPENGL_TOO
@pytest.mark.parametrize(("prefiltered", "order", "band"), [(False, 2.0, 0.12), (True, 4.0, 0.35)])
def test_cubic_splines_against_the_voxel(
    way: Way, prefiltered: bool, order: float, band: float, record_property: Record
) -> None:
    """Voxels as coefficients smooth the field by a third of a squared voxel: order 2. Solved for, they give order 4.

    Between two zeros of a Gaussian midpoints add nothing of their own.
    """
    truth = 1 - gaussian_transmittance(0.9, 0.25, -1.5, 1.5, 0.5)
    errors = []
    for cells in (12, 24, 48) if prefiltered else (24, 48, 96, 192):
        source = box_of(
            lambda x, y, z: np.exp(-(x**2) / (2 * 0.25**2)), (2, 2, cells), (-1.5, -1, -1), (1.5, 1, 1)
        )  # fmt: skip
        if prefiltered:
            source = type(source)(coefficients(source.read((0, 0, 0), source.grid.shape_zyx)), source.grid)
        scene = scene_along(ALONG_X, (0, 0, 0), opacity=((0.0, 0.0), (1.0, 0.9)), unit=0.5, step=1 / 8)
        errors.append(abs(way(with_settings(scene, {"interpolation": "cubic"}), source)[0, 0, 3] - truth))
    check_orders(record_property, errors, order, band)


def lit_ball(x: Any, y: Any, z: Any) -> Any:
    """Longer along x, so that its gradient turns when it is smoothed."""
    return np.exp(-(x**2) - 3 * (y**2 + z**2))


def lit_scene(interpolation: str, step: float) -> Scene:
    """One ray along x, 0.3 beside the middle of the ball; opacity is the same everywhere from 0.5 to 1.5.

    The rest is clipped away: at a face of the volume splines repeat voxels, and half of the slope is missing with them.
    """
    scene = scene_along(ALONG_X, (0.75, 0.3, 0.0), opacity=0.5, unit=1.0, step=step, scale=1e-6, cmap=GREY)
    clip = Clip(box=(0.5, 1.5, -1.0, 1.0, -1.0, 1.0), cap=False)
    return with_settings(scene, DULL | {"interpolation": interpolation}).model_copy(update={"clip": clip})


def brightness(kappa: float) -> float:
    """∫ cos(angle to the gradient) κ e^{−κ(t − 0.5)} dt from 0.5 to 1.5 along that ray, by Gauss-Legendre."""
    nodes, weights = np.polynomial.legendre.leggauss(64)
    t = 1 + nodes / 2
    return float(weights / 2 @ (t / np.hypot(t, 3 * 0.3) * kappa * np.exp(-kappa * (t - 0.5))))


@pytest.mark.cover
@EACH_WAY
@EACH_FIELD
def test_light_against_the_voxel(way: Way, interpolation: str, record_property: Record) -> None:
    """Central differences are derivatives to second order, and so are those of splines with voxels as coefficients."""
    errors = []
    for cells in (12, 24, 48, 96):
        source = box_of(lit_ball, (cells // 4, cells // 4, cells), (0.0, 0.05, -0.25), (2.0, 0.55, 0.25))
        errors.append(abs(way(lit_scene(interpolation, 1 / 8), source)[0, 0, 0] - brightness(math.log(2))))
    check_orders(record_property, errors, 2.0, 0.12)


@EACH_WAY
def test_light_beside_what_is_missing_against_the_voxel(way: Way, record_property: Record) -> None:
    """A quarter of a voxel beside cells that are invalid, and from face to face of the volume: as exact as inside."""
    errors = []
    for cells in (8, 16, 32):
        h = 1 / cells
        source = box_of(lit_ball, (3, 4, cells), (0.5, 0.3 - 1.25 * h, -1.5 * h), (1.5, 0.3 + 2.75 * h, 1.5 * h))
        source.read((0, 0, 0), source.grid.shape_zyx)[:, 0] = np.nan
        errors.append(abs(way(lit_scene("linear", 1 / 8), source)[0, 0, 0] - brightness(math.log(2))))
    check_orders(record_property, errors, 2.0, 0.12)


@EACH_WAY
def test_light_against_the_step(way: Way, record_property: Record) -> None:
    """The voxels are 2⁻⁷; their own error is taken off by a picture of a short step."""
    edge = 5 * 2**-7
    source = box_of(lit_ball, (10, 10, 256), (0.0, 0.3 - edge, -edge), (2.0, 0.3 + edge, edge))
    truth = by_reference(lit_scene("linear", 1), source)[0, 0, 0]
    errors = [abs(way(lit_scene("linear", step), source)[0, 0, 0] - truth) for step in (64, 32, 16, 8)]
    check_orders(record_property, errors, 2.0, 0.12)


def bowl(x: Any, y: Any, z: Any) -> Any:
    """Neither central differences nor their interpolation miss anything of its gradient."""
    return (x**2 + y**2 + z**2) / 3


def surface_scene(interpolation: str, step: float) -> Scene:
    """Rays aslant onto the surface of radius 0.75 of the bowl, from its inside."""
    scene = scene_along(ASLANT, (0.45, 0.4, 0.4), opacity=0.5, unit=1.0, step=step, size=(8, 8), scale=0.15, cmap=GREY)
    return with_settings(
        scene, DULL | {"interpolation": interpolation, "blending": "isosurface", "isosurfaces": [(0.1875, 1.0)]}
    )  # fmt: skip


def cosines(scene: Scene) -> Picture:
    """Between each ray and the sphere's radius where they meet: shows where that is."""
    rays = camera_rays(scene.camera, scene.image.size)
    along = (rays.start * rays.direction).sum(axis=1)
    return np.sqrt(along**2 - (rays.start**2).sum(axis=1) + 0.75**2) / 0.75


@pytest.mark.cover("cubic-renderer")
@EACH_WAY
@EACH_FIELD
def test_isosurfaces_against_the_voxel(way: Way, interpolation: str, record_property: Record) -> None:
    errors = []
    for cells in (8, 16, 32):
        source = box_of(bowl, (cells,) * 3, (0.1,) * 3, (0.9,) * 3)
        scene = surface_scene(interpolation, 0.5)
        errors.append(rms(way(scene, source)[..., 0].ravel() - cosines(scene)))
    check_orders(record_property, errors, 2.0, 0.25)


@EACH_WAY
def test_isosurfaces_do_not_depend_on_the_step(way: Way) -> None:
    """They are found by roots of the field, not by the samples."""
    source = box_of(bowl, (16,) * 3, (0.1,) * 3, (0.9,) * 3)
    finest = by_reference(surface_scene("linear", 1 / 16), source)
    assert finest[..., 0].min() > 0.5
    for step in (2.0, 1.0, 0.3):
        assert np.abs(way(surface_scene("linear", step), source) - finest).max() < 5e-6


def smooth_opacity(points: int, unit: float, depth: float) -> tuple[tuple[float, float], ...]:
    """κ(s) = depth · sin²(πs) / unit by so many control points, evenly spread."""
    s = np.linspace(0, 1, points)
    return tuple(zip(s.tolist(), (-np.expm1(-depth * np.sin(np.pi * s) ** 2)).tolist(), strict=True))


@pytest.mark.cover
@EACH_WAY
@pytest.mark.parametrize(("classification", "step"), [("post", 1 / 16), ("pre-integrated", 2.0)])
def test_control_points_against_their_number(
    way: Way, classification: str, step: float, record_property: Record
) -> None:
    """A transfer function drawn through more and more points of a smooth one; the mean of sin² is a half."""
    source = box_of(lambda x, y, z: x / 64, (2, 2, 64), (0, 0, 0), (64, 2, 2))
    truth = -math.expm1(-1.5 * 0.5 * 64 / 40)
    errors = []
    for points in (9, 17, 33, 65):
        scene = scene_along(ALONG_X, (32, 1, 1), opacity=smooth_opacity(points, 40.0, 1.5), unit=40.0, step=step)
        scene = with_settings(scene, {"classification": classification})
        errors.append(abs(way(scene, source)[0, 0, 3] - truth))
    check_orders(record_property, errors, 2.0, 0.12)
