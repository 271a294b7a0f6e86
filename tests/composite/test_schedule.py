"""Schedules are right and cost what theory says, for every number of ranks from 1 to 64."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import cast
from unittest import mock

import numpy as np
import pytest
from composite.cases import Case, picture, random_case, random_image, random_rect
from hypothesis import given, settings
from hypothesis import strategies as st

from clusterviz.comm import run_loopback
from clusterviz.composite import ALGORITHMS
from clusterviz.composite.fragment import Patch
from clusterviz.composite.schedules import direct_send, pipeline, radix_k, slic
from clusterviz.composite.schedules.algorithms import SEVERAL_IMAGES
from clusterviz.composite.schedules.direct_send import row_borders, top_to_bottom, weighted_borders
from clusterviz.composite.schedules.pipeline import automatic_batches
from clusterviz.composite.schedules.radix_k import automatic_factors
from clusterviz.composite.schedules.rectangles import Rectangles
from clusterviz.composite.schedules.schedule import MultiImageAlgorithm, Schedule, Stage, Transfer, borders, check
from clusterviz.composite.schedules.swap_2_3 import split
from clusterviz.composite.simulation.loads import direct_send_sparse
from clusterviz.composite.simulation.simulate import cube_footprints
from clusterviz.errors import InputError
from clusterviz.image.partial import Rect

RANKS = range(1, 65)
WIDTH, HEIGHT = 13, 11
PIXELS = WIDTH * HEIGHT
SEEDS = st.integers(0, 2**32 - 1)
ANY = -1
# Messages of 2-3 swap where every piece has pixels, from a simulation that shares no code with this one.
SWAP_2_3 = {
    2: 2, 3: 6, 4: 8, 5: 16, 6: 18, 7: 28, 8: 24, 9: 40, 10: 42, 11: 54, 12: 48, 13: 70, 14: 70, 15: 78, 16: 64, 17: 96,
    24: 120, 31: 228, 32: 160, 48: 288, 63: 534, 64: 384, 100: 864, 127: 1356, 128: 896, 1000: 13400, 1024: 10240,
}  # fmt: skip


def _remainder_messages(n: int, k: int = 2) -> int:
    """M(m) = (m − r)(k − 1) + k·r + k·M(⌊m/k⌋) with r = m mod k: for k = 2, Moreland's."""
    return 0 if n < 2 else (n - n % k) * (k - 1) + k * (n % k) + k * _remainder_messages(n // k, k)


def _counts(schedule: Schedule) -> dict[str, float]:
    load = schedule.counts()
    return {
        "rounds": load.rounds,
        "messages": load.messages,
        "pixels": load.pixels,
        "most_sent": int(load.pixels_sent.max(initial=0)),
        "most_received": int(load.pixels_received.max(initial=0)),
    }


def _theory(algorithm: str, n: int, p: int) -> dict[str, float]:
    """Rounds, messages, pixels and extremes for dense images, where every piece has pixels; ANY: no closed form."""
    if n == 1:
        return dict.fromkeys(("rounds", "messages", "pixels", "most_sent", "most_received"), 0)
    d = n.bit_length() - 1
    up, all_pixels, power = (n - 1).bit_length(), (n - 1) * p, n == 2**d
    largest, smallest = -(-p // n), p // n
    digits = [bit for bit in range(d + 1) if n >> bit & 1]
    factors = automatic_factors(n)
    exact = math.prod(factors) == n
    swap_sent = p - smallest if power else ANY
    swap_received = (1 - 2.0**-d + (not power)) * p if p % 2**d == 0 else ANY
    telescope = sum(b * 2**b for b in digits) + sum(2**b for b in digits[1:])
    flow_received = all_pixels // n if p % n == 0 else ANY
    batches = automatic_batches(p)
    rows: dict[str, tuple[float, ...]] = {
        # rounds, messages, most sent, most received
        "serial": (1, n - 1, p, all_pixels),
        "pipeline": (n - 2 + batches, batches * (n - 1), p, p),
        "tree": (up, n - 1, p, up * p),
        "direct-send": (1, n * (n - 1), p - smallest, (n - 1) * largest),
        "slic": (1, n * (n - 1), p - smallest, (n - 1) * largest),
        "parallel-pipeline": (n - 1, n * (n - 1), p - smallest, flow_received),
        "2-3-swap": (d, SWAP_2_3.get(n, ANY), p - smallest, ANY),
        "radix-k": (len(factors), n * sum(k - 1 for k in factors) if exact else ANY, p - smallest if exact else p, ANY),
        "binary-swap": (up, (n - 2**d) + d * 2**d, p - smallest if power else p, swap_received),
        "binary-swap-telescope": (up, telescope, swap_sent, ANY),
        "binary-swap-remainder": (d, _remainder_messages(n), swap_sent, ANY),
    }
    rounds, messages, sent, received = rows[algorithm]
    found = {"rounds": rounds, "messages": messages, "pixels": all_pixels}
    return found | {"most_sent": sent, "most_received": received}


@pytest.mark.cover("parallel-pipeline")
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_counts_equal_theory(algorithm: str) -> None:
    for ranks in RANKS:
        for pixels in (64 * 63, 1_000_003, 1 << 20, ranks * 1000):
            counts, theory = _counts(ALGORITHMS[algorithm](ranks, pixels, ())), _theory(algorithm, ranks, pixels)
            for name, wanted in theory.items():
                assert wanted in (ANY, counts[name]), f"{ranks} ranks, {pixels} pixels: {name}"
            assert counts["most_sent"] <= pixels
        for pixels in (p for p in (1, 2, 7, 31, 53) if p < ranks):
            counts, theory = _counts(ALGORITHMS[algorithm](ranks, pixels, ())), _theory(algorithm, ranks, pixels)
            assert counts["pixels"] == theory["pixels"]
            assert theory["messages"] == ANY or counts["messages"] <= theory["messages"]
            assert counts["rounds"] <= theory["rounds"]
            if algorithm in ("direct-send", "slic", "parallel-pipeline"):
                assert counts["messages"] == pixels * (ranks - 1)


@pytest.mark.cover
@pytest.mark.parametrize("algorithm", ALGORITHMS)
@pytest.mark.parametrize("pixels", [0, 1, 31, 1_000_003])
def test_every_pixel_is_merged_once_in_order_with_no_waste(algorithm: str, pixels: int) -> None:
    for ranks in RANKS if pixels > 1 else (1, 2, 3, 7, 8, 64):
        schedule = ALGORITHMS[algorithm](ranks, pixels, ())
        check(schedule)
        assert schedule.counts().pixels == (ranks - 1) * pixels


@pytest.mark.parametrize("ranks", SWAP_2_3)
def test_2_3_swap_sends_as_many_messages_as_its_table_says(ranks: int) -> None:
    schedule = ALGORITHMS["2-3-swap"](ranks, 1 << 24, ())
    counts = schedule.counts()
    assert counts.messages == SWAP_2_3[ranks] <= 2 * ranks * (ranks.bit_length() - 1)
    assert counts.pixels_received.max() <= 1.11 * (1 << 24)
    for stage in schedule.stages:
        assert np.bincount(stage.table[:, 0]).max() <= 3
        assert np.bincount(stage.table[:, 1]).max() <= 4


def test_2_3_swap_splits_and_deals_as_in_the_paper() -> None:
    assert [split(n) for n in (2, 3, 5, 7, 31)] == [(1, 1), (1, 1, 1), (2, 3), (2, 2, 3), (10, 10, 11)]
    for ranks, order in ((5, [2, 0, 3, 1, 4]), (7, [4, 0, 2, 5, 1, 3, 6])):
        stages = ALGORITHMS["2-3-swap"](ranks, 1000, ()).stages
        # Who receives a piece in the last stage owns it.
        owners = {(t.begin, t.end): t.target for t in stages[-1]}
        pieces = list(pairwise(borders(ranks, 1000).tolist()))
        assert all(owners.get(pieces[index], order[index]) == order[index] for index in range(ranks))
        assert {t.target for t in stages[-1]} <= set(order)


def test_radix_k_takes_the_factors_that_it_is_given() -> None:
    for ranks, factors in ((12, [3, 4]), (12, [4, 3]), (12, [2, 2, 3]), (13, [4, 3]), (23, [5, 4])):
        schedule = radix_k.schedule(ranks, 10_007, factors=factors)
        check(schedule)
        assert len(schedule.stages) == len(factors)
        if math.prod(factors) == ranks:
            assert schedule.counts().messages == ranks * sum(k - 1 for k in factors)


@pytest.mark.parametrize("k", [2, 3, 5, 8])
def test_radix_k_with_remainders_sends_what_its_manual_says(k: int) -> None:
    for ranks in RANKS:
        factors, left = [], ranks
        while left >= k:
            factors.append(k)
            left //= k
        if left == 1:
            schedule = radix_k.schedule(ranks, 1_000_003, factors=factors)
            check(schedule)
            assert schedule.counts().messages == _remainder_messages(ranks, k)


def test_radix_k_covers_direct_send_and_binary_swap() -> None:
    for ranks in (2, 8, 32):
        single, direct = radix_k.schedule(ranks, 999, factors=[ranks]), ALGORITHMS["direct-send"](ranks, 999, ())
        assert [set(stage) for stage in single.stages] == [set(stage) for stage in direct.stages]
        twos = radix_k.schedule(ranks, 999, factors=[2] * (ranks.bit_length() - 1))
        assert _counts(twos) == _counts(ALGORITHMS["binary-swap"](ranks, 999, ()))


def test_automatic_factors_are_between_4_and_8_but_for_the_last() -> None:
    assert (automatic_factors(1), automatic_factors(13), automatic_factors(4096)) == ((), (6, 2), (8, 8, 8, 8))
    for ranks in range(2, 3000):
        factors = automatic_factors(ranks)
        assert set(factors[:-1]) <= {4, 5, 6, 7, 8}
        assert 2 <= factors[-1] <= 8


@pytest.mark.parametrize(
    "make",
    [
        *(partial(radix_k.schedule, 8, 100, factors=factors) for factors in ([3], [2, 2, 2, 2], [1, 8], [], [0])),
        *(partial(direct_send.schedule, 7, 1001, owners=owners) for owners in (0, 8, -1)),
        partial(direct_send.schedule, 3, PIXELS, bands=0),
        partial(pipeline.schedule, 5, 1000, batches=0),
    ],
)
def test_options_that_do_not_fit_are_refused(make: Callable[[], Schedule]) -> None:
    with pytest.raises(InputError, match=r"radix-k|owners|batches|bands"):
        make()


def test_direct_send_to_few_owners_and_a_pipeline_of_any_number_of_batches() -> None:
    for owners in (1, 2, 3, 7):
        schedule = direct_send.schedule(7, 1001, owners=owners)
        check(schedule)
        counts = schedule.counts()
        assert (counts.rounds, counts.messages, counts.pixels) == (1, owners * 6, 6 * 1001)
        assert counts.pixels_received.max() <= 6 * -(-1001 // owners)
        assert len({t.target for t in schedule.stages[0]}) == owners
    for batches in (1, 2, 5, 400):
        schedule = pipeline.schedule(5, 1000, batches=batches)
        check(schedule)
        assert (schedule.counts().rounds, schedule.counts().messages) == (3 + batches, 4 * batches)


def test_pieces_are_exact_above_the_precision_of_floats() -> None:
    pixels = 2**40 + 1
    found = borders(1000, pixels)
    assert (found[0], found[-1]) == (0, pixels)
    assert set(np.diff(found).tolist()) == {pixels // 1000, pixels // 1000 + 1}
    check(ALGORITHMS["binary-swap"](12, pixels, ()))


@pytest.mark.parametrize(
    ("stages", "text"),
    [
        ([[(1, 1, 0, 4)]], "to oneself"),
        ([[(1, 0, 0, 2)]], "does not end on exactly one rank"),
        ([[(2, 0, 0, 4)]], "not neighbours"),
        ([[(1, 0, 0, 4), (1, 2, 2, 4)]], "sends twice"),
        ([[(1, 0, 2, 2)]], "no pixels"),
        ([[(0, 1, 0, 4)], [(0, 1, 0, 4)]], "does not hold"),
    ],
)
def test_check_finds_faulty_schedules(stages: list[list[tuple[int, int, int, int]]], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        check(Schedule(3, 4, tuple(Stage(np.array(rows)) for rows in stages)))


def test_a_stage_lists_the_transfers_of_a_rank() -> None:
    stage = ALGORITHMS["direct-send"](4, 8, ()).stages[0]
    assert stage.sent_by(2) == [Transfer(2, 0, 0, 2), Transfer(2, 1, 2, 4), Transfer(2, 3, 6, 8)]
    assert {t.source for t in stage.received_by(2)} == {0, 1, 3}
    assert sorted(map(str, stage)) == sorted(str(t) for rank in range(4) for t in stage.sent_by(rank))


def patches_of(rects: list[Rect], width: int = WIDTH, height: int = HEIGHT) -> list[Patch]:
    return [Patch(width, 0, width * height, rect) for rect in rects]


def random_rects(seed: int, count: int, size: tuple[int, int] = (WIDTH, HEIGHT)) -> list[Rect]:
    rng = np.random.default_rng(seed)
    return [random_rect(rng, size) for _ in range(count)]


def covers(rects: list[Rect], size: tuple[int, int] = (WIDTH, HEIGHT)) -> np.ndarray:
    """Whether each rectangle covers each pixel, (rectangles, pixels)."""
    y, x = (axis.ravel() for axis in np.mgrid[: size[1], : size[0]])
    inside = [(r.x_begin <= x) & (x < r.x_end) & (r.y_begin <= y) & (y < r.y_end) for r in rects]
    return np.array(inside)


@settings(max_examples=15, deadline=None)
@given(st.integers(1, 9), st.integers(1, 5), SEEDS)
def test_direct_send_by_bands_makes_the_same_picture(ranks: int, bands: int, seed: int) -> None:
    case = random_case(ranks, seed=seed, size=(WIDTH, HEIGHT))

    def made(case: Case) -> np.ndarray:
        return run_loopback(ranks, lambda channel: picture(channel, case, "direct-send"))[0]

    plain = made(case)
    with mock.patch.dict(ALGORITHMS, {"direct-send": partial(direct_send.schedule, bands=bands)}):
        interlaced = made(case)
    assert np.abs(interlaced - plain).max() <= max(ranks, 2) * 2.0**-23
    case.check(interlaced)


@pytest.mark.parametrize("pixels", [0, 1, 7, 97, 1_000_003])
def test_dense_footprints_are_cut_as_without_footprints(pixels: int) -> None:
    for width in {max(d, 1) for d in (1, pixels // 2, pixels) if pixels % max(d, 1) == 0}:
        rect = Rect(0, 0, width, pixels // width)
        for ranks in (1, 2, 3, 7, 64):
            made = direct_send.schedule(ranks, pixels, [Patch(width, 0, pixels, rect)] * ranks)
            plain = direct_send.schedule(ranks, pixels)
            assert [list(stage) for stage in made.stages] == [list(stage) for stage in plain.stages]


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 20), st.integers(1, 20), SEEDS)
def test_weighted_pieces_cover_the_canvas_and_cost_the_same_but_for_a_row(ranks: int, pieces: int, seed: int) -> None:
    rects = random_rects(seed, ranks)
    cuts = weighted_borders(pieces, Rectangles.of_patches(patches_of(rects)))
    assert (cuts[0], cuts[-1], len(cuts)) == (0, PIXELS, pieces + 1)
    assert (np.diff(cuts) >= 0).all()
    covered = covers(rects).sum(axis=0)
    cost = np.diff(np.concatenate([[0], np.cumsum(covered)])[cuts])
    most_of_a_row = covered.reshape(HEIGHT, WIDTH).sum(axis=1).max()
    assert np.abs(cost - covered.sum() / pieces).max(initial=0) <= most_of_a_row + 1


@settings(max_examples=60, deadline=None)
@given(st.data(), st.integers(1, 9), st.none() | st.integers(1, 20), SEEDS)
def test_direct_send_of_any_footprints_owners_and_bands_is_right(
    data: st.DataObject, ranks: int, bands: int | None, seed: int
) -> None:
    owners = data.draw(st.none() | st.integers(1, ranks))
    patches = patches_of(random_rects(seed, ranks))
    schedule = direct_send.schedule(ranks, PIXELS, patches, owners=owners, bands=bands)
    check(schedule)
    assert len({t.target for stage in schedule.stages for t in stage}) <= (owners or ranks)


def test_bands_are_whole_rows_dealt_in_turn() -> None:
    schedule = direct_send.schedule(2, PIXELS, patches_of([Rect(0, 0, WIDTH, HEIGHT)] * 2), bands=3)
    rows = [(t.begin // WIDTH, t.end // WIDTH) for t in schedule.stages[0].sent_by(0)]
    assert rows == [(1, 3), (5, 7), (9, 11)]
    assert all(t.begin % WIDTH == 0 for t in schedule.stages[0])
    flat = Rectangles.of_patches([Patch(5, 0, 10, Rect(0, 0, 5, 2))])
    assert row_borders(3, flat).tolist() == borders(3, 10).tolist()


@pytest.mark.parametrize("ranks", [4, 8, 16, 64, 256])
def test_bricks_are_shared_more_evenly_than_by_equal_pieces_with_fewer_messages_than_by_bands(ranks: int) -> None:
    cubes = cube_footprints(ranks, (2048, 2048))
    weighted, bands, plain = (direct_send_sparse(cubes, bands=bands) for bands in (None, 4, 1))
    assert weighted.pixels_received.max() < 0.8 * plain.pixels_received.max()
    assert weighted.pixels_received.max() <= 1.05 * bands.pixels_received.max()
    assert weighted.messages_sent.sum() <= bands.messages_sent.sum()
    assert weighted.pixels_sent.sum() <= plain.pixels_sent.sum()


def test_pieces_go_to_the_ranks_whose_images_lie_there() -> None:
    rects = [Rect(0, 8, WIDTH, 11), Rect(0, 0, WIDTH, 4), Rect(0, 4, WIDTH, 8)]
    assert top_to_bottom(Rectangles.of_patches(patches_of(rects)), 3).tolist() == [1, 2, 0]
    # Rank 0 has the lowest image and the uppermost: on the whole, it lies between the two others.
    many = [Rect(0, 0, 4, 1), Rect(0, 0, 4, 2), Rect(0, 8, 4, 11), Rect(0, 9, 4, 10)]
    assert top_to_bottom(Rectangles.of_patches(patches_of(many)), 3, [0, 1, 2, 0]).tolist() == [1, 0, 2]


@settings(max_examples=60, deadline=None)
@given(st.integers(2, 12), SEEDS)
def test_slic_deals_each_overlap_once_to_one_of_those_who_share_it(ranks: int, seed: int) -> None:
    rects = random_rects(seed, ranks, (29, 23))
    cover = covers(rects, (29, 23))
    merges, owner = np.zeros(29 * 23, int), np.full(29 * 23, -1)
    for transfer in (t for stage in slic.schedule(ranks, 29 * 23, patches_of(rects, 29, 23)).stages for t in stage):
        span = slice(transfer.begin, transfer.end)
        assert cover[[transfer.source, transfer.target], span].all()
        assert np.isin(owner[span], [-1, transfer.target]).all()
        owner[span] = transfer.target
        merges[span] += 1
    assert np.array_equal(merges, np.maximum(cover.sum(axis=0) - 1, 0))


@pytest.mark.parametrize(
    ("ranks", "rects", "owners", "received"),
    [
        (5, [Rect(3, 1, 11, 11)] * 5, None, [4 * 2 * 8] * 5),
        (5, [Rect(0, 2 * rank, 9, 2 * rank + 2) for rank in range(5)], None, []),
        (2, [Rect(0, 0, 9, 5), Rect(0, 6, 9, 11)] * 2, [0, 1, 0, 1], []),
        (4, [Rect(0, 0, 9, 5), Rect(0, 6, 9, 11)] * 2, None, [27, 18, 18, 27]),
        (2, [Rect(1, 2, 9, 8)] * 3, [1, 0, 1], [3 * 8, 3 * 8]),
    ],
    ids=["all overlap", "none overlap", "overlap on one rank", "overlap on two", "images of one rank are one"],
)
def test_slic_shares_the_work_evenly(
    ranks: int, rects: list[Rect], owners: list[int] | None, received: list[int]
) -> None:
    stages = slic.schedule(ranks, PIXELS, patches_of(rects), owners_of=owners).stages
    tables = np.concatenate([np.zeros((0, 4), int), *(stage.table for stage in stages)])
    found = np.bincount(tables[:, 1], weights=tables[:, 3] - tables[:, 2]).tolist()
    assert sorted(found) == sorted(received)


def test_slic_of_thousands_of_spans_makes_the_picture() -> None:
    rects = [Rect(40 * rank, 30 * rank, 40 * rank + 300, 30 * rank + 300) for rank in range(6)]
    rng = np.random.default_rng(2)
    case = Case(6, range(6), [random_image(rng, rect) for rect in rects], size=(500, 450))
    case.check(run_loopback(6, lambda channel: picture(channel, case, "slic"))[0])


def test_manuals_and_modules_say_how_many_images_a_rank_may_have() -> None:
    assert {"serial", "direct-send", "slic"} == SEVERAL_IMAGES
    for schedule in ALGORITHMS.values():
        module = sys.modules[schedule.__module__]
        text = (
            "any number of partial images a rank" if hasattr(module, "SEVERAL_IMAGES") else "one partial image a rank"
        )
        assert text in " ".join((module.__doc__ or "").split())


@pytest.mark.parametrize("name", sorted(SEVERAL_IMAGES))
@settings(max_examples=30, deadline=None)
@given(st.data(), st.integers(2, 6), st.integers(0, 6), SEEDS)
def test_each_pixel_meets_all_its_images_on_one_rank(
    name: str, data: st.DataObject, ranks: int, more: int, seed: int
) -> None:
    extra = data.draw(st.lists(st.integers(0, ranks - 1), min_size=more, max_size=more))
    owners = data.draw(st.permutations([*range(ranks), *extra]))
    rects = random_rects(seed, len(owners))
    take = cast(MultiImageAlgorithm, ALGORITHMS[name])
    schedule = take(ranks, PIXELS, patches_of(rects), owners_of=owners)
    assert schedule.ranks == ranks
    # What is not blank, by rank; it moves with its range.
    holds = np.array([covers(rects)[np.array(owners) == rank].any(axis=0) for rank in range(ranks)])
    somewhere = holds.any(axis=0)
    for transfer in (t for stage in schedule.stages for t in stage):
        assert transfer.source != transfer.target
        span = slice(transfer.begin, transfer.end)
        holds[transfer.target, span] |= holds[transfer.source, span]
        holds[transfer.source, span] = False
    assert np.array_equal(holds.sum(axis=0), somewhere)
    if name != "slic":
        check(schedule)
