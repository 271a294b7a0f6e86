"""Fragments of a rectangle of pixels, found by the rasteriser of a GPU.

The rasteriser only says which pixels a primitive may cover. Whether it does, and at which depth, is decided by the same
program text as for tile lists, so that pictures and counts of fragments are the same. Positions stay on the device. A
rectangle takes three calls, without a wait between them:

1. vertices are moved to the camera's coordinates, and the lists are emptied;
2. fragments are linked to the lists of their pixels;
3. those of each pixel get places side by side, and come in order. Grids alone do without: the few entries of a ray into
   a grid are looked for in any order.

When to use: on GPUs. When not: software rasterisers prefer tile lists; fill schemes that a scene names, resolve schemes
without a stored order, early fragment discarding and k-buffers have tile lists anyway.

References
----------
J. C. Yang, J. Hensley, H. Grün, N. Thibieroz, Real-Time Concurrent Linked List Construction on the GPU, 2010.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import moderngl
import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import DeviceError
from clusterviz.gl.context import LLVMPIPE_ITERATIONS, is_llvmpipe
from clusterviz.gl.device import Device, Program
from clusterviz.gl.layout import glsl_block
from clusterviz.gl.shader import assemble
from clusterviz.gl.staging import Bytes
from clusterviz.image.partial import Rect
from clusterviz.plan.geometry import GeometryLayer
from clusterviz.plan.plan import Plan
from clusterviz.render.abuffer import fills
from clusterviz.render.abuffer.fills import (
    FRAGMENT,
    HEAD,
    LEAST_SIDE,
    PAGE_SHIFT,
    SLACK,
    WORD,
    ManyFragmentsError,
)
from clusterviz.render.abuffer.fragments import DRAW_ITERATIONS, Fragments, check_loops, give_scene, sort_long
from clusterviz.render.abuffer.primitives import PrimitiveTable
from clusterviz.render.abuffer.program import MOST_SORTED, FindVariant, find_variants, lit_layer
from clusterviz.render.abuffer.resolves import is_sorted
from clusterviz.render.abuffer.tiles import GPU_TILE, camera_block, lens_of
from clusterviz.render.frame_block import FRAME_BLOCK

RASTER = np.dtype(
    [
        ("eye", "f8", 4),  # its depth, its place to the right and up, and pixels a unit
        ("centre", "f8", 4),  # column and row of the line of sight, 1 for perspective, the largest slope of a ray
        ("counts", "i4", 4),  # vertices, words of `fragment_list`, layers, logarithm of a page
    ]
)
MOVE = np.dtype(
    [("right", "f8", 4), ("up", "f8", 4), ("forward", "f8", 4), ("unit", "f8", 4), ("words", "i4", 4), ("pad", "i4", 4)]
)
"""As `Move` in raster_begin.glsl."""
TAKEN, GROUP, ROW = 2, 64, 1 << 15
"""Word of the lists' head with the number of all fragments; invocations of a work group; work groups in x."""
LEAST_BLOCKS, FIRST_ROOM = 8, 4
"""Storage blocks that a stage needs; fragments of a pixel for which the first frame has room."""
ROUNDED = 0.04
"""Pixels by which the vertex shader's sums may be off, with a margin."""
LINKED_SHIFT, JOINED_SHIFT = PAGE_SHIFT["lists"], PAGE_SHIFT["dynamic"]
Programs = tuple[Program, Program, Program]


def has_rasteriser(context: moderngl.Context) -> bool:
    """Return True if a context draws on a GPU whose stages all write storage buffers."""
    # A draw is recorded, or a CPU draws.
    if not isinstance(context, moderngl.Context) or is_llvmpipe(context.info["GL_RENDERER"]):
        return False
    blocks = (context.info.get(f"GL_MAX_{stage}_SHADER_STORAGE_BLOCKS", 0) for stage in ("VERTEX", "FRAGMENT"))
    return all(count >= LEAST_BLOCKS for count in blocks)


class Rasteriser:
    """Programs of a context, and primitives that stay there.

    Parameters
    ----------
    device : with the buffers
    forced : whether it is used, if it serves; None: on GPUs

    Attributes
    ----------
    device : the same
    is_used : whether it is used, if it serves
    """

    def __init__(self, device: Device, forced: bool | None = None) -> None:
        self.device = device
        self.is_used = has_rasteriser(device.context) if forced is None else forced
        self._most_sorted = MOST_SORTED if is_llvmpipe(device.context.info["GL_RENDERER"]) else 0
        self._programs: dict[FindVariant, Programs] = {}
        self._table: PrimitiveTable | None = None
        self._arrays: dict[str, NDArray[np.generic]] = {}
        self._words: NDArray[np.int32] = np.zeros((0, 4), np.int32)
        self._room = 0

    @property
    def choice(self) -> str:
        """How fragments are found where a scene leaves it to the device, and why."""
        return "rasteriser, as there is a GPU" if self.is_used else "tile lists, as no GPU rasterises"

    def serves(self, plan: Plan, rect: Rect) -> bool:
        """Return True if fragments of a plan's primitives are found here, and not by tile lists."""
        content = plan.content
        if not self.is_used or content.kbuffer or plan.march.discard_margin is not None:
            return False
        sides = self.device.context.info["GL_MAX_VIEWPORT_DIMS"]
        return is_sorted(content) and rect.width <= sides[0] and rect.height <= sides[1]

    def find(self, plan: Plan, table: PrimitiveTable, rect: Rect, *, waits: bool) -> Fragments:
        """Find fragments and bind them for drawing; `waits` and errors as of `FragmentFinder.find`."""
        self._room = max(self._room, FIRST_ROOM * rect.pixels)
        lists = self.queue(plan, table, rect)
        head = lists, 0, WORD * (HEAD + 2 * rect.pixels)

        def are_all(read: Sequence[Bytes]) -> bool:
            needed = int(read[0].view(np.uint32)[TAKEN])
            if needed > self._room:
                self._grow(needed, rect)
                return False
            return True

        def counts(read: Sequence[Bytes]) -> NDArray[np.int32]:
            return read[0].view(np.uint32)[HEAD + 1 :: 2].astype(np.int32)

        if waits or self._most_sorted:
            while not are_all(read := self.device.arrived(self.device.copy([head]))):
                self.queue(plan, table, rect)
            self._sort_long(table, read[0].view(np.uint32))
        return Fragments(lists, [0], [head], counts, are_all)

    def _sort_long(self, table: PrimitiveTable, lists: NDArray[np.uint32]) -> None:
        """Sort fragments that llvmpipe's loops do not."""
        if self._most_sorted:
            begins, counts = lists[HEAD::2], lists[HEAD + 1 :: 2]
            per_fragment = DRAW_ITERATIONS + len(table.layers)
            check_loops(LLVMPIPE_ITERATIONS, int(counts.max()), per_fragment, "fragments in a pixel")
            sort_long(self.device, self.device.reserve("keys", FRAGMENT * self._room), counts, begins)

    def queue(self, plan: Plan, table: PrimitiveTable, rect: Rect) -> moderngl.Buffer:
        """Queue all calls for a rectangle, and return the lists, whose word `TAKEN` may be beyond the room."""
        device, (begin, draw, sort) = self.device, self._compiled(plan)
        vertices, size = table.vertices, (rect.width, rect.height)
        words = HEAD + 2 * rect.pixels + (-(-rect.width // GPU_TILE)) * (-(-rect.height // GPU_TILE))
        has_order = _has_order(plan)
        self._give(plan, table, rect, words, JOINED_SHIFT if has_order else LINKED_SHIFT)
        lists = device.reserve("fragments", WORD * words)
        sizes = {"vertices": 16 * vertices, "boxes": 16 * vertices, "opaque": WORD * rect.pixels}
        for name, size_of in (sizes | {"links": WORD * self._room}).items():
            device.reserve(name, size_of)
        linked = device.reserve("linked" if has_order else "keys", FRAGMENT * self._room)
        device.bind("keys", linked, FRAGMENT * self._room)
        device.dispatch(begin, _groups(max(vertices, words)))
        device.draw(draw, 3 * len(table.corners), size)
        if has_order:
            device.reserve("keys", FRAGMENT * self._room)
            device.dispatch(sort, _groups(rect.pixels))
        return lists

    def release(self) -> None:
        """Free the programs."""
        for programs in self._programs.values():
            for program in programs:
                program.release()
        self._programs.clear()

    def _give(self, plan: Plan, table: PrimitiveTable, rect: Rect, words: int, page: int) -> None:
        """Bind what shaders read: the camera's numbers, and the primitives, which are sent once."""
        shading = lit_layer(plan)
        block = camera_block(plan, len(shading.lights) if shading else 0)
        give_scene(self.device, plan, table, block, int(self.device.context.info["GL_MAX_SHADER_STORAGE_BLOCK_SIZE"]))
        if table is not self._table:
            self._table, (self._words, self._arrays) = table, _resident(table)
        lens = lens_of(plan, block, rect)
        record = np.zeros(1, RASTER)
        record["eye"], record["centre"] = lens[:4], lens[4:8]
        record["counts"] = table.vertices, words, len(self._words), page
        self.device.give("raster", record)
        self.device.give("moves", _moves(plan, block, self._words))
        for name, data in self._arrays.items():
            self.device.give(name, data)

    def _compiled(self, plan: Plan) -> Programs:
        """Return the programs of a plan, compiled when they are first needed."""
        variant = replace(find_variants(plan)[0], step="count", most_sorted=self._most_sorted)
        if variant not in self._programs:
            snapped = f"const float SNAPPED = {2.0 ** -self.device.context.info['GL_SUBPIXEL_BITS'] + ROUNDED};\n"
            slots = variant.slots | {"FRAME": FRAME_BLOCK, "RASTER": _common(), "SNAPPED": snapped}
            draw = (assemble(f"raster_{stage}.glsl", slots) for stage in ("vertices", "fragments"))
            begin, sort = (self.device.compile(assemble(f"raster_{step}.glsl", slots)) for step in ("begin", "sort"))
            self._programs[variant] = begin, self.device.compile_stages(*draw), sort
        return self._programs[variant]

    def _grow(self, needed: int, rect: Rect) -> None:
        """Make room for as many fragments as were counted, and some more."""
        most = int(self.device.context.info["GL_MAX_SHADER_STORAGE_BLOCK_SIZE"])
        if FRAGMENT * needed > min(fills.MOST_BYTES, most) and rect.height > LEAST_SIDE:
            raise ManyFragmentsError
        if FRAGMENT * needed > most:
            of = f"the fragments of {rect.width} x {rect.height} pixels"
            raise DeviceError(f"no memory for {of}; needed {FRAGMENT * needed} bytes; allowed {most}")
        self._room = min(int(SLACK * needed), most // FRAGMENT)


def _has_order(plan: Plan) -> bool:
    """Return True if the fragments of a pixel are needed in order, unlike entries into grids alone."""
    return bool(plan.content.geometry)


def _groups(invocations: int) -> tuple[int, int]:
    groups = max(1, -(-invocations // GROUP))
    return min(groups, ROW), -(-groups // ROW)


def _common() -> str:
    """Return what all compute shaders share: their block, and the number of an invocation."""
    number = "(gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x) * gl_WorkGroupSize.x + gl_LocalInvocationIndex"
    invocation = f"int invocation() {{\n    return int({number});\n}}\n"
    return glsl_block("raster", 12, RASTER) + invocation


def _resident(table: PrimitiveTable) -> tuple[NDArray[np.int32], dict[str, NDArray[np.generic]]]:
    """Return the words of each layer, as in `MOVE`, and the arrays that stay on the device, by name."""
    parts: list[NDArray[np.uint32]] = []
    records = np.zeros((len(table.positions), 4), np.int32)
    first = place = 0
    for record, positions, radii in zip(records, table.positions, table.radii, strict=True):
        own = np.ascontiguousarray(positions).view(np.uint32).ravel()
        record[:] = first, place, place + len(own) if len(radii) else -1, positions.dtype == np.float64
        parts += [own, np.ascontiguousarray(radii, np.float32).view(np.uint32)]
        first, place = first + len(positions), place + len(own) + len(radii)
    arrays = {
        "words": np.concatenate([*parts, np.zeros(1, np.uint32)]),
        "corners": table.corners.view(),
        "layers": table.layers.view(),
        "attributes": table.attributes.view(),
    }
    for data in arrays.values():
        data.setflags(write=False)
    return records, arrays


def _moves(plan: Plan, block: NDArray[np.void], words: NDArray[np.int32]) -> NDArray[np.void]:
    """Return how the positions of each layer become the camera's coordinates; `MOVE` (layers,)."""
    found = np.zeros(max(1, len(words)), MOVE)
    for record, layer, own in zip(found, plan.content.layers, words, strict=False):
        for name in ("right", "up", "forward"):
            record[name] = block[name][0, :3] @ layer.index_from_file
            record[name][3] += block[name][0, 3]
        is_geometry = isinstance(layer, GeometryLayer)
        record["unit"][:2] = (1 / plan.content.domain.spacing, 0) if is_geometry else (1, 1)
        record["words"] = own
    return found
