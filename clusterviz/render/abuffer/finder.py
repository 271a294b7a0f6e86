"""Fragments of a rectangle of pixels, found by the rasteriser of a device, or with tile lists."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm.placement import kernel_threads
from clusterviz.image.partial import Rect
from clusterviz.partition import BrickBox
from clusterviz.plan.content import Content
from clusterviz.plan.plan import Plan
from clusterviz.render.abuffer.fills import (
    EARLY,
    FRAGMENT,
    HEAD,
    WORD,
    Lists,
    Pass,
    Pools,
    store_fragments,
    with_fill,
)
from clusterviz.render.abuffer.fragments import (
    DRAW_ITERATIONS,
    Fragments,
    Read,
    check_loops,
    give_scene,
    sort_long,
)
from clusterviz.render.abuffer.primitives import PrimitiveTable, TableCache
from clusterviz.render.abuffer.program import FindVariant, find_variants, lit_layer
from clusterviz.render.abuffer.resolves import classified, counts_of, is_sorted
from clusterviz.render.abuffer.tiles import TileLists, make_lists, prepare_tiles
from clusterviz.render.device import Device
from clusterviz.spmd.threads import thread_pool

FIND_ITERATIONS, FACE_ITERATIONS = 3, 16
"""Bounds for a primitive of a tile in each pass over them; each layer adds one; and for a face of a tile, without those
over the entries of a k-buffer."""
COUNTED = 8
"""Bytes of what a k-buffer counts for a pixel."""


class FragmentFinder:
    """Programs that find fragments, and what they know of earlier draws.

    Parameters
    ----------
    device : with the primitives
    """

    def __init__(self, device: Device) -> None:
        self._device = device
        self._passes: dict[FindVariant, Any] = {}
        self.forget()
        self.forget_bricks()

    def compile(self, plan: Plan) -> None:
        """Compile the programs of a plan in place of those of another."""
        if plan.content.layers:
            prepare_tiles(plan)
        old, variants = self._passes, find_variants(plan, self._device.lanes)
        self._passes = {variant: self._device.compile(variant) for variant in variants}
        for program in old.values():
            program.release()

    def can_draw(self, plan: Plan) -> bool:
        """Return True if there are the programs of a plan."""
        return all(variant in self._passes for variant in find_variants(plan, self._device.lanes))

    def forget(self) -> None:
        """Forget how many fragments there were."""
        self._pools = Pools()

    def forget_bricks(self) -> None:
        """Forget the primitives, as bricks have changed."""
        self._primitives = TableCache()

    def with_fill(self, plan: Plan) -> Plan:
        """Return a plan whose fill scheme is chosen."""
        return with_fill(plan, self._pools)

    def table(self, plan: Plan, part: Any) -> PrimitiveTable:
        """Return the primitives and tetrahedra of a box of bricks, of a plan with layers of them."""
        found = self._primitives.table(plan.content.layers, part.bricks, part.atlas.members)
        assert found, "there are layers"
        return found

    def find(
        self,
        plan: Plan,
        table: PrimitiveTable,
        rect: Rect,
        tiles: dict[BrickBox, TileLists],
        box: BrickBox,
        limits: NDArray[np.float32] | None,
        *,
        waits: bool,
    ) -> Fragments:
        """Find the fragments of a box, and bind them for drawing; the blocks of the frame and of clipping are bound.

        Parameters
        ----------
        tiles, box : tile lists of a piece by box, which are narrowed when it is drawn again; and the key
        limits : depths behind which nothing is stored; None: there are none
        waits : whether all have to be there when this returns; else `Fragments.are_all` may ask for another try

        Raises
        ------
        ManyFragmentsError
            The rectangle should be divided.
        DeviceError
            There is no memory, or llvmpipe would leave out primitives or fragments.
        """
        device = self._device
        if device.rasteriser and device.rasteriser.serves(plan, rect):
            return device.rasteriser.find(plan, table, rect, waits=waits)
        found = tiles[box] = self._listed(plan, table, rect, limits, tiles.get(box))
        give_scene(device.arrays, plan, table, found.block, device.most_bytes)
        for name, data in (found.lists | found.primitives(table)).items():
            device.arrays.give(name, data)
        if plan.content.kbuffer:
            return self._counted_by_kbuffer(plan.content, rect)
        return self._stored(plan, rect)

    def release(self) -> None:
        """Free the programs."""
        for program in self._passes.values():
            program.release()

    def _listed(
        self, plan: Plan, table: PrimitiveTable, rect: Rect, limits: NDArray[np.float32] | None, last: TileLists | None
    ) -> TileLists:
        """Return the primitives of each tile of a rectangle of pixels; parameters as for `make_lists`."""
        shading, threads = lit_layer(plan), (thread_pool(os.getpid()), kernel_threads())
        lights = len(shading.lights) if shading else 0
        tiles = make_lists(plan, table, rect, lights, self._device.list_tile, *threads, limits, last)
        most, kbuffer = int(np.diff(tiles.begins).max(initial=0)), plan.content.kbuffer
        check_loops(self._device.loop_limit, most, 2 * (FIND_ITERATIONS + len(table.layers)), "primitives in a tile")
        if kbuffer:
            check_loops(self._device.loop_limit, most, 2 * kbuffer.k + FACE_ITERATIONS, "faces in a tile")
        return tiles

    def _stored(self, plan: Plan, rect: Rect) -> Fragments:
        """Store the fragments of a rectangle, of the primitives of its tiles."""
        device, arrays, fill = self._device, self._device.arrays, plan.content.fill
        variants = {variant.step: variant for variant in find_variants(plan, device.lanes)}
        per_fragment, tile = DRAW_ITERATIONS + len(plan.content.layers), device.list_tile
        keys = arrays.reserve("keys", FRAGMENT)
        if fill == "dynamic":
            arrays.reserve("early", FRAGMENT * EARLY * rect.pixels)

        def run_pass(step: Pass, lists: Lists, fragments: int, pages: int) -> None:
            nonlocal keys
            given = arrays.begin("fragments", lists)
            if fragments:
                keys = arrays.reserve("keys", FRAGMENT * fragments)
            if pages:
                arrays.reserve("links", WORD * (pages + 1))
            if (variant := variants[step]) not in self._passes:
                self._passes[variant] = device.compile(variant)
            arrays.dispatch(self._passes[variant], (-(-rect.width // tile), -(-rect.height // tile)))
            if step == "fill":  # the lists have been counted
                return
            lists[:] = np.frombuffer(arrays.read(given, lists.nbytes), np.uint32)
            most = int(lists[HEAD + 1 :: 2].max(initial=0))
            check_loops(device.loop_limit, most, per_fragment, "fragments in a pixel")

        lists = store_fragments(fill, rect, self._pools, run_pass, device.most_bytes)
        counts = counts_of(lists, rect)
        if not is_sorted(plan.content):
            # Insertion in a private array, of half of them for each.
            most = int(counts.max(initial=0))
            check_loops(device.loop_limit, most, per_fragment + most // 2, "fragments in a pixel")
        elif not device.lanes:
            sort_long(arrays, keys, lists[HEAD + 1 :: 2], lists[HEAD::2])
        lists, sizes = classified(plan.content, lists, counts, device.class_tile)
        return Fragments(arrays.begin("fragments", lists), sizes, (), lambda _: counts)

    def _counted_by_kbuffer(self, content: Content, rect: Rect) -> Fragments:
        """Bind what a k-buffer takes, and the counts of pixels, which it writes."""
        arrays = self._device.arrays
        if (integrals := content.cells[0].integrals) is not None:
            arrays.give("integrals", integrals)
        size = COUNTED * (rect.pixels + 1)
        counted = arrays.reserve("counted", size)
        arrays.clear(counted, size)

        def counts(read: Read) -> NDArray[np.int32]:
            return read[0].view(np.uint32)[::2].astype(np.int32)

        return Fragments(counted, [0], [(counted, 0, COUNTED * rect.pixels)], counts)
