"""The table at the end of a render: where the time went, and what it was spent on."""

from __future__ import annotations

from collections.abc import Mapping

from clusterviz.report.statistics import FrameStatistics

WORTH_SHOWING = 0.0005
"""Seconds below which a stage has no line."""


def print_costs(statistics: FrameStatistics, startup: Mapping[str, float]) -> None:
    """Print the table on stdout.

    Parameters
    ----------
    statistics : of the frame
    startup : seconds before it, of the slowest rank, by part
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
    """What the time was spent on, in a few lines."""
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
    if statistics.sharing and len(ranks) > 1:
        lines.append(f"shared     {statistics.sharing}")
    if statistics.accuracy:
        lines.append(f"accuracy   {statistics.accuracy}")
        lines += [f"           {key}: {reason}" for key, reason in statistics.accuracy.reasons.items()]
    return "\n".join(lines)


def _rows(statistics: FrameStatistics, startup: Mapping[str, float]) -> list[tuple[str, float, float | None]]:
    """(what, slowest rank's seconds, mean seconds), in order of time; what is left of the total is waiting."""
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
    shown = [row for row in rows if row[1] >= WORTH_SHOWING]
    return [*shown, ("total, without the start", max(totals), sum(totals) / len(totals))]
