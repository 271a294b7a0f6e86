"""What a schedule moves for given footprints: which patches really travel, and what a rank holds after each stage.

A schedule speaks of ranges. Footprints tell where the images are not blank, and since every rank knows all of them, it
can follow what it will receive without being told: no message needs a header, and one that would be empty is neither
sent nor waited for.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from clusterviz.composite.patch import Patch, unite
from clusterviz.composite.schedule import Schedule, Stage

Held = tuple[Patch, ...]


@dataclass(frozen=True)
class Message:
    """Patches that travel between this rank and a peer, one after the other, in one message."""

    peer: int
    patches: tuple[Patch, ...]

    @property
    def pixels(self) -> int:
        """Pixels in the message, at least one."""
        return sum(patch.count for patch in self.patches)


@dataclass(frozen=True)
class StageTraffic:
    """One stage as one rank sees it.

    Attributes
    ----------
    sends, receives : what leaves and what comes, by peer; nothing empty
    kept : what remains of what the rank held, cut where received ranges begin and end
    held : what `kept` becomes when all that came is blended in, one for one
    """

    sends: tuple[Message, ...]
    receives: tuple[Message, ...]
    kept: Held
    held: Held


def plan_traffic(schedule: Schedule, rank: int, footprints: Sequence[Patch]) -> tuple[StageTraffic, ...]:
    """What one rank sends and receives, stage by stage; `footprints` are by position, over the whole canvas."""
    concerned = _concerned(schedule, rank)
    held: dict[int, Held] = {r: (footprints[r],) for r in concerned[0]}
    result = []
    for number, stage in enumerate(schedule.stages):
        result.append(_stage_traffic(stage, rank, held))
        held = {r: _stage_traffic(stage, r, held).held for r in concerned[number + 1]}
    return tuple(result)


def _concerned(schedule: Schedule, rank: int) -> list[set[int]]:
    """The ranks whose holdings before each stage (and after the last) one rank must know, to know its messages."""
    needed = [{rank}]
    for stage in reversed(schedule.stages):
        needed.append(needed[-1] | {t.source for r in needed[-1] for t in stage.received_by(r)})
    return needed[::-1]


def _stage_traffic(stage: Stage, rank: int, held: dict[int, Held]) -> StageTraffic:
    received = stage.received_by(rank)
    starts = {r: [patch.begin for patch in held[r]] for r in {rank, *(t.source for t in received)}}
    leaving = [(t.target, _find(held[rank], starts[rank], t.begin, t.end)) for t in stage.sent_by(rank)]
    coming = [(t.source, _find(held[t.source], starts[t.source], t.begin, t.end)) for t in received]
    kept = _cut_out(held[rank], [patch for _, patch in leaving], [patch for _, patch in coming])
    return StageTraffic(_messages(leaving), _messages(coming), kept, _merged(kept, [patch for _, patch in coming]))


def _find(held: Held, starts: list[int], begin: int, end: int) -> Patch:
    """The range [begin, end) of what a rank holds.

    Raises
    ------
    ValueError
        The range is not inside one patch: no algorithm may ask for that.
    """
    index = bisect_right(starts, begin) - 1
    if index < 0 or end > held[index].end:
        raise ValueError(f"pixels [{begin}, {end}) are not held in one piece")
    return held[index].cut(begin, end)


def _merged(kept: Held, received: Sequence[Patch]) -> Held:
    """What is held when all that was received is blended in: each kept patch with what lies in its range."""
    coming = sorted(received, key=lambda patch: patch.begin)
    starts = [patch.begin for patch in coming]
    merged = []
    for patch in kept:
        inside = coming[bisect_left(starts, patch.begin) : bisect_left(starts, patch.end)]
        merged.append(unite(patch.begin, patch.end, [patch, *inside]) if inside else patch)
    return tuple(merged)


def _messages(patches: Sequence[tuple[int, Patch]]) -> tuple[Message, ...]:
    """One message for each peer, of the patches that hold something."""
    by_peer: dict[int, list[Patch]] = {}
    for peer, patch in patches:
        if patch.count:
            by_peer.setdefault(peer, []).append(patch)
    return tuple(Message(peer, tuple(by_peer[peer])) for peer in sorted(by_peer))


def _cut_out(held: Held, sent: Sequence[Patch], received: Sequence[Patch]) -> Held:
    """What a rank keeps: its patches without what it sends, cut where a run of received ranges begins or ends."""
    gone = sorted((patch.begin, patch.end) for patch in sent)
    starts = [begin for begin, _ in gone]
    borders = sorted({border for span in gone for border in span} | _run_borders(received))
    kept = []
    for patch in held:
        inside = borders[bisect_right(borders, patch.begin) : bisect_left(borders, patch.end)]
        for begin, end in pairwise([patch.begin, *inside, patch.end]):
            index = bisect_right(starts, begin) - 1
            if index < 0 or end > gone[index][1]:
                kept.append(patch.cut(begin, end))
    return tuple(kept)


def _run_borders(patches: Sequence[Patch]) -> set[int]:
    """Where runs of ranges that overlap or touch begin and end: fragments that complete each other stay together."""
    borders: set[int] = set()
    reached = -1
    for begin, end in sorted((patch.begin, patch.end) for patch in patches):
        if begin > reached:
            borders |= {begin, reached} if reached >= 0 else {begin}
        reached = max(reached, end)
    return borders | ({reached} if reached >= 0 else set())
