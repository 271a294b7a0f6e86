"""Single-pass ray casting of one rank's bricks: a partial image, and how many samples it took.

References
----------
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, sections 3.3.1 and
5.3.3.
"""

from __future__ import annotations

from collections.abc import MutableMapping
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from clusterviz.gl.context import compile_compute
from clusterviz.image.partial import PartialImage, blank
from clusterviz.image.region import EMPTY, Rect
from clusterviz.partition import BrickBox
from clusterviz.plan.plan import Plan
from clusterviz.render.chunks import chunks_of
from clusterviz.render.frame_block import frame_block
from clusterviz.render.residence import Residence, capacity, upload
from clusterviz.render.storage import Slot, make_slot
from clusterviz.render.variant import variant_of

TILE = 8  # pixels along the side of a work group, as in raycast.glsl
Index = tuple[int, int, int]


@dataclass(frozen=True)
class Drawn:
    """What one draw gave.

    Attributes
    ----------
    partial : float32; `image/merge.py` says what four floats are, by the operator of the plan's look
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
        self._slot: Slot = make_slot(plan.layout, plan.encoding, plan.march)
        self._variant = variant_of(plan, self._slot, int(context.info["GL_MAX_UNIFORM_BLOCK_SIZE"]))
        self._program = compile_compute(context, self._variant.source)
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

    def load(self, plan: Plan, bricks: MutableMapping[Index, NDArray[Any]]) -> None:
        """Upload the visible bricks of this rank's box: samples (z, y, x) by index, taken out as they are stored."""
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
            pixels = buffers.reserve(1, 16 * rect.pixels)
            progress = buffers.bind(2, np.zeros(1 + rect.pixels + groups[0] * groups[1], np.uint32))
            buffers.bind(4, segments.buckets)
            records = buffers.make(_padded(segments.records, self._variant.block_bytes))
            if segments.sums is not None:
                buffers.bind(0, segments.sums)
            if len(plan.clip):
                buffers.make(plan.clip).bind_to_uniform_block(3)
            if plan.look.surfaces:
                buffers.make(plan.look.surface_block()).bind_to_uniform_block(4)
            if plan.look.shading:
                buffers.make(plan.look.shading.block()).bind_to_uniform_block(2)
            records.bind_to_uniform_block(1) if self._variant.block_bytes else records.bind_to_storage_buffer(5)
            if plan.look.grading:
                buffers.make(plan.look.grading.block()).bind_to_uniform_block(5)
                if plan.look.grading.table is not None:
                    buffers.table(plan.look.grading.table).use(1)
            # Front to back: each draw adds behind what the pixels hold.
            for number, residence in enumerate(self._residences):
                buffers.bind(6, residence.visibility(plan, self._slot))
                self._bind(residence)
                block = frame_block(plan, residence.box, rect, self._slot)
                block["first_box"] = number == 0
                self._march(buffers, block, progress, groups)
            rendered = perf_counter()
            rgba = np.frombuffer(pixels.read(), np.float32).reshape(rect.height, rect.width, 4)
            samples = progress.read(offset=4 + 4 * rect.pixels)
            taken = int(np.frombuffer(samples, np.uint32).sum(dtype=np.int64))
        bricks = sum(residence.bricks for residence in self._residences)
        return Drawn(PartialImage(rect, rgba), taken, bricks, rendered - started, perf_counter() - rendered)

    def release(self) -> None:
        """Give everything back to the driver."""
        self._drop()
        self._program.release()

    def _march(
        self, buffers: _Buffers, block: NDArray[np.void], progress: moderngl.Buffer, groups: tuple[int, int]
    ) -> None:
        """Dispatch until every ray has ended; rays of more than some thousand slabs take several dispatches."""
        frame = buffers.make(block)
        frame.bind_to_uniform_block(0)
        unfinished, block["first_dispatch"] = 1, 1
        while unfinished:
            frame.write(block)
            progress.write(b"\0\0\0\0")
            self._program.run(*groups)
            self._context.memory_barrier()
            unfinished = int(np.frombuffer(progress.read(4), np.uint32)[0])
            block["first_dispatch"] = 0

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
    """Buffers and textures that live for one draw."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._made: list[moderngl.Buffer | moderngl.Texture] = []

    def bind(self, binding: int, data: NDArray[Any]) -> moderngl.Buffer:
        buffer = self.make(data)
        buffer.bind_to_storage_buffer(binding)
        return buffer

    def reserve(self, binding: int, size: int) -> moderngl.Buffer:
        buffer = self._context.buffer(reserve=size)
        buffer.bind_to_storage_buffer(binding)
        self._made.append(buffer)
        return buffer

    def make(self, data: NDArray[Any]) -> moderngl.Buffer:
        buffer = self._context.buffer(data.tobytes())
        self._made.append(buffer)
        return buffer

    def table(self, texels: NDArray[np.float32]) -> moderngl.Texture:
        """A texture of float32 (h, w, 4)."""
        texture = self._context.texture(texels.shape[1::-1], 4, texels.tobytes(), dtype="f4")
        texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._made.append(texture)
        return texture

    def __enter__(self) -> _Buffers:
        return self

    def __exit__(self, *_: object) -> None:
        for buffer in self._made:
            buffer.release()


def _padded(records: NDArray[np.void], size: int) -> NDArray[np.uint8]:
    """Bytes of an array, with zeros up to a size: a uniform block has the size that its program declares."""
    data = np.zeros(max(size, records.nbytes), np.uint8)
    data[: records.nbytes] = records.view(np.uint8)
    return data


def _footprint(plan: Plan, box: BrickBox) -> Rect:
    """The pixels that a box of bricks may cover."""
    brick, cells = plan.layout.brick, plan.layout.cells_zyx
    begin = tuple(float(b * brick) for b in box.begin_zyx[::-1])
    end = tuple(float(min(e * brick, c)) for e, c in zip(box.end_zyx[::-1], cells[::-1], strict=True))
    return plan.view.footprint(begin, end)  # type: ignore[arg-type]
