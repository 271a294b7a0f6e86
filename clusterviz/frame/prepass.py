"""The pre-pass before a mode is chosen: every rank draws few rays through its share, and rank 0 learns what they took.

It takes about one sample in 64 of a small picture, less of a large one, and once a sixteenth of the picture by its own
slabs, which tells what a sample costs on the device that draws. The bricks are those of sort-last, which need the least
memory; they stay where they are for the frames that follow. That part is drawn three times, and each rank's shortest
time counts: what is chosen by a clock shall not depend on what else the machine does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm import Channel
from clusterviz.comm.placement import granted_cores
from clusterviz.data.source import Index
from clusterviz.frame.drawing import Drawing
from clusterviz.frame.run import Run
from clusterviz.frame.several import Opened
from clusterviz.frame.share import Share
from clusterviz.frame.sounding import Sounding
from clusterviz.image.partial import PartialImage
from clusterviz.image.region import Rect
from clusterviz.partition import UNASSIGNED, Owners, Piece, bricks_of, build_tree, leaf_pieces, owner_pieces, owners_of
from clusterviz.partition.screen import COARSE, coarse_plan
from clusterviz.partition.screen.estimated import LONGER
from clusterviz.plan.plan import Plan
from clusterviz.render.drawn import SQUARE
from clusterviz.scene.values import Scene

SIDE = 128  # pixels of the longer side of the coarse picture, at most
BOXES = 64  # of all ranks together, if that is not less than one a rank
MOST_BOXES = 8  # of a rank
CLOSE = 4  # the picture's side over that of the part that is drawn by its own slabs
LEAST_CLOSE = 64  # pixels of that part's side
LOOKS = 3  # at that part, of which the shortest counts
DEEPEST = 30.0  # no light is left that float32 could tell
UNKNOWN = 1e-8  # seconds a sample, where no rank took any


@dataclass(frozen=True, eq=False)
class _Piece:
    """A piece as its rank drew it: its number, the samples of squares of pixels, and how deep it is at each pixel."""

    number: int
    rect: Rect
    work: NDArray[np.uint32]
    depth: NDArray[np.float16]


@dataclass(frozen=True, eq=False)
class _Told:
    """What one rank found.

    Attributes
    ----------
    pieces : that it drew
    seconds, samples : of the shortest close look
    host, cores : where it runs
    """

    pieces: list[_Piece]
    seconds: float
    samples: int
    host: str
    cores: frozenset[int]


def sound(
    run: Run,
    drawing: Drawing,
    opened: Opened,
    scene: Scene,
    plan: Plan,
    holds: frozenset[Index] = frozenset(),
    seconds_per_sample: float | None = None,
) -> Sounding | None:
    """Draw the pre-pass; collective.

    Parameters
    ----------
    drawing : which keeps the bricks
    plan : of the completed scene's picture
    holds : bricks that are kept besides
    seconds_per_sample : where it is known on all ranks, nothing is drawn to measure it

    Returns
    -------
    sounding : on rank 0; None elsewhere
    """
    channel = run.channel
    with run.together("plan", "plan"):
        place = channel.placement()
    with run.alone("plan", "plan"):
        boxes, owner = _boxes(plan, channel.size)
        scale = max(COARSE, -(-max(plan.view.size) // SIDE))
        share = Share(scene, plan, boxes, leaf_bricks(plan, channel.rank, channel.size) | holds)
    drawing.bring(opened, share)
    with run.aside("choose"):
        partials, _ = drawing.draw(replace(share, plan=coarse_plan(plan, scale)))
        numbers = [number for number, box in enumerate(boxes) if box.rank == channel.rank]
        found = list(map(_found, numbers, partials, drawing.work))
        closer = replace(share, pieces=_close_look(plan, channel, found, scale))
        seconds, samples = _measured(run, drawing, closer) if seconds_per_sample is None else (0.0, 0)
    with run.together("plan", "choose"):
        told = channel.gather(_Told(found, seconds, samples, place.host, granted_cores()))
    with run.alone("plan", "choose"):
        return None if told is None else _sounding(plan, told, owner, len(boxes), scale, seconds_per_sample)


def _boxes(plan: Plan, ranks: int) -> tuple[tuple[Piece, ...], NDArray[np.int32]]:
    """Sort-last's leaves, each in some boxes, from front to back; and the piece of each brick, −1 for hidden ones."""
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
    """The bricks that a rank needs for the pre-pass: those of sort-last."""
    bricks = bricks_of(build_tree(plan.cost, ranks), rank, plan.cost)
    return frozenset((z, y, x) for z, y, x in bricks.tolist())


def _found(number: int, partial: PartialImage, work: tuple[Rect, NDArray[np.uint32]]) -> _Piece:
    """A piece as it is told: how deep it is, and where samples were taken."""
    with np.errstate(divide="ignore"):
        depth = -np.log(np.maximum(0.0, 1.0 - partial.rgba[..., 3].astype(np.float64)))
    return _Piece(number, *work, np.minimum(depth, DEEPEST).astype(np.float16))


def _close_look(plan: Plan, channel: Channel, found: list[_Piece], scale: int) -> tuple[Piece, ...]:
    """This rank's leaf in a part of the picture, round where it took most samples."""
    busiest = max(found, key=lambda piece: int(piece.work.max(initial=0)), default=None)
    if busiest is None or not busiest.work.any():
        return ()
    row, column = np.unravel_index(int(busiest.work.argmax()), busiest.work.shape)
    middle = [scale * (begin + SQUARE * (at + 0.5)) for begin, at in
              ((busiest.rect.x_begin, int(column)), (busiest.rect.y_begin, int(row)))]  # fmt: skip
    begins, ends = [], []
    for centre, side in zip(middle, plan.view.size, strict=True):
        length = min(side, max(LEAST_CLOSE, side // CLOSE))
        begin = min(max(0, int(centre) - length // 2), side - length)
        begins.append(begin)
        ends.append(begin + length)
    tree = build_tree(plan.cost, channel.size)
    leaves = leaf_pieces(tree, plan.cost, plan.eye_in_bricks(), plan.view.forward)
    return tuple(replace(leaf, rect=Rect(*begins, *ends)) for leaf in leaves if leaf.rank == channel.rank)


def _measured(run: Run, drawing: Drawing, share: Share) -> tuple[float, int]:
    """Seconds and samples of a share that is drawn more than once: what else runs on the machine only adds time."""
    looks = []
    for _ in range(LOOKS):
        before = run.clock.seconds.get("render", 0.0)
        _, counts = drawing.draw(share)
        looks.append(run.clock.seconds.get("render", 0.0) - before)
    return min(looks), counts.samples


def _sounding(
    plan: Plan, told: list[_Told], owner: NDArray[np.int32], pieces: int, scale: int, seconds_per_sample: float | None
) -> Sounding:
    """What all ranks told, over one picture."""
    width, height = (-(-side // scale) for side in plan.view.size)
    samples, depth = (np.zeros((pieces, height, width), np.float32) for _ in range(2))
    for each in (piece for rank in told for piece in rank.pieces):
        rect = each.rect
        place = each.number, slice(rect.y_begin, rect.y_end), slice(rect.x_begin, rect.x_end)
        depth[place] = each.depth
        samples[place] = LONGER * scale**2 * _by_pixel(rect, each.work)
    ends = plan.look.operator == "over" and plan.march.residual > 0
    limit = -np.log(plan.march.residual) / LONGER if ends else np.inf
    taken = sum(rank.samples for rank in told)
    measured = sum(rank.seconds for rank in told if rank.samples) / taken if taken else UNKNOWN
    return Sounding(scale, owner, samples, depth, float(limit), seconds_per_sample or measured, _crowd(told))


def _by_pixel(rect: Rect, work: NDArray[np.uint32]) -> NDArray[np.float64]:
    """Samples of each pixel (height, width), from those of squares, in which they count as even."""
    rows, columns = (
        np.minimum(SQUARE, side - SQUARE * np.arange(-(-side // SQUARE))) for side in (rect.height, rect.width)
    )
    even = work / np.outer(rows, columns)
    return np.repeat(np.repeat(even, rows, axis=0), columns, axis=1)


def _crowd(told: list[_Told]) -> float:
    """Ranks for each core where that is most."""
    shares = [
        sum(1 / sum(core in other.cores and other.host == mine.host for other in told) for core in mine.cores)
        for mine in told
    ]
    return max(1.0, 1 / min(shares))
