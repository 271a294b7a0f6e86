"""Start-up, statistics, cost table and trace of commands that render."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterable, Mapping
from pathlib import Path

import clusterviz
from clusterviz.cli.console import announce_compilation
from clusterviz.comm import Channel, abort_on_failure, agree, limit_threads, open_channel
from clusterviz.image.replace import check_replaceable, replacing
from clusterviz.report.statistics import FrameStatistics, statistics_file
from clusterviz.report.trace import RankTrace, Span, measure_offset, write_trace
from clusterviz.scene.files import public_data
from clusterviz.scene.values import Scene

MIN_SHOWN_SECONDS = 0.0005
"""Stages below this many seconds are left out of the cost table."""


def start(*, several_threads: bool = False) -> tuple[Channel, dict[str, float]]:
    """Open the channel; return it, and the seconds of each part of the start-up of this process."""
    reached, began = clusterviz.REACHED, time.perf_counter()
    age = _process_age()
    channel = open_channel(several_threads=several_threads)
    limit_threads(channel.placement())
    if channel.rank == 0:
        announce_compilation()
    ready = time.perf_counter()
    return channel, {"interpreter": max(0.0, age - (began - reached)), "imports": began - reached, "mpi": ready - began}


def _process_age() -> float:
    """Return the age of this process in seconds, to 0.01; 0 if /proc is not available."""
    try:
        ticks = int(Path("/proc/self/stat").read_text().rpartition(")")[2].split()[19])
        return time.clock_gettime(time.CLOCK_BOOTTIME) - ticks / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, AttributeError):
        return 0.0


def slowest_startup(startups: list[dict[str, float]]) -> dict[str, float]:
    """Return the seconds of each part of the start-up on the slowest rank."""
    return {name: max(startup[name] for startup in startups) for name in startups[0]}


def check_reports(*reports: Path | None) -> None:
    """Check before rendering that optional report files can be written; None is ignored."""
    for report in filter(None, reports):
        check_replaceable(report)


def write_statistics(path: Path, scene: Scene, frames: list[FrameStatistics], startup: dict[str, float]) -> None:
    """Write the statistics of each frame and rank as JSON."""
    report = statistics_file(public_data(scene), frames, startup)
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(report, indent=2) + "\n")


class Tracing:
    """Trace of a command; all methods but `add` are collective. `path`: the trace file; None for no trace."""

    def __init__(self, channel: Channel, path: Path | None) -> None:
        self._channel, self._path, self._spans = channel, path, list[Span]()
        if path:
            with abort_on_failure(channel, 0, "clocks"):
                self._before = measure_offset(channel)

    def add(self, spans: Iterable[Span]) -> None:
        """Add spans of this rank."""
        self._spans.extend(spans)

    def write(self) -> None:
        """Gather the spans of all ranks and write them on rank 0."""
        if self._path is None:
            return
        with abort_on_failure(self._channel, 0, "trace"):
            after = measure_offset(self._channel)
            ranks = self._channel.gather(RankTrace(tuple(self._spans), self._before, after))
        with agree(self._channel, 0, "trace"):
            if ranks:
                write_trace(self._path, ranks)


def print_cost_table(statistics: FrameStatistics, startup: Mapping[str, float]) -> None:
    """Print the seconds of each stage and a summary on stdout.

    `startup`: part of the start-up -> seconds on the slowest rank.
    """
    several = len(statistics.per_rank) > 1
    rows = [("where the time went", "slowest rank", "mean of ranks")]
    for name, slowest, mean in _rows(statistics, startup):
        rows.append((name, f"{slowest:.3f} s", "" if mean is None else f"{mean:.3f} s"))
    width = max(len(name) for name, _, _ in rows)
    for name, slowest_text, mean_text in rows:
        print(f"{name:{width}}  {slowest_text:>12}" + (f"  {mean_text:>13}" if several else ""))
    print(f"\n{summary(statistics)}")


def summary(statistics: FrameStatistics) -> str:
    """Return a frame's samples, messages, memory and renderers in a few lines."""
    ranks = statistics.per_rank
    samples, seconds = sum(rank.samples for rank in ranks), statistics.seconds.get("render", 0.0)
    speed = f" ({samples / seconds / 1e6:.1f} million a second)" if samples and seconds else ""
    drawn, held = sum(rank.bricks_drawn for rank in ranks), sum(rank.bricks for rank in ranks)
    names = dict.fromkeys(rank.renderer for rank in ranks if rank.renderer)
    sent, messages = sum(rank.bytes_sent for rank in ranks), sum(rank.messages_sent for rank in ranks)
    occluded = sum(rank.bricks_occluded for rank in ranks)
    hidden = f", {occluded} behind what is opaque" if occluded else ""
    lines = [
        f"ranks      {len(ranks)}, imbalance {statistics.imbalance:.2f} (1 is even)",
        f"samples    {samples:,}{speed}, {drawn} of {held} bricks drawn{hidden}",
        f"sent       {sent / 2**20:.2f} MiB in {messages} messages",
        f"memory     {max(rank.peak_memory_bytes for rank in ranks) / 2**20:.0f} MiB at most on a rank",
        f"renderer   {'; '.join(names) or 'none: no rank had anything to draw'}",
    ]
    if back := sum(rank.readback_bytes for rank in ranks):
        formats = dict.fromkeys(rank.readback_pixel for rank in ranks if rank.readback_pixel)
        lines.append(f"read back  {back / 2**20:.2f} MiB from GPUs, {', '.join(formats)}")
    if statistics.sharing and len(ranks) > 1:
        lines.append(f"shared     {statistics.sharing}")
    if statistics.accuracy:
        lines.append(f"accuracy   {statistics.accuracy}")
        lines += [f"           {key}: {reason}" for key, reason in statistics.accuracy.reasons.items()]
    lines += [f"detail     {each}" for each in statistics.detail]
    lines += [f"flow       {each}" for each in statistics.flows]
    return "\n".join(lines)


def _rows(statistics: FrameStatistics, startup: Mapping[str, float]) -> list[tuple[str, float, float | None]]:
    """Return (stage, seconds of the slowest rank, mean seconds) in order of execution; the rest is waiting."""
    per_rank = [rank.seconds for rank in statistics.per_rank]
    rows: list[tuple[str, float, float | None]] = [
        (f"start: {name}", seconds, None) for name, seconds in startup.items()
    ]
    for name, slowest in statistics.seconds.items():
        if name != "total":
            rows.append((name, slowest, sum(seconds.get(name, 0.0) for seconds in per_rank) / len(per_rank)))
    idle = [2 * seconds["total"] - sum(seconds.values()) for seconds in per_rank]
    rows.append(("waiting for other ranks", max(idle), sum(idle) / len(idle)))
    totals = [seconds["total"] for seconds in per_rank]
    shown = [row for row in rows if row[1] >= MIN_SHOWN_SECONDS]
    return [*shown, ("total, without the start", max(totals), sum(totals) / len(totals))]
