"""How long a slab is in the world, and how many of them a ray may have: slabs are counted in 32 bits."""

from __future__ import annotations

import math

from clusterviz.data.grid import Grid
from clusterviz.errors import InputError
from clusterviz.plan.encoding import FAR

MOST_SLABS = 1 << 30
"""On the longest way through a volume; a jittered ray has one more, and windows of slabs end behind the last one."""


def slab_length(step: float, grid: Grid) -> float:
    """A step of smallest spacings in world units.

    Parameters
    ----------
    step : in smallest spacings
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
    """The length of a slab in opacity unit distances; what float32 does not hold is as opaque as `FAR`."""
    return min(step_world / unit_distance, FAR)
