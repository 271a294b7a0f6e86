"""Length of a slab, and the most slabs of a ray, which are counted in 32 bits."""

from __future__ import annotations

import math

from clusterviz.data.grid import Grid
from clusterviz.errors import InputError
from clusterviz.plan.encoding import FAR

MOST_SLABS = 1 << 30
"""On the diagonal of a volume; a jittered ray has one more, and the last batch of slabs may end behind them."""


def slab_length(step: float, grid: Grid) -> float:
    """Return the length of a slab in world units.

    Parameters
    ----------
    step : length of a slab in units of the smallest spacing
    grid : of the volume, or of the box around several

    Raises
    ------
    InputError
        A ray would have more than `MOST_SLABS` slabs.
    """
    diagonal, spacing = math.dist(*grid.corners[[0, 7]].tolist()), min(grid.spacing)
    if diagonal > MOST_SLABS * (step * spacing):
        raise InputError(
            "too short for this volume: a ray would have more than 2³⁰ slabs",
            where="quality.step",
            found=step,
            allowed=f"at least {diagonal / MOST_SLABS / spacing:.2g}",
        )
    return step * spacing


def slab_units(step_world: float, unit_distance: float) -> float:
    """Return the length of a slab in opacity unit distances, at most `FAR`, so that float32 holds it."""
    return min(step_world / unit_distance, FAR)
