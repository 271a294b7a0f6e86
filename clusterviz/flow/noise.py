"""Noise for line integral convolution, as a function of a voxel's index and a seed.

White noise gives every voxel a number of its own. Sparse noise puts a spot on every point of a Halton sequence; its
lines are distinct, where those of white noise hide each other in a volume. Any box of either can be computed alone, so
the noise does not depend on bricks or ranks. `phase` changes the noise periodically: every voxel or point brightens
and fades at a time of its own.

References
----------
Halton, On the efficiency of certain quasi-random sequences of points in evaluating multi-dimensional integrals,
Numerische Mathematik 2, 1960.
Pharr, Jakob, Humphreys, Physically Based Rendering, 3rd edition, 7.4 (points of an elementary interval).
Wellons, Prospecting for hash functions, 2018 (the 32-bit hash).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.source import Index

BASES_ZYX = (5, 3, 2)
"""Of the Halton sequence along each axis; the longest rows of memory get the finest intervals."""
TIME_BASE = 7
"""Of the Halton sequence along time."""
CELL = 16
"""Smallest side, in voxels, of an elementary interval whose points are listed together."""
FIRST_POINTS = 1 << 20
"""Points of the sequence at which a seed may begin."""
Floats = NDArray[np.float32]


@dataclass(frozen=True)
class Noise:
    """What noise is drawn.

    Attributes
    ----------
    kind : "white" or "halton"
    density : points per voxel, of Halton noise
    blur : radius of a point's footprint in voxels: a Gaussian with half of it as standard deviation; 0: one voxel
    seed : 0 or more
    phase : of the animation, in periods
    """

    kind: str = "halton"
    density: float = 0.02
    blur: float = 1.5
    seed: int = 1
    phase: float = 0.0

    def read(self, shape_zyx: Index, begin_zyx: Index, end_zyx: Index) -> Floats:
        """Return the noise of the half-open box [begin, end) of a grid: float32, 0 to 1, (z, y, x)."""
        if self.kind == "white":
            return self._wave(_hash(self._numbers(begin_zyx, end_zyx)).astype(np.float32) * np.float32(2.0**-32))
        return self._sparse(shape_zyx, begin_zyx, end_zyx)

    def _wave(self, share: Floats) -> Floats:
        """Return a triangle wave of the phase, which begins with a share of its period, in place.

        Shares that are uniformly distributed give values that are so at any phase.
        """
        share += np.float32(self.phase % 1.0)
        share -= np.floor(share)
        share *= np.float32(2.0)
        share -= np.float32(1.0)
        return np.abs(share, out=share)

    def _numbers(self, begin_zyx: Index, end_zyx: Index) -> NDArray[np.uint32]:
        """Return a number for each voxel of a box."""
        odd = (0xC2B2AE3D, 0x85EBCA77, 0x9E3779B1)
        z, y, x = (
            np.arange(b, e, dtype=np.uint32) * np.uint32(o) for b, e, o in zip(begin_zyx, end_zyx, odd, strict=True)
        )
        z += _hash(np.array([self.seed], np.uint32))
        numbers: NDArray[np.uint32] = (z[:, None] + y)[:, :, None] + x
        return numbers

    def _sparse(self, shape_zyx: Index, begin_zyx: Index, end_zyx: Index) -> Floats:
        reach = int(np.ceil(1.5 * self.blur))
        begin = tuple(b - reach for b in begin_zyx)
        spots = np.zeros([e + reach - b for b, e in zip(begin, end_zyx, strict=True)], np.float32)
        first = tuple(max(0, b) for b in begin)
        last = tuple(min(n, e + reach) for n, e in zip(shape_zyx, end_zyx, strict=True))
        numbers, voxels = self.points(shape_zyx, first, last)  # type: ignore[arg-type]
        # A further dimension of the sequence: neighbours differ in their times, and their mean is even.
        strength = self._wave(_radical_inverse(numbers, TIME_BASE).astype(np.float32))
        np.add.at(spots, tuple((voxels - begin).T), strength)
        if reach:
            distance = np.arange(-reach, reach + 1) / (self.blur / 2)
            for axis in range(3):
                spots = _convolved(spots, np.exp(-distance * distance / 2).astype(np.float32), axis)
        return np.minimum(spots, np.float32(1.0), out=spots)

    def points(self, shape_zyx: Index, begin_zyx: Index, end_zyx: Index) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the points of Halton noise in a box: their numbers in the sequence, ascending, and their voxels.

        The points whose numbers have one remainder modulo a power of the base lie in one interval along an axis;
        remainders along three axes give one modulo their product (Chinese remainder theorem).

        Returns
        -------
        numbers : int64 (points,)
        voxels : int64 (points, 3), z, y, x
        """
        count = round(self.density * float(np.prod(np.asarray(shape_zyx, float))))
        first = int(_hash(np.array([self.seed + 1], np.uint32))[0]) % FIRST_POINTS
        remainders, moduli = list[NDArray[np.int64]](), list[int]()
        for base, side, begin, end in zip(BASES_ZYX, shape_zyx, begin_zyx, end_zyx, strict=True):
            modulus = 1
            while side // (modulus * base) >= CELL:
                modulus *= base
            # A voxel more on each side, as places are rounded.
            low, high = max(0, (begin - 1) * modulus // side), min(modulus, -(-(end + 1) * modulus // side))
            remainders.append(_reversed_digits(np.arange(low, high), base, modulus))
            moduli.append(modulus)
        whole = int(np.prod(moduli))
        ones = [whole // modulus * pow(whole // modulus, -1, modulus) for modulus in moduli]
        parts = [
            np.array([int(r) * one % whole for r in each], np.int64) for each, one in zip(remainders, ones, strict=True)
        ]
        joined = ((parts[0][:, None, None] + parts[1][:, None] + parts[2]).ravel() - first) % whole
        numbers = joined[:, None] + whole * np.arange(-(-count // whole))
        numbers = np.sort(numbers[numbers < count]) + first
        places = [_radical_inverse(numbers, base) * side for base, side in zip(BASES_ZYX, shape_zyx, strict=True)]
        voxels = np.stack([np.minimum(p.astype(np.int64), n - 1) for p, n in zip(places, shape_zyx, strict=True)], 1)
        inside = ((voxels >= begin_zyx) & (voxels < end_zyx)).all(axis=1)
        return numbers[inside], voxels[inside]


def _hash(numbers: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Mix the bits of numbers, in place; `lowbias32` of Wellons."""
    shifted = np.empty_like(numbers)
    for shift, factor in ((16, 0x21F0AAAD), (15, 0x735A2D97), (15, 1)):
        np.right_shift(numbers, np.uint32(shift), out=shifted)
        numbers ^= shifted
        numbers *= np.uint32(factor)
    return numbers


def _reversed_digits(numbers: NDArray[np.int64], base: int, modulus: int) -> NDArray[np.int64]:
    found = np.zeros_like(numbers)
    while modulus > 1:
        numbers, digit = np.divmod(numbers, base)
        found, modulus = found * base + digit, modulus // base
    return found


def _radical_inverse(numbers: NDArray[np.int64], base: int) -> NDArray[np.float64]:
    found, unit = np.zeros(numbers.shape), 1.0
    while numbers.any():
        numbers, digit = np.divmod(numbers, base)
        unit /= base
        found += digit * unit
    return found


def _convolved(values: Floats, weights: Floats, axis: int) -> Floats:
    """Convolve along an axis where all weights have values."""
    size = values.shape[axis] - len(weights) + 1
    parts = [values[(slice(None),) * axis + (slice(n, n + size),)] for n in range(len(weights))]
    found: Floats = weights[0] * parts[0]
    scaled = np.empty_like(found)
    for weight, part in zip(weights[1:], parts[1:], strict=True):
        found += np.multiply(part, weight, out=scaled)
    return found


def power_spectrum(noise: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the mean power of the noise's waves by their frequency.

    Parameters
    ----------
    noise : (n, n, n), a cube

    Returns
    -------
    frequency : float64 (k,), cycles per voxel, up to 0.5
    power : float64 (k,), relative to the noise's variance: 1 for white noise at all frequencies
    """
    side = noise.shape[0]
    values = noise - noise.mean(dtype=np.float64)
    power = np.abs(np.fft.fftn(values)) ** 2 / (values.size * values.size * max(values.var(), 1e-300)) * values.size
    steps = np.fft.fftfreq(side) * side
    radius = np.rint(np.sqrt(sum(s * s for s in np.meshgrid(steps, steps, steps, indexing="ij")))).astype(int).ravel()
    sums, counts = np.bincount(radius, power.ravel()), np.bincount(radius)
    used = np.arange(1, side // 2 + 1)
    return used / side, sums[used] / counts[used]
