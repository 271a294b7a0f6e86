"""Volumes and vectors by formula, exact at any resolution and computed where they are needed.

`field:NAME` or `field:NAME:SIZE` is a cube of SIZE samples a side (default 64) over the world box [-1, 1]³. A sample is
computed in float64 from its position alone and stored as float32, so it does not depend on the box that is read. Of
vectors an unsteady flow has steps, `field:NAME:SIZE:STEPS`, at even times over its period.

References
----------
Marschner and Lobb, An evaluation of reconstruction filters for volume rendering, IEEE Visualization 1994, section 4.
Kak and Slaney, Principles of Computerized Tomographic Imaging, IEEE Press 1988, table 3.2: the head phantom of Shepp
and Logan in three dimensions; with the contrasts of Toft, The Radon Transform, thesis, DTU 1996, appendix B.
M. J. M. Hill: On a spherical vortex, Philosophical Transactions of the Royal Society A 185, 1894.
T. Dombre et al.: Chaotic streamlines in the ABC flows, Journal of Fluid Mechanics 167, 1986.
S. C. Shadden, F. Lekien, J. E. Marsden: Definition and properties of Lagrangian coherent structures, Physica D 212,
2005, section 5. (The double gyre.)
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.header import check_box, check_step
from clusterviz.data.source import Grid, Index
from clusterviz.errors import DataError

Values = NDArray[np.float64]
DEFAULT_SIZE, MOST_SIZE = 64, 1 << 20
SHEPP_LOGAN = (
    (1.0, (0.69, 0.92, 0.81), (0.0, 0.0, 0.0), 0.0),
    (-0.8, (0.6624, 0.874, 0.78), (0.0, -0.0184, 0.0), 0.0),
    (-0.2, (0.11, 0.31, 0.22), (0.22, 0.0, 0.0), -18.0),
    (-0.2, (0.16, 0.41, 0.28), (-0.22, 0.0, 0.0), 18.0),
    (0.1, (0.21, 0.25, 0.41), (0.0, 0.35, -0.15), 0.0),
    (0.1, (0.046, 0.046, 0.05), (0.0, 0.1, 0.25), 0.0),
    (0.1, (0.046, 0.046, 0.05), (0.0, -0.1, 0.25), 0.0),
    (0.1, (0.046, 0.023, 0.05), (-0.08, -0.605, 0.0), 0.0),
    (0.1, (0.023, 0.023, 0.02), (0.0, -0.606, 0.0), 0.0),
    (0.1, (0.023, 0.046, 0.02), (0.06, -0.605, 0.0), 0.0),
)
"""Ellipsoids that add up: value, half axes and centre along x, y, z, and rotation about z in degrees."""
BOHR_RADIUS = 1 / 24  # world units: the lobes peak at 6 radii, and have faded at the box


def marschner_lobb(x: Values, y: Values, z: Values) -> Values:
    """Reconstruction test signal of Marschner and Lobb, α = 0.25 and f_M = 6; values in [0, 1]."""
    ripples = np.cos(12 * np.pi * np.cos(np.pi / 2 * np.hypot(x, y)))
    return (1 - np.sin(np.pi / 2 * z) + 0.25 * (1 + ripples)) / 2.5


def gaussian(x: Values, y: Values, z: Values) -> Values:
    """Gaussian exp(−r² / 2σ²) with σ = 0.4."""
    return np.asarray(np.exp(-(x * x + y * y + z * z) / 0.32))


def ramp(x: Values, y: Values, z: Values) -> Values:
    """Ramp from 0 to 1 along x, which trilinear interpolation reproduces exactly."""
    return (x + 1) / 2 + 0 * (y + z)


def constant(x: Values, y: Values, z: Values) -> Values:
    return 0.5 + 0 * (x + y + z)


def hydrogen(x: Values, y: Values, z: Values) -> Values:
    """Probability density of the 3d orbital of hydrogen with m = 0, relative to its maximum."""
    r_squared = (x * x + y * y + z * z) / BOHR_RADIUS**2
    angular = 3 * (z / BOHR_RADIUS) ** 2 - r_squared
    decay = np.exp(-2 / 3 * np.sqrt(r_squared))
    return np.asarray(angular * angular * decay / (4 * 6**4 * np.exp(-4.0)))


def shells(x: Values, y: Values, z: Values) -> Values:
    """Three concentric shells, at r = 0.3, 0.6 and 0.9, of values 1, 2/3 and 1/3."""
    r = np.sqrt(x * x + y * y + z * z)
    peaks = ((0.3, 1.0), (0.6, 2 / 3), (0.9, 1 / 3))
    return np.asarray(sum(height * np.exp(-(((r - radius) / 0.05) ** 2)) for radius, height in peaks))


def shepp_logan(x: Values, y: Values, z: Values) -> Values:
    """Head phantom of Shepp and Logan: ten ellipsoids with sharp borders, values in [0, 1]."""
    found = np.zeros(np.broadcast_shapes(x.shape, y.shape, z.shape))
    for value, (a, b, c), (x0, y0, z0), degrees in SHEPP_LOGAN:
        cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        along, across = cosine * (x - x0) + sine * (y - y0), cosine * (y - y0) - sine * (x - x0)
        found += value * ((along / a) ** 2 + (across / b) ** 2 + ((z - z0) / c) ** 2 <= 1)
    return found


def shepp_logan_integrals(begin: Values, ways: Values) -> Values:
    """Return the integrals of the head phantom along lines, exact but for rounding.

    Parameters
    ----------
    begin : float64 (3,), a point on all lines
    ways : float64 (…, 3), unit vectors along them
    """
    found = np.zeros(ways.shape[:-1])
    for value, axes, centre, degrees in SHEPP_LOGAN:
        cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        to_sphere = np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]]) / np.array(axes)[:, None]
        first, rays = to_sphere @ (begin - centre), ways @ to_sphere.T
        a, b, c = (rays * rays).sum(axis=-1), rays @ first, first @ first - 1
        found += value * 2 * np.sqrt(np.maximum(b * b - a * c, 0)) / a
    return found


_FORMULAS = (marschner_lobb, gaussian, ramp, constant, hydrogen, shells, shepp_logan)
FIELDS: dict[str, Callable[[Values, Values, Values], Values]] = {
    formula.__name__.replace("_", "-"): formula for formula in _FORMULAS
}


@dataclass(frozen=True)
class FieldSource:
    """Formula sampled on a cube; see `Source`."""

    name: str
    grid: Grid
    formula: Callable[[Values, Values, Values], Values]
    dtype: np.dtype[Any] = np.dtype(np.float32)  # noqa: RUF009 - a dtype never changes

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        voxels = np.empty(check_box(begin_zyx, end_zyx, self.grid.shape_zyx), self.dtype)
        z, y, x = (cube_positions(self.grid, axis, begin_zyx[axis], end_zyx[axis]) for axis in range(3))
        for layer, height in zip(voxels, z, strict=True):
            layer[:] = self.formula(*np.broadcast_arrays(x[None, :], y[:, None], height))
        return voxels


def open_field(spec: str) -> FieldSource:
    name, side = parse_field(spec, FIELDS)
    return FieldSource(spec, cube(side), FIELDS[name])


def parse_field(spec: str, known: Iterable[str]) -> tuple[str, int]:
    """Return the name and the size in `field:NAME[:SIZE]`; raises as `open_field`."""
    _, name, *rest = (*spec.split(":"), "")[: max(2, spec.count(":") + 1)]
    if name not in known:
        raise DataError("no such field", where=spec, found=repr(name), allowed=", ".join(known))
    size = rest[0] if rest else str(DEFAULT_SIZE)
    if len(rest) > 1 or not size.isdecimal() or len(size) > 9 or not 1 <= int(size) <= MOST_SIZE:
        allowed = f"one whole number, 1 to {MOST_SIZE}"
        raise DataError("impossible size", where=spec, found=":".join(rest), allowed=allowed)
    return name, int(size)


def cube(side: int) -> Grid:
    spacing = 2 / max(1, side - 1)
    first = -1.0 if side > 1 else 0.0
    return Grid((side,) * 3, (spacing,) * 3, (first,) * 3)


def cube_positions(grid: Grid, axis: int, begin: int, end: int) -> Values:
    """Return the positions of samples [begin, end) along an axis, 0 for z, of a cube over [-1, 1]³."""
    last = grid.shape_zyx[axis] - 1
    return np.arange(2 * begin - last, 2 * end - last, 2, dtype=np.float64) / max(1, last)


Vectors = tuple[Values, Values, Values]
Formula = Callable[[Values, Values, Values, float], Vectors]
DEFAULT_STEPS = 21
HILL_RADIUS = 0.8
ABC = (3.0**0.5, 2.0**0.5, 1.0)
GYRE_PERIOD, GYRE_SPEED, GYRE_SWING = 10.0, 0.1, 0.25


def uniform(x: Values, y: Values, z: Values, time: float) -> Vectors:
    """Unit vectors along x."""
    return 1 + 0 * x, 0 * x, 0 * x


def shear(x: Values, y: Values, z: Values, time: float) -> Vectors:
    """Speed along x that rises with y, and is 0 in the middle."""
    return y, 0 * x, 0 * x


def rotation(x: Values, y: Values, z: Values, time: float) -> Vectors:
    """Solid rotation about z with angular speed 1; lines are circles."""
    return -y, x, 0 * x


def saddle(x: Values, y: Values, z: Values, time: float) -> Vectors:
    """Flow without divergence around a saddle at the origin: in along z, out along x and y."""
    return x, y, -2 * z


def abc(x: Values, y: Values, z: Values, time: float) -> Vectors:
    """Arnold-Beltrami-Childress flow with A = √3, B = √2, C = 1; one period fills the box."""
    a, b, c = ABC
    x, y, z = np.pi * x, np.pi * y, np.pi * z
    return a * np.sin(z) + c * np.cos(y), b * np.sin(x) + a * np.cos(z), c * np.sin(y) + b * np.cos(x)


def hill_vortex(x: Values, y: Values, z: Values, time: float) -> Vectors:
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


def double_gyre(x: Values, y: Values, z: Values, time: float) -> Vectors:
    """Two vortices side by side in x, between which a wall swings with period 10; nothing moves along z."""
    swing = GYRE_SWING * np.sin(2 * np.pi * time / GYRE_PERIOD)
    x, y = x + 1, (y + 1) / 2
    f, slope = swing * x * x + (1 - 2 * swing) * x, 2 * swing * x + 1 - 2 * swing
    speed = np.pi * GYRE_SPEED
    u = -speed * np.sin(np.pi * f) * np.cos(np.pi * y)
    v = speed * np.cos(np.pi * f) * np.sin(np.pi * y) * slope
    return u, 2 * v, 0 * x


VECTOR_FIELDS: dict[str, Formula] = {"constant": uniform, "shear": shear, "rotation": rotation, "saddle": saddle}
VECTOR_FIELDS |= {"abc": abc, "hill-vortex": hill_vortex, "double-gyre": double_gyre}
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
    head, _, steps = spec.rpartition(":") if spec.count(":") > 2 else (spec, "", "")
    name, side = parse_field(head, VECTOR_FIELDS)
    period = PERIODS.get(name)
    if steps and (period is None or not steps.isdecimal() or int(steps) < 2):
        allowed = "2 or more" if period else "none: the flow is steady"
        raise DataError("impossible number of time steps", where=spec, found=steps, allowed=allowed)
    times = tuple(np.linspace(0, period, int(steps or DEFAULT_STEPS)).tolist()) if period else ()
    return VectorField(spec, cube(side), VECTOR_FIELDS[name], times, 0, scale)
