"""Noise: the same in any box, as Halton and the spectrum of white noise say, and periodic in its phase."""

from __future__ import annotations

import numpy as np
import pytest

from clusterviz.flow.noise import FIRST_POINTS, Noise, power_spectrum

SHAPE = (40, 50, 70)
KINDS = (Noise("white"), Noise("halton"), Noise("halton", density=0.3, blur=4, seed=7, phase=0.3))
ORIGIN = (0, 0, 0)


@pytest.mark.parametrize("noise", KINDS)
@pytest.mark.parametrize("shape", [SHAPE, (1, 50, 70), (1, 1, 1)])
def test_a_box_has_the_bits_of_the_whole(noise: Noise, shape: tuple[int, int, int]) -> None:
    whole = noise.read(shape, ORIGIN, shape)
    assert whole.dtype == np.float32
    assert 0 <= whole.min() <= whole.max() <= 1
    for begin in (ORIGIN, tuple(n // 3 for n in shape), tuple(n - 1 for n in shape)):
        for end in (
            tuple(b + 1 for b in begin),
            tuple(min(n, b + 17) for b, n in zip(begin, shape, strict=True)),
            shape,
        ):
            box = tuple(slice(b, e) for b, e in zip(begin, end, strict=True))
            assert np.array_equal(noise.read(shape, begin, end), whole[box])


def test_points_are_those_of_halton() -> None:
    def radical_inverse(number: int, base: int) -> float:
        found, unit = 0.0, 1.0
        while number:
            number, digit = divmod(number, base)
            unit /= base
            found += digit * unit
        return found

    noise = Noise("halton", density=0.01)
    numbers, voxels = noise.points(SHAPE, ORIGIN, SHAPE)
    assert len(numbers) == round(0.01 * np.prod(SHAPE))
    assert np.array_equal(numbers, np.arange(len(numbers)) + numbers[0])
    assert 0 <= numbers[0] < FIRST_POINTS
    for number, voxel in zip(numbers[:50].tolist(), voxels[:50].tolist(), strict=True):
        assert voxel == [int(radical_inverse(number, base) * side) for base, side in zip((5, 3, 2), SHAPE, strict=True)]


def test_spectrum_of_white_noise_is_flat_and_halton_has_little_at_low_frequencies() -> None:
    side = (48,) * 3
    frequency, white = power_spectrum(Noise("white").read(side, ORIGIN, side))
    _, points = power_spectrum(Noise("halton", blur=0.0).read(side, ORIGIN, side))
    _, spots = power_spectrum(Noise("halton").read(side, ORIGIN, side))
    assert np.abs(white[frequency > 0.1] - 1).max() < 0.15
    # A period of 14 voxels is four mean distances of points.
    assert points[frequency < 0.07].max() < 0.4
    assert np.abs(points[frequency > 0.35] - 1).max() < 0.25
    # Footprints take away high frequencies.
    assert spots[frequency < 0.1].max() < 0.6 * spots.max()
    assert spots[frequency > 0.45].max() < 0.1 * spots.max()


@pytest.mark.parametrize("kind", ["white", "halton"])
def test_the_phase_is_periodic_and_changes_the_noise_steadily(kind: str) -> None:
    side = (24,) * 3
    at = {phase: Noise(kind, phase=phase).read(side, ORIGIN, side) for phase in (0.0, 0.01, 0.5, 1.0)}
    assert np.array_equal(at[0.0], at[1.0])
    assert 0 < np.abs(at[0.0] - at[0.01]).max() < 0.05
    assert np.abs(at[0.0] - at[0.5]).max() > 0.8
    assert abs(at[0.0].mean() - at[0.5].mean()) < 0.02
    assert not np.array_equal(at[0.0], Noise(kind, seed=2).read(side, ORIGIN, side))
