"""Optics of spectral volumes: absorption and scattering of a scalar at wavelengths, directly or by materials."""

from __future__ import annotations

from dataclasses import dataclass
from difflib import get_close_matches
from itertools import pairwise
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from clusterviz.image.spectral.lights import VISIBLE
from clusterviz.scene.background import background_rgb
from clusterviz.scene.checks import InvalidValueError, check_points, to_builtin
from clusterviz.scene.field_types import FINITE, NotNegative, Number, Positive, Section
from clusterviz.scene.materials import MATERIALS, material, material_of_colour
from clusterviz.scene.transfer import TransferFunction, distinct, interpolate
from clusterviz.scene.volume_info import range_around

Floats = NDArray[np.float64]
WAVELENGTH_SETS: dict[str, tuple[float, ...]] = {
    "rgb": (450.0, 550.0, 650.0),
    "visible-8": tuple(np.linspace(400, 680, 8).tolist()),
    "visible-16": tuple(np.linspace(400, 700, 16).tolist()),
    "visible-31": tuple(np.linspace(400, 700, 31).tolist()),
}
"""Wavelengths by name, nm."""
MOST_WAVELENGTHS = 64
ALLOWED_WAVELENGTHS = (
    f"ascending numbers of nm in {VISIBLE[0]:g}..{VISIBLE[1]:g}, or one of {', '.join(WAVELENGTH_SETS)}"
)
ALLOWED_MATERIALS = f"{', '.join(MATERIALS)}, a CSS colour name or #rrggbb"


def check_wavelengths(value: Any) -> Any:
    """Replace the name of a set by its wavelengths."""
    value = to_builtin(value)
    if isinstance(value, str):
        if value not in WAVELENGTH_SETS:
            raise InvalidValueError("unknown wavelengths", ALLOWED_WAVELENGTHS)
        return WAVELENGTH_SETS[value]
    return value


def check_ascending(value: tuple[float, ...]) -> tuple[float, ...]:
    """Validate the order of wavelengths."""
    for before, after in pairwise(value):
        if after <= before:
            raise InvalidValueError(f"wavelengths out of order: {after:g} after {before:g}", ALLOWED_WAVELENGTHS)
    return value


def check_materials(value: Any) -> Any:
    """Add the amount 1 to rows [scalar, material]."""
    value = to_builtin(value)
    if not isinstance(value, (list, tuple)) or not all(isinstance(row, (list, tuple)) for row in value):
        raise InvalidValueError("not a list of materials", "[[scalar, material], …]")
    return [[*row, 1.0] if len(row) == 2 else row for row in value]


def check_material(value: str) -> str:
    """Refuse names that are neither materials nor colours."""
    if value in MATERIALS:
        return value
    try:
        rgb = background_rgb(value)
    except InvalidValueError:
        rgb = None
    if rgb is None:
        near = get_close_matches(value, MATERIALS, 1)
        raise InvalidValueError(f"unknown material{f', did you mean {near[0]}?' if near else ''}", ALLOWED_MATERIALS)
    return value


def check_coefficients(value: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
    """Validate rows [scalar, coefficient, …]: sorted, and no coefficient is negative."""
    for row in check_points(value):
        if min(row[1:]) < 0:
            raise InvalidValueError(f"a negative coefficient, {min(row[1:]):g}", "coefficients of at least 0")
    return value


Wavelength = Annotated[float, FINITE, Field(ge=VISIBLE[0], le=VISIBLE[1]), BeforeValidator(to_builtin)]
MaterialName = Annotated[str, AfterValidator(check_material)]
Coefficients = Annotated[
    tuple[Annotated[tuple[Number, ...], Field(min_length=2), BeforeValidator(to_builtin)], ...],
    BeforeValidator(to_builtin),
    AfterValidator(check_coefficients),
]


class Optics(Section):
    """Optics: how a volume absorbs and scatters light of several wavelengths."""

    model: Literal["kubelka-munk"] = Field(
        default="kubelka-munk", description="Light goes towards the eye and away from it, and is scattered between."
    )
    wavelengths: Annotated[
        tuple[Wavelength, ...],
        Field(min_length=1, max_length=MOST_WAVELENGTHS, examples=[[450, 550, 650]]),
        BeforeValidator(check_wavelengths),
        AfterValidator(check_ascending),
    ] = Field(
        default=WAVELENGTH_SETS["visible-16"],
        description="Wavelengths in nm, each of which is drawn, or the name of a set: rgb, visible-8, visible-16, "
        "visible-31.",
    )
    materials: (
        Annotated[
            tuple[tuple[Number, MaterialName, NotNegative], ...],
            BeforeValidator(check_materials),
            AfterValidator(check_points),
        ]
        | None
    ) = Field(
        default=None,
        examples=[[[40, "fat"], [220, "blood", 0.1]]],
        description="[[scalar, material], …] or [[scalar, material, amount], …]: absorption and scattering are linear "
        "between them; amount multiplies both. A colour, a CSS name or #rrggbb, is a material that has it in thick "
        "layers. " + "; ".join(f"{name}: {about}" for name, about in MATERIALS.items()) + ".",
    )
    millimetres: Positive | None = Field(
        default=None, description="Millimetres of a world unit, with materials; default: 1."
    )
    absorption: Coefficients | None = Field(
        default=None,
        examples=[[[40, 0.1, 0.1, 0.02], [220, 0.4, 0.2, 0.1]]],
        description="[[scalar, K, K, …], …]: absorption coefficient per world unit for each wavelength, linear between "
        "scalars; a repeated scalar is a step; default: 0.",
    )
    scattering: Coefficients | None = Field(
        default=None,
        examples=[[[40, 0.0, 0.0, 0.0], [220, 0.6, 0.6, 0.6]]],
        description="[[scalar, S, S, …], …]: the same of the scattering coefficient.",
    )

    @model_validator(mode="after")
    def _suits_wavelengths(self) -> Optics:
        direct = [key for key in ("absorption", "scattering") if getattr(self, key) is not None]
        if self.materials is None and not direct:
            raise InvalidValueError("missing", "[[scalar, material], …], or absorption and scattering", key="materials")
        if self.materials is not None and direct:
            raise InvalidValueError("not with materials", "null, or no materials", key=direct[0], found="coefficients")
        if self.materials is None and self.millimetres is not None:
            raise InvalidValueError("not without materials", "null", key="millimetres", found=self.millimetres)
        for key in direct:
            for row in getattr(self, key):
                if len(row) != 1 + len(self.wavelengths):
                    allowed = f"a scalar and {len(self.wavelengths)}, one for each wavelength"
                    raise InvalidValueError("as many coefficients as wavelengths", allowed, key=key, found=list(row))
        return self


@dataclass(frozen=True, eq=False)
class OpticalFunction:
    """Piecewise-linear absorption and scattering of a scalar, constant beyond the first and last control point.

    A repeated value is a step; at exactly that scalar the later control point applies. NaN does neither.

    Attributes
    ----------
    wavelengths : float64 (n,), nm
    absorption_values : float64 (a,), ascending
    absorption : float64 (a, n), K per world unit
    scattering_values : float64 (s,), ascending
    scattering : float64 (s, n), S per world unit
    """

    wavelengths: Floats
    absorption_values: Floats
    absorption: Floats
    scattering_values: Floats
    scattering: Floats

    @property
    def domain(self) -> tuple[float, float]:
        """Range of the control points, or one around a single value."""
        values = distinct(self.absorption_values, self.scattering_values)
        return (float(values[0]), float(values[-1])) if len(values) > 1 else range_around(float(values[0]))

    def at(self, number: int) -> TransferFunction:
        """Return the coefficients at one wavelength as a transfer function.

        Its colours are (K, S, 0) per world unit, and its opacity is 0 where nothing is absorbed or scattered at any
        wavelength, else 1. It is linear between the same values for all wavelengths.
        """
        knots = distinct(self.absorption_values, self.scattering_values)
        tables = (self.absorption_values, self.absorption), (self.scattering_values, self.scattering)
        after = np.concatenate([interpolate(knots, *table) for table in tables], axis=1)
        # Mirrored, so that of two equal control points the earlier one counts: the limit from below.
        before = np.concatenate([interpolate(-knots, -values[::-1], rows[::-1]) for values, rows in tables], axis=1)
        both = np.stack([before, after], axis=1).reshape(2 * len(knots), -1)
        colours = np.zeros((len(both), 3))
        colours[:, :2] = both[:, [number, len(self.wavelengths) + number]]
        values = np.repeat(knots, 2)
        return TransferFunction(values, colours, values, both.any(axis=1).astype(float), 1.0, self.domain)

    def coefficients(self, s: ArrayLike) -> tuple[Floats, Floats]:
        """Return K and S, float64 (…, n) each, of scalars (…)."""
        return (
            interpolate(s, self.absorption_values, self.absorption),
            interpolate(s, self.scattering_values, self.scattering),
        )


def optical_function(optics: Optics) -> OpticalFunction:
    """Return the coefficients of a volume's optics."""
    wavelengths = np.array(optics.wavelengths)
    if optics.materials is not None:
        values = np.array([scalar for scalar, _, _ in optics.materials])
        found = [_material(name, wavelengths) for _, name, _ in optics.materials]
        amounts = np.array([[amount * (optics.millimetres or 1.0)] for _, _, amount in optics.materials])
        absorption, scattering = (np.stack(each) * amounts for each in zip(*found, strict=True))
        return OpticalFunction(wavelengths, values, absorption, values, scattering)
    nothing = ((0.0, *[0.0] * len(wavelengths)),)
    tables = [np.array(rows or nothing) for rows in (optics.absorption, optics.scattering)]
    columns = [part for table in tables for part in (table[:, 0], table[:, 1:])]
    return OpticalFunction(wavelengths, *columns)


def _material(name: str, wavelengths: Floats) -> tuple[Floats, Floats]:
    """Return K and S per millimetre, float64 (n,) each, of a material or a colour."""
    rgb = None if name in MATERIALS else background_rgb(name)
    found = material(name).at(wavelengths) if rgb is None else material_of_colour(rgb, wavelengths)
    return found.absorption, found.scattering
