"""Reference of rays that bend, in float64 and in world space: |v| − n(x) by the leapfrog method, and Snell's law.

The ray of each pixel and wavelength is followed by itself. It is in the world, with the gradient there, where the
renderer has momenta in index space and steps in bricks. `plan/refraction.py` has the equations.

Reference: E. Hairer, C. Lubich, G. Wanner: Geometric numerical integration, 2006, section I.1 (leapfrog).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.content.volume.optics import optical_function
from clusterviz.data.source import Grid
from clusterviz.image.spectral.two_flux import Fluxes
from clusterviz.reference.lighting import SAMPLERS, gradient_at
from clusterviz.reference.rays import Floats, Rays, inside
from clusterviz.reference.two_flux import TwoFlux
from clusterviz.scene.values import Volume

MOST_DIAGONALS, MOST_REFLECTIONS, HALVINGS = 16, 256, 20
"""As in plan/refraction.py and refraction.glsl."""


def snell(momentum: Floats, normal: Floats, change: float) -> tuple[Floats, bool]:
    """Return the momentum (3,) behind a face, and whether it is refracted rather than reflected.

    `momentum`: (3,), its length the refractive index; `normal`: (3,), of any length but 0; `change`: n² behind the face
    less n² before it.
    """
    unit = normal / np.linalg.norm(normal)
    across = float(momentum @ unit)
    left = across**2 + change
    if left < 0:
        return momentum - 2 * across * unit, False
    return momentum + (np.copysign(np.sqrt(left), across) - across) * unit, True


@dataclass
class Medium:
    """Volume at one wavelength: scalars, gradients and refractive index at points in the world.

    `number`: of the wavelength.
    """

    volume: Volume
    voxels: NDArray[Any]
    grid: Grid
    number: int

    def __post_init__(self) -> None:
        assert self.volume.optics, "the volume is spectral"
        index = optical_function(self.volume.optics).index
        assert index, "rays bend"
        self.index, self.outside = index, index.outside
        self.matrix = self.grid.world_from_index[:3, :3]
        self.inverse, self.last = np.linalg.inv(self.matrix), np.array(self.voxels.shape[::-1]) - 1.0
        steps = np.unique(index.values[1:][np.diff(index.values) == 0])
        is_step = [np.ptp(index.indices[index.values == value, self.number]) > 1e-9 for value in steps]
        self.steps = steps[np.array(is_step, bool)]

    def scalar(self, x: Floats) -> float:
        """Return the scalar at a point (3,) in index space; NaN where it is invalid."""
        value, valid = SAMPLERS[self.volume.interpolation](self.voxels, *x[:, None])
        return float(value[0]) if valid[0] else np.nan

    def gradient(self, x: Floats) -> Floats:
        """Return the gradient of the scalar in the world, (3,), at a point in index space."""
        found: Floats = self.inverse.T @ gradient_at(self.volume, self.voxels, x[None])[0]
        return found

    def n(self, scalar: float) -> float:
        return float(self.index.at(scalar)[self.number])

    def slope(self, scalar: float) -> float:
        """Return the derivative of the index by the scalar, that of the later part at a control point."""
        values, column = self.index.values, self.index.indices[:, self.number]
        at = int(np.searchsorted(values, scalar, side="right"))
        if np.isnan(scalar) or at in (0, len(values)):
            return 0.0
        return float((column[at] - column[at - 1]) / (values[at] - values[at - 1]))

    def side(self, scalar: float) -> int | None:
        """Return how many steps of the index are at or below a scalar."""
        return None if np.isnan(scalar) else int(np.count_nonzero(self.steps <= scalar))


Take = Callable[[float, float], None]
"""Adds a slab, by its scalar and its length in world units."""


def follow(medium: Medium, start: Floats, direction: Floats, step: float, take: Take) -> tuple[Floats, Floats, bool]:
    """Follow a ray from where it enters the volume.

    Returns `x` and `v`, where it leaves, in index space, and its momentum, in the world, the length of which is the
    index outside; `leaves`, False if it was ended.

    `start`, `direction`: (3,) in index space; the direction is a world unit long. `step`: length of a slab, world
    units.
    """
    x: NDArray[Any] = start.copy()
    side: int | None = None
    v = medium.outside * (medium.matrix @ direction)
    entry = _entry_axis(x, direction, medium.last)
    n = medium.n(medium.scalar(np.clip(x, 0, medium.last)))
    if entry is None:
        v *= n / medium.outside
    else:
        v, goes_in = snell(v, medium.inverse[entry], n**2 - medium.outside**2)
        if not goes_in:
            return x, v, True
    diagonal = float(np.linalg.norm(medium.matrix @ medium.last))
    slabs, reflections = 0, 0
    while slabs < MOST_DIAGONALS * np.ceil(diagonal / step) + 1 and reflections < MOST_REFLECTIONS:
        slabs += 1
        along = medium.inverse @ (v / np.linalg.norm(v))
        leave, _ = _to_face(x, along, medium.last)
        is_last, length = leave <= step, min(leave, step)
        cut, side, ends = _cut(medium, x, length * along, side) if len(medium.steps) else (None, None, (0.0, 0.0))
        if cut is not None:
            is_last, length = False, cut * length
        middle = x + 0.5 * length * along
        s = medium.scalar(np.clip(middle, 0, medium.last))
        if not np.isnan(s) and medium.slope(s) != 0:
            v = v + length * medium.slope(s) * medium.gradient(np.clip(middle, 0, medium.last))
        along = medium.inverse @ (v / np.linalg.norm(v))
        leave, axis = _to_face(middle, along, medium.last)
        half = 0.5 * length
        meets_face = cut is None and leave <= (step if is_last else half)
        half = leave if meets_face else half
        x = middle + half * along
        take(s, 0.5 * length + half)
        goes_on = True
        if cut is not None:
            change = medium.n(ends[1]) ** 2 - medium.n(ends[0]) ** 2
            v, goes_on = snell(v, medium.gradient(np.clip(x, 0, medium.last)), change)
            side = medium.side(ends[1]) if goes_on else side
        elif meets_face:
            x[axis] = medium.last[axis] if along[axis] > 0 else 0.0
            change = medium.outside**2 - float(v @ v)
            v, goes_on = snell(v, medium.inverse[axis], 0.0 if abs(change) < 1e-12 * medium.outside**2 else change)
            if goes_on:
                return x, v, True
        reflections += not goes_on
    return x, v, False


def _entry_axis(x: Floats, direction: Floats, last: Floats) -> int | None:
    """Return the axis of the face on which a ray begins; None if it begins in the volume."""
    away = np.abs(np.where(direction > 0, x, last - x)) / last
    away = np.where(direction == 0, np.inf, away)
    return int(away.argmin()) if away.min() < 1e-9 else None


def _to_face(x: NDArray[Any], along: NDArray[Any], last: Floats) -> tuple[float, int]:
    """Return the length to the volume's faces on a straight line, and the axis of the one that is met."""
    with np.errstate(divide="ignore", invalid="ignore"):
        lengths = np.where(along == 0, np.inf, np.maximum((np.where(along > 0, last, 0.0) - x) / along, 0.0))
    return float(lengths.min()), int(lengths.argmin())


def _cut(
    medium: Medium, x: Floats, slab: NDArray[Any], side: int | None
) -> tuple[float | None, int | None, tuple[float, float]]:
    """Return the share of a slab before a step of the index, the side of its begin, and the scalars at the step."""

    def at(share: float) -> float:
        return medium.scalar(np.clip(x + share * slab, 0, medium.last))

    side = medium.side(at(0.0)) if side is None else side
    low, high, scalars = 0.0, 1.0, (at(0.0), at(1.0))
    there = medium.side(scalars[1])
    if side is None or there is None or there == side:
        return None, there, scalars
    for _ in range(HALVINGS):
        s = at(0.5 * (low + high))
        if medium.side(s) == side:
            low, scalars = 0.5 * (low + high), (s, scalars[1])
        elif not np.isnan(s):
            high, scalars = 0.5 * (low + high), (scalars[0], s)
    return high, side, scalars


class Bent(TwoFlux):
    """Fluxes of rays that bend, at all wavelengths of a volume's optics; for parameters see `TwoFlux`."""

    def march(self, rays: Rays, voxels: NDArray[Any], length: float, volume: Volume, grid: Grid) -> None:
        """Follow all rays at each wavelength, by slabs of a length in world units."""
        entry, leave = inside(rays, np.array(voxels.shape[::-1]) - 1.0)
        for number in range(len(self.function.wavelengths)):
            medium = Medium(volume, voxels, grid, number)
            for ray in np.flatnonzero(leave > entry):
                start = rays.start[ray] + entry[ray] * rays.direction[ray]
                own = self.of_ray(number)

                def take(scalar: float, depth: float, own: TwoFlux = own) -> None:
                    s = np.array([scalar])
                    own.take(np.array([0]), s, ~np.isnan(s), np.array([depth]))

                _, _, leaves = follow(medium, start, rays.direction[ray], length, take)
                found = Fluxes(*(one[0, 0] for one in own.fluxes))
                for whole, part in zip(self.fluxes, found, strict=True):
                    whole[ray, number] = part
                if not leaves:
                    self.fluxes.transmitted[ray, number] = 0.0
