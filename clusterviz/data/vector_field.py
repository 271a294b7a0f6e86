"""Vectors by formula, exact at any resolution: flows whose lines are known, for tests and examples.

`field:NAME` or `field:NAME:SIZE` is a cube of SIZE samples a side (default 64) over the world box [-1, 1]³, as of
`clusterviz.data.field`. An unsteady flow has steps, `field:NAME:SIZE:STEPS`, at even times over its period.

References
----------
M. J. M. Hill: On a spherical vortex, Philosophical Transactions of the Royal Society A 185, 1894.
T. Dombre et al.: Chaotic streamlines in the ABC flows, Journal of Fluid Mechanics 167, 1986.
S. C. Shadden, F. Lekien, J. E. Marsden: Definition and properties of Lagrangian coherent structures, Physica D 212,
2005, section 5. (The double gyre.)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.field import Values, cube, cube_positions, parse_field
from clusterviz.data.header import check_box, check_step
from clusterviz.data.source import Grid, Index
from clusterviz.errors import DataError

Formula = Callable[[Values, Values, Values, float], tuple[Values, Values, Values]]
DEFAULT_STEPS = 21
HILL_RADIUS = 0.8
ABC = (3.0**0.5, 2.0**0.5, 1.0)
GYRE_PERIOD, GYRE_SPEED, GYRE_SWING = 10.0, 0.1, 0.25


def constant(x: Values, y: Values, z: Values, time: float) -> tuple[Values, Values, Values]:
    """Unit vectors along x."""
    return 1 + 0 * x, 0 * x, 0 * x


def shear(x: Values, y: Values, z: Values, time: float) -> tuple[Values, Values, Values]:
    """Speed along x that rises with y, and is 0 in the middle."""
    return y, 0 * x, 0 * x


def rotation(x: Values, y: Values, z: Values, time: float) -> tuple[Values, Values, Values]:
    """Solid rotation about z with angular speed 1; lines are circles."""
    return -y, x, 0 * x


def saddle(x: Values, y: Values, z: Values, time: float) -> tuple[Values, Values, Values]:
    """Flow without divergence around a saddle at the origin: in along z, out along x and y."""
    return x, y, -2 * z


def abc(x: Values, y: Values, z: Values, time: float) -> tuple[Values, Values, Values]:
    """Arnold-Beltrami-Childress flow with A = √3, B = √2, C = 1; one period fills the box."""
    a, b, c = ABC
    x, y, z = np.pi * x, np.pi * y, np.pi * z
    return a * np.sin(z) + c * np.cos(y), b * np.sin(x) + a * np.cos(z), c * np.sin(y) + b * np.cos(x)


def hill_vortex(x: Values, y: Values, z: Values, time: float) -> tuple[Values, Values, Values]:
    """Hill's spherical vortex of radius 0.8 in a stream of speed 1 along −z.

    Lines inside are closed, and keep ψ = (x² + y²)(0.64 − x² − y² − z²).
    """
    axial, r = x * x + y * y, np.sqrt(x * x + y * y + z * z)
    inside, beyond = 1.0 * (r < HILL_RADIUS), np.maximum(r, HILL_RADIUS)
    outside = 1.5 * HILL_RADIUS**3 / beyond**5
    along = inside * (1.5 / HILL_RADIUS**2 * (HILL_RADIUS**2 - 2 * axial - z * z))
    along = along + (1 - inside) * (HILL_RADIUS**3 / beyond**3 - 1 - outside * axial)
    radial = z * (inside * (1.5 / HILL_RADIUS**2) + (1 - inside) * outside)
    return radial * x, radial * y, along


def double_gyre(x: Values, y: Values, z: Values, time: float) -> tuple[Values, Values, Values]:
    """Two vortices side by side in x, between which a wall swings with period 10; nothing moves along z."""
    swing = GYRE_SWING * np.sin(2 * np.pi * time / GYRE_PERIOD)
    x, y = x + 1, (y + 1) / 2
    f, slope = swing * x * x + (1 - 2 * swing) * x, 2 * swing * x + 1 - 2 * swing
    speed = np.pi * GYRE_SPEED
    u = -speed * np.sin(np.pi * f) * np.cos(np.pi * y)
    v = speed * np.cos(np.pi * f) * np.sin(np.pi * y) * slope
    return u, 2 * v, 0 * x


VECTOR_FIELDS: dict[str, Formula] = {
    "constant": constant,
    "shear": shear,
    "rotation": rotation,
    "saddle": saddle,
    "abc": abc,
    "hill-vortex": hill_vortex,
    "double-gyre": double_gyre,
}
PERIODS = {"double-gyre": GYRE_PERIOD}
"""Of unsteady flows."""


@dataclass(frozen=True)
class VectorField:
    """Formula sampled on a cube; see `VectorSource`."""

    name: str
    grid: Grid
    formula: Formula
    times: tuple[float, ...] = ()
    step: int = 0
    scale: float = 1.0

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[np.float32]:
        """Compute the vectors of a box, a layer at a time; see `VectorSource.read`."""
        found = np.empty((*check_box(begin_zyx, end_zyx, self.grid.shape_zyx), 3), np.float32)
        z, y, x = (cube_positions(self.grid, axis, begin_zyx[axis], end_zyx[axis]) for axis in range(3))
        time = self.times[self.step] if self.times else 0.0
        for layer, height in zip(found, z, strict=True):
            places = [np.broadcast_to(each, layer.shape[:2]) for each in (x[None], y[:, None], height)]
            for component, values in enumerate(self.formula(places[0], places[1], places[2], time)):
                layer[..., component] = self.scale * values
        return found

    def at_time(self, step: int) -> VectorField:
        return replace(self, step=check_step(step, self.times, self.name))

    def velocity(self, points: NDArray[np.float64], time: float = 0.0) -> NDArray[np.float64]:
        """Return the exact vectors, float64 (n, 3), at points (n, 3) in the world."""
        return self.scale * np.stack(self.formula(points[:, 0], points[:, 1], points[:, 2], time), axis=1)


def open_vector_field(spec: str, scale: float = 1.0) -> VectorField:
    """Open the vectors that `field:NAME[:SIZE[:STEPS]]` names."""
    head, _, steps = spec.rpartition(":") if spec.count(":") > 2 else (spec, "", "")
    name, side = parse_field(head, VECTOR_FIELDS)
    period = PERIODS.get(name)
    if steps and (period is None or not steps.isdecimal() or int(steps) < 2):
        allowed = "2 or more" if period else "none: the flow is steady"
        raise DataError("impossible number of time steps", where=spec, found=steps, allowed=allowed)
    times = tuple(np.linspace(0, period, int(steps or DEFAULT_STEPS)).tolist()) if period else ()
    return VectorField(spec, cube(side), VECTOR_FIELDS[name], times, 0, scale)
