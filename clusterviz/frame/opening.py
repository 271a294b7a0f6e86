"""Opening a volume: each rank reads an equal share of its bricks, and all learn what it holds; later, single bricks."""

from __future__ import annotations

from collections.abc import Set
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data import open_source
from clusterviz.data.bricks import BrickLayout, read_bricks
from clusterviz.data.source import Index, Source
from clusterviz.data.summary import summarise
from clusterviz.frame.run import Run
from clusterviz.frame.share import OpenedVolume
from clusterviz.partition import bricks_of, build_tree
from clusterviz.plan.accuracy import classification_of
from clusterviz.plan.look import margin_of
from clusterviz.plan.plan import brick_cost
from clusterviz.report.machine import memory
from clusterviz.scene.values import Scene

HELD_SHARE_OF_MEMORY = 0.4


def open_volume(run: Run, scene: Scene, source: Source | None = None) -> OpenedVolume | None:
    """Read an equal share of the bricks, and learn together what the volume holds; the share is kept for drawing."""
    if not scene.volumes:
        return None
    with run.alone("open", "load"):
        source = source or open_source(scene.volumes[0].path, scene.volumes[0].array)
        margin = margin_of(scene.volumes[0], classification_of(scene.quality))
        layout = BrickLayout(source.grid.shape_zyx, scene.cluster.brick, margin)
    with run.together("read", "load"):
        most_bytes = HELD_SHARE_OF_MEMORY * memory().available_bytes / run.channel.place().local_size
    with run.alone("read", "load"):
        cells = brick_cost(layout, np.zeros(layout.counts_zyx, bool))
        mine = bricks_of(build_tree(cells, run.channel.size), run.channel.rank, cells)
        share = [(z, y, x) for z, y, x in mine.tolist()]
        fits = len(share) * (layout.brick + 1 + 2 * layout.margin) ** 3 * source.dtype.itemsize <= most_bytes
        held = dict(read_bricks(source, layout, share)) if fits else {}
    with run.together("summarise", "load"):
        # A share larger than the memory is read again for each pass; of it only what is visible is ever held.
        again = (lambda: iter(held.items())) if fits else (lambda: read_bricks(source, layout, share))
        return OpenedVolume(source, layout, summarise(source.dtype, layout, again, run.channel.allgather), held)


def load_bricks(
    run: Run, opened: OpenedVolume, wanted: Set[Index], holds: Set[Index] = frozenset()
) -> dict[Index, NDArray[Any]]:
    """Bricks of this rank; those that are not in memory are read.

    Parameters
    ----------
    wanted : which
    holds : those that may be asked for again, and are kept in memory where the options say so
    """
    with run.alone("load", "load"):
        bricks = {index: opened.held[index] for index in wanted & opened.held.keys()}
        if run.options.keep_bricks:
            kept = {index: opened.held[index] for index in holds & opened.held.keys()}
        opened.held.clear()
        bricks.update(read_bricks(opened.source, opened.layout, wanted - bricks.keys()))
        if run.options.keep_bricks:
            opened.held.update(kept | bricks)
        return bricks
