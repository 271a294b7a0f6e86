"""`--trace F.json`: what commands that have it do alike."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from clusterviz.comm import Channel, abort_on_failure, agree
from clusterviz.report.trace import RankTrace, Span, measure_offset, write_trace


class Tracing:
    """The trace of a command, if there is one; every method but `add` is collective.

    Parameters
    ----------
    path : of the file; None for no trace
    """

    def __init__(self, channel: Channel, path: Path | None) -> None:
        self._channel, self._path, self._spans = channel, path, list[Span]()
        if path:
            with abort_on_failure(channel, 0, "clocks"):
                self._before = measure_offset(channel)

    def add(self, spans: Iterable[Span]) -> None:
        """What this rank did."""
        self._spans.extend(spans)

    def write(self) -> None:
        """Bring the spans of all ranks together, and write them on rank 0."""
        if self._path is None:
            return
        with abort_on_failure(self._channel, 0, "trace"):
            after = measure_offset(self._channel)
            ranks = self._channel.gather(RankTrace(tuple(self._spans), self._before, after))
        with agree(self._channel, 0, "trace"):
            if ranks:
                write_trace(self._path, ranks)
