"""Optics of spectral volumes: absorption, scattering and refraction of a scalar at wavelengths.

They are given directly or by materials.
"""

from __future__ import annotations

from dataclasses import dataclass
from difflib import get_close_matches
from itertools import pairwise
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from clusterviz.content.facts import range_around
from clusterviz.image.spectral.lights import VISIBLE
from clusterviz.scene.background import background_rgb
from clusterviz.scene.checks import InvalidValueError, check_points, to_builtin
from clusterviz.scene.field_types import FINITE, NotNegative, Number, Positive, Section
from clusterviz.scene.materials import MATERIALS, Material, material, material_of_colour
from clusterviz.scene.transfer import TransferFunction, distinct, interpolate

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


def check_indices(value: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
    """Validate rows [scalar, index, …]: sorted, and every index is above 0; below 1 are those of X-rays and plasmas."""
    for row in check_points(value):
        if min(row[1:]) <= 0:
            raise InvalidValueError(f"a refractive index of {min(row[1:]):g}", "refractive indices above 0")
    return value


Wavelength = Annotated[float, FINITE, Field(ge=VISIBLE[0], le=VISIBLE[1]), BeforeValidator(to_builtin)]
MaterialName = Annotated[str, AfterValidator(check_material)]
Rows = tuple[Annotated[tuple[Number, ...], Field(min_length=2), BeforeValidator(to_builtin)], ...]
Coefficients = Annotated[Rows, BeforeValidator(to_builtin), AfterValidator(check_coefficients)]
Indices = Annotated[Rows, BeforeValidator(to_builtin), AfterValidator(check_indices)]
DIRECT_KEYS = ("absorption", "scattering", "refractive_index")


class Optics(Section):
    """Optics: how a volume absorbs, scatters and refracts light of several wavelengths."""

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
    refraction: bool = Field(
        default=False,
        description="Rays bend by the refractive index at each wavelength; every rank then draws a part of the picture "
        "with all bricks.",
    )
    refractive_index: Indices | None = Field(
        default=None,
        examples=[[[40, 1.0], [220, 1.52, 1.52, 1.51]]],
        description="[[scalar, n, n, …], …]: refractive index above 0 for each wavelength, or one for all, linear "
        "between scalars; a repeated scalar is a step, at which rays follow Snell's law. With materials, theirs; "
        "default: outside_index.",
    )
    outside_index: Positive | None = Field(
        default=None, description="Refractive index around the volume, with refraction; default: 1."
    )

    @model_validator(mode="after")
    def _suits_wavelengths(self) -> Optics:
        direct = [key for key in DIRECT_KEYS if getattr(self, key) is not None]
        for key in ("refractive_index", "outside_index"):
            if not self.refraction and (found := getattr(self, key)) is not None:
                found = "indices" if isinstance(found, tuple) else found
                raise InvalidValueError("not without refraction", "null, or refraction: true", key=key, found=found)
        if self.materials is None and not direct:
            raise InvalidValueError("missing", "[[scalar, material], …], or absorption and scattering", key="materials")
        if self.materials is not None and direct:
            raise InvalidValueError("not with materials", "null, or no materials", key=direct[0], found="coefficients")
        if self.materials is None and self.millimetres is not None:
            raise InvalidValueError("not without materials", "null", key="millimetres", found=self.millimetres)
        for key in direct:
            for row in getattr(self, key):
                is_index = key == "refractive_index"
                if len(row) != 1 + len(self.wavelengths) and not (is_index and len(row) == 2):
                    allowed = f"a scalar and {len(self.wavelengths)}, one for each wavelength{', or 1' * is_index}"
                    text = f"as many {'indices' if is_index else 'coefficients'} as wavelengths"
                    raise InvalidValueError(text, allowed, key=key, found=list(row))
        return self


@dataclass(frozen=True, eq=False)
class IndexFunction:
    """Piecewise-linear refractive index at values (m,), (m, n) above 0, and around a volume; see `OpticalFunction`."""

    values: Floats
    indices: Floats
    outside: float

    def at(self, s: ArrayLike) -> Floats:
        """Return indices, float64 (…, n), of scalars (…); that outside for NaN."""
        found = interpolate(s, self.values, self.indices)
        return np.where(np.isnan(np.asarray(s, np.float64))[..., None], self.outside, found)


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
    index : refractive index; None: rays are straight
    """

    wavelengths: Floats
    absorption_values: Floats
    absorption: Floats
    scattering_values: Floats
    scattering: Floats
    index: IndexFunction | None = None

    @property
    def knots(self) -> Floats:
        """Distinct values of all control points, ascending."""
        return distinct(*(values for values, _ in self._tables))

    @property
    def domain(self) -> tuple[float, float]:
        """Range of the control points, or one around a single value."""
        values = self.knots
        return (float(values[0]), float(values[-1])) if len(values) > 1 else range_around(float(values[0]))

    def at(self, number: int) -> TransferFunction:
        """Return the coefficients at one wavelength as a transfer function.

        Its colours are (K, S, n − n outside) per world unit, with 0 for the last without refraction, and its opacity is
        0 where these are 0 at all wavelengths, else 1. It is linear between the same values for all wavelengths.
        """
        knots, count = self.knots, len(self.wavelengths)
        after = np.concatenate([interpolate(knots, *table) for table in self._tables], axis=1)
        # Mirrored, so that of two equal control points the earlier one counts: the limit from below.
        mirrored = [interpolate(-knots, -values[::-1], rows[::-1]) for values, rows in self._tables]
        both = np.stack([np.concatenate(mirrored, axis=1), after], axis=1).reshape(2 * len(knots), -1)
        colours = np.zeros((len(both), 3))
        for part in range(len(self._tables)):
            colours[:, part] = both[:, part * count + number]
        values = np.repeat(knots, 2)
        return TransferFunction(values, colours, values, both.any(axis=1).astype(float), 1.0, self.domain)

    def coefficients(self, s: ArrayLike) -> tuple[Floats, Floats]:
        """Return K and S, float64 (…, n) each, of scalars (…)."""
        return (
            interpolate(s, self.absorption_values, self.absorption),
            interpolate(s, self.scattering_values, self.scattering),
        )

    @property
    def _tables(self) -> list[tuple[Floats, Floats]]:
        """Values and rows of K, S, and what the refractive index is above that outside."""
        tables = [(self.absorption_values, self.absorption), (self.scattering_values, self.scattering)]
        return [*tables, (self.index.values, self.index.indices - self.index.outside)] if self.index else tables


def optical_function(optics: Optics) -> OpticalFunction:
    """Return the coefficients of a volume's optics."""
    wavelengths, outside = np.array(optics.wavelengths), optics.outside_index or 1.0
    if optics.materials is not None:
        values = np.array([scalar for scalar, _, _ in optics.materials])
        found = [_material(name, wavelengths) for _, name, _ in optics.materials]
        amounts = np.array([[amount * (optics.millimetres or 1.0)] for _, _, amount in optics.materials])
        absorption, scattering = (
            amounts * np.stack(each) for each in zip(*((one.absorption, one.scattering) for one in found), strict=True)
        )
        indices = np.stack([one.refractive_index for one in found])
        index = IndexFunction(values, indices, outside) if optics.refraction else None
        return OpticalFunction(wavelengths, values, absorption, values, scattering, index)
    nothing = ((0.0, *[0.0] * len(wavelengths)),)
    tables = [np.array(rows or nothing) for rows in (optics.absorption, optics.scattering)]
    (k_values, absorption), (s_values, scattering) = ((table[:, 0], table[:, 1:]) for table in tables)
    index = _index(optics, outside) if optics.refraction else None
    return OpticalFunction(wavelengths, k_values, absorption, s_values, scattering, index)


def _index(optics: Optics, outside: float) -> IndexFunction:
    given = optics.refractive_index or ((0.0, outside),)
    rows = [np.broadcast_to(row[1:], len(optics.wavelengths)) for row in given]
    return IndexFunction(np.array([row[0] for row in given]), np.array(rows), outside)


def _material(name: str, wavelengths: Floats) -> Material:
    rgb = None if name in MATERIALS else background_rgb(name)
    return material(name).at(wavelengths) if rgb is None else material_of_colour(rgb, wavelengths)
