"""Gradient opacity and two-dimensional transfer functions, as the shader reads them.

Either extinction is multiplied by a piecewise-linear function of the magnitude (gradient opacity), or colour and
opacity come from a table over scalars and magnitudes. In the shader scalars are in units of clim, and magnitudes in
units of clim over the smallest spacing, so that no unit of length or of data leaves float32.

References
----------
M. Levoy: Display of surfaces from volume data, IEEE CG&A 8(3), 1988. G. Kindlmann, J. Durkin: Semi-automatic generation
of transfer functions for direct volume rendering, IEEE VolVis 1998.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.grid import Grid
from clusterviz.plan.encoding import in_units_of_clim
from clusterviz.scene.transfer_2d import load_table
from clusterviz.scene.values import Volume

FAR = float(np.finfo(np.float32).max)
Table = Literal["", "opacity", "colour and opacity"]
Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Grading:
    """Dependence of opacity on the gradient's magnitude.

    Attributes
    ----------
    magnitude_from_gradient : float64 (3, 3); maps a gradient in units of clim per voxel to a vector whose length is
        the magnitude
    pieces : float64 (n, 4): start, 1 / length, rise and end of each piece of gradient opacity
    first : gradient opacity up to the first piece; with a table (scalar, columns, magnitude, rows): scalar and
        magnitude of its first entry, and columns and rows per unit
    table : float32 (rows, columns, 4), straight colour and opacity; None for gradient opacity
    table_holds : the part of the table that is read
    """

    magnitude_from_gradient: Floats
    pieces: Floats
    first: tuple[float, ...]
    table: NDArray[np.float32] | None = None
    table_holds: Table = ""

    @property
    def fading(self) -> int:
        """Number of pieces."""
        return len(self.pieces)

    def block(self) -> NDArray[np.float32]:
        """Return the block of magnitude.glsl, (4 + fading, 4): the matrix's columns, `first`, the pieces."""
        rows = np.zeros((4 + self.fading, 4))
        rows[:3, :3] = self.magnitude_from_gradient.T
        rows[3, : len(self.first)] = self.first
        rows[4:] = self.pieces
        return np.clip(rows, -FAR, FAR).astype(np.float32)


def make_grading(volume: Volume, clim: tuple[float, float], grid: Grid) -> Grading:
    """Return the grading of a completed volume that has one."""
    length = min(grid.spacing)
    matrix = np.linalg.inv(grid.world_from_index[:3, :3] / length).T.astype(np.float64)

    def units(magnitudes: Floats) -> Floats:
        # In halves, as the range of clim may overflow.
        with np.errstate(over="ignore"):
            found = magnitudes * (length / 2 / (clim[1] / 2 - clim[0] / 2))
        return np.minimum(found, FAR)

    if volume.transfer_2d is None:
        magnitudes, factors = np.array(volume.gradient_opacity, np.float64).T
        return Grading(matrix, _pieces(units(magnitudes), factors), (float(factors[0]),))
    table = load_table(volume.transfer_2d)
    opacities, colours = table.opacities, table.colours
    rgba = np.zeros((*opacities.shape, 4), np.float32)
    rgba[..., 3] = opacities
    if colours is not None:
        rgba[..., :3] = colours
    along = _axis(in_units_of_clim(table.values, *clim), opacities.shape[1])
    across = _axis(units(np.array(table.magnitudes)), opacities.shape[0])
    holds: Table = "opacity" if colours is None else "colour and opacity"
    return Grading(matrix, np.zeros((0, 4)), along + across, rgba, holds)


def _pieces(places: Floats, factors: Floats) -> Floats:
    """Return the pieces between points, (n, 4); a single point is a constant piece."""
    places, factors = np.append(places, places[-1]), np.append(factors, factors[-1])
    lengths = np.diff(places)
    per_unit = np.where(lengths > 0, 1 / np.maximum(lengths, 1 / FAR), 0)
    pieces = np.stack([places[:-1], per_unit, np.diff(factors), places[1:]], axis=1)
    return pieces[: max(1, len(pieces) - 1)]


def _axis(ends: Floats, count: int) -> tuple[float, float]:
    """Return the position of the first entry, and entries per unit."""
    width = float(ends[1] - ends[0])
    return float(ends[0]), (count - 1) / width if width > 0 else 0.0
