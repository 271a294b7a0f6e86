"""Schedules are right and cost what theory says, for every number of ranks from 1 to 64."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from clusterviz.composite import ALGORITHMS
from clusterviz.composite.schedules import direct_send, pipeline, radix_k
from clusterviz.composite.schedules.pipeline import automatic_batches
from clusterviz.composite.schedules.radix_k import automatic_factors
from clusterviz.composite.schedules.schedule import Counts, Schedule, Stage, Transfer, check, piece
from clusterviz.composite.schedules.swap_2_3 import split
from clusterviz.errors import InputError

# Fewer pixels than ranks, as many, and many; 31 and the last are primes.
PIXELS = [0, 1, 31, 64, 1_000_003]
RANKS = range(1, 65)


def _ceil_log2(n: int) -> int:
    return (n - 1).bit_length()


ANY = -1
# Messages of 2-3 swap where every piece has pixels, from a simulation that shares no code with this one.
SWAP_2_3 = {
    2: 2, 3: 6, 4: 8, 5: 16, 6: 18, 7: 28, 8: 24, 9: 40, 10: 42, 11: 54, 12: 48, 13: 70, 14: 70, 15: 78, 16: 64, 17: 96,
    24: 120, 31: 228, 32: 160, 48: 288, 63: 534, 64: 384, 100: 864, 127: 1356, 128: 896, 1000: 13400, 1024: 10240,
}  # fmt: skip


def _remainder_messages(n: int, k: int = 2) -> int:
    """M(m) = (m − r)(k − 1) + k·r + k·M(⌊m/k⌋) with r = m mod k: for k = 2, Moreland's."""
    return 0 if n < 2 else (n - n % k) * (k - 1) + k * (n % k) + k * _remainder_messages(n // k, k)


def _theory(algorithm: str, n: int, p: int) -> Counts:
    """Rounds, messages, pixels and extremes for dense images, where every piece has pixels; ANY: no closed form."""
    if n == 1:
        return Counts(0, 0, 0, 0, 0)
    d = n.bit_length() - 1
    all_pixels, power = (n - 1) * p, n == 2**d
    largest, smallest = -(-p // n), p // n
    digits = [bit for bit in range(d + 1) if n >> bit & 1]
    if algorithm == "serial":
        return Counts(1, n - 1, all_pixels, p, all_pixels)
    if algorithm == "pipeline":
        batches = automatic_batches(p)
        return Counts(n - 2 + batches, batches * (n - 1), all_pixels, p, p)
    if algorithm == "tree":
        return Counts(_ceil_log2(n), n - 1, all_pixels, p, _ceil_log2(n) * p)
    if algorithm in ("direct-send", "slic"):
        return Counts(1, n * (n - 1), all_pixels, p - smallest, (n - 1) * largest)
    if algorithm == "parallel-pipeline":
        return Counts(n - 1, n * (n - 1), all_pixels, p - smallest, ANY)
    if algorithm == "2-3-swap":
        return Counts(d, SWAP_2_3.get(n, ANY), all_pixels, p - smallest, ANY)
    if algorithm == "radix-k":
        factors = automatic_factors(n)
        exact = math.prod(factors) == n
        messages = n * sum(k - 1 for k in factors) if exact else ANY
        return Counts(len(factors), messages, all_pixels, p - smallest if exact else p, ANY)
    if algorithm == "binary-swap-telescope":
        messages = sum(b * 2**b for b in digits) + sum(2**b for b in digits[1:])
        return Counts(d + (not power), messages, all_pixels, p - smallest if power else ANY, ANY)
    if algorithm == "binary-swap-remainder":
        return Counts(d, _remainder_messages(n), all_pixels, p - smallest if power else ANY, ANY)
    return Counts(d + (not power), (n - 2**d) + d * 2**d, all_pixels, p - smallest if power else p, ANY)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_counts_equal_theory(algorithm: str) -> None:
    for ranks in RANKS:
        for pixels in (64 * 63, 4099, 1_000_003, 16_777_259):
            counts, theory = ALGORITHMS[algorithm](ranks, pixels, ()).counts(), _theory(algorithm, ranks, pixels)
            for name, wanted in vars(theory).items():
                assert wanted in (ANY, getattr(counts, name)), f"{ranks} ranks, {pixels} pixels: {name}"
            assert counts.most_sent <= pixels


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_fewer_pixels_than_ranks_need_no_more_messages_than_theory_says(algorithm: str) -> None:
    for ranks in RANKS:
        for pixels in (p for p in (1, 2, 7, 31, 53) if p < ranks):
            counts, theory = ALGORITHMS[algorithm](ranks, pixels, ()).counts(), _theory(algorithm, ranks, pixels)
            assert counts.pixels == theory.pixels
            assert theory.messages == ANY or counts.messages <= theory.messages
            assert counts.rounds <= theory.rounds
            if algorithm in ("direct-send", "slic", "parallel-pipeline"):
                assert counts.messages == pixels * (ranks - 1)


def test_binary_swap_receives_what_theory_says() -> None:
    for ranks in RANKS:
        d = ranks.bit_length() - 1
        share = 1 - 2.0**-d + (ranks > 2**d)
        counts = ALGORITHMS["binary-swap"](ranks, 1 << 20, ()).counts()
        assert counts.most_received == share * (1 << 20)


def test_parallel_pipeline_receives_no_more_than_it_sends() -> None:
    for ranks in RANKS:
        counts = ALGORITHMS["parallel-pipeline"](ranks, ranks * 1000, ()).counts()
        assert counts.most_received == counts.most_sent == (ranks - 1) * 1000


@pytest.mark.parametrize("ranks", SWAP_2_3)
def test_2_3_swap_sends_as_many_messages_as_its_table_says(ranks: int) -> None:
    schedule = ALGORITHMS["2-3-swap"](ranks, 1 << 24, ())
    counts = schedule.counts()
    assert counts.messages == SWAP_2_3[ranks] <= 2 * ranks * (ranks.bit_length() - 1)
    assert counts.most_received <= 1.11 * (1 << 24)
    for stage in schedule.stages:
        assert np.bincount(stage.table[:, 0]).max() <= 3
        assert np.bincount(stage.table[:, 1]).max() <= 4


def test_2_3_swap_splits_and_deals_as_in_the_paper() -> None:
    assert [split(n) for n in (2, 3, 5, 7, 31)] == [(1, 1), (1, 1, 1), (2, 3), (2, 2, 3), (10, 10, 11)]
    for ranks, order in ((5, [2, 0, 3, 1, 4]), (7, [4, 0, 2, 5, 1, 3, 6])):
        stages = ALGORITHMS["2-3-swap"](ranks, 1000, ()).stages
        # Who receives a piece in the last stage owns it.
        owners = {(t.begin, t.end): t.target for t in stages[-1]}
        pieces = [piece(index, ranks, 1000) for index in range(ranks)]
        assert all(owners.get(pieces[index], order[index]) == order[index] for index in range(ranks))
        assert {t.target for t in stages[-1]} <= set(order)


@pytest.mark.parametrize(
    ("ranks", "factors"), [(12, [3, 4]), (12, [4, 3]), (12, [2, 2, 3]), (13, [4, 3]), (23, [5, 4])]
)
def test_radix_k_takes_the_factors_that_it_is_given(ranks: int, factors: list[int]) -> None:
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
    def transfers(schedule: Schedule) -> list[set[Transfer]]:
        return [set(stage) for stage in schedule.stages]

    for ranks in (2, 8, 32):
        single = radix_k.schedule(ranks, 999, factors=[ranks])
        assert transfers(single) == transfers(ALGORITHMS["direct-send"](ranks, 999, ()))
        twos = radix_k.schedule(ranks, 999, factors=[2] * (ranks.bit_length() - 1))
        assert twos.counts() == ALGORITHMS["binary-swap"](ranks, 999, ()).counts()


@pytest.mark.parametrize("factors", [[3], [2, 2, 2, 2], [1, 8], [], [0]])
def test_radix_k_refuses_factors_that_do_not_fit(factors: list[int]) -> None:
    with pytest.raises(InputError, match="radix-k"):
        radix_k.schedule(8, 100, factors=factors)


def test_automatic_factors_are_between_4_and_8_but_for_the_last() -> None:
    assert automatic_factors(1) == ()
    assert automatic_factors(4096) == (8, 8, 8, 8)
    assert automatic_factors(13) == (6, 2)
    for ranks in range(2, 3000):
        factors = automatic_factors(ranks)
        assert set(factors[:-1]) <= {4, 5, 6, 7, 8}
        assert 2 <= factors[-1] <= 8


@pytest.mark.parametrize("owners", [1, 2, 3, 7])
def test_direct_send_to_few_owners(owners: int) -> None:
    schedule = direct_send.schedule(7, 1001, owners=owners)
    check(schedule)
    counts = schedule.counts()
    assert (counts.rounds, counts.messages, counts.pixels) == (1, owners * 6, 6 * 1001)
    assert counts.most_received <= 6 * -(-1001 // owners)
    assert len({t.target for t in schedule.stages[0]}) == owners


@pytest.mark.parametrize("owners", [0, 8, -1])
def test_direct_send_refuses_owners_that_are_not_there(owners: int) -> None:
    with pytest.raises(InputError, match="owners"):
        direct_send.schedule(7, 1001, owners=owners)


@pytest.mark.parametrize("batches", [1, 2, 5, 400])
def test_a_pipeline_of_any_number_of_batches(batches: int) -> None:
    schedule = pipeline.schedule(5, 1000, batches=batches)
    check(schedule)
    counts = schedule.counts()
    assert (counts.rounds, counts.messages) == (3 + batches, 4 * batches)


def test_a_pipeline_of_no_batches_is_refused() -> None:
    with pytest.raises(InputError, match="batches"):
        pipeline.schedule(5, 1000, batches=0)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
@pytest.mark.parametrize("pixels", PIXELS)
def test_every_pixel_is_merged_once_in_order_with_no_waste(algorithm: str, pixels: int) -> None:
    for ranks in RANKS:
        schedule = ALGORITHMS[algorithm](ranks, pixels, ())
        check(schedule)
        assert schedule.counts().pixels == (ranks - 1) * pixels


def test_pieces_are_exact_above_the_precision_of_floats() -> None:
    pixels = 2**40 + 1
    borders = [piece(index, 1000, pixels) for index in range(1000)]
    assert borders[0][0] == 0
    assert borders[-1][1] == pixels
    assert all(a[1] == b[0] for a, b in pairwise(borders))
    assert {end - begin for begin, end in borders} == {pixels // 1000, pixels // 1000 + 1}
    check(ALGORITHMS["binary-swap"](12, pixels, ()))


@pytest.mark.parametrize(
    ("transfers", "text"),
    [
        ([(1, 1, 0, 4)], "to oneself"),
        ([(1, 0, 0, 2)], "does not end on exactly one rank"),
        ([(2, 0, 0, 4)], "not neighbours"),
        ([(1, 0, 0, 4), (1, 2, 2, 4)], "sends twice"),
    ],
)
def test_check_finds_faulty_schedules(transfers: list[tuple[int, int, int, int]], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        check(Schedule(3, 4, (Stage.of(Transfer(*row) for row in transfers),)))


def test_check_finds_an_empty_message() -> None:
    with pytest.raises(ValueError, match="no pixels"):
        check(Schedule(2, 4, (Stage(np.array([[1, 0, 2, 2]])),)))


def test_check_finds_what_is_sent_on_within_its_stage() -> None:
    stages = (Stage.of([Transfer(0, 1, 0, 4)]), Stage.of([Transfer(0, 1, 0, 4)]))
    with pytest.raises(ValueError, match="does not hold"):
        check(Schedule(2, 4, stages))


def test_a_stage_lists_the_transfers_of_a_rank() -> None:
    stage = ALGORITHMS["direct-send"](4, 8, ()).stages[0]
    assert stage.sent_by(2) == [Transfer(2, 0, 0, 2), Transfer(2, 1, 2, 4), Transfer(2, 3, 6, 8)]
    assert {t.source for t in stage.received_by(2)} == {0, 1, 3}
    assert sorted(map(str, stage)) == sorted(str(t) for rank in range(4) for t in stage.sent_by(rank))
