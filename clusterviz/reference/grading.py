"""Reference of what depends on the gradient: gradient opacity, 2-D transfer functions, and users' looks."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from clusterviz.content.flow.expansion import LicVolume
from clusterviz.data.source import Grid
from clusterviz.errors import InputError
from clusterviz.reference.rays import Floats
from clusterviz.reference.sample import interpolated
from clusterviz.reference.transfer import OPAQUE, TransferFunction, interpolate
from clusterviz.scene.transfer_2d import TransferTable, load_table
from clusterviz.scene.values import Volume

Look = Callable[[Floats, Floats, Floats], Floats]
LOOKS: dict[str, Look] = {}
"""What shader files mean, by their paths: float64 functions of values (n,), gradients (n, 3) and positions (n, 3) with
straight colours and opacities (n, 4). The reference does not read GLSL."""


def needs_gradient(volume: Volume) -> bool:
    """Return whether a composited volume depends on its gradient."""
    return volume.shade or bool(volume.gradient_opacity or volume.transfer_2d or volume.shader)


def glow_and_extinction(
    volume: Volume, classify: TransferFunction, scalar: Floats, gradient: Floats | None, grid: Grid, point: Floats
) -> tuple[Floats, Floats]:
    """Return straight colour (n, 3) and extinction (n,) of samples.

    `scalar`: float64 (n,). `gradient`: float64 (n, 3), per voxel along (x, y, z), of a LIC volume the vectors; None if
    nothing depends on it. `point`: float64 (n, 3), in index space. Raises InputError: the volume has a shader that is
    not in `LOOKS`.
    """
    if gradient is None or not (volume.gradient_opacity or volume.transfer_2d or volume.shader):
        return classify.colour(scalar), classify.extinction(scalar)
    magnitude = np.linalg.norm(gradient, axis=1) if isinstance(volume, LicVolume) else magnitude_of(gradient, grid)
    if volume.shader is not None:
        if volume.shader not in LOOKS:
            raise InputError("the float64 reference does not read shaders", where=volume.shader)
        matrix = grid.world_from_index
        slope = gradient @ np.linalg.inv(matrix[:3, :3])
        found = np.clip(LOOKS[volume.shader](scalar, slope, point @ matrix[:3, :3].T + matrix[:3, 3]), 0, 1)
        opacity = np.minimum(found[:, 3] * classify.opacity(scalar), OPAQUE)
        factor = fading(volume, magnitude) if volume.gradient_opacity else 1.0
        return found[:, :3], -np.log1p(-opacity) / classify.unit_distance * factor
    if volume.transfer_2d is None:
        return classify.colour(scalar), classify.extinction(scalar) * fading(volume, magnitude)
    table = load_table(volume.transfer_2d)
    opacity = _between_entries(table, table.opacities[..., None], scalar, magnitude)[:, 0]
    colour = classify.colour(scalar)
    if table.colours is not None:
        colour = _between_entries(table, table.colours, scalar, magnitude)
    return colour, -np.log1p(-np.minimum(opacity, OPAQUE)) / classify.unit_distance


def magnitude_of(gradient: Floats, grid: Grid) -> Floats:
    """Return the magnitude of gradients in data values per world unit, (n,)."""
    found: Floats = np.linalg.norm(gradient @ np.linalg.inv(grid.world_from_index[:3, :3]), axis=1)
    return found


def fading(volume: Volume, magnitude: Floats) -> Floats:
    """Return the factor of extinction by gradient opacity."""
    magnitudes, factors = np.array(volume.gradient_opacity, np.float64).T
    return interpolate(magnitude, magnitudes, factors[:, None])[:, 0]


def _between_entries(table: TransferTable, entries: Floats, scalar: Floats, magnitude: Floats) -> Floats:
    """Interpolate entries (m, v, c) bilinearly, constant beyond them: (n, c)."""
    ranges = ((scalar, table.values, entries.shape[1]), (magnitude, table.magnitudes, entries.shape[0]))
    places = [np.clip((found - low) / (high - low), 0, 1) * (count - 1) for found, (low, high), count in ranges]
    return interpolated(entries, np.stack(places, axis=1))
