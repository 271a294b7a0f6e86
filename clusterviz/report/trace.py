"""Traces: what every rank did and when, as one file that Perfetto and chrome://tracing show, one row a rank's thread.

Each rank notes spans by its own clock. Clocks of different nodes differ, so rank 0 asks every rank for its time and
halves the round trip; the smallest of several round trips bounds the error. This is done before and after the work, and
what a clock has drifted between the two is spread over it.

References
----------
F. Cristian: Probabilistic clock synchronization, Distributed Computing 3, 1989.
Chromium, Trace Event Format: complete events ("ph": "X"), times in microseconds.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from clusterviz.image.replace import replacing

ROUNDS = 8
"""Round trips to each rank; the fastest counts."""
TAG = 30_011


@dataclass(frozen=True)
class Span:
    """Something that one rank did.

    Attributes
    ----------
    name, category : what is shown, and by what it can be filtered
    begin, end : seconds of this rank's `perf_counter`
    args : shown when the span is chosen
    row : of the rank's thread that did it; "" for the first
    """

    name: str
    category: str
    begin: float
    end: float
    args: Mapping[str, Any] = field(default_factory=dict)
    row: str = ""


@dataclass(frozen=True)
class ClockOffset:
    """How far a rank's clock is ahead of rank 0's.

    Attributes
    ----------
    at : this rank's time when it was measured
    seconds : ahead
    round_trip : seconds; the offset is wrong by half of it at most
    """

    at: float
    seconds: float
    round_trip: float


class Link(Protocol):
    """What measuring clocks needs of a channel to the other ranks."""

    @property
    def rank(self) -> int: ...

    @property
    def size(self) -> int: ...

    def post_receive(self, buffer: NDArray[Any], source: int, tag: int) -> Any: ...

    def isend(self, buffer: NDArray[Any], target: int, tag: int) -> None: ...

    def wait_some(self, pending: Sequence[Any]) -> list[tuple[int, int]]: ...

    def wait_sends(self) -> None: ...


def measure_offset(channel: Link, rounds: int = ROUNDS) -> ClockOffset:
    """This rank's clock against rank 0's; collective."""
    if channel.rank > 0:
        mine = np.zeros(3)
        for _ in range(rounds):
            _receive(channel, np.zeros(1), 0)
            _send(channel, np.array([perf_counter()]), 0)
        _receive(channel, mine, 0)
        return ClockOffset(*mine.tolist())
    for rank in range(1, channel.size):
        best = min((_round_trip(channel, rank) for _ in range(rounds)), key=lambda offset: offset.round_trip)
        _send(channel, np.array([best.at, best.seconds, best.round_trip]), rank)
    return ClockOffset(perf_counter(), 0.0, 0.0)


def _round_trip(channel: Link, rank: int) -> ClockOffset:
    told = np.zeros(1)
    began = perf_counter()
    _send(channel, np.zeros(1), rank)
    _receive(channel, told, rank)
    spent = perf_counter() - began
    return ClockOffset(float(told[0]), float(told[0]) - (began + spent / 2), spent)


def _send(channel: Link, numbers: NDArray[np.float64], target: int) -> None:
    channel.isend(numbers, target, TAG)
    channel.wait_sends()


def _receive(channel: Link, numbers: NDArray[np.float64], source: int) -> None:
    channel.wait_some([channel.post_receive(numbers, source, TAG)])


@dataclass(frozen=True)
class RankTrace:
    """All that one rank noted, and its clock before and after."""

    spans: tuple[Span, ...]
    before: ClockOffset
    after: ClockOffset

    def on_clock_of_rank_0(self, time: float) -> float:
        """A time of this rank by rank 0's clock."""
        lasted = self.after.at - self.before.at
        share = (time - self.before.at) / lasted if lasted > 0 else 0.0
        return time - self.before.seconds - share * (self.after.seconds - self.before.seconds)


def composition_spans(begin: float, end: float, compositing: Mapping[str, Any]) -> Iterator[Span]:
    """The spans of one composition inside [begin, end], from what it counted.

    Its stages are known by their lengths: they are laid one behind the other, and so are packing, waiting and blending
    within each, although these take turns.

    Parameters
    ----------
    compositing : as in `RankFrame.compositing`
    """
    if not compositing:
        return
    names = ("algorithm", "codec", "transport", "seconds_predicted")
    yield Span("composite", "composite", begin, end, {name: compositing.get(name) for name in names})
    reached = begin

    def next_span(name: str, seconds: float, **args: Any) -> Span:
        nonlocal reached
        started, reached = reached, min(end, reached + max(0.0, seconds))
        return Span(name, "composite", started, reached, args)

    yield next_span("agree", compositing["seconds_agree"])
    for number, stage in enumerate(compositing["stages"]):
        started = reached
        parts = [next_span(part, stage[f"seconds_{part}"]) for part in ("encode", "wait", "blend")]
        counted = {name: stage[name] for name in ("messages_sent", "pixels_sent", "bytes_raw", "bytes_sent")}
        peers = [dict(peer) for peer in stage["peers"]]
        yield Span(f"stage {number}", "composite", started, reached, counted | {"peers": peers})
        yield from (part for part in parts if part.end > part.begin)
    yield next_span("collect", compositing["seconds_collect"], bytes_sent=compositing["bytes_collected"])


def trace_file(ranks: Sequence[RankTrace]) -> dict[str, Any]:
    """What `--trace` writes.

    Parameters
    ----------
    ranks : index = rank
    """
    events: list[dict[str, Any]] = []
    starts = [rank.on_clock_of_rank_0(span.begin) for rank in ranks for span in rank.spans]
    origin = min(starts, default=0.0)
    for number, rank in enumerate(ranks):
        rows = list(dict.fromkeys(["", *(span.row for span in rank.spans)]))
        named = {"pid": number, "tid": 0, "ph": "M"}
        events.append({**named, "name": "process_name", "args": {"name": f"rank {number}"}})
        events.append({**named, "name": "process_sort_index", "args": {"sort_index": number}})
        for tid, row in enumerate(rows):
            shown = {"name": f"rank {number} {row}".strip()}
            events.append({**named, "tid": tid, "name": "thread_name", "args": shown})
        # Where two begin together, the longer one is the outer one.
        spans = sorted(rank.spans, key=lambda span: (span.begin, -span.end))
        events.extend(_event(number, rows.index(span.row), span, rank, origin) for span in spans)
    offsets = [
        {"rank": number, "seconds": rank.before.seconds, "round_trip": rank.before.round_trip,
         "drift": rank.after.seconds - rank.before.seconds}
        for number, rank in enumerate(ranks)
    ]  # fmt: skip
    return {"traceEvents": events, "displayTimeUnit": "ms", "otherData": {"clock_offsets": offsets}}


def _event(number: int, row: int, span: Span, rank: RankTrace, origin: float) -> dict[str, Any]:
    begin, end = (1e6 * (rank.on_clock_of_rank_0(time) - origin) for time in (span.begin, span.end))
    return {
        "name": span.name,
        "cat": span.category,
        "ph": "X",
        "pid": number,
        "tid": row,
        "ts": begin,
        "dur": end - begin,
        "args": dict(span.args),
    }


def write_trace(path: Path, ranks: Sequence[RankTrace]) -> None:
    """Write the trace of all ranks; whole or not at all.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(trace_file(ranks)) + "\n")
