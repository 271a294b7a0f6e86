"""Single-pass ray casting of one rank's bricks: a partial image, and how many samples it took.

References
----------
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, sections 3.3.1 and 5.3.3.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from clusterviz.gl.context import compile_compute
from clusterviz.gl.shader import ShaderSource, assemble
from clusterviz.image.partial import PartialImage, blank
from clusterviz.image.region import EMPTY, Rect
from clusterviz.partition import BrickBox
from clusterviz.plan.encoding import VoxelKind
from clusterviz.plan.plan import Plan
from clusterviz.plan.segments import RECORD
from clusterviz.render.chunks import chunks_of
from clusterviz.render.frame_block import FRAME_BLOCK, frame_block
from clusterviz.render.residence import Residence, capacity, upload
from clusterviz.render.storage import Slot, make_slot

TILE = 8  # pixels along the side of a work group, as in raycast.glsl
Index = tuple[int, int, int]


def source_of(filter: str, kind: VoxelKind, further_starts: int) -> ShaderSource:
    """The assembled shader of a variant.

    Parameters
    ----------
    filter : "linear", "nearest" or "hardware"
    kind : the stored voxel type
    further_starts : of the plan's segments; a constant, since most transfer functions need no search
    """
    constants = f"const int RECORD = {RECORD.itemsize // 8};\nconst int FURTHER_STARTS = {further_starts};\n"
    voxel, scalar = f"voxel_{kind}.glsl", f"{filter}.glsl"
    if filter == "hardware":
        voxel = "atlas.glsl"
    elif filter == "linear" and kind == "u8":
        scalar = "linear_u8.glsl"
    slots = {"FRAME": FRAME_BLOCK, "CONSTANTS": constants, "VOXEL": voxel, "SCALAR": scalar}
    return assemble("raycast.glsl", slots)


@dataclass(frozen=True)
class Drawn:
    """What one draw gave.

    Attributes
    ----------
    partial : float32, premultiplied
    samples : field samples taken
    bricks : bricks drawn
    seconds_render, seconds_readback : until the GPU was done, and until the pixels were here
    """

    partial: PartialImage
    samples: int = 0
    bricks: int = 0
    seconds_render: float = 0.0
    seconds_readback: float = 0.0


class Raycaster:
    """One rank's ray caster: its program, its bricks in GPU memory.

    Parameters
    ----------
    context : a context that this thread has current
    plan : decides the variant, the slots and the transfer function
    box : the bricks that this rank owns, and no other rank
    block_bytes : GPU buffers no larger than this, for tests
    """

    def __init__(self, context: moderngl.Context, plan: Plan, box: BrickBox, block_bytes: int | None = None) -> None:
        self._context, self._box = context, box
        self._program = compile_compute(context, source_of(plan.march.filter, plan.encoding.kind, plan.segments.further_starts))
        self._slot: Slot = make_slot(plan.layout, plan.encoding, plan.march.filter == "hardware")
        self._capacity = capacity(context, self._slot, block_bytes)
        self._residences: list[Residence] = []

    @property
    def renderer(self) -> str:
        """OpenGL's name of what draws."""
        return str(self._context.info["GL_RENDERER"])

    @property
    def voxel_bytes(self) -> int:
        """GPU memory taken by voxels."""
        return sum(residence.bytes for residence in self._residences)

    def load(self, plan: Plan, bricks: Mapping[Index, NDArray[Any]]) -> None:
        """Upload the visible bricks of this rank's box; samples (z, y, x) by brick index."""
        self._drop()
        self._residences = [
            upload(self._context, chunk, bricks, self._slot, plan.encoding)
            for chunk in chunks_of(self._box, plan, self._capacity)
        ]

    def draw(self, plan: Plan) -> Drawn:
        """Draw one frame; the partial image is the rectangle that the loaded bricks may cover."""
        started = perf_counter()
        rects = [_footprint(plan, residence.box) for residence in self._residences]
        rect = EMPTY
        for part in rects:
            rect = rect.unite(part)
        if rect.pixels == 0:
            return Drawn(blank())
        groups = (-(-rect.width // TILE), -(-rect.height // TILE))
        segments = plan.segments
        with _Buffers(self._context) as buffers:
            pixels = buffers.bind(1, np.zeros((rect.height, rect.width, 4), np.float32))
            samples = buffers.bind(2, np.zeros(groups, np.uint32))
            buffers.bind(4, segments.buckets)
            buffers.bind(5, segments.records)
            # Front to back: each draw adds behind what the pixels hold.
            for residence in self._residences:
                buffers.make(frame_block(plan, residence.box, rect, self._slot)).bind_to_uniform_block(0)
                buffers.bind(6, residence.visibility(plan.transfer, self._slot))
                self._bind(residence)
                self._march(buffers, groups, rect)
            rendered = perf_counter()
            rgba = np.frombuffer(pixels.read(), np.float32).reshape(rect.height, rect.width, 4)
            taken = int(np.frombuffer(samples.read(), np.uint32).sum(dtype=np.int64))
        bricks = sum(residence.bricks for residence in self._residences)
        return Drawn(PartialImage(rect, rgba), taken, bricks, rendered - started, perf_counter() - rendered)

    def release(self) -> None:
        """Give everything back to the driver."""
        self._drop()
        self._program.release()

    def _march(self, buffers: _Buffers, groups: tuple[int, int], rect: Rect) -> None:
        """Dispatch until every ray has ended; rays of more than some ten thousand slabs take several dispatches."""
        progress = buffers.bind(8, np.zeros(1 + rect.pixels, np.int32))
        unfinished = 1
        while unfinished:
            progress.write(b"\0\0\0\0")
            self._program.run(*groups)
            self._context.memory_barrier()
            unfinished = int(np.frombuffer(progress.read(4), np.uint32)[0])

    def _bind(self, residence: Residence) -> None:
        residence.offsets.bind_to_storage_buffer(3)
        if isinstance(residence.voxels, moderngl.Buffer):
            residence.voxels.bind_to_storage_buffer(7)
        else:
            residence.voxels.use(0)

    def _drop(self) -> None:
        for residence in self._residences:
            residence.release()
        self._residences = []


class _Buffers:
    """Buffers that live for one draw."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._made: list[moderngl.Buffer] = []

    def bind(self, binding: int, data: NDArray[Any]) -> moderngl.Buffer:
        buffer = self.make(data)
        buffer.bind_to_storage_buffer(binding)
        return buffer

    def make(self, data: NDArray[Any]) -> moderngl.Buffer:
        buffer = self._context.buffer(data.tobytes())
        self._made.append(buffer)
        return buffer

    def __enter__(self) -> _Buffers:
        return self

    def __exit__(self, *_: object) -> None:
        for buffer in self._made:
            buffer.release()


def _footprint(plan: Plan, box: BrickBox) -> Rect:
    """The pixels that a box of bricks may cover."""
    brick, cells = plan.layout.brick, plan.layout.cells_zyx
    begin = tuple(float(b * brick) for b in box.begin_zyx[::-1])
    end = tuple(float(min(e * brick, c)) for e, c in zip(box.end_zyx[::-1], cells[::-1], strict=True))
    return plan.view.footprint(begin, end)  # type: ignore[arg-type]
