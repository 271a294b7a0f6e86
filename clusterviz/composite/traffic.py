"""Traffic of a schedule for given footprints: the patches that travel, and those that a rank holds after each stage.

A schedule transfers ranges of the canvas. Every rank knows the footprints of all images, so it can compute which pixels
it will receive: messages need no header, and empty ones are neither sent nor expected.

A rank may begin with several layers (one for each convex group of its bricks). They travel together, each with its
depth, to the rank that merges them. A merged layer has the depth of the rank's own first layer, which is part of it.
Layers are only merged with neighbours, so any of the merged depths gives the right order.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from clusterviz.composite.fragment import Patch, unite
from clusterviz.composite.schedules.schedule import Schedule, Stage, Transfer
from clusterviz.image.partial import Rect
from clusterviz.scene.transfer import distinct


@dataclass(frozen=True)
class Part:
    """A patch of one layer; `depth` is the layer's index in visibility order, 0 in front."""

    depth: int
    patch: Patch


@dataclass(frozen=True)
class Zone:
    """A range [begin, end) that a rank holds, with the parts of its layers that are not blank, front to back."""

    begin: int
    end: int
    parts: tuple[Part, ...]

    def cut(self, begin: int, end: int) -> Zone:
        """Return the sub-range [begin, end), which lies inside."""
        cut = ((part.depth, part.patch.cut(begin, end)) for part in self.parts)
        return Zone(begin, end, tuple(Part(depth, patch) for depth, patch in cut if patch.count))


Held = tuple[Zone, ...]
# Layers of each rank at the beginning, front to back; a single patch for most.
Layers = Sequence[Sequence[Part]]


@dataclass(frozen=True)
class Message:
    """Parts that travel between this rank and a peer in one message, in this order."""

    peer: int
    parts: tuple[Part, ...]

    @cached_property
    def pixels(self) -> int:
        """Number of pixels in the message, at least one."""
        return sum(part.patch.count for part in self.parts)


@dataclass(frozen=True)
class Merge:
    """Merge of all parts in one range that a rank keeps."""

    zone: Zone  # the rank's own parts in the range
    incoming: tuple[Part, ...]  # parts that arrive
    result: Patch  # patch that contains all parts
    depth: int  # depth of the merged layer

    @property
    def merged(self) -> Zone:
        """Zone after the merge: one layer, or none."""
        parts = (Part(self.depth, self.result),) if self.result.count else ()
        return Zone(self.zone.begin, self.zone.end, parts)


@dataclass(frozen=True)
class StageTraffic:
    """Messages (none empty) and merges of one rank in one stage."""

    sends: tuple[Message, ...]
    receives: tuple[Message, ...]
    merges: tuple[Merge, ...]


def plan_traffic(
    schedule: Schedule, rank: int, layers: Layers, width: int, *, whole: bool = False
) -> tuple[StageTraffic, ...]:
    """Return the messages and merges of one rank, stage by stage.

    `layers`: layers of each position; the range of each patch is the whole canvas. `whole`: whether the last merges
    make all pixels of their ranges, also blank ones, so that the final gather needs no headers.
    """
    if not schedule.stages and len(layers[rank]) > 1:
        # Nothing is sent, but the rank's own layers have to be merged.
        schedule = Schedule(schedule.ranks, schedule.pixels, (Stage.join(()),))
    concerned = _concerned(schedule, rank)
    there = {r: tuple(part for part in layers[r] if part.patch.count) for r in concerned[0]}
    held: dict[int, Held] = {r: (Zone(0, schedule.pixels, parts),) for r, parts in there.items()}
    result = []
    for number, stage in enumerate(schedule.stages):
        views = {r: _stage_traffic(stage, r, held, layers[r][0].depth, width) for r in {rank, *concerned[number + 1]}}
        last = whole and number == len(schedule.stages) - 1
        result.append(_whole_ranges(views[rank], schedule.pixels, width) if last else views[rank])
        held = {r: tuple(merge.merged for merge in views[r].merges) for r in concerned[number + 1]}
    return tuple(result)


def owned_ranges(schedule: Schedule) -> list[tuple[int, int, int]] | None:
    """Return the final owners as (rank, begin, end), ascending; None if pixels stay on the rank that covers them.

    The owner of a pixel is the target of its last transfer, if all ranks but one send every pixel away.
    """
    moved = sum(int((stage.table[:, 3] - stage.table[:, 2]).sum()) for stage in schedule.stages)
    if moved != (schedule.ranks - 1) * schedule.pixels:
        return None
    tables = [np.unique(stage.table[:, 1:], axis=0) for stage in schedule.stages]
    cuts = distinct(np.array([0, schedule.pixels]), *(table[:, 1:].ravel() for table in tables))
    owner = np.full(len(cuts) - 1, -1, np.int64)
    for table in tables:
        spans = np.searchsorted(cuts, table[:, 1:]).tolist()
        for target, (first, last) in zip(table[:, 0].tolist(), spans, strict=True):
            owner[first:last] = target
    if schedule.ranks == 1:
        owner[:] = 0
    new = np.flatnonzero(np.diff(owner, prepend=-1))
    begins = cuts[new].tolist()
    return list(zip(owner[new].tolist(), begins, [*begins[1:], schedule.pixels], strict=False))


def _whole_ranges(stage: StageTraffic, pixels: int, width: int) -> StageTraffic:
    canvas = Patch(width, 0, pixels, Rect(0, 0, width, pixels // max(width, 1)))
    merges = (replace(merge, result=canvas.cut(merge.zone.begin, merge.zone.end)) for merge in stage.merges)
    return replace(stage, merges=tuple(merges))


def _concerned(schedule: Schedule, rank: int) -> list[set[int]]:
    """Return the ranks whose zones before each stage (and after the last) determine the messages of one rank."""
    needed = [{rank}]
    for stage in reversed(schedule.stages):
        needed.append(needed[-1] | {t.source for r in needed[-1] for t in stage.received_by(r)})
    return needed[::-1]


def _stage_traffic(stage: Stage, rank: int, held: dict[int, Held], depth: int, width: int) -> StageTraffic:
    leaving, coming = stage.sent_by(rank), stage.received_by(rank)
    sent = [(t.target, _find(held[rank], t)) for t in leaving]
    received = [(t.source, _find(held[t.source], t)) for t in coming]
    kept = _cut_out(held[rank], leaving, coming)
    incoming = [part for _, zone in received for part in zone.parts]
    return StageTraffic(_messages(sent), _messages(received), _merges(kept, incoming, depth, width))


def _find(held: Held, transfer: Transfer) -> Zone:
    """Return the zone of a transfer's range in the zones that a rank holds.

    Raises ValueError if the range is not inside one zone; no algorithm may do that.
    """
    index = bisect_right(held, transfer.begin, key=lambda zone: zone.begin) - 1
    if index < 0 or transfer.end > held[index].end:
        raise ValueError(f"pixels [{transfer.begin}, {transfer.end}) are not held in one piece")
    return held[index].cut(transfer.begin, transfer.end)


def _merges(kept: Held, incoming: Iterable[Part], depth: int, width: int) -> tuple[Merge, ...]:
    coming = sorted(incoming, key=lambda part: (part.patch.begin, part.depth))
    starts = [part.patch.begin for part in coming]
    merges = []
    for zone in kept:
        inside = tuple(coming[bisect_left(starts, zone.begin) : bisect_left(starts, zone.end)])
        patches = [part.patch for part in (*zone.parts, *inside)]
        result = patches[0] if len(patches) == 1 and not inside else unite(width, zone.begin, zone.end, patches)
        merges.append(Merge(zone, inside, result, depth))
    return tuple(merges)


def _messages(zones: Iterable[tuple[int, Zone]]) -> tuple[Message, ...]:
    by_peer: dict[int, list[Part]] = {}
    for peer, zone in zones:
        if zone.parts:
            by_peer.setdefault(peer, []).extend(zone.parts)
    return tuple(Message(peer, tuple(by_peer[peer])) for peer in sorted(by_peer))


def _cut_out(held: Held, leaving: Sequence[Transfer], coming: Sequence[Transfer]) -> Held:
    """Return the zones without the ranges that are sent, cut where a run of received ranges begins or ends."""
    gone = sorted((transfer.begin, transfer.end) for transfer in leaving)
    starts = [begin for begin, _ in gone]
    borders = sorted({border for span in gone for border in span} | _run_borders(coming))
    kept = []
    for zone in held:
        inside = borders[bisect_right(borders, zone.begin) : bisect_left(borders, zone.end)]
        for begin, end in pairwise([zone.begin, *inside, zone.end]):
            index = bisect_right(starts, begin) - 1
            if index < 0 or end > gone[index][1]:
                kept.append(zone.cut(begin, end))
    return tuple(kept)


def _run_borders(transfers: Sequence[Transfer]) -> set[int]:
    """Return where runs of overlapping or touching ranges begin and end."""
    borders: set[int] = set()
    reached = -1
    for begin, end in sorted((transfer.begin, transfer.end) for transfer in transfers):
        if begin > reached:
            borders |= {begin, reached} if reached >= 0 else {begin}
        reached = max(reached, end)
    return borders | ({reached} if reached >= 0 else set())
