"""Fragments of a rectangle of pixels, found by CPUs."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.image.partial import Rect
from clusterviz.plan.plan import Plan
from clusterviz.render.abuffer.fills import EARLY, KEYS, LINKS, LISTS, Lists, Pass, Pools, store_fragments
from clusterviz.render.abuffer.primitives import PrimitiveTable
from clusterviz.render.abuffer.program import (
    COUNTED_BINDING,
    INTEGRALS_BINDING,
    LIGHTING_BINDING,
    FindVariant,
    find_variants,
    lit_layer,
)
from clusterviz.render.abuffer.tiles import CPU_TILE, GEOMETRY_BINDING, TileLists, make_lists, prepare_tiles
from clusterviz.render.cells.table import GRIDS_BINDING, grids_block
from clusterviz.spmd.machine_code import addresses, compiled

Blocks = dict[int, NDArray[Any]]
ONE_GROUP = np.zeros(7, np.uint32)
COUNTER, STATE = 1, 2
"""Word of the counter of tiles in the state, and the binding of that."""
Run = Callable[[Callable[[int], None], NDArray[np.uint64], NDArray[np.uint32], int], None]


@cache
def compiled_pass(variant: FindVariant) -> Callable[[int], None]:
    """Return the machine code of a pass."""
    return compiled(variant.source, variant.name, variant.lanes)


def prepare_passes(plan: Plan, lanes: int) -> None:
    """Compile what a plan needs."""
    variants = find_variants(plan, lanes)
    if plan.content.layers:
        prepare_tiles(plan)
    for variant in variants:
        compiled_pass(variant)


def list_primitives(
    plan: Plan,
    table: PrimitiveTable,
    rect: Rect,
    threads: tuple[Executor, int],
    limits: NDArray[np.float32] | None,
    last: TileLists | None,
) -> TileLists:
    """Return the primitives of each tile of a rectangle of pixels; parameters as for `make_lists`."""
    shading = lit_layer(plan)
    return make_lists(plan, table, rect, len(shading.lights) if shading else 0, CPU_TILE, *threads, limits, last)


def find_fragments(
    plan: Plan,
    table: PrimitiveTable,
    tiles: TileLists,
    rect: Rect,
    uniforms: Blocks,
    given: Blocks,
    lanes: int,
    run: Run,
    pools: Pools,
) -> tuple[Blocks, Blocks]:
    """Return uniform blocks and storage buffers of geometry by their bindings; lists of fragments have `LISTS`.

    Parameters
    ----------
    tiles : of the rectangle
    uniforms : blocks of the volumes' program
    given : its storage buffers
    run : runs a program in all threads, given the table of addresses, the counter of tiles, and their number
    pools : of fragments

    Raises
    ------
    ManyFragmentsError
        The rectangle should be divided.
    """
    fill = plan.content.fill
    own: Blocks = {GEOMETRY_BINDING: tiles.block}
    buffers: Blocks = tiles.primitives(table)
    if table.cells:
        own[GRIDS_BINDING] = grids_block(plan.content, table.cells)
    if plan.content.kbuffer:
        counted = np.zeros((rect.pixels, 2), np.uint32)
        table_of_integrals = plan.content.cells[0].integrals
        buffers |= {} if table_of_integrals is None else {INTEGRALS_BINDING: table_of_integrals}
        return own, buffers | tiles.lists | {COUNTED_BINDING: counted}
    variants = {variant.step: variant for variant in find_variants(plan, lanes)}
    links = np.empty((EARLY * rect.pixels if fill == "dynamic" else 1, 2), np.uint32)

    def run_pass(step: Pass, lists: Lists, fragments: int, pages: int) -> None:
        state = np.zeros(COUNTER + 1, np.uint32)
        buffers[LISTS], buffers[KEYS] = lists, np.empty((max(1, fragments), 2), np.uint32)
        buffers[LINKS] = np.empty(pages + 1, np.uint32) if pages else links
        passed = given | buffers | tiles.lists | {STATE: state}
        run(compiled_pass(variants[step]), addresses(uniforms | own, passed, ONE_GROUP), state, len(tiles.begins) - 1)

    store_fragments(fill, rect, pools, run_pass)
    if shading := lit_layer(plan):
        own[LIGHTING_BINDING] = shading.block()
    return own, buffers
