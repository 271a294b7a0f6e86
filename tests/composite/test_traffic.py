"""Loads in closed form, those of the schedules of sparse images, and what the exchange really sends are the same."""

from __future__ import annotations

import numpy as np
import pytest
from composite.cases import Case, random_image, random_rect
from hypothesis import given, settings
from hypothesis import strategies as st

from clusterviz.codec import pack
from clusterviz.comm import LoopbackChannel, run_loopback
from clusterviz.composite import ALGORITHMS
from clusterviz.composite.fragment import Fragment, OwnedPixels, Patch
from clusterviz.composite.gather import collect
from clusterviz.composite.messages import Endpoint, run_exchange
from clusterviz.composite.schedules import direct_send, pipeline
from clusterviz.composite.schedules.rectangles import Rectangles
from clusterviz.composite.schedules.schedule import Load, Schedule, Stage, borders, check
from clusterviz.composite.simulation.loads import (
    count_sparse,
    direct_send_dense,
    direct_send_sparse,
    parallel_pipeline_dense,
    parallel_pipeline_sparse,
    pipeline_sparse,
)
from clusterviz.composite.simulation.simulate import cube_footprints
from clusterviz.composite.traffic import Part, plan_traffic
from clusterviz.image.partial import Rect

WIDTH, HEIGHT = 13, 11
PIXELS = WIDTH * HEIGHT
CANVAS = Rect(0, 0, WIDTH, HEIGHT)


def _columns(load: Load) -> dict[str, list[int]]:
    return {name: np.atleast_1d(column).tolist() for name, column in vars(load).items()}


def _some_patches(seed: int, ranks: int) -> list[Patch]:
    """Footprints, none of them empty."""
    rng = np.random.default_rng(seed)
    rects = [random_rect(rng, (WIDTH, HEIGHT)) for _ in range(ranks)]
    return [Patch(WIDTH, 0, PIXELS, rect if rect.pixels else CANVAS) for rect in rects]


def _layers(patches: list[Patch]) -> list[list[Part]]:
    return [[Part(depth, patch)] for depth, patch in enumerate(patches)]


def _dealt(ranks: int, spans: int) -> Schedule:
    """Direct send of spans that are dealt to the ranks like cards: several ranges in each message."""
    cuts, target = borders(spans, PIXELS), np.arange(spans) % ranks
    return Schedule(ranks, PIXELS, (Stage.of_columns(np.arange(ranks)[:, None], target, cuts[:-1], cuts[1:]),))


@pytest.mark.cover
@pytest.mark.parametrize("dense", [True, False])
@pytest.mark.parametrize(
    "schedule",
    [*(pipeline.schedule(4, PIXELS, batches=n) for n in (1, 6, 200)), _dealt(5, 17), _dealt(3, PIXELS)],
    ids=["one batch", "batches", "more batches than pixels", "dealt spans", "dealt pixels"],
)
def test_the_exchange_runs_any_schedule(schedule: Schedule, dense: bool) -> None:
    check(schedule)
    rng, ranks, dtype = np.random.default_rng(schedule.ranks), range(schedule.ranks), np.dtype(np.float32)
    rects = [CANVAS if dense else random_rect(rng, (WIDTH, HEIGHT)) for _ in ranks]
    case = Case(schedule.ranks, ranks, [random_image(rng, rect) for rect in rects], size=(WIDTH, HEIGHT))
    patches = [Patch(WIDTH, 0, PIXELS, rect) for rect in rects]

    def run(channel: LoopbackChannel) -> tuple[np.ndarray | None, int, int]:
        rank = channel.rank
        own = {rank: Fragment(patches[rank], case.images[rank].rgba.reshape(-1, 4))}
        moved = plan_traffic(schedule, rank, _layers(patches), WIDTH)
        order = tuple(range(channel.size))
        endpoint = Endpoint(channel, order, rank, dtype, lambda pixels, rows, key: pack(pixels, "raw", rows))
        fragments, counters = run_exchange(own, moved, endpoint)
        made = collect(OwnedPixels(CANVAS, dtype, fragments, order), (WIDTH, HEIGHT), channel)
        return made, sum(c.messages_sent for c in counters), sum(c.pixels_sent for c in counters)

    results, counts = run_loopback(schedule.ranks, run), schedule.counts()
    case.check(results[0][0])
    if dense:
        assert sum(messages for _, messages, _ in results) == counts.messages
        assert sum(pixels for _, _, pixels in results) == counts.pixels
    else:
        assert sum(pixels for _, _, pixels in results) < counts.pixels


def test_several_ranges_to_one_rank_are_one_message() -> None:
    assert _dealt(5, 17).counts().messages == 5 * 4


@pytest.mark.parametrize("pixels", [0, 1, 7, 1000, 64 * 63])
def test_closed_forms_equal_the_schedules(pixels: int) -> None:
    for ranks in (*range(1, 18), 31, 33, 64):
        direct = _columns(direct_send_dense(ranks, pixels))
        assert direct == _columns(ALGORITHMS["direct-send"](ranks, pixels, ()).counts())
        # With more ranks than pixels, both have as many owners, but not the same ones.
        spans = _columns(ALGORITHMS["slic"](ranks, pixels, ()).counts())
        assert {name: sorted(column) for name, column in direct.items()} == {n: sorted(c) for n, c in spans.items()}
        flow = _columns(parallel_pipeline_dense(ranks, pixels))
        assert flow == _columns(ALGORITHMS["parallel-pipeline"](ranks, pixels, ()).counts())


@pytest.mark.parametrize("owners", [1, 3, 7, 20])
def test_closed_forms_with_few_owners_equal_the_schedules(owners: int) -> None:
    patches = _some_patches(owners, 20)
    rectangles = Rectangles.of_patches(patches)
    for bands in (None, 1, 2, 5, 100):
        dense = direct_send.schedule(20, PIXELS, owners=owners, bands=bands)
        assert _columns(direct_send_dense(20, PIXELS, owners, bands)) == _columns(dense.counts())
        sparse = direct_send.schedule(20, PIXELS, patches, owners=owners, bands=bands)
        assert _columns(direct_send_sparse(rectangles, owners, bands)) == _columns(count_sparse(sparse, rectangles))


SPARSE = {
    "direct-send": direct_send_sparse,
    "pipeline": pipeline_sparse,
    "parallel-pipeline": parallel_pipeline_sparse,
}


@pytest.mark.cover
@pytest.mark.parametrize("algorithm", ALGORITHMS)
@settings(max_examples=15, deadline=None)
@given(st.integers(1, 19), st.integers(0, 2**32 - 1))
def test_sparse_loads_are_what_the_exchange_sends(algorithm: str, ranks: int, seed: int) -> None:
    patches = _some_patches(seed, ranks)
    schedule, rectangles = ALGORITHMS[algorithm](ranks, PIXELS, patches), Rectangles.of_patches(patches)
    views = [plan_traffic(schedule, rank, _layers(patches), WIDTH) for rank in range(ranks)]
    load = count_sparse(schedule, rectangles)
    assert load.messages_sent.tolist() == [sum(len(stage.sends) for stage in view) for view in views]
    assert load.messages_received.tolist() == [sum(len(stage.receives) for stage in view) for view in views]
    sent = [sum(message.pixels for stage in view for message in stage.sends) for view in views]
    received = [sum(message.pixels for stage in view for message in stage.receives) for view in views]
    assert load.pixels_sent.tolist() == sent
    assert load.pixels_received.tolist() == received
    if algorithm in SPARSE:
        assert _columns(SPARSE[algorithm](rectangles)) == _columns(load)
    if algorithm == "slic":
        assert _columns(schedule.counts()) == _columns(load)
    for stages in zip(*views, strict=True):
        parts = {(rank, message.peer): message.parts for rank, stage in enumerate(stages) for message in stage.sends}
        expected = {(each.peer, rank): each.parts for rank, stage in enumerate(stages) for each in stage.receives}
        assert parts == expected, "what one sends is what the other expects"
        assert all(part.patch.count > 0 for message in parts.values() for part in message)


@pytest.mark.parametrize("batches", [1, 2, 7, 200])
def test_a_sparse_pipeline_of_any_number_of_batches(batches: int) -> None:
    rectangles = Rectangles.of_patches(_some_patches(batches, 9))
    schedule = pipeline.schedule(9, PIXELS, batches=batches)
    assert _columns(pipeline_sparse(rectangles, batches)) == _columns(count_sparse(schedule, rectangles))


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_rectangles_count_and_cut_as_patches_do(seed: int) -> None:
    patches = _some_patches(seed, 6)
    cuts = np.sort(np.random.default_rng(seed + 1).integers(0, PIXELS + 1, (6, 2)), axis=1)
    cut = Rectangles.of_patches(patches).cut(cuts[:, 0], cuts[:, 1])
    wanted = [patch.cut(begin, end) for patch, (begin, end) in zip(patches, cuts.tolist(), strict=True)]
    assert cut.count().tolist() == [patch.count for patch in wanted]
    sides = zip(*(column.tolist() for column in cut.columns()[2:]), strict=True)
    assert [Rect(*rect) for rect in sides] == [patch.rect for patch in wanted]


@pytest.mark.parametrize("ranks", [1, 2, 7, 64, 1000])
def test_cubes_fill_the_picture(ranks: int) -> None:
    cubes = cube_footprints(ranks, (640, 480))
    assert len(cubes) == ranks
    assert (cubes.count() > 0).all()
    assert (cubes.x_begin.min(), cubes.y_begin.min()) == (0, 0)
    assert (cubes.x_end.max(), cubes.y_end.max()) == (cubes.width, cubes.height)
    assert (cubes.width, cubes.height) == (pytest.approx(480 * np.sqrt(3) / 2, abs=2), 480)


@pytest.mark.parametrize(("algorithm", "factor"), [("direct-send", 1.0), ("binary-swap", 2.43), ("radix-k", 1.75)])
def test_cubes_move_what_theory_says_within_a_factor_of_two(algorithm: str, factor: float) -> None:
    """A brick covers about P·n^(−2/3) pixels, so that direct send moves about n^(1/3)·P."""
    for ranks in (64, 512, 4096):
        cubes = cube_footprints(ranks, (1024, 1024))
        pixels = cubes.canvas_pixels
        is_direct = algorithm == "direct-send"
        load = direct_send_sparse(cubes) if is_direct else count_sparse(ALGORITHMS[algorithm](ranks, pixels, ()), cubes)
        moved = load.pixels_sent.sum() / (pixels * ranks ** (1 / 3))
        assert factor / 2 <= moved <= factor * 1.1
