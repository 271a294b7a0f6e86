"""Schedules are right and cost what theory says, for every number of ranks from 1 to 64."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from clusterviz.composite import ALGORITHMS
from clusterviz.composite.schedule import Counts, Schedule, Stage, Transfer, check, piece

PIXELS = [0, 1, 7, 64, 1_000_003]
RANKS = range(1, 65)


def _ceil_log2(n: int) -> int:
    return (n - 1).bit_length()


def _theory(algorithm: str, n: int, p: int) -> Counts:
    """Rounds, messages, pixels and extremes for dense images, where every piece has pixels."""
    if n == 1:
        return Counts(0, 0, 0, 0, 0)
    d = n.bit_length() - 1
    folded = n - 2**d
    largest, smallest = -(-p // n), p // n
    if algorithm == "serial":
        return Counts(1, n - 1, (n - 1) * p, p, (n - 1) * p)
    if algorithm == "tree":
        return Counts(_ceil_log2(n), n - 1, (n - 1) * p, p, _ceil_log2(n) * p)
    if algorithm == "direct-send":
        return Counts(1, n * (n - 1), (n - 1) * p, p - smallest, (n - 1) * largest)
    most = p if folded else p - p // 2**d
    return Counts(d + (folded > 0), folded + d * 2**d, (n - 1) * p, most, -1)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_counts_equal_theory(algorithm: str) -> None:
    for ranks in RANKS:
        for pixels in (64, 1_000_003):
            counts, theory = ALGORITHMS[algorithm](ranks, pixels, ()).counts(), _theory(algorithm, ranks, pixels)
            assert (counts.rounds, counts.messages, counts.pixels) == (theory.rounds, theory.messages, theory.pixels)
            assert counts.most_sent == theory.most_sent
            if theory.most_received >= 0:
                assert counts.most_received == theory.most_received


def test_binary_swap_receives_what_theory_says() -> None:
    for ranks in RANKS:
        d = ranks.bit_length() - 1
        share = 1 - 2.0**-d + (ranks > 2**d)
        counts = ALGORITHMS["binary-swap"](ranks, 1 << 20, ()).counts()
        assert counts.most_received == share * (1 << 20)


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
