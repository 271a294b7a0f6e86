"""Fragments of a rectangle of pixels, found by OpenGL."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from clusterviz.comm.placement import kernel_threads
from clusterviz.errors import DeviceError
from clusterviz.gl.compute import run_compute
from clusterviz.image.partial import Rect
from clusterviz.plan.plan import Plan
from clusterviz.render.abuffer.discarding import LEFT_OUT_BINDING
from clusterviz.render.abuffer.fills import EARLY, HEAD, Lists, Pass, Pools, store_fragments
from clusterviz.render.abuffer.primitives import PrimitiveTable
from clusterviz.render.abuffer.program import (
    COUNTED_BINDING,
    INTEGRALS_BINDING,
    LIGHTING_BINDING,
    MOST_SORTED,
    FindVariant,
    find_variants,
    lit_layer,
)
from clusterviz.render.abuffer.resolves import classified, counts_of, is_sorted
from clusterviz.render.abuffer.tiles import GEOMETRY_BINDING, GPU_TILE, TileLists, make_lists, prepare_tiles
from clusterviz.render.cells.table import CELLS_BINDING, GRIDS_BINDING, grids_block
from clusterviz.spmd.driver_needs import compile_checked

LLVMPIPE_ITERATIONS = 65535
"""Iterations of all loops of an invocation together, after which llvmpipe leaves loops without a message."""
FIND_ITERATIONS, DRAW_ITERATIONS = 3, 16
"""Bounds for a primitive of a tile in each pass over them, and for a fragment of a pixel; each layer adds one."""
FACE_ITERATIONS = 16
"""Bound for a face of a tile, without those over the entries of a k-buffer."""
Make = Callable[[NDArray[Any]], moderngl.Buffer]
Programs = dict[FindVariant, moderngl.ComputeShader]


def compile_passes(context: moderngl.Context, plan: Plan) -> dict[FindVariant, moderngl.ComputeShader]:
    """Compile the programs of a plan."""
    variants = find_variants(plan)
    if plan.content and plan.content.layers:
        prepare_tiles(plan)
    return {variant: compile_checked(context, variant.source) for variant in variants}


def list_primitives(
    context: moderngl.Context,
    plan: Plan,
    table: PrimitiveTable,
    rect: Rect,
    limits: NDArray[np.float32] | None,
    last: TileLists | None,
) -> TileLists:
    """Return the primitives of each tile of a rectangle of pixels; parameters as for `make_lists`.

    Raises
    ------
    DeviceError
        llvmpipe would leave out primitives.
    """
    shading, threads = lit_layer(plan), kernel_threads()
    lights = len(shading.lights) if shading else 0
    tiles = make_lists(plan, table, rect, lights, GPU_TILE, _pool(), threads, limits, last)
    most = int(np.diff(tiles.begins).max(initial=0))
    check_loops(context, most, 2 * (FIND_ITERATIONS + len(table.layers)), "primitives in a tile")
    return tiles


def bind_fragments(
    context: moderngl.Context,
    programs: Programs,
    plan: Plan,
    table: PrimitiveTable,
    tiles: TileLists,
    rect: Rect,
    make: Make,
    pools: Pools,
) -> tuple[NDArray[np.int32], moderngl.Buffer, list[int]]:
    """Find fragments and bind them for drawing.

    Parameters
    ----------
    programs : those that are compiled, and then others; the uniform blocks of the frame and of clipping are bound
    tiles : of the rectangle
    make : makes a buffer, of at least one byte
    pools : of fragments

    Returns
    -------
    counts : int32 (h, w), fragments of pixels
    lists : their lists, whose word `DRAWN_CLASS` chooses the tiles that are drawn; for a k-buffer the counts of pixels
    sizes : of the programs that draw them

    Raises
    ------
    ManyFragmentsError
        The rectangle should be divided.
    DeviceError
        llvmpipe would leave out fragments, or there is no memory.
    """
    assert plan.content, "there is geometry"
    fill, layers = plan.content.fill, len(table.layers)
    make(tiles.block).bind_to_uniform_block(GEOMETRY_BINDING)
    if shading := lit_layer(plan):
        make(shading.block()).bind_to_uniform_block(LIGHTING_BINDING)
    given = {
        9: tiles.begins,
        10: tiles.rows,
        12: tiles.vertices,
        13: tiles.corners,
        14: table.layers,
        15: table.attributes,
        LEFT_OUT_BINDING: tiles.left_out,
    }
    most_bytes = int(context.info["GL_MAX_SHADER_STORAGE_BLOCK_SIZE"])
    if table.cells:
        given[CELLS_BINDING] = table.cells.words
        make(grids_block(plan.content, table.cells)).bind_to_uniform_block(GRIDS_BINDING)
        if table.cells.words.nbytes > most_bytes:
            text, bytes_each = f"{table.cells.tetrahedra} tetrahedra", table.cells.words.nbytes
            raise DeviceError(
                f"too large a buffer for {text}; found {bytes_each} bytes; allowed {most_bytes}; more ranks have fewer "
                "each, and CPUs draw any number (--device cpu)"
            )
    if kbuffer := plan.content.kbuffer:
        most = int(np.diff(tiles.begins).max(initial=0))
        check_loops(context, most, 2 * kbuffer.k + FACE_ITERATIONS, "faces in a tile")
        integrals = plan.content.cells[0].integrals
        given |= {} if integrals is None else {INTEGRALS_BINDING: integrals}
    for binding, data in given.items():
        make(_filled(data)).bind_to_storage_buffer(binding)
    if kbuffer:
        counted = make(np.zeros((rect.pixels + 1, 2), np.uint32))
        counted.bind_to_storage_buffer(COUNTED_BINDING)
        return np.zeros((rect.height, rect.width), np.int32), counted, [0]
    variants = {variant.step: variant for variant in find_variants(plan)}
    links = make(np.zeros((EARLY * rect.pixels if fill == "dynamic" else 1, 2), np.uint32))
    keys = make(np.zeros((1, 2), np.uint32))

    def run_pass(step: Pass, lists: Lists, fragments: int, pages: int) -> None:
        nonlocal links, keys
        given = make(lists)
        if fragments:
            keys = make(np.empty((fragments, 2), np.uint32))
        if pages:
            links = make(np.empty(pages + 1, np.uint32))
        if context.error == "GL_OUT_OF_MEMORY":
            raise MemoryError
        for binding, buffer in ((11, given), (8, keys), (16, links)):
            buffer.bind_to_storage_buffer(binding)
        if (variant := variants[step]) not in programs:
            programs[variant] = compile_checked(context, variant.source)
        run_compute(programs[variant], (-(-rect.width // GPU_TILE), -(-rect.height // GPU_TILE)))
        context.memory_barrier()
        lists[:] = np.frombuffer(given.read(), np.uint32)
        most = int(lists[HEAD + 1 :: 2].max(initial=0))
        check_loops(context, most, DRAW_ITERATIONS + layers, "fragments in a pixel")

    lists = store_fragments(fill, rect, pools, run_pass, True, most_bytes)
    counts = counts_of(lists, rect)
    if is_sorted(plan.content):
        sort_long(keys, lists[HEAD + 1 :: 2], lists[HEAD::2])
    else:
        # Insertion in a private array, of half of them for each.
        most = int(counts.max(initial=0))
        check_loops(context, most, DRAW_ITERATIONS + layers + most // 2, "fragments in a pixel")
    lists, sizes = classified(plan.content, lists, counts, GPU_TILE)
    bound = make(lists)
    bound.bind_to_storage_buffer(11)
    return counts, bound, sizes


def check_loops(context: moderngl.Context, found: int, iterations: int, of: str) -> None:
    """Refuse what llvmpipe would not draw to the end."""
    if "llvmpipe" in context.info["GL_RENDERER"] and found * iterations > LLVMPIPE_ITERATIONS:
        allowed = f"{LLVMPIPE_ITERATIONS // iterations}; CPUs draw any number (--device cpu)"
        raise DeviceError(f"too many {of} for llvmpipe; found {found}; allowed {allowed}")


def sort_long(keys: moderngl.Buffer, counts: NDArray[np.uint32], begins: NDArray[np.uint32]) -> None:
    """Sort the fragments of pixels with more than `MOST_SORTED`."""
    for pixel in np.flatnonzero(counts > MOST_SORTED):
        size, offset = 8 * int(counts[pixel]), 8 * int(begins[pixel])
        own = np.frombuffer(keys.read(size, offset=offset), np.uint32).reshape(-1, 2)
        keys.write(own[np.lexsort(own.T[::-1])].tobytes(), offset=offset)


def _filled(data: NDArray[Any]) -> NDArray[Any]:
    """Return an array that is not empty."""
    return data if data.size else np.zeros(4, np.uint32)


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(kernel_threads(), thread_name_prefix="lists")
