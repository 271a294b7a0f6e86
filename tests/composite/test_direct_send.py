"""Direct send gives every owner as much to blend, in pieces that make the same picture however they are cut."""

from __future__ import annotations

from functools import partial
from unittest import mock

import numpy as np
import pytest
from composite.images import composite_all, over_all, random_partial, random_rect
from hypothesis import given, settings
from hypothesis import strategies as st

from clusterviz.composite import ALGORITHMS
from clusterviz.composite.fragment import Patch
from clusterviz.composite.schedules import direct_send
from clusterviz.composite.schedules.direct_send import row_borders, top_to_bottom, weighted_borders
from clusterviz.composite.schedules.rectangles import Rectangles
from clusterviz.composite.schedules.schedule import borders, check
from clusterviz.composite.simulation.closed_forms import direct_send_sparse
from clusterviz.composite.simulation.cubes import cube_footprints
from clusterviz.errors import InputError
from clusterviz.image.region import Rect

WIDTH, HEIGHT = 13, 11
PIXELS = WIDTH * HEIGHT


def _patches(rects: list[Rect]) -> list[Patch]:
    return [Patch(WIDTH, 0, PIXELS, rect) for rect in rects]


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 9), st.integers(1, 5), st.integers(0, 2**32 - 1))
def test_interlace_is_identity(ranks: int, bands: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    partials = [random_partial(rng, random_rect(rng, (WIDTH, HEIGHT)), np.float32) for _ in range(ranks)]
    order = [int(rank) for rank in rng.permutation(ranks)]
    plain = composite_all(partials, order, (WIDTH, HEIGHT), "direct-send")
    with mock.patch.dict(ALGORITHMS, {"direct-send": partial(direct_send.schedule, bands=bands)}):
        interlaced = composite_all(partials, order, (WIDTH, HEIGHT), "direct-send")
    bound = max(ranks, 2) * 2.0**-23
    assert np.abs(interlaced - plain).max() <= bound
    assert np.abs(interlaced - over_all(partials, order, (WIDTH, HEIGHT))).max() <= bound


@pytest.mark.parametrize("pixels", [0, 1, 7, 97, 1_000_003])
def test_dense_footprints_are_cut_as_without_footprints(pixels: int) -> None:
    for width in {max(d, 1) for d in (1, pixels // 2, pixels) if pixels % max(d, 1) == 0}:
        rect = Rect(0, 0, width, pixels // width)
        for ranks in (1, 2, 3, 7, 64):
            patches = [Patch(width, 0, pixels, rect)] * ranks
            made, plain = direct_send.schedule(ranks, pixels, patches), direct_send.schedule(ranks, pixels)
            assert [list(stage) for stage in made.stages] == [list(stage) for stage in plain.stages]


@settings(max_examples=100, deadline=None)
@given(st.integers(1, 20), st.integers(1, 20), st.integers(0, 2**32 - 1))
def test_weighted_pieces_cover_the_canvas_and_cost_the_same_but_for_a_row(ranks: int, pieces: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    patches = _patches([random_rect(rng, (WIDTH, HEIGHT)) for _ in range(ranks)])
    cuts = weighted_borders(pieces, Rectangles.of_patches(patches))
    assert (cuts[0], cuts[-1], len(cuts)) == (0, PIXELS, pieces + 1)
    assert (np.diff(cuts) >= 0).all()
    covered = np.zeros((HEIGHT, WIDTH), np.int64)
    for patch in patches:
        covered[patch.rect.y_begin : patch.rect.y_end, patch.rect.x_begin : patch.rect.x_end] += 1
    cost = np.diff(np.concatenate([[0], np.cumsum(covered)])[cuts])
    assert np.abs(cost - covered.sum() / pieces).max(initial=0) <= covered.sum(axis=1).max() + 1


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_every_schedule_is_right(data: st.DataObject) -> None:
    ranks = data.draw(st.integers(1, 9))
    owners = data.draw(st.one_of(st.none(), st.integers(1, ranks)))
    bands = data.draw(st.one_of(st.none(), st.integers(1, 20)))
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    patches = _patches([random_rect(rng, (WIDTH, HEIGHT)) for _ in range(ranks)])
    schedule = direct_send.schedule(ranks, PIXELS, patches, owners=owners, bands=bands)
    check(schedule)
    assert len({t.target for stage in schedule.stages for t in stage}) <= (owners or ranks)


def test_bands_are_whole_rows_dealt_in_turn() -> None:
    schedule = direct_send.schedule(2, PIXELS, _patches([Rect(0, 0, WIDTH, HEIGHT)] * 2), bands=3)
    rows = [(t.begin // WIDTH, t.end // WIDTH) for t in schedule.stages[0].sent_by(0)]
    assert rows == [(1, 3), (5, 7), (9, 11)]
    assert all(t.begin % WIDTH == 0 for t in schedule.stages[0])
    flat = Rectangles.of_patches([Patch(5, 0, 10, Rect(0, 0, 5, 2))])
    assert row_borders(3, flat).tolist() == borders(3, 10).tolist()


def test_no_bands_are_refused() -> None:
    with pytest.raises(InputError, match="bands"):
        direct_send.schedule(3, PIXELS, bands=0)


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
    footprints = Rectangles.of_patches(_patches(rects))
    assert top_to_bottom(footprints, 3).tolist() == [1, 2, 0]
    # Rank 0 has the lowest image and the uppermost: on the whole, it lies between the two others.
    many = Rectangles.of_patches(_patches([Rect(0, 0, 4, 1), Rect(0, 0, 4, 2), Rect(0, 8, 4, 11), Rect(0, 9, 4, 10)]))
    assert top_to_bottom(many, 3, [0, 1, 2, 0]).tolist() == [1, 0, 2]
