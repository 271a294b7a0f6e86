"""Encoding of voxels for drawing, and of scalars in the shader: 0 at the low end of clim, 1 at the high end.

8- and 16-bit integers keep their size if clim spans a range of their values. All else becomes float32 in units of clim,
computed in float64, so that a field of 300.00 … 300.01 or of 1e300 keeps the digits that the transfer function needs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

VoxelKind = Literal["u8", "u16", "f32"]
FAR = 1e30  # values farther from clim are clamped to it; its differences stay finite in float32
FINEST, WIDEST = 2.0**-8, 2.0**64
"""Least and greatest range of clim, and greatest magnitude of its ends, with which small integers keep their size."""


@dataclass(frozen=True)
class Encoding:
    """Map from stored voxels to scalars in units of clim. `scale`, `bias`: scalar = scale · (stored − base) + bias."""

    kind: VoxelKind  # the stored type
    low: float
    high: float
    shift: int = 0  # added to signed integers to make them unsigned
    base: int = 0  # stored integer that the shader subtracts before it interpolates (u16)
    scale: float = 1.0
    bias: float = 0.0

    def encode(self, voxels: NDArray[Any]) -> NDArray[np.uint8] | NDArray[np.uint16] | NDArray[np.float32]:
        """Return voxels of the source's dtype as stored; float32 is in units of clim, NaN where not finite."""
        if self.kind == "u8":
            return voxels.view(np.uint8) ^ np.uint8(self.shift)
        if self.kind == "u16":
            return voxels.view(np.uint16) ^ np.uint16(self.shift)
        units = in_units_of_clim(voxels, self.low, self.high)
        stored = np.clip(units, -FAR, FAR).astype(np.float32)
        if voxels.dtype.kind == "f":
            stored[~np.isfinite(voxels)] = np.nan
        return stored


def make_encoding(dtype: np.dtype[Any], clim: tuple[float, float]) -> Encoding:
    """Return the encoding of a dtype for a range of values."""
    low, high = clim
    sensible = max(-low, high) <= WIDEST and high - low >= FINEST
    if dtype.kind not in "iu" or dtype.itemsize > 2 or not sensible:
        return Encoding("f32", low, high)
    # Flipping the sign bit adds half the range to a two's complement integer.
    shift = 1 << (8 * dtype.itemsize - 1) if dtype.kind == "i" else 0
    scale = 1.0 / (high - low)
    if dtype.itemsize == 1:
        return Encoding("u8", low, high, shift, 0, scale, (-shift - low) * scale)
    base = int(np.clip(round(low) + shift, 0, 65535))
    return Encoding("u16", low, high, shift, base, scale, (base - shift - low) * scale)


def in_units_of_clim(values: ArrayLike, low: float, high: float) -> NDArray[np.float64]:
    """Return (value − low) / (high − low) in float64, correct from denormals to the largest floats; overflow is inf."""
    exponent = -int(np.frexp(max(abs(low), abs(high)))[1])
    with np.errstate(over="ignore", invalid="ignore"):
        scaled = np.ldexp(np.asarray(values, np.float64), exponent)
        bottom, top = np.ldexp(low, exponent), np.ldexp(high, exponent)
        units: NDArray[np.float64] = (scaled - bottom) / (top - bottom)
    return units
