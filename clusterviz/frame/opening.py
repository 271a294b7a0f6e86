"""Opening volumes: each rank reads an equal share of their bricks, and all learn what they hold; later, bricks."""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data import open_volume, override_grid
from clusterviz.data.bricks import BrickLayout, read_bricks
from clusterviz.data.source import Index, Source
from clusterviz.data.summary import VolumeSummary, summarise
from clusterviz.errors import InputError
from clusterviz.frame.run import Run
from clusterviz.frame.several import Opened, OpenedVolumes
from clusterviz.frame.share import Bricks, OpenedVolume
from clusterviz.partition import bricks_of, build_tree, refined_edges
from clusterviz.plan.look import LARGEST_MARGIN, classification_of, margin_of
from clusterviz.plan.plan import Plan, brick_cost
from clusterviz.report.machine import memory
from clusterviz.scene.complete import complete_scene
from clusterviz.scene.values import Scene

HELD_SHARE_OF_MEMORY = 0.4
MOST_BRICKS = 1 << 17
"""For each rank: every brick takes some time in Python, however small it is."""
Given = Source | Sequence[Source] | None
"""Data instead of the files that a scene names: of its volume, or of each."""


def open_volumes(run: Run, scene: Scene, source: Given = None) -> Opened | None:
    """Read an equal share of each volume's bricks, and learn together what they hold.

    The share of a single volume is kept for drawing; several are read again, as bricks of their domain.

    Parameters
    ----------
    source : of the volume, or one for each, instead of the files that the scene names
    """
    if not scene.volumes:
        return None
    with run.alone("open", "load"):
        sources = _sources(scene, source)
        margins = [
            LARGEST_MARGIN
            if scene.automatic
            else margin_of(volume, classification_of(scene.quality), scene.quality.borders)
            for volume in scene.volumes
        ]
        layouts = [
            BrickLayout(each.grid.shape_zyx, scene.cluster.brick, margin)
            for each, margin in zip(sources, margins, strict=True)
        ]
        _check_bricks([each.grid.shape_zyx for each in sources], scene.cluster.brick, run.channel.size)
    with run.together("read", "load"):
        most_bytes = HELD_SHARE_OF_MEMORY * memory().available_bytes / run.channel.placement().local_size
    with run.alone("read", "load"):
        shares = [_equal_share(layout, run) for layout in layouts]
        samples = sum(
            len(share) * (layout.brick + 1 + 2 * layout.margin) ** 3 * each.dtype.itemsize
            for each, layout, share in zip(sources, layouts, shares, strict=True)
        )
        fits, three = samples <= most_bytes, list(zip(sources, layouts, shares, strict=True))
        held = [dict(read_bricks(*one)) if fits else {} for one in three]
    with run.together("summarise", "load"):
        opened = tuple(
            OpenedVolume(one[0], one[1], _summary(run, *one, bricks if fits else None), bricks)
            for one, bricks in zip(three, held, strict=True)
        )
    if len(opened) > 1:
        return OpenedVolumes(tuple(replace(each, held={}) for each in opened), {})
    with run.alone("plan", "plan"):
        return _with_larger_bricks(opened[0], scene, run.channel.size)


def _with_larger_bricks(opened: OpenedVolume, scene: Scene, ranks: int) -> OpenedVolume:
    """The volume in bricks that are small near the planes between ranks, as expected, and larger elsewhere.

    References
    ----------
    M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 5.3.6.
    """
    largest, brick = scene.cluster.largest_brick, scene.cluster.brick
    if largest is None or largest == brick:
        return opened
    tree = build_tree(opened.plan(complete_scene(scene, opened.facts)).cost, ranks)
    edges, summary = refined_edges(tree, largest // brick), opened.summary

    def joined(pick: np.ufunc, values: NDArray[Any]) -> NDArray[Any]:
        for axis, inner in enumerate(edges):
            values = pick.reduceat(values, [0, *inner], axis)
        return values

    found = joined(np.minimum, summary.minimum), joined(np.maximum, summary.maximum)
    summary = replace(
        summary, minimum=found[0], maximum=found[1], has_invalid=joined(np.logical_or, summary.has_invalid)
    )
    return replace(opened, layout=replace(opened.layout, edges_zyx=edges), summary=summary, held={})


def _check_bricks(shapes: Sequence[Index], brick: int, ranks: int) -> None:
    """Refuse bricks that are so many that preparing them would take minutes."""

    def bricks(side: int) -> int:
        return sum(int(np.prod(BrickLayout(shape, side).counts_zyx)) for shape in shapes)

    if (found := bricks(brick)) > MOST_BRICKS * ranks:
        fitting = next(side for side in range(brick, max(map(max, shapes)) + 1) if bricks(side) <= MOST_BRICKS * ranks)
        text, allowed = "too many bricks", f"{fitting} or more, which makes {bricks(fitting)} bricks"
        raise InputError(
            text,
            where="cluster.brick",
            found=f"{brick}, which makes {found} bricks on {ranks} rank{'s' * (ranks > 1)}",
            allowed=allowed,
        )


def _sources(scene: Scene, given: Given) -> list[Source]:
    """The source of each volume."""
    if given is None:
        return [open_volume(volume) for volume in scene.volumes]
    sources = list(given) if isinstance(given, Sequence) else [given]
    if len(sources) != len(scene.volumes):
        raise InputError("not one for each volume", where="sources", found=len(sources), allowed=len(scene.volumes))
    return [override_grid(each, volume) for each, volume in zip(sources, scene.volumes, strict=True)]


def _equal_share(layout: BrickLayout, run: Run) -> list[Index]:
    """This rank's bricks, as if all were shown."""
    cells = brick_cost(layout, np.zeros(layout.counts_zyx, bool))
    mine = bricks_of(build_tree(cells, run.channel.size), run.channel.rank, cells)
    return [(z, y, x) for z, y, x in mine.tolist()]


def _summary(run: Run, source: Source, layout: BrickLayout, share: list[Index], held: Bricks | None) -> VolumeSummary:
    """What a volume holds; a share larger than the memory is read again for each pass."""
    again = (lambda: read_bricks(source, layout, share)) if held is None else (lambda: iter(held.items()))
    return summarise(source.dtype, layout, again, run.channel.allgather)


def load_bricks(run: Run, opened: Opened, plan: Plan, wanted: Set[Index], holds: Set[Index] = frozenset()) -> Bricks:
    """Bricks of this rank; those that are not in memory are read.

    Parameters
    ----------
    plan : what is shown
    wanted : which
    holds : those that may be asked for again, and are kept in memory where the options say so
    """
    with run.alone("load", "load"):
        held = opened.fitting(plan)
        bricks = {index: held[index] for index in wanted & held.keys()}
        if run.options.keep_bricks:
            kept = {index: held[index] for index in holds & held.keys()}
        opened.held.clear()
        bricks.update(opened.read(plan, wanted - bricks.keys()))
        if run.options.keep_bricks:
            opened.held.update(kept | bricks)
        return bricks
