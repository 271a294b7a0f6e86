"""Ranks with several images, anywhere in depth: which algorithms take them, and what they make of them."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from composite.images import random_rect
from hypothesis import given, settings
from hypothesis import strategies as st

from clusterviz.composite import ALGORITHMS
from clusterviz.composite.fragment import Patch
from clusterviz.composite.schedules import direct_send, serial, slic
from clusterviz.composite.schedules.schedule import MultiImageAlgorithm, check
from clusterviz.image.region import Rect

WIDTH, HEIGHT = 13, 11
PIXELS = WIDTH * HEIGHT
TAKERS: dict[str, MultiImageAlgorithm] = {
    "serial": serial.schedule,
    "direct-send": direct_send.schedule,
    "slic": slic.schedule,
}


def test_every_module_says_whether_it_takes_several_images() -> None:
    said = {name: sys.modules[schedule.__module__].SEVERAL_IMAGES for name, schedule in ALGORITHMS.items()}
    assert {name for name, several in said.items() if several} == set(TAKERS)


@pytest.mark.parametrize("name", ALGORITHMS)
def test_every_manual_says_how_many_images(name: str) -> None:
    module = sys.modules[ALGORITHMS[name].__module__]
    text = "any number of partial images a rank" if module.SEVERAL_IMAGES else "one partial image a rank"
    assert text in " ".join((module.__doc__ or "").split())


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_each_pixel_meets_all_its_images_on_one_rank(data: st.DataObject) -> None:
    ranks = data.draw(st.integers(2, 6), label="ranks")
    images = data.draw(st.integers(ranks, 12), label="images")
    extra = data.draw(st.lists(st.integers(0, ranks - 1), min_size=images - ranks, max_size=images - ranks))
    owners = data.draw(st.permutations([*range(ranks), *extra]), label="owners")
    name = data.draw(st.sampled_from(sorted(TAKERS)), label="name")
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    patches = [Patch(WIDTH, 0, PIXELS, random_rect(rng, (WIDTH, HEIGHT))) for _ in range(images)]
    schedule = TAKERS[name](ranks, PIXELS, patches, owners_of=owners)
    assert schedule.ranks == ranks
    # What is not blank, by rank; it moves with its range.
    holds = np.zeros((ranks, HEIGHT, WIDTH), bool)
    for owner, patch in zip(owners, patches, strict=True):
        holds[owner, patch.rect.y_begin : patch.rect.y_end, patch.rect.x_begin : patch.rect.x_end] = True
    holds = holds.reshape(ranks, PIXELS)
    somewhere = holds.any(axis=0)
    for transfer in (t for stage in schedule.stages for t in stage):
        assert transfer.source != transfer.target
        span = slice(transfer.begin, transfer.end)
        holds[transfer.target, span] |= holds[transfer.source, span]
        holds[transfer.source, span] = False
    assert np.array_equal(holds.sum(axis=0), somewhere)
    if name != "slic":
        check(schedule)


def test_images_of_one_rank_that_meet_are_no_reason_to_send() -> None:
    rects = [Rect(0, 0, 9, 5), Rect(0, 6, 9, 11)] * 2
    patches = [Patch(WIDTH, 0, PIXELS, rect) for rect in rects]
    assert slic.schedule(2, PIXELS, patches, owners_of=[0, 1, 0, 1]).stages == ()
    assert len(slic.schedule(4, PIXELS, patches).stages[0]) > 0


def test_images_of_one_rank_that_meet_are_one_contributor() -> None:
    patches = [Patch(WIDTH, 0, PIXELS, Rect(1, 2, 9, 8))] * 3
    table = slic.schedule(2, PIXELS, patches, owners_of=[1, 0, 1]).stages[0].table
    assert np.bincount(table[:, 1], weights=table[:, 3] - table[:, 2]).tolist() == [3 * 8, 3 * 8]
