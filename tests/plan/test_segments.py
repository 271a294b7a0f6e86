"""Segments of transfer functions as the shaders read them, and their integrals between the ends of slabs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from clusterviz.plan.encoding import in_units_of_clim
from clusterviz.plan.preintegration import make_preintegrated
from clusterviz.plan.segments import BUCKETS, FAR, NORMAL, Segments, make_segments
from clusterviz.reference.preintegrated import integrate
from clusterviz.scene.transfer import TransferFunction

GREY = ((0.0, 0.0), (1.0, 1.0))


def transfer_of(
    opacity: object, colour: object = GREY, domain: tuple[float, float] = (0.0, 1.0), unit: float = 1.0
) -> TransferFunction:
    """A transfer function of (value, opacity) and (value, grey) points."""
    a, c = np.array(opacity, float), np.array(colour, float)
    return TransferFunction(c[:, 0], np.repeat(c[:, 1:], 3, axis=1), a[:, 0], a[:, 1], unit, domain)


def segment_of(segments: Segments, s: np.ndarray) -> np.ndarray:
    """transfer.glsl's segment_of, in float32."""
    bucket = np.clip((s - np.float32(segments.low)) * np.float32(segments.per_unit), 0, BUCKETS - 1).astype(int)
    known = segments.buckets[bucket]
    segment = (known["first"] - NORMAL).astype(int)
    further = s >= known["next_start"]
    later = segment + 1
    stride = segments.further_starts
    while stride:
        candidate = np.minimum(later + stride, len(segments.records) - 1)
        later = np.where(s >= segments.records["start"][candidate], candidate, later)
        stride >>= 1
    return np.where(further, later, segment)


def classify(segments: Segments, s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Opacity of a slab, opacity of a unit, grey, as the shader finds them, in float32."""
    s = np.asarray(s, np.float32)
    record = segments.records[segment_of(segments, s)]
    with np.errstate(over="ignore"):
        beyond = s - record["start"]
    # The first segment starts at the lowest float; it is constant.
    beyond = np.where(np.isfinite(beyond), beyond, 0)
    slab = np.clip(record["slab_opacity"] + record["slab_slope"] * beyond, 0, 1)
    unit = np.clip(record["unit_opacity"] + record["unit_slope"] * beyond, 0, 1)
    return slab, unit, record["colour"][:, 0] + record["colour_slope"][:, 0] * beyond


def errors(transfer: TransferFunction, s: np.ndarray, slab_units: float = 1.0) -> tuple[float, float, float]:
    """Largest errors of the slab's opacity, the unit's and of the grey at scalars in units of clim."""
    s = np.asarray(s, np.float32).astype(np.float64)
    low, high = transfer.domain
    values = low + s * (high - low)
    slab, unit, grey = classify(make_segments(transfer, slab_units), s)
    opacity = np.minimum(transfer.opacity(values), 1 - 2.0**-24)
    return (
        float(np.abs(slab + np.expm1(slab_units * np.log1p(-opacity))).max()),
        float(np.abs(unit - transfer.opacity(values)).max()),
        float(np.abs(grey - transfer.colour(values)[:, 0]).max()),
    )


DENSE = np.linspace(-0.7, 1.7, 50_001)
SMOOTH = tuple((x, 0.8 * float(np.exp(-(((x - 0.4) / 0.15) ** 2)))) for x in np.linspace(0, 1, 80).tolist())


@pytest.mark.parametrize("slab_units", [1e-4, 0.1, 1.0, 7.0])
@pytest.mark.parametrize(
    "opacity",
    [((0.0, 0.0), (1.0, 1.0)), SMOOTH, ((0.2, 0.4),), ((-0.3, 0.9), (1.4, 0.1)), ((0.0, 1.0), (1.0, 1.0))],
    ids=["ramp", "smooth", "one-point", "points-outside-of-clim", "opaque"],
)
def test_every_scalar_has_the_transfer_functions_opacity_and_colour(opacity: object, slab_units: float) -> None:
    slab, unit, grey = errors(transfer_of(opacity), DENSE, slab_units)
    assert slab <= 1.5e-6 * min(1, 20 * slab_units)
    assert max(unit, grey) <= 1e-6


def test_step_is_a_step_and_the_later_value_holds_at_it() -> None:
    transfer = transfer_of(((0.0, 0.1), (0.5, 0.1), (0.5, 0.7), (1.0, 0.7)))
    half = np.float32(0.5)
    _, unit, _ = classify(make_segments(transfer, 1.0), np.array([np.nextafter(half, -1), half, np.nextafter(half, 1)]))
    assert unit.tolist() == pytest.approx([0.1, 0.7, 0.7], abs=1e-6)


def test_repeated_points_and_a_step_at_the_end_hold_their_last_value() -> None:
    transfer = transfer_of(((0.0, 0.2), (0.0, 0.3), (0.0, 0.4), (1.0, 0.4), (1.0, 0.9)), ((0.3, 0.0), (0.3, 1.0)))
    _, unit, grey = classify(make_segments(transfer, 1.0), np.array([-1, -1e-6, 0, 0.29, 0.3, 0.99, 1, 2]))
    assert unit.tolist() == pytest.approx([0.2, 0.2, 0.4, 0.4, 0.4, 0.4, 0.9, 0.9], abs=1e-6)
    assert grey.tolist() == pytest.approx([0, 0, 0, 0, 1, 1, 1, 1], abs=1e-6)


def test_thousand_points_in_one_bucket_are_all_found() -> None:
    close = tuple((0.5 + 1e-7 * k, 0.1 + 0.8 * (k % 2)) for k in range(1000))
    transfer = transfer_of(((0.0, 0.0), *close, (1.0, 0.0)))
    segments = make_segments(transfer, 1.0)
    starts = segments.records["start"]
    scalars = np.concatenate([np.linspace(0.49999, 0.50011, 5000), starts[1:]]).astype(np.float32)
    assert segments.further_starts >= 256
    assert np.array_equal(segment_of(segments, scalars), np.searchsorted(starts, scalars, side="right") - 1)


def test_what_is_before_the_first_visible_segment_is_told() -> None:
    transfer = transfer_of(((0.0, 0.0), (0.3, 0.0), (0.6, 0.5)))
    assert make_segments(transfer, 1.0).transparent_below == np.float32(0.3)
    assert make_segments(transfer_of(((0.0, 0.0), (1.0, 0.0))), 1.0).transparent_below == FAR
    assert make_segments(transfer_of(((0.0, 0.2), (1.0, 0.0))), 1.0).transparent_below == -FAR


@pytest.mark.parametrize("domain", [(-1e300, 1e300), (0.0, 1e-300), (300.0, 300.01), (-1e9, 1.0)])
def test_range_of_any_size_gives_the_same_function(domain: tuple[float, float]) -> None:
    low, high = domain
    points = np.array([0.1, 0.4, 0.8])
    values = low * (1 - points) + high * points
    transfer = transfer_of(np.column_stack([values, [0.0, 0.6, 0.2]]), ((low, 0.0), (high, 1.0)), domain)
    s = np.linspace(0, 1, 1001)
    _, unit, grey = classify(make_segments(transfer, 1.0), s)
    assert np.abs(unit - np.interp(s, points, [0.0, 0.6, 0.2])).max() <= 1e-5
    assert np.abs(grey - s).max() <= 1e-5


def test_points_far_outside_of_the_range_do_not_take_its_digits() -> None:
    transfer = transfer_of(((-1e30, 0.0), (0.2, 0.1), (0.9, 0.6), (1e30, 0.6)))
    assert max(errors(transfer, np.linspace(0.2, 1, 2001))) <= 1e-5


points = st.lists(st.tuples(st.floats(-0.5, 1.5, width=32), st.floats(0, 1, width=32)), min_size=1, max_size=12).map(
    lambda pairs: tuple(sorted(pairs, key=lambda pair: pair[0]))
)


@settings(deadline=None, max_examples=60)
@example(opacity=((0.0, 0.90625), (0.9063593745231628, 0.0)), colour=((0.0, 0.0),), slab_units=0.01)
@given(opacity=points, colour=points, slab_units=st.sampled_from([0.01, 0.5, 3.0]))
def test_any_points_give_a_scalar_its_segment_and_a_segment_its_ends(
    opacity: object, colour: object, slab_units: float
) -> None:
    """Between control points that float32 tells apart; a step in float32's last digits may be taken a digit early."""
    transfer = transfer_of(opacity, colour)
    segments = make_segments(transfer, slab_units)
    starts = segments.records["start"]
    scalars = np.concatenate([starts[1:], np.linspace(-0.6, 1.6, 500)]).astype(np.float32)
    assert (np.diff(starts) >= 0).all()
    assert np.array_equal(segment_of(segments, scalars), np.searchsorted(starts, scalars, side="right") - 1)
    knots = in_units_of_clim(np.concatenate([transfer.opacity_values, transfer.colour_values]), 0.0, 1.0)
    clear = np.abs(scalars[:, None] - knots).min(axis=1) > 1e-3
    if clear.any():
        gap = np.diff(np.unique(knots))
        steepest = 1 / max(1e-3, gap.min(initial=1.0))
        assert max(errors(transfer, scalars[clear], slab_units)) <= 1e-6 * (2 + steepest)


FULL = ((0.0, 0.0), (1.0, 1.0))
BUMP = ((0.0, 0.0), (0.25, 0.02), (0.5, 0.6), (0.7, 0.1), (1.0, 0.3))
JUMPS = ((0.0, 0.0), (0.3, 0.0), (0.3, 0.9), (0.31, 0.9), (0.31, 0.0), (0.6, 0.0), (0.6, 1.0), (1.0, 0.2))
PEAKS = ((0.0, 0.0), *((p + d, a) for p in (0.35, 0.55, 0.8) for d, a in ((-0.005, 0.0), (0, 0.9), (0.005, 0.0))))
FAR_APART = ((-1e12, 0.3), (0.2, 0.1), (0.4, 0.5), (1e12, 0.2))
FAINT = ((0.0, 1e-8), (1.0, 2e-8))
FUNCTIONS = {"full": FULL, "bump": BUMP, "jumps": JUMPS, "peaks": PEAKS, "far": FAR_APART, "faint": FAINT}


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
    assert segments.transparent_below == np.nextafter(np.float32(0.345), np.float32(1))  # where opacity rises from 0


def test_knots_far_beyond_clim_cost_no_digits() -> None:
    """Sums that began at the lowest knot would lose 12 digits of those between 0 and 1."""
    segments = make_preintegrated(transfer_of(FAR_APART))
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
