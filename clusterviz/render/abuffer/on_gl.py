"""Fragments of a rectangle of pixels, found by OpenGL."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache

import moderngl
import numpy as np
from numpy.typing import NDArray

from clusterviz.comm.placement import kernel_threads
from clusterviz.errors import DeviceError
from clusterviz.gl.context import is_llvmpipe
from clusterviz.gl.device import Device
from clusterviz.gl.driver_needs import compile_checked
from clusterviz.gl.staging import Bytes
from clusterviz.image.partial import Rect
from clusterviz.plan.content import Content
from clusterviz.plan.plan import Plan
from clusterviz.render.abuffer.fills import (
    EARLY,
    FRAGMENT,
    HEAD,
    KEYS,
    LINKS,
    LISTS,
    WORD,
    Lists,
    Pass,
    Pools,
    store_fragments,
)
from clusterviz.render.abuffer.fragments import Fragments
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

LLVMPIPE_ITERATIONS = 65535
"""Iterations of all loops of an invocation together, after which llvmpipe leaves loops without a message."""
FIND_ITERATIONS, DRAW_ITERATIONS = 3, 16
"""Bounds for a primitive of a tile in each pass over them, and for a fragment of a pixel; each layer adds one."""
FACE_ITERATIONS = 16
"""Bound for a face of a tile, without those over the entries of a k-buffer."""
COUNTED = 8
"""Bytes of what a k-buffer counts for a pixel."""
Programs = dict[FindVariant, moderngl.ComputeShader]


def compile_passes(context: moderngl.Context, plan: Plan) -> dict[FindVariant, moderngl.ComputeShader]:
    """Compile the programs of a plan."""
    variants = find_variants(plan)
    if plan.content.layers:
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
    """Return the primitives of each tile of a rectangle of pixels; parameters as for `make_lists`."""
    shading, threads = lit_layer(plan), kernel_threads()
    lights = len(shading.lights) if shading else 0
    tiles = make_lists(plan, table, rect, lights, GPU_TILE, _pool(), threads, limits, last)
    most = int(np.diff(tiles.begins).max(initial=0))
    check_loops(context, most, 2 * (FIND_ITERATIONS + len(table.layers)), "primitives in a tile")
    return tiles


def bind_fragments(
    device: Device,
    programs: Programs,
    plan: Plan,
    table: PrimitiveTable,
    tiles: TileLists,
    rect: Rect,
    pools: Pools,
) -> Fragments:
    """Find fragments and bind them for drawing.

    Parameters
    ----------
    programs : those that are compiled, and then others; the uniform blocks of the frame and of clipping are bound
    tiles : of the rectangle
    pools : of fragments
    """
    _bind_primitives(device, plan, table, tiles)
    if plan.content.kbuffer:
        return _counted_by_kbuffer(device, plan.content, tiles, rect)
    fill, layers, context = plan.content.fill, len(table.layers), device.context
    variants = {variant.step: variant for variant in find_variants(plan)}
    keys = device.reserve(KEYS, FRAGMENT)
    device.reserve(LINKS, FRAGMENT * EARLY * rect.pixels if fill == "dynamic" else FRAGMENT)

    def run_pass(step: Pass, lists: Lists, fragments: int, pages: int) -> None:
        nonlocal keys
        given = device.begin(LISTS, lists)
        if fragments:
            keys = device.reserve(KEYS, FRAGMENT * fragments)
        if pages:
            device.reserve(LINKS, WORD * (pages + 1))
        if (variant := variants[step]) not in programs:
            programs[variant] = compile_checked(context, variant.source)
        device.dispatch(programs[variant], (-(-rect.width // GPU_TILE), -(-rect.height // GPU_TILE)))
        if step == "fill":  # the lists have been counted
            return
        lists[:] = np.frombuffer(device.read(given, lists.nbytes), np.uint32)
        most = int(lists[HEAD + 1 :: 2].max(initial=0))
        check_loops(context, most, DRAW_ITERATIONS + layers, "fragments in a pixel")

    most_bytes = int(context.info["GL_MAX_SHADER_STORAGE_BLOCK_SIZE"])
    lists = store_fragments(fill, rect, pools, run_pass, True, most_bytes)
    counts = counts_of(lists, rect)
    if is_sorted(plan.content):
        sort_long(keys, lists[HEAD + 1 :: 2], lists[HEAD::2])
    else:
        # Insertion in a private array, of half of them for each.
        most = int(counts.max(initial=0))
        check_loops(context, most, DRAW_ITERATIONS + layers + most // 2, "fragments in a pixel")
    lists, sizes = classified(plan.content, lists, counts, GPU_TILE)
    return Fragments(device.begin(LISTS, lists), sizes, (), lambda _: counts)


def _bind_primitives(device: Device, plan: Plan, table: PrimitiveTable, tiles: TileLists) -> None:
    """Bind the primitives of tiles, and tetrahedra."""
    device.give(GEOMETRY_BINDING, tiles.block, "uniform")
    if shading := lit_layer(plan):
        device.give(LIGHTING_BINDING, shading.block(), "uniform")
    bind_cells(device, plan, table)
    for binding, data in (tiles.lists | tiles.primitives(table)).items():
        device.give(binding, data)


def bind_cells(device: Device, plan: Plan, table: PrimitiveTable) -> None:
    """Bind the tetrahedra of a table, if it has grids."""
    if not table.cells:
        return
    most, found = int(device.context.info["GL_MAX_SHADER_STORAGE_BLOCK_SIZE"]), table.cells.words.nbytes
    if found > most:
        raise DeviceError(
            f"too large a buffer for {table.cells.tetrahedra} tetrahedra; found {found} bytes; allowed {most}; "
            "more ranks have fewer each, and CPUs draw any number (--device cpu)"
        )
    device.give(GRIDS_BINDING, grids_block(plan.content, table.cells), "uniform")
    device.give(CELLS_BINDING, table.cells.words)


def _counted_by_kbuffer(device: Device, content: Content, tiles: TileLists, rect: Rect) -> Fragments:
    """Bind what a k-buffer takes, and the counts of pixels, which it writes."""
    assert content.kbuffer, "there is a k-buffer"
    most = int(np.diff(tiles.begins).max(initial=0))
    check_loops(device.context, most, 2 * content.kbuffer.k + FACE_ITERATIONS, "faces in a tile")
    if (integrals := content.cells[0].integrals) is not None:
        device.give(INTEGRALS_BINDING, integrals)
    size = COUNTED * (rect.pixels + 1)
    counted = device.reserve(COUNTED_BINDING, size)
    device.clear(counted, size)

    def counts(read: Sequence[Bytes]) -> NDArray[np.int32]:
        return read[0].view(np.uint32)[::2].astype(np.int32)

    return Fragments(counted, [0], [(counted, 0, COUNTED * rect.pixels)], counts)


def check_loops(context: moderngl.Context, found: int, iterations: int, of: str) -> None:
    """Refuse what llvmpipe would not draw to the end."""
    if is_llvmpipe(context.info["GL_RENDERER"]) and found * iterations > LLVMPIPE_ITERATIONS:
        allowed = f"{LLVMPIPE_ITERATIONS // iterations}; CPUs draw any number (--device cpu)"
        raise DeviceError(f"too many {of} for llvmpipe; found {found}; allowed {allowed}")


def sort_long(keys: moderngl.Buffer, counts: NDArray[np.uint32], begins: NDArray[np.uint32]) -> None:
    """Sort the fragments of pixels with more than `MOST_SORTED`."""
    for pixel in np.flatnonzero(counts > MOST_SORTED):
        size, offset = 8 * int(counts[pixel]), 8 * int(begins[pixel])
        own = np.frombuffer(keys.read(size, offset=offset), np.uint32).reshape(-1, 2)
        keys.write(own[np.lexsort(own.T[::-1])].tobytes(), offset=offset)


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(kernel_threads(), thread_name_prefix="lists")
