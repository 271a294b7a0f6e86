"""What a schedule moves for given footprints: which patches really travel, and what a rank holds after each stage.

A schedule speaks of ranges. Footprints tell where the images are not blank, and since every rank knows all of them, it
can follow what it will receive without being told: no message needs a header, and one that would be empty is neither
sent nor waited for.
"""

from __future__ import annotations

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
    leaving = [(t.target, _find(held[rank], t.begin, t.end)) for t in stage.sent_by(rank)]
    coming = [(t.source, _find(held[t.source], t.begin, t.end)) for t in stage.received_by(rank)]
    kept = _cut_out(held[rank], [patch for _, patch in leaving], [patch for _, patch in coming])
    merged = (
        unite(p.begin, p.end, [p, *(c for _, c in coming if p.begin <= c.begin and c.end <= p.end)]) for p in kept
    )
    return StageTraffic(_messages(leaving), _messages(coming), kept, tuple(merged))


def _find(held: Held, begin: int, end: int) -> Patch:
    """The range [begin, end) of what a rank holds.

    Raises
    ------
    ValueError
        The range is not inside one patch: no algorithm may ask for that.
    """
    for patch in held:
        if patch.begin <= begin and end <= patch.end:
            return patch.cut(begin, end)
    raise ValueError(f"pixels [{begin}, {end}) are not held in one piece")


def _messages(patches: Sequence[tuple[int, Patch]]) -> tuple[Message, ...]:
    """One message for each peer, of the patches that hold something."""
    by_peer: dict[int, list[Patch]] = {}
    for peer, patch in patches:
        if patch.count:
            by_peer.setdefault(peer, []).append(patch)
    return tuple(Message(peer, tuple(by_peer[peer])) for peer in sorted(by_peer))


def _cut_out(held: Held, sent: Sequence[Patch], received: Sequence[Patch]) -> Held:
    """What a rank keeps: its patches without what it sends, cut where a run of received ranges begins or ends."""
    gone = {(patch.begin, patch.end) for patch in sent}
    borders = {border for span in gone for border in span} | _run_borders(received)
    kept = []
    for patch in held:
        cuts = sorted({patch.begin, patch.end} | {border for border in borders if patch.begin < border < patch.end})
        for begin, end in pairwise(cuts):
            if not any(b <= begin and end <= e for b, e in gone):
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
