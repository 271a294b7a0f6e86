"""The engine runs schedules that no algorithm of today makes: many pieces a rank, many ranges a message."""

from __future__ import annotations

import numpy as np
import pytest
from composite.images import over_all, random_partial, random_rect

from clusterviz.codec import pack
from clusterviz.comm import LoopbackChannel, run_loopback
from clusterviz.composite import ALGORITHMS
from clusterviz.composite.exchange import Endpoint, run_exchange
from clusterviz.composite.fragment import Fragment, OwnedPixels, Patch
from clusterviz.composite.gather import collect
from clusterviz.composite.schedules.schedule import Schedule, Stage, Transfer, check, piece
from clusterviz.composite.traffic import layers_of, plan_traffic
from clusterviz.image.region import Rect

WIDTH, HEIGHT = 13, 11
PIXELS = WIDTH * HEIGHT


def _pipeline(ranks: int, batches: int) -> Schedule:
    """Batches flow from the back to the front, one rank a stage."""
    stages = []
    for number in range(batches + ranks - 2):
        flows = [(rank, number - (ranks - 1 - rank)) for rank in range(1, ranks)]
        rows = [Transfer(rank, rank - 1, *piece(b, batches, PIXELS)) for rank, b in flows if 0 <= b < batches]
        stages.append(Stage.of(rows))
    return Schedule(ranks, PIXELS, tuple(stages))


def _dealt(ranks: int, spans: int) -> Schedule:
    """Direct send of spans that are dealt to the ranks like cards: several ranges in each message."""
    pairs = [(source, span) for source in range(ranks) for span in range(spans) if source != span % ranks]
    rows = [Transfer(source, span % ranks, *piece(span, spans, PIXELS)) for source, span in pairs]
    return Schedule(ranks, PIXELS, (Stage.of(rows),))


SCHEDULES = {
    "pipeline of 1": _pipeline(4, 1),
    "pipeline of 6": _pipeline(4, 6),
    "pipeline of more batches than pixels": _pipeline(3, 200),
    "dealt spans": _dealt(5, 17),
    "dealt pixels": _dealt(3, PIXELS),
}


@pytest.mark.parametrize("name", SCHEDULES)
@pytest.mark.parametrize("dense", [True, False])
def test_any_schedule_makes_the_picture(name: str, dense: bool) -> None:
    schedule = SCHEDULES[name]
    check(schedule)
    rng = np.random.default_rng(len(name))
    canvas = Rect(0, 0, WIDTH, HEIGHT)
    rects = [canvas if dense else random_rect(rng, (WIDTH, HEIGHT)) for _ in range(schedule.ranks)]
    partials = [random_partial(rng, rect, np.float32) for rect in rects]
    patches = [Patch(WIDTH, 0, PIXELS, rect) for rect in rects]

    def run(channel: LoopbackChannel) -> tuple[np.ndarray | None, int, int]:
        rank = channel.rank
        own = {rank: Fragment(patches[rank], partials[rank].rgba.reshape(-1, 4))}
        moved = plan_traffic(schedule, rank, layers_of(patches), WIDTH)
        order = tuple(range(channel.size))
        endpoint = Endpoint(
            channel, order, rank, np.dtype(np.float32), lambda pixels, rows, key: pack(pixels, "raw", rows)
        )
        fragments, counters = run_exchange(own, moved, endpoint)
        made = collect(OwnedPixels(canvas, np.dtype(np.float32), fragments, order), (WIDTH, HEIGHT), channel)
        return made, sum(c.messages_sent for c in counters), sum(c.pixels_sent for c in counters)

    results = run_loopback(schedule.ranks, run)
    made = results[0][0]
    assert made is not None
    assert np.abs(made - over_all(partials, range(schedule.ranks), (WIDTH, HEIGHT))).max() <= 2.0**-20
    counts = schedule.counts()
    if dense:
        assert sum(messages for _, messages, _ in results) == counts.messages
        assert sum(pixels for _, _, pixels in results) == counts.pixels
    else:
        assert sum(pixels for _, _, pixels in results) < counts.pixels


def test_several_ranges_to_one_rank_are_one_message() -> None:
    assert _dealt(5, 17).counts().messages == 5 * 4


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_what_one_sends_is_what_the_other_expects(algorithm: str) -> None:
    rng = np.random.default_rng(0)
    for ranks in range(1, 20):
        patches = [Patch(WIDTH, 0, PIXELS, random_rect(rng, (WIDTH, HEIGHT))) for _ in range(ranks)]
        schedule = ALGORITHMS[algorithm](ranks, PIXELS, patches)
        views = [plan_traffic(schedule, rank, layers_of(patches), WIDTH) for rank in range(ranks)]
        for number in range(len(schedule.stages)):
            sent = {(r, m.peer): m.parts for r in range(ranks) for m in views[r][number].sends}
            expected = {(m.peer, r): m.parts for r in range(ranks) for m in views[r][number].receives}
            assert sent == expected
            assert all(part.patch.count > 0 for message in sent.values() for part in message)
