"""Light sources by their spectra: CIE illuminants, lines of lasers, and tables of the user.

A light is a sum of lines, each with a wavelength and a power: the nodes of a quadrature. A tabulated spectrum is linear
between its wavelengths and has a line at each nanometre. Only relative powers matter.

References
----------
CIE 15:2004, Colorimetry, 3rd edition: tables T.1 (A, D65) and T.6 (F11), with linear interpolation.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clusterviz.errors import InputError
from clusterviz.input_files import require_regular_file

Floats = NDArray[np.float64]
VISIBLE = (380.0, 780.0)
"""First and last wavelength, nm, of the tables of the observer and of the illuminants."""
TABLES = Path(__file__).parent / "tables"
NAMES = ("D65", "A", "F11", "E")
ALLOWED = f"{', '.join(NAMES)}, laser:NM, laser:NM:WIDTH, or a file with rows of wavelength, power"
MOST_NODES = 100_000
LINE_NODES, LINE_REACH = 81, 3.0
"""Nodes of a line with a width, and the standard deviations that they reach from its middle."""


@dataclass(frozen=True, eq=False)
class Light:
    """Spectrum of a light source.

    Attributes
    ----------
    wavelengths : float64 (m,), nm, ascending, within `VISIBLE`
    powers : float64 (m,), of the lines, not negative, with a sum of more than 0
    """

    name: str
    wavelengths: Floats
    powers: Floats

    def __post_init__(self) -> None:
        for array in (self.wavelengths, self.powers):
            array.setflags(write=False)


def light_of(text: str) -> Light:
    """Return the light with a name.

    Parameters
    ----------
    text : D65, A, F11, E (equal energy), laser:NM, laser:NM:WIDTH, or the path of a file, as of `read_light`

    Raises
    ------
    InputError
        The name is unknown, or the file is not a spectrum.
    """
    name = text.strip()
    known = {each.lower(): each for each in NAMES} | {"equal-energy": "E"}
    if name.lower() in known:
        return illuminant(known[name.lower()])
    if name.lower().startswith("laser:"):
        try:
            numbers = [float(part) for part in name.split(":")[1:]]
        except ValueError:
            numbers = []
        if len(numbers) not in (1, 2):
            raise InputError("not a laser", where="light", found=text, allowed="laser:NM or laser:NM:WIDTH, in nm")
        return laser(*numbers)
    if Path(name).suffix.lower() in (".csv", ".txt") or os.path.exists(name):
        return read_light(name)
    raise InputError("unknown light", where="light", found=text, allowed=ALLOWED)


@cache
def illuminant(name: str) -> Light:
    """Return a CIE illuminant: D65 (daylight), A (incandescent lamp), F11 (fluorescent lamp), or E, equal energy."""
    if name == "E":
        return spectrum(VISIBLE, (1.0, 1.0), name)
    table = read_table("illuminants.csv")
    return spectrum(table[:, 0], table[:, 1 + ("A", "D65", "F11").index(name)], name)


def laser(wavelength: float, width: float = 0.0) -> Light:
    """Return a spectral line: a normal distribution.

    Parameters
    ----------
    wavelength : nm, of its middle
    width : nm, at half of its height; 0: a single wavelength

    Raises
    ------
    InputError
        The wavelength is not within `VISIBLE`, or the width is negative or above 200 nm.
    """
    low, high = VISIBLE
    if not low <= wavelength <= high:
        raise InputError("not visible", where="laser", found=f"{wavelength:g} nm", allowed=f"{low:g} to {high:g} nm")
    if not 0 <= width <= 200:
        raise InputError("not a width of a line", where="laser", found=f"{width:g} nm", allowed="0 to 200 nm")
    name = f"laser {wavelength:g} nm" + (f", {width:g} nm wide" if width else "")
    if not width:
        return Light(name, np.array([wavelength]), np.array([1.0]))
    steps = np.linspace(-LINE_REACH, LINE_REACH, LINE_NODES)
    at = wavelength + steps * (width / math.sqrt(8 * math.log(2)))
    seen = (at >= low) & (at <= high)
    return Light(name, at[seen], np.exp(-(steps[seen] ** 2) / 2))


def read_light(path: str | os.PathLike[str]) -> Light:
    """Read a spectrum from a text file: rows of a wavelength in nm and a power, with a comma or blanks between.

    Raises
    ------
    InputError
        The file is missing, or not a table of two columns, or not a spectrum, as of `spectrum`.
    """
    require_regular_file(path)
    try:
        lines = Path(path).read_text().splitlines()
        table = np.array([line.replace(",", " ").split() for line in lines if line.strip("# \t") and line[0] != "#"])
        columns = table.astype(np.float64)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else "rows of different lengths, or no numbers"
        raise InputError("cannot be read as a spectrum", where=str(path), found=reason) from None
    if columns.ndim != 2 or columns.shape[1] != 2:
        raise InputError("not a spectrum", where=str(path), found=f"shape {columns.shape}", allowed="two columns")
    return spectrum(columns[:, 0], columns[:, 1], Path(path).name)


def spectrum(wavelengths: ArrayLike, powers: ArrayLike, name: str = "spectrum") -> Light:
    """Return a light with a tabulated spectrum, linear between the wavelengths and 0 beyond them.

    Parameters
    ----------
    wavelengths : (n,), nm, ascending; those outside of `VISIBLE` are not seen
    powers : (n,), relative power per nanometre; of a single wavelength, its power

    Raises
    ------
    InputError
        Different shapes, wavelengths out of order, powers that are negative or not finite, or nothing to see.
    """
    at, power = np.atleast_1d(np.asarray(wavelengths, np.float64)), np.atleast_1d(np.asarray(powers, np.float64))
    if at.ndim != 1 or at.shape != power.shape or not at.size:
        found = f"shapes {at.shape} and {power.shape}"
        raise InputError("wavelengths and powers differ in shape", where=name, found=found, allowed="(n,) and (n,)")
    check_wavelengths(at, name, anywhere=True)
    wrong = ~(np.isfinite(power) & (power >= 0))
    if wrong.any():
        found = f"{power[wrong][0]:g} at {at[wrong][0]:g} nm"
        raise InputError("not a power", where=name, found=found, allowed="finite powers of at least 0")
    low, high = max(at[0], VISIBLE[0]), min(at[-1], VISIBLE[1])
    seen = (at >= low) & (at <= high)
    between = np.arange(math.ceil(low), math.floor(high) + 1.0) if at.size > 1 else at[:0]
    nodes = np.array(sorted({*at[seen].tolist(), *between.tolist(), *((low, high) if low <= high else ())}))
    if len(nodes) > MOST_NODES:
        raise InputError("too many wavelengths", where=name, found=len(at), allowed=f"at most {MOST_NODES}")
    width = np.diff(nodes, prepend=nodes[:1]) / 2 + np.diff(nodes, append=nodes[-1:]) / 2
    # Powers are divided by their largest, so that their sum is finite.
    lines = np.interp(nodes, at, power / (power.max() or 1.0)) * (width if at.size > 1 else 1.0)
    if not lines.sum() > 0:
        found = f"no power from {VISIBLE[0]:g} to {VISIBLE[1]:g} nm"
        raise InputError("not a visible light", where=name, found=found, allowed="power at visible wavelengths")
    return Light(name, nodes, lines)


def check_wavelengths(wavelengths: Any, where: str, anywhere: bool = False) -> Floats:
    """Return wavelengths as float64 (n,), n >= 1.

    Parameters
    ----------
    anywhere : also outside of `VISIBLE`

    Raises
    ------
    InputError
        None, or not a list of numbers, or not ascending, or not within `VISIBLE`.
    """
    at = np.asarray(wavelengths, np.float64)
    if at.ndim != 1 or not at.size:
        raise InputError("not wavelengths", where=where, found=f"shape {at.shape}", allowed="a list of one or more")
    low, high = (0.0, np.finfo(np.float64).max) if anywhere else VISIBLE
    outside = ~((at >= low) & (at <= high))
    if outside.any():
        allowed = "numbers of at least 0" if anywhere else f"{low:g} to {high:g} nm, which the observer's table has"
        raise InputError("not a wavelength", where=where, found=f"{at[outside][0]:g} nm", allowed=allowed)
    falling = np.flatnonzero(np.diff(at) <= 0)
    if falling.size:
        found = f"{at[falling[0] + 1]:g} nm after {at[falling[0]]:g} nm"
        raise InputError("wavelengths out of order", where=where, found=found, allowed="ascending wavelengths")
    return at


@cache
def read_table(name: str) -> Floats:
    """Return one of the tables beside this module, float64 (rows, columns), the first column wavelengths in nm."""
    table = np.loadtxt(TABLES / name, delimiter=",")
    table.setflags(write=False)
    return table
