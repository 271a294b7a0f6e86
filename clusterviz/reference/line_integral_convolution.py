"""Reference line integral convolution in float64, all voxels at once.

A line goes from a voxel in steps of equal arc length, or in proportion to the vectors, and ends at the border of the
grid, where a cell has a sample that is NaN, and where vectors are 0. The value is the weighted mean of the noise on it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.source import Grid
from clusterviz.reference.sample import interpolated

Floats = NDArray[np.float64]
SUBSTEPS = 8
"""Steps of Runge-Kutta that stand for one of an adaptive method, which has a small error."""
BORDER = 2.0**-10
"""Samples by which a place may be outside of the grid, so that rounding does not end lines along the border."""


@dataclass(frozen=True)
class Lines:
    """Lines of vectors on a grid."""

    vectors: Floats  # float64 (z, y, x, 3), components along x, y, z of the world
    grid: Grid  # positions of the samples
    integrator: str = "rk4"  # "euler", "rk4" or "rk45"
    # a unit of a line's parameter moves it as far as the vector, in parts of the largest one; else by 1
    by_speed: bool = False

    def velocity(self, places: Floats) -> Floats:
        """Return the move, in samples along x, y, z, for a smallest spacing at places (n, 3); NaN for none."""
        used = np.array(self.grid.shape_zyx[::-1]) > 1
        vectors = np.linalg.solve(np.asarray(self.grid.direction), interpolated(self.vectors, places).T).T * used
        with np.errstate(divide="ignore", invalid="ignore"):
            if self.by_speed:
                vectors = vectors / np.nanmax(np.linalg.norm(self.vectors, axis=-1))
            else:
                vectors = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
        spacing = np.asarray(self.grid.spacing)
        unit = spacing.min(where=used, initial=np.inf) if used.any() else 0.0
        found: Floats = vectors * unit / spacing
        return found

    def stepped(self, places: Floats, step: float) -> Floats:
        """Return places one step further."""
        if self.integrator == "euler":
            return places + step * self.velocity(places)
        parts = SUBSTEPS if self.integrator == "rk45" else 1
        h = step / parts
        for _ in range(parts):
            a = self.velocity(places)
            b = self.velocity(places + h / 2 * a)
            c = self.velocity(places + h / 2 * b)
            d = self.velocity(places + h * c)
            places = places + h / 6 * (a + 2 * b + 2 * c + d)
        return places


def line_integral_convolution(
    lines: Lines, noise: NDArray[Any], weight: Callable[[int], float], steps: int, step: float
) -> Floats:
    """Return the mean of the noise along the line through each sample.

    `noise`: (z, y, x); `weight`: of the sample n steps downstream, −steps to steps; `steps`: of half a line; `step`: in
    units of the smallest spacing. Returns float64 (z, y, x); NaN at samples without vectors.
    """
    shape = lines.grid.shape_zyx
    index = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1).reshape(-1, 3)[:, ::-1].astype(float)
    noise = np.asarray(noise, np.float64)
    sums, weights = weight(0) * noise.reshape(-1), np.full(len(index), weight(0))
    speed = np.linalg.norm(lines.vectors.reshape(-1, 3), axis=1)
    last = np.array(shape[::-1]) - 1
    for sign in (1, -1):
        rows = np.flatnonzero(speed > 0)
        places = index[rows]
        for n in range(1, steps + 1):
            places = lines.stepped(places, sign * step)
            going = ((places >= -BORDER) & (places <= last + BORDER)).all(axis=1)
            rows, places = rows[going], places[going]
            sums[rows] += weight(sign * n) * interpolated(noise, places)
            weights[rows] += weight(sign * n)
            going = np.linalg.norm(interpolated(lines.vectors, places), axis=1) > 0
            rows, places = rows[going], places[going]
    values: Floats = np.where(np.isnan(speed), np.nan, sums / weights).reshape(shape)
    return values
