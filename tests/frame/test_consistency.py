"""A rank that decides differently is found before compositing, on all ranks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from frame.views import on_ranks, views

from clusterviz.comm import Channel, run_loopback
from clusterviz.distribution.dynamic import Dynamic
from clusterviz.distribution.flights import Flight
from clusterviz.distribution.static import Coherent
from clusterviz.errors import ClustervizError, RankError
from clusterviz.frame import Options, Run
from clusterviz.frame.work import check_equal, digest_of
from clusterviz.image.partial import Rect
from clusterviz.partition import BrickBox, Piece

BOX = BrickBox((0, 1, 2), (2, 3, 4))
OWN = np.arange(8).reshape(2, 2, 2) % 3 == 0
PIECES = (Piece(0, BOX), Piece(2, BOX, OWN), Piece(1, BOX, None, Rect(0, 0, 5, 4)))
OTHERS = (
    PIECES[::-1],
    PIECES[:2],
    (replace(PIECES[0], rank=1), *PIECES[1:]),
    (replace(PIECES[0], box=BrickBox((0, 1, 2), (2, 3, 3))), *PIECES[1:]),
    (PIECES[0], replace(PIECES[1], bricks=~OWN), PIECES[2]),
    (PIECES[0], replace(PIECES[1], bricks=None), PIECES[2]),
    (replace(PIECES[0], bricks=OWN), replace(PIECES[1], bricks=None), PIECES[2]),
    (*PIECES[:2], replace(PIECES[2], rect=Rect(0, 0, 4, 5))),
    (*PIECES[:2], replace(PIECES[2], rect=None)),
)


def test_pieces_have_the_same_checksum_only_where_they_are_the_same() -> None:
    again = (Piece(0, BOX), Piece(2, BOX, OWN.copy()), Piece(1, BOX, None, Rect(0, 0, 5, 4)))
    assert digest_of(again) == digest_of(PIECES)
    assert len({digest_of(pieces) for pieces in (PIECES, *OTHERS, ())}) == len(OTHERS) + 2


@pytest.mark.parametrize(
    ("sums", "said"),
    [
        ([7, 7, 8], "rank 2, frame 0, compare: decides otherwise than the other ranks all; "),
        ([7, 8, 7, 9, 7], r"rank 1, frame 0, compare: .* all \(and so do ranks 3\); "),
        ([7, 8], "rank 1, frame 0"),
    ],
)
def test_the_ranks_that_differ_from_most_are_named(sums: list[int], said: str) -> None:
    def run(channel: Channel) -> None:
        check_equal(Run(channel, Options()), {"nothing": [4] * len(sums), "all": sums})

    with pytest.raises(RankError, match=said):
        run_loopback(len(sums), run)


@pytest.mark.gl
@pytest.mark.parametrize(
    ("place", "said"),
    [("assign", "frame 3, compare: .* who draws what"), ("depart", "frame 3, compare: .* bricks fly")],
)
def test_a_rank_whose_distribution_differs_ends_all_ranks(
    place: str, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where the difference would show in the next frame only."""
    right, calls = getattr(Dynamic, place), dict[int, int]()

    def wrong(distribution: Dynamic, *args: Any) -> Any:
        calls[id(distribution)] = calls.get(id(distribution), 0) + 1
        found = right(distribution, *args)
        if calls[id(distribution)] != 4 or id(distribution) != min(calls):
            return found
        return found[1:] if place == "assign" else (*found, Flight((0, 0, 0), 7, 8, "planned"))

    monkeypatch.setattr(Dynamic, place, wrong)
    with pytest.raises(RankError, match=said):
        on_ranks(3, views(5, 4, distribution="dynamic"))


@pytest.mark.parametrize(
    ("place", "wrong", "said"),
    [
        ("assign", lambda found: (*found, replace(found[0], rank=1)), r"visible brick \(\d, \d, \d\) is drawn 2 times"),
        ("assign", lambda found: found[1:], r"visible brick \(\d, \d, \d\) is drawn by no rank"),
        ("holds", lambda found: frozenset(), r"rank 0 draws brick \(\d, \d, \d\), which it does not hold"),
    ],
    ids=["twice", "missed", "not held"],
)
def test_a_brick_with_a_wrong_owner_is_named(
    place: str, wrong: Callable[[Any], Any], said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where all ranks agree on it, pictures are wrong and composited right."""
    right = getattr(Coherent, place)
    monkeypatch.setattr(Coherent, place, lambda *args: wrong(right(*args)))
    with pytest.raises(ClustervizError, match=said):
        on_ranks(2, views(1, 2, mode="sort-last"), device="cpu", check=True)
