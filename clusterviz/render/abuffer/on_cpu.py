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
from clusterviz.render.abuffer.primitives import PrimitiveTable
from clusterviz.render.abuffer.program import LIGHTING_BINDING, FindVariant, find_variants, lit_layer
from clusterviz.render.abuffer.tiles import CPU_TILE, EARLY, GEOMETRY_BINDING, check_memory, make_lists, prepare_tiles
from clusterviz.spmd.machine_code import addresses, compiled

Blocks = dict[int, NDArray[Any]]
ONE_GROUP = np.zeros(7, np.uint32)
COUNTER = 1
Run = Callable[[Callable[[int], None], NDArray[np.uint64], NDArray[np.uint32], int], None]


@cache
def compiled_pass(variant: FindVariant) -> Callable[[int], None]:
    """Return the machine code of a pass."""
    return compiled(variant.source, variant.name, variant.lanes)


def prepare_passes(plan: Plan, lanes: int) -> None:
    """Compile what a plan needs."""
    variants = find_variants(plan, lanes)
    if variants:
        prepare_tiles()
    for variant in variants:
        compiled_pass(variant)


def find_fragments(
    plan: Plan,
    table: PrimitiveTable,
    rect: Rect,
    uniforms: Blocks,
    offsets: NDArray[Any],
    lanes: int,
    run: Run,
    threads: tuple[Executor, int],
) -> tuple[Blocks, Blocks, NDArray[np.int32]]:
    """Return uniform blocks and storage buffers of geometry by their bindings, and the fragments of pixels (h, w).

    Parameters
    ----------
    uniforms : blocks of the volumes' program
    offsets : int32 (z, y, x) of the bricks of the box; negative: not drawn
    run : runs a program in all threads, given the table of addresses, the counter of tiles, and their number
    threads : their pool and number

    Raises
    ------
    ManyFragmentsError
        The rectangle should be divided.
    """
    check_memory(rect, 0)
    shading = lit_layer(plan)
    lights = len(shading.lights) if shading else 0
    lists = make_lists(plan, table, rect, lights, CPU_TILE, *threads)
    own: Blocks = {GEOMETRY_BINDING: lists.block}
    begins = np.zeros(rect.pixels + 1, np.uint32)
    buffers: Blocks = {
        11: begins,
        12: lists.vertices,
        13: table.corners,
        14: table.layers,
        15: table.attributes,
    }
    keys, early = np.zeros((1, 2), np.uint32), np.empty((rect.pixels, EARLY, 2), np.uint32)
    for variant in find_variants(plan, lanes):
        state = np.zeros(COUNTER + 1, np.uint32)
        passed = buffers | {2: state, 3: offsets, 16: early, 8: keys, 9: lists.begins, 10: lists.rows}
        run(compiled_pass(variant), addresses(uniforms | own, passed, ONE_GROUP), state, len(lists.begins) - 1)
        if variant.step == "count":
            np.cumsum(begins, out=begins)
            check_memory(rect, int(begins[-1]))
            if not begins[-1]:
                break
            keys = np.empty((int(begins[-1]), 2), np.uint32)
    if shading:
        own[LIGHTING_BINDING] = shading.block()
    counts = (begins[1:] - begins[:-1]).view(np.int32)
    return own, buffers | {8: keys}, counts.reshape(rect.height, rect.width)
