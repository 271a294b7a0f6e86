"""Fields whose rendering integral is known in closed form, and two ways to draw them.

All rays are parallel, so that one integral is the truth of a whole picture or of one of its pixels. α is the opacity
gathered over a unit of length, κ(s) = −ln(1 − α(s)) / unit; α is linear in the scalar, so κ is not, and neither the
midpoint rule nor interpolation is right by accident.

References
----------
T. Etiene, D. Jönsson, T. Ropinski, C. Scheidegger, J. Comba, L. Nonato, R. Kirby, A. Ynnerman, C. Silva: Verifying
volume rendering using discretization error analysis, IEEE TVCG 20(1), 2014, sections 4 and 5.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

from clusterviz.comm import LoopbackChannel
from clusterviz.content.complete import complete_scene
from clusterviz.content.volume.info import VolumeInfo
from clusterviz.data.field import marschner_lobb
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid
from clusterviz.frame import render_frame
from clusterviz.frame.run import Options
from clusterviz.reference import render_reference
from clusterviz.reference.rays import Rays, camera_rays, inside
from clusterviz.scene.values import Camera, ImageSettings, Quality, Scene, Volume

Picture = np.ndarray[Any, Any]
Way = Callable[[Scene, ArraySource], Picture]
Formula = Callable[..., Any]
Record = Callable[[str, object], None]
"""Notes a measured value beside the test's result."""

BLUE_RAMP = ((0.0, 1.0, 0.0, 0.0), (1.0, 1.0, 0.0, 1.0))  # red all along, blue the scalar itself


def by_renderer(scene: Scene, source: ArraySource) -> Picture:
    """float64 (h, w, 4): the renderer on one rank."""
    image = render_frame(scene, LoopbackChannel(), source).image
    assert image is not None
    return image.astype(np.float64)


def by_opengl(scene: Scene, source: ArraySource) -> Picture:
    """float64 (h, w, 4): OpenGL on one rank, also where the processor's vectors are what one gets."""
    image = render_frame(scene, LoopbackChannel(), source, options=Options(device=0)).image
    assert image is not None
    return image.astype(np.float64)


def by_reference(scene: Scene, source: ArraySource) -> Picture:
    """float64 (h, w, 4): the float64 reference."""
    grid = source.grid
    info = VolumeInfo(grid.shape_zyx, grid.spacing, grid.corners, 0.0, 1.0, 0.0, 1.0)
    return render_reference(complete_scene(scene, info), grid, source.read((0, 0, 0), grid.shape_zyx))


WAYS = [pytest.param(by_reference, id="reference"), pytest.param(by_renderer, id="renderer", marks=pytest.mark.gl)]
EACH_WAY = pytest.mark.parametrize("way", WAYS)
BY_OPENGL = pytest.mark.parametrize("way", [WAYS[0], pytest.param(by_opengl, id="OpenGL", marks=pytest.mark.gl)])
OPENGL_TOO = pytest.mark.parametrize("way", [*WAYS, pytest.param(by_opengl, id="OpenGL", marks=pytest.mark.gl)])


def box_of(
    formula: Formula, cells_zyx: Sequence[int], begin_xyz: Sequence[float], end_xyz: Sequence[float]
) -> ArraySource:
    """A formula of (x, y, z), sampled on a box of the world."""
    axes = [np.linspace(b, e, n + 1) for b, e, n in zip(begin_xyz, end_xyz, tuple(cells_zyx)[::-1], strict=True)]
    x, y, z = np.meshgrid(*axes, indexing="ij")
    voxels = np.broadcast_to(formula(x, y, z), x.shape).transpose(2, 1, 0)
    spacing = tuple(float(axis[1] - axis[0]) for axis in axes)
    grid = Grid(voxels.shape, spacing, tuple(map(float, begin_xyz)))
    return ArraySource(np.ascontiguousarray(voxels, np.float64), grid)


def scene_along(
    direction: Sequence[float],
    centre: Sequence[float],
    *,
    opacity: Any,
    unit: float,
    step: float,
    size: tuple[int, int] = (1, 1),
    scale: float = 1e-3,
    cmap: Any = BLUE_RAMP,
) -> Scene:
    """Parallel rays through a point; `scale` is half the picture's height in world units."""
    back = np.asarray(centre, float) - 1e3 * np.asarray(direction, float)
    up = (0.0, 0.0, 1.0) if abs(direction[2]) < 0.9 else (0.0, 1.0, 0.0)
    camera = Camera(position=tuple(back.tolist()), focal_point=tuple(centre), view_up=up, parallel_scale=scale)
    volume = Volume(path="formula", cmap=cmap, clim=(0.0, 1.0), opacity=opacity, opacity_unit_distance=unit)
    return Scene(volumes=(volume,), camera=camera, image=ImageSettings(size=size), quality=Quality(step=step))


def ramp_transmittance(opacity: float, length: float, unit: float) -> float:
    """e^{−∫κ} through a field that rises from 0 to 1 over `length`, with α(s) = opacity · s."""
    a = opacity
    return math.exp(length / unit * -((1 - a) * math.log1p(-a) + a) / a)


def ramp_blue(opacity: float, length: float, unit: float) -> float:
    """∫ s κ e^{−κ s L} L ds over [0, 1] with constant κ: the colour c(s) = s of the same field at constant opacity."""
    depth = -math.log1p(-opacity) * length / unit
    return (1 - math.exp(-depth) * (1 + depth)) / depth


def gaussian_transmittance(opacity: float, sigma: float, begin: float, end: float, unit: float) -> float:
    """e^{−∫κ} along a line through the middle of s = e^{−t²/2σ²}, with α(s) = opacity · s.

    −ln(1 − a s) is the sum of (a s)^m / m, and the integral of s^m is an error function.
    """
    root = sigma * math.sqrt(2)
    integral = lambda m: (math.erf(math.sqrt(m) * end / root) - math.erf(math.sqrt(m) * begin / root)) / math.sqrt(m)  # noqa: E731
    terms = (opacity**m / m * integral(m) for m in range(1, 200))
    return math.exp(-sigma * math.sqrt(math.pi / 2) * math.fsum(terms) / unit)


def marschner_lobb_opacity(
    scene: Scene, begin_xyz: Sequence[float], end_xyz: Sequence[float], opacity: float, unit: float
) -> Picture:
    """1 − e^{−∫κ} of the formula itself, not of samples, for each pixel in order, with α(s) = opacity · s.

    Gauss-Legendre with 16 points in each of 16 pieces of a ray: exact to rounding for the few waves in them.
    """
    rays, entry, length = _within(scene, begin_xyz, end_xyz)
    nodes, weights = np.polynomial.legendre.leggauss(16)
    share = ((np.arange(16)[:, None] + (nodes + 1) / 2) / 16).ravel()
    t = entry[:, None] + length[:, None] * share
    points = rays.start[:, None] + t[..., None] * rays.direction[:, None]
    kappa = -np.log1p(-opacity * marschner_lobb(*np.moveaxis(points, -1, 0))) / unit
    return -np.expm1(-length * (kappa @ np.tile(weights / 32, 16)))


def lengths(scene: Scene, begin_xyz: Sequence[float], end_xyz: Sequence[float]) -> Picture:
    """How far the ray of each pixel, in order, runs through a box."""
    return _within(scene, begin_xyz, end_xyz)[2]


def _within(scene: Scene, begin_xyz: Sequence[float], end_xyz: Sequence[float]) -> tuple[Rays, Picture, Picture]:
    """The rays, where they enter a box, and how far they run through it."""
    rays = camera_rays(scene.camera, scene.image.size)
    entry, leave = inside(Rays(rays.start - begin_xyz, rays.direction), np.subtract(end_xyz, begin_xyz))
    return rays, entry, np.maximum(leave - entry, 0)


def orders(errors: Sequence[float]) -> list[float]:
    """log₂ of how much each halving of a parameter shrinks the error."""
    return [math.log2(a / b) for a, b in itertools.pairwise(errors)]


def check_orders(record_property: Record, errors: list[float], order: float, band: float) -> None:
    """Every halving but the first, which may still be outside of the range where the leading term rules."""
    found = orders(errors)
    record_property("orders", [round(value, 3) for value in found])
    record_property("errors", [float(error) for error in errors])
    assert found[1:] == pytest.approx([order] * (len(found) - 1), abs=band), errors
