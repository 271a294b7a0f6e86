"""What a pre-pass found, and how many samples each rank would take if groups of ranks shared the screen.

The pre-pass draws few rays through boxes of bricks, each as if it stood alone: how many samples, and how much light is
left behind it. From that follows what any sharing takes. A rank ends a ray by what it draws itself: in sort-last by its
own leaf, in sort-first by all that lies in front. Where a ray would end inside a box, the box is taken to be even.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clusterviz.balance.expected import expected_samples
from clusterviz.image.region import Rect
from clusterviz.partition import BspTree, build_tree, owners_of
from clusterviz.partition.screen import CostMap, RankGroups, build_cuts, cost_map_of_blocks, visible_bricks
from clusterviz.plan.plan import Plan

FOLLOWED = 16  # groups whose members are looked at one by one, the dearest; the members of others count as even
Floats = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Sounding:
    """Samples of pieces, each drawn as if it stood alone, over a coarse picture.

    Attributes
    ----------
    scale : pixels of the picture along the side of one here
    piece : int32 (bz, by, bx), the piece of each brick, counted from front to back; −1 for those that are not shown
    samples : float32 (pieces, height, width), of the whole picture
    depth : float32 (pieces, height, width), −log of the light that a piece leaves
    limit : the depth at which a ray ends; inf where none does early
    seconds_per_sample : as measured while all ranks drew
    crowd : ranks for each core that they may use, at least 1
    """

    scale: int
    piece: NDArray[np.int32]
    samples: Floats
    depth: Floats
    limit: float
    seconds_per_sample: float
    crowd: float


def samples_of_ranks(sounding: Sounding, plan: Plan, groups: RankGroups) -> NDArray[np.float64]:
    """The samples of each rank, float64 (ranks,), where groups share the screen and a tree deals out each one's data.

    Parameters
    ----------
    plan : of the picture
    groups : the ranks of each; one group is sort-last
    """
    found = np.zeros(sum(map(len, groups)))
    if len(groups) == 1:
        tree = build_tree(plan.cost, len(found))
        return np.array([each.cost.sum() for each in _maps(sounding, plan, tree)])
    everything = _map(sounding, plan, np.ones(len(sounding.samples), np.float32))
    windows = build_cuts(everything, tuple(map(len, groups))).rects()
    expected = expected_samples(plan)
    costs = [everything.total(window) for window in windows]
    dearest = set(np.argsort(costs)[::-1][:FOLLOWED].tolist())
    for group, (members, window) in enumerate(zip(groups, windows, strict=True)):
        if len(members) == 1 or group not in dearest or not window.pixels:
            found[list(members)] = costs[group] / len(members)
            continue
        tree = build_tree(np.where(visible_bricks(plan, [window]), expected, 0.0), len(members))
        found[list(members)] = [each.total(window) for each in _maps(sounding, plan, tree)]
    return found


def drawing_seconds(sounding: Sounding, samples: NDArray[np.float64], nodes: Sequence[Sequence[int]]) -> float:
    """How long ranks draw that take so many samples: as the busiest, or as all of a node with the cores that it has."""
    alone = sounding.seconds_per_sample / sounding.crowd
    together = max(float(samples[list(ranks)].mean()) for ranks in nodes) * sounding.seconds_per_sample
    return float(max(samples.max() * alone, together))


def _maps(sounding: Sounding, plan: Plan, tree: BspTree) -> list[CostMap]:
    """Where on the screen each leaf of a tree takes samples."""
    owner = owners_of(tree).owner
    shown = sounding.piece >= 0
    share = np.zeros((tree.ranks, len(sounding.samples)))
    np.add.at(share, (owner[shown], sounding.piece[shown]), plan.cost[shown])
    share /= np.maximum(share.sum(axis=0), 1e-30)
    return [_map(sounding, plan, each.astype(np.float32)) for each in share]


def _map(sounding: Sounding, plan: Plan, share: Floats) -> CostMap:
    """Where somebody takes samples who draws a share of each piece."""
    mine = share > 0
    part = share[mine, None, None]
    samples, depth = sounding.samples[mine] * part, sounding.depth[mine] * part
    left = _left(samples, depth, sounding.limit).sum(axis=0, dtype=np.float64)
    height, width = left.shape
    # Samples are those of the whole picture already.
    counted = cost_map_of_blocks(plan.view.size, [(Rect(0, 0, width, height), left)], sounding.scale, 1)
    return CostMap(counted.size, counted.cost / sounding.scale**2)


def _left(samples: Floats, depth: Floats, limit: float) -> Floats:
    """What is taken of pieces' samples (pieces, height, width), front to back, by one who has drawn those in front."""
    if not np.isfinite(limit):
        return samples
    depth = np.minimum(depth, np.float32(limit))
    before = np.cumsum(depth, axis=0) - depth
    taken: Floats = samples * np.clip((limit - before) / np.maximum(depth, np.float32(1e-6)), 0.0, 1.0)
    return taken
