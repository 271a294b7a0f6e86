from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from plan.test_segments import segment_of, transfer_of

from clusterviz.plan.preintegration import make_preintegrated
from clusterviz.plan.segments import Segments
from clusterviz.reference.preintegrated import integrate
from clusterviz.scene.transfer import TransferFunction

FULL = ((0.0, 0.0), (1.0, 1.0))
BUMP = ((0.0, 0.0), (0.25, 0.02), (0.5, 0.6), (0.7, 0.1), (1.0, 0.3))
JUMPS = ((0.0, 0.0), (0.3, 0.0), (0.3, 0.9), (0.31, 0.9), (0.31, 0.0), (0.6, 0.0), (0.6, 1.0), (1.0, 0.2))
PEAKS = ((0.0, 0.0), *((p + d, a) for p in (0.35, 0.55, 0.8) for d, a in ((-0.005, 0.0), (0, 0.9), (0.005, 0.0))))
FAR = ((-1e12, 0.3), (0.2, 0.1), (0.4, 0.5), (1e12, 0.2))
FAINT = ((0.0, 1e-8), (1.0, 2e-8))
FUNCTIONS = {"full": FULL, "bump": BUMP, "jumps": JUMPS, "peaks": PEAKS, "far": FAR, "faint": FAINT}


@dataclass(frozen=True)
class Ends:
    """Scalars at the ends of slabs."""

    front: np.ndarray
    back: np.ndarray


def slabs(count: int = 600) -> Ends:
    """Short and long ramps, up and down, constant ones among them, some of them beyond clim."""
    random = np.random.default_rng(3)
    front = random.random(count) * 1.6 - 0.3
    reach = np.where(
        random.random(count) < 0.1, 0, 10.0 ** random.uniform(-6, 0, count) * random.choice([-1, 1], count)
    )
    return Ends(*(end.astype(np.float32).astype(np.float64) for end in (front, front + reach)))


def shade(segments: Segments, ends: Ends, units: float) -> np.ndarray:
    """preintegrated.glsl in float64 with the stored numbers: (n, 4), premultiplied."""
    assert segments.sums is not None
    found = np.zeros((len(ends.front), 4))
    front, back = (segment_of(segments, end.astype(np.float32)) for end in (ends.front, ends.back))
    for n, (a, b) in enumerate(zip(ends.front, ends.back, strict=True)):
        here, there = segments.records[front[n]], segments.records[back[n]]
        if front[n] == back[n]:
            _within(found[n], here, a, b, units)
            continue
        per_scalar, rises = units / abs(b - a), b > a
        leaves, enters = (here["end"], there["start"]) if rises else (here["start"], there["end"])
        _within(found[n], here, a, leaves, per_scalar * abs(leaves - a))
        low, high = min(front[n], back[n]) + 1, max(front[n], back[n])
        passed = segments.sums[high] - segments.sums[low]
        if passed[0] > 0:
            mean = passed[1:4] / passed[0]
            moment = (passed[4:7] - segments.sums[low, 0] * passed[1:4]) / passed[0] ** 2
            change = np.clip(12 * moment - 6 * mean, -1.5, 1.5)
            _absorb(found[n], passed[0] * per_scalar, mean, change if rises else -change)
        _within(found[n], there, enters, b, per_scalar * abs(b - enters))
    return found


def _within(pixel: np.ndarray, record: Any, begin: float, end: float, units: float) -> None:
    per = float(record["per_scalar"])
    x, d = (0.0 if per == 0 else ((begin + end) / 2 - record["start"]) * per), (end - begin) * per
    k0, k1, k2 = record["kappa"].astype(float)
    kappa = max(k0 + x * (k1 + x * k2) + k2 * d * d / 12, 0.0)
    tilt = np.clip((k1 + 2 * k2 * x) * d / kappa, -4, 4) if kappa > 0 else 0.0
    change = record["colour_change"].astype(float) * d
    mean = record["colour"] + record["colour_change"].astype(float) * x + change * tilt / 12
    _absorb(pixel, units * kappa, mean, change * (1 - tilt * tilt / 20))


def _absorb(pixel: np.ndarray, depth: float, mean: np.ndarray, change: np.ndarray) -> None:
    leaning = -depth / 12 if depth < 1e-3 else 1 / depth + 1 / np.expm1(-depth) + 0.5
    colour = np.clip(mean + leaning * change, 0, 1)
    pixel += (1 - pixel[3]) * -np.expm1(-depth) * np.append(colour, 1)


def truth(transfer: TransferFunction, ends: Ends, units: float) -> np.ndarray:
    """The reference's integrals."""
    length = np.full(len(ends.front), units * transfer.unit_distance)
    colour, depth = integrate(transfer, ends.front, ends.back, length)
    return np.append(colour, -np.expm1(-depth)[:, None], axis=1)


ALL = pytest.mark.parametrize("name", FUNCTIONS)


@ALL
@pytest.mark.parametrize("units", [0.02, 1.0, 20.0])
def test_opacity_of_a_slab_between_any_two_scalars(name: str, units: float) -> None:
    """The length does not enter; what float32 makes of the places of peaks and jumps does."""
    transfer, ends = transfer_of(FUNCTIONS[name], unit=3.0), slabs()
    found, expected = shade(make_preintegrated(transfer), ends, units)[:, 3], truth(transfer, ends, units)[:, 3]
    assert np.abs(found - expected).max() <= (1e-3 if name in ("peaks", "jumps") else 2e-5) * expected.max()
    assert not found[expected == 0].any()


@ALL
@pytest.mark.parametrize(("units", "bound"), [(0.02, 1e-5), (1.0, 4e-3), (20.0, 0.2)])
def test_colour_of_a_slab_between_any_two_scalars(name: str, units: float, bound: float) -> None:
    """What is not known is how colour is spread within a part: nothing where slabs are thin, and little at a unit."""
    transfer, ends = transfer_of(FUNCTIONS[name], unit=3.0), slabs()
    found, expected = shade(make_preintegrated(transfer), ends, units), truth(transfer, ends, units)
    assert np.abs(found - expected)[:, :3].max() <= bound


def test_colours_in_front_hide_those_behind_them() -> None:
    """A slab through red and then blue is not that through blue and then red, and the order's share is right."""
    grey = ((0.0, 0.0), (0.5, 0.0), (0.5, 1.0), (1.0, 1.0))
    transfer = transfer_of(((0.0, 0.8), (1.0, 0.8)), grey)
    many = transfer_of(tuple((v, 0.8) for v in np.linspace(0, 1, 21)), grey)
    depth = 2 * -np.log(0.2)
    for function in (transfer, many):
        found = shade(make_preintegrated(function), Ends(np.array([0.1, 0.9]), np.array([0.9, 0.1])), 2.0)
        half = 1 - np.exp(-depth / 2)
        exact = 2 if function is transfer else 0  # two parts are; many between are up to their first moment
        assert found[:, 0] == pytest.approx([half * np.exp(-depth / 2), half], abs=1e-6 if exact else 0.1)
        assert found[:, 3] == pytest.approx(1 - np.exp(-depth))


def test_transparent_slabs_are_exactly_transparent() -> None:
    segments = make_preintegrated(transfer_of(PEAKS))
    ends = Ends(np.array([-1.0, 0.36, 0.56, 0.79, 0.81]), np.array([0.34, 0.54, 0.79, 0.56, 7.0]))
    assert not shade(segments, ends, 5.0).any()
    assert segments.transparent_below == np.float32(0.345)


def test_knots_far_beyond_clim_cost_no_digits() -> None:
    """Sums that began at the lowest knot would lose 12 digits of those between 0 and 1."""
    segments = make_preintegrated(transfer_of(FAR))
    inside = (segments.records["start"] >= 0) & (segments.records["start"] <= 1)
    assert segments.sums is not None
    assert np.abs(segments.sums[inside, 0]).max() < 1


def test_few_segments_and_no_table() -> None:
    """A colour map of 256 entries with a bump of 64 points stays near its own points."""
    place = np.linspace(0, 1, 64)
    bump = tuple(zip(place, 0.4 * np.exp(-(((place - 0.65) / 0.15) ** 2)), strict=True))
    grey = tuple((v, v) for v in np.linspace(0, 1, 256))
    segments = make_preintegrated(transfer_of(bump, grey))
    assert segments.sums is not None
    assert len(segments.records) < 1000
    assert segments.sums.shape == (len(segments.records), 8)
