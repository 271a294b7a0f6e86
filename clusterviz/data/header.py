"""Checks of header contents that all formats share: dtype, shape, sizes, grid and units."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.source import Grid, Index, Triple, as_index
from clusterviz.errors import DataError, warn_of_data

MIN_DETERMINANT = 1e-6  # |det| of the unit axes, below which a placement counts as singular
# Upper bounds, by the format of deflate and LZ4, generous for the others.
MAX_COMPRESSION_RATIO = {"text": 1, "lz4": 256, "gzip": 1040, "lzma": 1 << 14, "TIFF": 1 << 16, "bzip2": 1 << 21}


def check_dtype(dtype: np.dtype[Any], where: str) -> np.dtype[Any]:
    """Return the native dtype of samples, numbers of up to 64 bits, stored as `dtype`; uint8 for booleans."""
    if dtype.kind == "b":
        return np.dtype(np.uint8)
    if dtype.kind not in "iuf" or dtype.itemsize > 8:
        allowed = "int8 to int64, uint8 to uint64, float16 to float64, one number a voxel"
        raise DataError("not a scalar volume", where=where, found=dtype, allowed=allowed)
    return dtype.newbyteorder("=")


def check_shape(shape: Sequence[int], where: str) -> Index:
    """Return the shape as (z, y, x); a picture (y, x) becomes one layer."""
    sizes = [int(n) for n in shape]
    if any(n < 1 for n in sizes):
        raise DataError("an axis has no samples", where=where, found=tuple(sizes), allowed="at least 1 on each axis")
    if len(sizes) == 2:
        sizes = [1, *sizes]
    if len(sizes) != 3:
        raise DataError("not a volume", where=where, found=f"{len(sizes)} axes {tuple(sizes)}", allowed="2 or 3 axes")
    return sizes[0], sizes[1], sizes[2]


def check_size(found: int, needed: int, where: str, exact: bool = False) -> None:
    """Check that the file has the bytes that its header requires, and with `exact` no more."""
    if found < needed:
        what = "truncated, or the header lies about its size"
        raise DataError(what, where=where, found=f"{found} bytes", allowed=f"{needed}")
    if exact and found > needed:
        raise DataError("longer than the header says", where=where, found=f"{found} bytes", allowed=f"{needed}")


def check_packed(packed: int, needed: int, packing: str, where: str) -> None:
    """Check that compressed bytes can hold the size that the header states, before memory is allocated.

    Parameters
    ----------
    packing : a key of `MAX_COMPRESSION_RATIO`
    """
    if packed * MAX_COMPRESSION_RATIO[packing] < needed:
        found, allowed = f"{packed} bytes, {packing}", f"enough to hold {needed} bytes"
        raise DataError("truncated, or the header lies about its size", where=where, found=found, allowed=allowed)


def triple(numbers: Sequence[float] | NDArray[Any], where: str) -> Triple:
    try:
        values = np.asarray(numbers, float)
    except (TypeError, ValueError):
        values = np.empty(0)
    if values.shape != (3,) or not np.isfinite(values).all():
        raise DataError("not a position or spacing", where=where, found=numbers, allowed="three finite numbers, x y z")
    return float(values[0]), float(values[1]), float(values[2])


def stated_numbers(stated: Any, key: str, count: int, where: str) -> NDArray[np.float64]:
    """Return the numbers, float64 (count,), that a header states under a key, as text or as an array."""
    try:
        numbers = np.array(stated.split() if isinstance(stated, str) else stated, float).ravel()
    except (TypeError, ValueError):
        numbers = np.empty(0)
    if len(numbers) != count or not np.isfinite(numbers).all():
        found = "nothing" if stated is None else repr(stated)
        raise DataError(f"impossible {key}", where=where, found=found, allowed=f"{count} numbers")
    return numbers


def make_grid(shape_zyx: Index, steps: NDArray[np.float64], origin: Sequence[float] | NDArray[Any], where: str) -> Grid:
    """Return the grid with the given steps and origin.

    Left-handed and sheared placements are allowed: the columns of the direction are unit vectors, not necessarily
    orthogonal.

    Parameters
    ----------
    shape_zyx : samples along z, y, x
    steps : float64 (3, 3); column a is the world vector from a sample to the next along index axis a (x, y, z)
    origin : world position (x, y, z) of the first sample
    """
    spacing = np.array([np.hypot.reduce(column) for column in np.asarray(steps, float).T])
    if not (np.isfinite(spacing).all() and (spacing > 0).all()):
        raise DataError("singular placement", where=where, found=f"spacing {spacing}", allowed="finite and above 0")
    direction = np.asarray(steps, float) / spacing
    if abs(np.linalg.det(direction)) < MIN_DETERMINANT:
        found = f"axes {direction.tolist()}"
        raise DataError("singular placement", where=where, found=found, allowed="an invertible matrix")
    x, y, z = (triple(row, where) for row in direction)
    return Grid(shape_zyx, triple(spacing, where), triple(origin, where), (x, y, z))


def check_box(begin_zyx: Index, end_zyx: Index, shape_zyx: Index) -> Index:
    """Return the shape of the half-open box [begin, end) inside the volume.

    Raises
    ------
    IndexError
        It lies outside: an error of the caller, not of the file.
    """
    if not all(0 <= b <= e <= n for b, e, n in zip(begin_zyx, end_zyx, shape_zyx, strict=True)):
        raise IndexError(f"box {begin_zyx} to {end_zyx} does not lie in a volume of shape {shape_zyx}")
    return as_index(e - b for b, e in zip(begin_zyx, end_zyx, strict=True))


def check_step(step: int, times: Sequence[float], where: str) -> int:
    if not 0 <= step < max(1, len(times)):
        allowed = f"0 to {len(times) - 1}" if times else "0: the vectors have no time steps"
        raise DataError("no such time step", where=where, found=step, allowed=allowed)
    return step


METRES = {"angstrom": 1e-10, "\u00c5": 1e-10, "\u212b": 1e-10, "picometer": 1e-12, "pm": 1e-12, "nanometer": 1e-9}
METRES |= {"nm": 1e-9, **dict.fromkeys(("micrometer", "micron", "\u00b5m", "\u03bcm", "um"), 1e-6), "millimeter": 1e-3}
METRES |= {"mm": 1e-3, "centimeter": 1e-2, "cm": 1e-2, "decimeter": 0.1, "dm": 0.1, "meter": 1.0, "m": 1.0}
METRES |= {"kilometer": 1e3, "km": 1e3, "inch": 0.0254, "in": 0.0254, "foot": 0.3048, "ft": 0.3048}
"""Lengths of units; micro and ångström have several characters."""
SPACING = "spacing: [x, y, z] of the volume"
"""Key of a scene that replaces what a file says."""


def unit_factors(units: Sequence[str]) -> list[float] | None:
    """Return the factor of each unit to the first one that is not empty; 1 for empty ones.

    None: units differ, and one of them is not known. Plurals and British spelling are known.
    """
    named = [unit for unit in units if unit]
    if len(set(named)) < 2:
        return [1.0] * len(units)
    metres = {unit: METRES.get(unit.removesuffix("s").replace("metre", "meter"), 0.0) for unit in named}
    if not all(metres.values()):
        return None
    return [metres[unit] / metres[named[0]] if unit else 1.0 for unit in units]


def axis_factors(units: Sequence[str], where: str) -> list[float]:
    """Return the factors of the units of x, y and z to one unit; warn of those that are not known, and return 1."""
    found = unit_factors(units)
    if found is None:
        what = "the axes have different units, whose numbers are taken as they are: the picture may be flat or long"
        warn_of_data(what, where=where, found=", ".join(unit or "none" for unit in units), allowed=SPACING)
    return found or [1.0] * len(units)
