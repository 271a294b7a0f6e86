"""Cost probe: few rays through each rank's bricks, to predict the cost of sharing data or screen.

Every rank draws a coarse picture of its share. Rank 0 derives from it how many samples each rank would take if groups
of ranks shared the screen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm import Channel
from clusterviz.comm.placement import granted_cores
from clusterviz.data.source import Index
from clusterviz.distribution.brick_cost import expected_samples
from clusterviz.frame.run import Run
from clusterviz.frame.work import DrawingRequest, Planning, RankWork
from clusterviz.image.partial import PartialImage, Rect
from clusterviz.partition import (
    UNASSIGNED,
    BspTree,
    Owners,
    Piece,
    bricks_of,
    build_tree,
    leaf_pieces,
    owner_pieces,
    owners_of,
)
from clusterviz.partition.screen import (
    COARSE,
    CostMap,
    RankGroups,
    build_cuts,
    coarse_plan,
    cost_map_of_blocks,
    visible_bricks,
)
from clusterviz.partition.screen.estimated import LONGER
from clusterviz.plan.plan import Plan
from clusterviz.render.render_result import SQUARE
from clusterviz.scene.values import Scene

EXAMINED = 16  # most expensive groups, whose ranks are computed one by one; ranks of other groups count as even
Floats = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class CostProbe:
    """Samples and optical depth of pieces, each drawn alone, in the pixels of a coarse picture.

    `piece`: int32 (bz, by, bx), piece of each brick, counted from front to back; −1 for bricks that are not visible.
    """

    scale: int  # pixels of the picture along the side of a coarse pixel
    piece: NDArray[np.int32]
    samples: Floats  # float32 (pieces, height, width), in the whole picture
    depth: Floats  # float32 (pieces, height, width), −log of the transmittance of a piece
    limit: float  # optical depth at which a ray ends; inf without early ray termination
    seconds_per_sample: float  # measured while all ranks drew
    ranks_per_core: float  # ranks for each core that they may use, at least 1


def samples_of_ranks(probe: CostProbe, plan: Plan, groups: RankGroups) -> NDArray[np.float64]:
    """Predict the samples of each rank, float64 (ranks,), if groups share the screen and a tree the data of each.

    `plan`: of the picture. `groups`: ranks of each group; a single group is sort-last.
    """
    found = np.zeros(sum(map(len, groups)))
    if len(groups) == 1:
        tree = build_tree(plan.cost, len(found))
        return np.array([each.cost.sum() for each in _maps(probe, plan, tree)])
    everything = _map(probe, plan, np.ones(len(probe.samples), np.float32))
    tiles = build_cuts(everything, tuple(map(len, groups))).rects()
    expected = expected_samples(plan)
    costs = [everything.total(tile) for tile in tiles]
    examined = set(np.argsort(costs)[::-1][:EXAMINED].tolist())
    for group, (members, tile) in enumerate(zip(groups, tiles, strict=True)):
        if len(members) == 1 or group not in examined or not tile.pixels:
            found[list(members)] = costs[group] / len(members)
            continue
        tree = build_tree(np.where(visible_bricks(plan, [tile]), expected, 0.0), len(members))
        found[list(members)] = [each.total(tile) for each in _maps(probe, plan, tree)]
    return found


def drawing_seconds(probe: CostProbe, samples: NDArray[np.float64], nodes: Sequence[Sequence[int]]) -> float:
    """Return the time of drawing: of the busiest rank, or of all ranks of a node on its cores, if that is longer."""
    alone = probe.seconds_per_sample / probe.ranks_per_core
    together = max(float(samples[list(ranks)].mean()) for ranks in nodes) * probe.seconds_per_sample
    return float(max(samples.max() * alone, together))


def _maps(probe: CostProbe, plan: Plan, tree: BspTree) -> list[CostMap]:
    """Return the cost map of each leaf of a tree."""
    owner = owners_of(tree).owner
    shown = probe.piece >= 0
    share = np.zeros((tree.ranks, len(probe.samples)))
    np.add.at(share, (owner[shown], probe.piece[shown]), plan.cost[shown])
    share /= np.maximum(share.sum(axis=0), 1e-30)
    return [_map(probe, plan, each.astype(np.float32)) for each in share]


def _map(probe: CostProbe, plan: Plan, share: Floats) -> CostMap:
    """Return the cost map of a rank that draws a share of each piece."""
    mine = share > 0
    part = share[mine, None, None]
    samples, depth = probe.samples[mine] * part, probe.depth[mine] * part
    left = _left(samples, depth, probe.limit).sum(axis=0, dtype=np.float64)
    height, width = left.shape
    # These are samples in the whole picture, not in the coarse one.
    counted = cost_map_of_blocks(plan.view.size, [(Rect(0, 0, width, height), left)], probe.scale, 1)
    return CostMap(counted.size, counted.cost / probe.scale**2)


def _left(samples: Floats, depth: Floats, limit: float) -> Floats:
    """Return the samples (pieces, height, width) that remain with early ray termination by the pieces in front."""
    if not np.isfinite(limit):
        return samples
    depth = np.minimum(depth, np.float32(limit))
    before = np.cumsum(depth, axis=0) - depth
    taken: Floats = samples * np.clip((limit - before) / np.maximum(depth, np.float32(1e-6)), 0.0, 1.0)
    return taken


SIDE = 128  # pixels of the longer side of the coarse picture, at most
BOXES = 64  # pieces of all ranks together, but at least one a rank
MOST_BOXES = 8  # pieces of a rank
PROBED = 4  # side of the picture over that of the part that is drawn at full resolution to measure time
LEAST_PROBED = 64  # pixels of that part's side
REPEATS = 3  # of that part, of which the fastest counts
DEEPEST = 30.0  # optical depth without transmittance in float32
UNKNOWN = 1e-8  # seconds a sample, if no rank took any


@dataclass(frozen=True, eq=False)
class _Piece:
    """Piece as its rank drew it: number, samples of squares of pixels, and optical depth at each pixel."""

    number: int
    rect: Rect
    work: NDArray[np.uint32]
    depth: NDArray[np.float16]


@dataclass(frozen=True, eq=False)
class _RankProbe:
    """Cost probe of one rank.

    `seconds`, `samples`: of the fastest drawing at full resolution. `host`, `cores`: that it runs on.
    """

    pieces: list[_Piece]  # that it drew
    seconds: float
    samples: int
    host: str
    cores: frozenset[int]


def probe_cost(
    run: Run,
    scene: Scene,
    plan: Plan,
    holds: frozenset[Index] = frozenset(),
    seconds_per_sample: float | None = None,
) -> Planning[CostProbe | None]:
    """Return the cost probe; collective.

    Parameters
    ----------
    run : of the loop
    scene : completed
    plan : of the scene
    holds : further bricks to keep
    seconds_per_sample : if known, the same on all ranks; None: draw a part of the picture to measure it

    Returns
    -------
    probe : on rank 0; None elsewhere
    """
    channel = run.channel
    with run.collective("plan", "plan"):
        place = channel.placement()
    with run.local("plan", "plan"):
        boxes, owner = _boxes(plan, channel.size)
        scale = max(COARSE, -(-max(plan.view.size) // SIDE))
        work = RankWork(scene, plan, boxes, leaf_bricks(plan, channel.rank, channel.size) | holds)
    drawn = yield DrawingRequest(run, replace(work, plan=coarse_plan(plan, scale)), loads=work, stage="choose")
    numbers = [number for number, box in enumerate(boxes) if box.rank == channel.rank]
    each = zip(numbers, drawn.partials, drawn.sample_counts, strict=True)
    found = [_found(plan.pictures, *piece) for piece in each]
    part = replace(work, pieces=_busiest_part(plan, channel, found, scale))
    seconds, samples = (yield from _measured(run, part)) if seconds_per_sample is None else (0.0, 0)
    with run.collective("plan", "choose"):
        ranks = channel.gather(_RankProbe(found, seconds, samples, place.host, granted_cores()))
    with run.local("plan", "choose"):
        return None if ranks is None else _cost_probe(plan, ranks, owner, len(boxes), scale, seconds_per_sample)


def _boxes(plan: Plan, ranks: int) -> tuple[tuple[Piece, ...], NDArray[np.int32]]:
    """Divide sort-last's leaves into pieces, front to back; also returns each brick's piece, −1 if invisible."""
    each = max(1, min(MOST_BOXES, BOXES // ranks))
    owner = np.full(plan.cost.shape, UNASSIGNED, np.int32)
    for leaf in build_tree(plan.cost, ranks).leaves:
        inside = plan.cost[leaf.box.slices]
        if inside.size:
            owner[leaf.box.slices] = leaf.rank * each + owners_of(build_tree(inside, each)).owner
    shown = plan.cost > 0
    owners = Owners(ranks * each, np.where(shown, owner, UNASSIGNED).astype(np.int32))
    pieces = owner_pieces(owners, plan.eye_in_bricks(), plan.view.forward)
    number = np.full(plan.cost.shape, UNASSIGNED, np.int32)
    for at, piece in enumerate(pieces):
        number[tuple(piece.members(shown).T)] = at
    return tuple(replace(piece, rank=piece.rank // each) for piece in pieces), number


def leaf_bricks(plan: Plan, rank: int, ranks: int) -> frozenset[Index]:
    """Return the bricks that a rank needs for the cost probe: those of its sort-last leaf."""
    bricks = bricks_of(build_tree(plan.cost, ranks), rank, plan.cost)
    return frozenset((z, y, x) for z, y, x in bricks.tolist())


def _found(rows: int, number: int, partial: PartialImage, work: tuple[Rect, NDArray[np.uint32]]) -> _Piece:
    """Return the optical depth and the samples of a drawn piece, whose image has so many rows for one of the screen."""
    with np.errstate(divide="ignore"):
        depth = -np.log(np.maximum(0.0, 1.0 - partial.rgba[::rows, :, 3].astype(np.float64)))
    return _Piece(number, *work, np.minimum(depth, DEEPEST).astype(np.float16))


def _busiest_part(plan: Plan, channel: Channel, found: list[_Piece], scale: int) -> tuple[Piece, ...]:
    """Return this rank's leaf in a part of the picture, around the pixels with most samples."""
    busiest = max(found, key=lambda piece: int(piece.work.max(initial=0)), default=None)
    if busiest is None or not busiest.work.any():
        return ()
    row, column = np.unravel_index(int(busiest.work.argmax()), busiest.work.shape)
    middle = [scale * (begin + SQUARE * (at + 0.5)) for begin, at in
              ((busiest.rect.x_begin, int(column)), (busiest.rect.y_begin, int(row)))]  # fmt: skip
    begins, ends = [], []
    for centre, side in zip(middle, plan.view.size, strict=True):
        length = min(side, max(LEAST_PROBED, side // PROBED))
        begin = min(max(0, int(centre) - length // 2), side - length)
        begins.append(begin)
        ends.append(begin + length)
    tree = build_tree(plan.cost, channel.size)
    leaves = leaf_pieces(tree, plan.cost, plan.eye_in_bricks(), plan.view.forward)
    return tuple(replace(leaf, rect=Rect(*begins, *ends)) for leaf in leaves if leaf.rank == channel.rank)


def _measured(run: Run, work: RankWork) -> Planning[tuple[float, int]]:
    """Measure seconds and samples of drawing; the fastest of several counts, since other processes only add time."""
    times = []
    for _ in range(REPEATS):
        drawn = yield DrawingRequest(run, work, stage="choose")
        times.append(drawn.seconds)
    return min(times), drawn.counts.samples


def _cost_probe(
    plan: Plan,
    ranks: list[_RankProbe],
    owner: NDArray[np.int32],
    pieces: int,
    scale: int,
    seconds_per_sample: float | None,
) -> CostProbe:
    width, height = (-(-side // scale) for side in plan.view.size)
    samples, depth = (np.zeros((pieces, height, width), np.float32) for _ in range(2))
    for each in (piece for rank in ranks for piece in rank.pieces):
        rect = each.rect
        place = each.number, slice(rect.y_begin, rect.y_end), slice(rect.x_begin, rect.x_end)
        depth[place] = each.depth
        samples[place] = LONGER * scale**2 * _by_pixel(rect, each.work)
    ends = plan.blend_mode.traits.composited and plan.march.residual > 0
    limit = -np.log(plan.march.residual) / LONGER if ends else np.inf
    taken = sum(rank.samples for rank in ranks)
    measured = sum(rank.seconds for rank in ranks if rank.samples) / taken if taken else UNKNOWN
    return CostProbe(scale, owner, samples, depth, float(limit), seconds_per_sample or measured, _ranks_per_core(ranks))


def _by_pixel(rect: Rect, work: NDArray[np.uint32]) -> NDArray[np.float64]:
    """Return the samples of each pixel (height, width), from those of squares, divided evenly."""
    rows, columns = (
        np.minimum(SQUARE, side - SQUARE * np.arange(-(-side // SQUARE))) for side in (rect.height, rect.width)
    )
    even = work / np.outer(rows, columns)
    return np.repeat(np.repeat(even, rows, axis=0), columns, axis=1)


def _ranks_per_core(ranks: list[_RankProbe]) -> float:
    """Return the largest number of ranks for each core."""
    shares = [
        sum(1 / sum(core in other.cores and other.host == mine.host for other in ranks) for core in mine.cores)
        for mine in ranks
    ]
    return max(1.0, 1 / min(shares))
