"""SLIC moves what overlaps and nothing else, deals it evenly, and stays quick with many spans."""

from __future__ import annotations

import numpy as np
from composite.images import composite_all, over_all, random_partial, random_rect
from hypothesis import given, settings
from hypothesis import strategies as st

from clusterviz.comm import run_loopback
from clusterviz.composite import composite
from clusterviz.composite.fragment import Patch
from clusterviz.composite.schedules import slic
from clusterviz.image.region import Rect

WIDTH, HEIGHT = 29, 23


def _overlaps(rects: list[Rect]) -> np.ndarray:
    """How many rectangles cover each pixel."""
    covered = np.zeros((HEIGHT, WIDTH), int)
    for rect in rects:
        covered[rect.y_begin : rect.y_end, rect.x_begin : rect.x_end] += 1
    return covered


@settings(max_examples=60, deadline=None)
@given(st.integers(2, 12), st.integers(0, 2**32 - 1))
def test_each_overlap_is_dealt_once_to_one_of_those_who_share_it(ranks: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    rects = [random_rect(rng, (WIDTH, HEIGHT)) for _ in range(ranks)]
    schedule = slic.schedule(ranks, WIDTH * HEIGHT, [Patch(WIDTH, 0, WIDTH * HEIGHT, rect) for rect in rects])
    merges = np.zeros(WIDTH * HEIGHT, int)
    owner = np.full(WIDTH * HEIGHT, -1)
    covers = [_overlaps([rect]).ravel().astype(bool) for rect in rects]
    for stage in schedule.stages:
        for transfer in stage:
            span = slice(transfer.begin, transfer.end)
            assert covers[transfer.source][span].all()
            assert covers[transfer.target][span].all()
            assert np.isin(owner[span], [-1, transfer.target]).all()
            owner[span] = transfer.target
            merges[span] += 1
    assert np.array_equal(merges, np.maximum(_overlaps(rects).ravel() - 1, 0))


def test_the_work_is_shared_where_all_overlap_in_a_part_of_the_picture() -> None:
    patches = [Patch(WIDTH, 0, WIDTH * HEIGHT, Rect(3, 1, 19, 21)) for _ in range(5)]
    table = slic.schedule(5, WIDTH * HEIGHT, patches).stages[0].table
    received = np.bincount(table[:, 1], weights=table[:, 3] - table[:, 2], minlength=5)
    assert received.tolist() == [4 * 4 * 16] * 5


def test_images_that_do_not_overlap_send_nothing() -> None:
    patches = [Patch(WIDTH, 0, WIDTH * HEIGHT, Rect(0, 4 * rank, 9, 4 * rank + 4)) for rank in range(5)]
    assert slic.schedule(5, WIDTH * HEIGHT, patches).stages == ()


def test_sent_pixels_are_those_that_overlap() -> None:
    rng = np.random.default_rng(1)
    rects = [random_rect(rng, (WIDTH, HEIGHT)) for _ in range(6)]
    partials = [random_partial(rng, rect, np.float32) for rect in rects]
    counted = run_loopback(6, lambda c: composite(partials[c.rank], range(6), c, "slic")[1])
    assert sum(c.total.pixels_sent for c in counted) == np.maximum(_overlaps(rects) - 1, 0).sum()
    assert all(c.total.messages_sent <= 5 for c in counted)


def test_thousands_of_spans_make_the_picture() -> None:
    rng = np.random.default_rng(2)
    rects = [Rect(40 * rank, 30 * rank, 40 * rank + 300, 30 * rank + 300) for rank in range(6)]
    partials = [random_partial(rng, rect, np.float32) for rect in rects]
    size = (500, 450)
    assert np.abs(composite_all(partials, range(6), size, "slic") - over_all(partials, range(6), size)).max() <= 2e-6
