from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from clusterviz.plan.encoding import in_units_of_clim
from clusterviz.plan.segments import BUCKETS, FAR, Segments, make_segments
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
    segment = known["first"].astype(int)
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
