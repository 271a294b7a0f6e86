"""Traces: spans of all ranks in a file for Perfetto and chrome://tracing, one row for each thread of a rank.

Each rank records spans by its own clock. Rank 0 measures the offset of every rank's clock as half a round trip; the
smallest of several round trips bounds the error. Offsets are measured before and after the work, and drift is
interpolated linearly.

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
"""Number of round trips to each rank; the fastest is used."""
TAG = 30_011


@dataclass(frozen=True)
class Span:
    """Interval of work on one rank. `begin`, `end`: seconds of this rank's `perf_counter`."""

    name: str
    category: str
    begin: float
    end: float
    args: Mapping[str, Any] = field(default_factory=dict)  # details shown for the selected span
    row: str = ""  # name of the thread; "" for the main thread


@dataclass(frozen=True)
class ClockOffset:
    """Offset of a rank's clock from rank 0's."""

    at: float  # this rank's time of the measurement, seconds
    seconds: float  # offset; positive if this rank's clock is ahead
    round_trip: float  # seconds; the error of the offset is at most half of it


class Link(Protocol):
    """Channel operations that clock measurement needs."""

    @property
    def rank(self) -> int: ...

    @property
    def size(self) -> int: ...

    def post_receive(self, buffer: NDArray[Any], source: int, tag: int) -> Any: ...

    def isend(self, buffer: NDArray[Any], target: int, tag: int) -> None: ...

    def wait_some(self, pending: Sequence[Any]) -> list[tuple[int, int]]: ...

    def wait_sends(self) -> None: ...


def measure_offset(channel: Link) -> ClockOffset:
    """Measure the offset of this rank's clock from rank 0's; collective."""
    if channel.rank > 0:
        mine = np.zeros(3)
        for _ in range(ROUNDS):
            _receive(channel, np.zeros(1), 0)
            _send(channel, np.array([perf_counter()]), 0)
        _receive(channel, mine, 0)
        return ClockOffset(*mine.tolist())
    for rank in range(1, channel.size):
        best = min((_round_trip(channel, rank) for _ in range(ROUNDS)), key=lambda offset: offset.round_trip)
        _send(channel, np.array([best.at, best.seconds, best.round_trip]), rank)
    return ClockOffset(perf_counter(), 0.0, 0.0)


def _round_trip(channel: Link, rank: int) -> ClockOffset:
    reply = np.zeros(1)
    began = perf_counter()
    _send(channel, np.zeros(1), rank)
    _receive(channel, reply, rank)
    spent = perf_counter() - began
    return ClockOffset(float(reply[0]), float(reply[0]) - (began + spent / 2), spent)


def _send(channel: Link, numbers: NDArray[np.float64], target: int) -> None:
    channel.isend(numbers, target, TAG)
    channel.wait_sends()


def _receive(channel: Link, numbers: NDArray[np.float64], source: int) -> None:
    channel.wait_some([channel.post_receive(numbers, source, TAG)])


@dataclass(frozen=True)
class RankTrace:
    """Spans of one rank, and its clock offsets before and after the work."""

    spans: tuple[Span, ...]
    before: ClockOffset
    after: ClockOffset

    def on_clock_of_rank_0(self, time: float) -> float:
        """Convert a time of this rank to rank 0's clock."""
        lasted = self.after.at - self.before.at
        share = (time - self.before.at) / lasted if lasted > 0 else 0.0
        return time - self.before.seconds - share * (self.after.seconds - self.before.seconds)


def composition_spans(begin: float, end: float, compositing: Mapping[str, Any]) -> Iterator[Span]:
    """Yield the spans of one composition in [begin, end], from its counters.

    Only durations are known: stages are placed one after the other, and so are packing, waiting and blending within a
    stage, although these alternate.

    `begin`, `end`: seconds of this rank's clock.
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
    """Return the contents of a `--trace` file. `ranks`: index = rank."""
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
        # Of two spans with equal begin, the longer one is the outer one.
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
    """Write the trace of all ranks; the file appears whole or not at all.

    Raises OutputError: the file cannot be written.
    """
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(trace_file(ranks)) + "\n")
