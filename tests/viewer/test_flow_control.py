"""A client gets the newest pictures, as many as its link takes; a link is simulated with a clock of its own."""

from __future__ import annotations

import heapq
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import count

import numpy as np
import pytest

from clusterviz.viewer.encoding import LOSSLESS, LOSSY, Encoding, Picture
from clusterviz.viewer.flow_control import ACK_SECONDS, MAX_WINDOW, MIN_WINDOW, FlowControl

SHARES = dict(zip(LOSSY, (1.0, 0.7, 0.55, 0.2, 0.13), strict=True)) | {LOSSLESS: 8.0}
"""Bytes of each encoding, by those of the first."""


def picture(number: int, still: bool = False) -> Picture:
    return Picture(np.zeros((1, 1, 4), np.float32), None, number, 0, {}, still, {}, 0.0)


@dataclass(frozen=True)
class Link:
    """Result of a simulation: pictures a second, their median age when they arrive, and the most on their way."""

    rate: float
    age: float
    most: int
    encodings: Mapping[Encoding, int]


def simulate(megabits: float, round_trip: float, kilobytes: float, drawn: float = 25.0, seconds: float = 20.0) -> Link:
    """Draw pictures at a rate, and send them over a link with a bandwidth and a delay; judge the second half."""
    flow, order, events = FlowControl(), count(), list[tuple[float, int, str, int]]()
    link_free, ages, on_way, most, encodings = 0.0, list[float](), 0, 0, dict[Encoding, int]()
    drawn_at = {}
    for number in range(int(drawn * seconds)):
        heapq.heappush(events, (number / drawn, next(order), "drawn", number))
    while events:
        now, _, kind, number = heapq.heappop(events)
        if kind == "drawn":
            drawn_at[number] = now
            flow.offer(picture(number))
        else:
            on_way -= 1
            flow.acknowledge(number, now)
            if now > seconds / 2:
                ages.append(now - round_trip / 2 - drawn_at[number])
        while taken := flow.take(now):
            found, encoding = taken
            size = int(kilobytes * 1000 * SHARES[encoding])
            flow.sent(found, encoding, size, now)
            on_way += 1
            most, encodings[encoding] = max(most, on_way), encodings.get(encoding, 0) + (now > seconds / 2)
            link_free = max(link_free, now) + size / (megabits * 125_000)
            heapq.heappush(events, (link_free + round_trip, next(order), "acknowledged", found.number))
    return Link(len(ages) / (seconds / 2), float(np.median(ages)), most, encodings)


@pytest.mark.parametrize(
    ("megabits", "round_trip", "kilobytes", "least", "oldest", "encoding"),
    [
        (1000, 0.010, 40, 24, 0.03, LOSSY[0]),
        (1000, 0.300, 40, 20, 0.20, LOSSY[0]),
        (10, 0.100, 40, 18, 0.25, LOSSY[0]),
        (10, 0.200, 40, 18, 0.30, LOSSY[0]),
        (10, 0.200, 120, 12, 0.45, LOSSY[1]),
        (2, 0.100, 40, 12, 0.30, LOSSY[3]),
        (1, 0.100, 80, 8, 0.60, LOSSY[4]),
    ],
)
def test_pictures_a_second(
    megabits: float, round_trip: float, kilobytes: float, least: float, oldest: float, encoding: Encoding
) -> None:
    found = simulate(megabits, round_trip, kilobytes)
    assert found.rate >= least
    assert found.age <= oldest
    assert found.most <= MAX_WINDOW
    assert max(found.encodings, key=lambda each: found.encodings[each]) == encoding


def test_newest_picture_is_taken_and_none_without_room() -> None:
    flow = FlowControl()
    assert flow.take(0.0) is None
    for number in range(5):
        flow.offer(picture(number))
        if (taken := flow.take(0.0)) is not None:
            flow.sent(*taken, 1000, 0.0)
    assert (flow.has_newer, number) == (True, 4)

    flow.acknowledge(0, 0.1)
    taken = flow.take(0.1)
    assert taken is not None
    assert taken[0].number == 4
    assert not flow.has_newer


@pytest.mark.parametrize("number", [1, 7, 2**53])
def test_acknowledgement_counts_for_earlier_pictures_and_repeated_ones_do_not(number: int) -> None:
    flow = FlowControl()
    for each in range(MIN_WINDOW):
        flow.sent(picture(each), LOSSY[0], 1000, 0.0)
    flow.acknowledge(number, 0.1)
    flow.acknowledge(number, 0.1)
    taken = 0
    for each in range(10, 20):
        flow.offer(picture(each))
        if (found := flow.take(0.2)) is not None:
            flow.sent(*found, 1000, 0.2)
            taken += 1
    assert MIN_WINDOW <= taken <= MIN_WINDOW + 1


def test_still_pictures_are_lossless_and_lost_ones_make_room() -> None:
    flow = FlowControl()
    for each in range(MIN_WINDOW):
        flow.sent(picture(each), LOSSY[0], 1000, 0.0)
    flow.offer(picture(9, still=True))
    assert flow.take(ACK_SECONDS - 1) is None
    assert flow.take(ACK_SECONDS + 1) is not None
    assert not flow.has_newer
    flow.offer(picture(10, still=True))
    taken = flow.take(ACK_SECONDS + 1)
    assert taken is not None
    assert taken[1] == LOSSLESS
