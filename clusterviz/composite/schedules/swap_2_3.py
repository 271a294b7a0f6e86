"""2-3 swap: binary swap for any number of ranks, in groups of two or three, with no rank idle.

What: the ranks are the leaves, at depth ⌊log₂ n⌋, of a tree with groups of two or three. In each stage the m ranks
below a node cut the picture into m pieces, such that the new piece of a rank lies inside its old one.
When: numbers of ranks that are no power of two, with dense images; the work is balanced.
When not: a power of two, where it is binary swap; sparse images. The simpler variants are often as fast (Moreland
2018).
Cost: ⌊log₂ n⌋ rounds, at most 2n·⌊log₂ n⌋ messages (16 at 5 ranks, 1356 at 127, 13,400 at 1000); a rank sends P without
its own piece and receives at most 1.11·P.
Limits: one partial image a rank, or several adjacent in depth.
Reference: H. Yu et al., "Massively parallel volume rendering using 2-3 swap image compositing", SC 2008.
"""

from __future__ import annotations

import numpy as np

from clusterviz.composite.schedules.schedule import Indices, Patches, Schedule, Stage


def schedule(ranks: int, pixels: int, footprints: Patches = ()) -> Schedule:
    """Return the schedule: one stage for each level of the tree, from the leaves to the root."""
    levels = _levels(ranks)
    owners = np.arange(ranks, dtype=np.int64)
    begin, end = np.zeros(ranks, np.int64), np.full(ranks, pixels, np.int64)
    stages = []
    for parents, children in zip(levels[-2::-1], levels[:0:-1], strict=True):
        owners = _assign_pieces(owners, parents, children)
        new_begin, new_end = _regions(owners, parents, pixels)
        stages.append(_stage(owners, parents, (begin, end), (new_begin, new_end), pixels))
        begin, end = new_begin, new_end
    return Schedule(ranks, pixels, tuple(stages))


def split(ranks: int) -> tuple[int, ...]:
    """Return the sizes of a node's children: two halves of equal depth, or three thirds if there are none."""
    half, third = ranks // 2, ranks // 3
    if half.bit_length() == (ranks - half).bit_length():
        return half, ranks - half
    return third, third, ranks - 2 * third


def _levels(ranks: int) -> list[list[int]]:
    """Return the sizes of the nodes of each level, root first, leaves last; each child follows its elder siblings."""
    levels = [[ranks]] if ranks else [[]]
    while levels[-1] and max(levels[-1]) > 1:
        levels.append([size for parent in levels[-1] for size in split(parent)])
    return levels


def _assign_pieces(owners: Indices, parents: list[int], children: list[int]) -> Indices:
    """Return the owners of the pieces of each parent: from its children round-robin, larger children first.

    `owners` and the result hold the ranks of one node after those of another; position i in a node owns piece i.
    """
    parent_of_child, place = [], []
    for number, parent in enumerate(parents):
        sizes = split(parent)
        by_size = sorted(range(len(sizes)), key=lambda child: -sizes[child])
        parent_of_child += [number] * len(sizes)
        place += [by_size.index(child) for child in range(len(sizes))]
    keys = (np.repeat(place, children), _position(children), np.repeat(parent_of_child, children))
    return owners[np.lexsort(keys)]


def _position(sizes: list[int]) -> Indices:
    ends = np.cumsum(sizes)
    return np.arange(ends[-1], dtype=np.int64) - np.repeat(ends - sizes, sizes)


def _regions(owners: Indices, sizes: list[int], pixels: int) -> tuple[Indices, Indices]:
    """Return the range of each rank: piece i of m for the owner at position i of a node of m."""
    position, members = _position(sizes), np.repeat(sizes, sizes)
    begin, end = np.empty_like(position), np.empty_like(position)
    begin[owners], end[owners] = position * pixels // members, (position + 1) * pixels // members
    return begin, end


def _stage(
    owners: Indices, sizes: list[int], old: tuple[Indices, Indices], new: tuple[Indices, Indices], pixels: int
) -> Stage:
    """Return the transfers within each node: from each rank the part of its old piece in another's new one."""
    begin, end = old
    # Ranks of a node are consecutive, so a node begins in `owners` at its first rank.
    start, members = np.repeat(np.cumsum(sizes) - sizes, sizes), np.repeat(sizes, sizes)
    full = np.flatnonzero(end > begin)
    first = _piece_of(begin[full], members[full], pixels)
    last = _piece_of(end[full] - 1, members[full], pixels)
    found = []
    for offset in range(int((last - first).max(initial=-1)) + 1):
        source = full[first + offset <= last]
        target = owners[start[source] + first[first + offset <= last] + offset]
        overlap = np.maximum(begin[source], new[0][target]), np.minimum(end[source], new[1][target])
        found.append(Stage.of_columns(source, target, *overlap))
    return Stage.join(found)


def _piece_of(pixel: Indices, pieces: Indices, pixels: int) -> Indices:
    return ((pixel + 1) * pieces - 1) // pixels
