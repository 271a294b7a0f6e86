"""Messages and pixels of each round equal the schedule's, for every algorithm."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from clusterviz.comm import Channel, run_loopback
from clusterviz.composite import ALGORITHMS, Compositor
from clusterviz.image.partial import PartialImage
from clusterviz.image.region import Rect
from clusterviz.report.pages.scale.measure import Measured, RankResources
from clusterviz.report.pages.scale.rounds import count_rounds, dense_bytes

SIZE = (40, 30)
RECTS = [(3, 2, 20, 17), (10, 5, 38, 25), (0, 0, 0, 0), (1, 12, 15, 28), (22, 3, 39, 11), (12, 12, 30, 30)]


def sent(algorithm: str, rects: Sequence[tuple[int, int, int, int]], order: list[int]) -> Measured:
    """What ranks in one process send of images with these rectangles."""

    def rank(channel: Channel) -> list[tuple[int, int]]:
        rect = Rect(*rects[channel.rank])
        image = PartialImage(rect, np.full((rect.height, rect.width, 4), 0.25, np.float32))
        compositor = Compositor(channel, SIZE, algorithm=algorithm, codec="raw", transport="messages")
        _, counters = compositor.composite(image, order)
        compositor.close()
        return [(stage.messages_sent, stage.pixels_sent) for stage in counters.stages]

    counted = run_loopback(len(rects), rank)
    resources = [RankResources("here", (0,), None)] * len(rects)
    return Measured([], [], 0.0, resources, order, list(rects), algorithm, counted, SIZE, 1.0, 16)


@pytest.mark.parametrize("algorithm", sorted(ALGORITHMS))
def test_every_algorithm_sends_what_theory_says(algorithm: str) -> None:
    measured = sent(algorithm, RECTS, [3, 0, 5, 2, 1, 4])
    rounds = count_rounds(measured)
    assert all(one.agrees for one in rounds), rounds
    assert sum(one.messages for one in rounds) > 0
    assert 0 < sum(one.bytes for one in rounds) <= dense_bytes(measured)


def test_a_message_that_was_not_sent_is_seen() -> None:
    measured = sent("direct-send", RECTS[:3], [0, 1, 2])
    measured.counted[0][0] = (measured.counted[0][0][0] - 1, measured.counted[0][0][1])
    assert [one.agrees for one in count_rounds(measured)] == [False]


@pytest.mark.parametrize("rects", [RECTS[:1], [RECTS[2], RECTS[0], RECTS[2]], [RECTS[2]] * 2])
def test_one_image_or_none_needs_no_message(rects: list[tuple[int, int, int, int]]) -> None:
    measured = sent("binary-swap", rects, list(range(len(rects))))
    assert (count_rounds(measured), dense_bytes(measured)) == ((), 0)
