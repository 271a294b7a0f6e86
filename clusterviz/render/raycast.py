"""Single-pass ray casting of one rank's bricks in OpenGL.

With early ray termination, bricks are divided into layers from front to back, so that opaque layers hide those behind
them.

References
----------
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, sections 3.3.1,
3.3.2 (early ray termination, here for whole bricks) and 5.3.3.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, MutableMapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from operator import length_hint
from time import perf_counter
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import InputError
from clusterviz.gl.compute import run_compute
from clusterviz.gl.context import compile_compute, is_software
from clusterviz.gl.device import Device
from clusterviz.image.partial import PartialImage, Rect, blank
from clusterviz.partition import BrickBox, Piece, bounding_box, build_tree, front_to_back
from clusterviz.plan.plan import Plan
from clusterviz.render.abuffer.discarding import HIDDEN, HIDDEN_BINDING, HiddenPixels, LastEnds, prepare_discarding
from clusterviz.render.abuffer.fills import ManyFragmentsError, Pools, with_fill
from clusterviz.render.abuffer.on_gl import bind_fragments, compile_passes, list_primitives
from clusterviz.render.abuffer.primitives import TableCache
from clusterviz.render.abuffer.program import find_variants
from clusterviz.render.abuffer.resolves import DRAWN_CLASS
from clusterviz.render.abuffer.tiles import TileLists
from clusterviz.render.brick_atlas import BrickPool, capacity
from clusterviz.render.cells.table import walk_planes
from clusterviz.render.content_bricks import store_as
from clusterviz.render.frame_block import ASK, ONLY, frame_block
from clusterviz.render.frame_coherence import BINDING, LastFrame, Starts, prepare_reprojection
from clusterviz.render.packed_picture import PIXEL_BYTES, PictureReader
from clusterviz.render.passes import Passes
from clusterviz.render.refraction import CarriedRays, Paths, rays_block
from clusterviz.render.render_result import (
    PROGRESS_SECONDS,
    SQUARE,
    PartOf,
    Progress,
    RenderResult,
    footprint,
    joined_bands,
    no_progress,
)
from clusterviz.render.storage import slot_of
from clusterviz.render.variant import Variant, of_size, variant_of
from clusterviz.render.volume_layers import all_segments, content_blocks, content_tables
from clusterviz.report.early_discarding import all_counts
from clusterviz.report.kbuffer_counts import KBufferCounts

TILE = SQUARE  # pixels along the side of a work group, as in raycast.glsl
ITERATIONS = (1 << 16, 3600)
"""Of the loops of a ray in a dispatch, on GPUs and on llvmpipe, which silently leaves all loops after 65535 in total:
sixteen lanes that diverge may take sixteen times the iterations that each of them counts."""
MOST_PIXELS_AT_ONCE, FIRST_BAND_PIXELS = 1 << 18, 1 << 15
"""Larger pictures are drawn in bands, with progress reports; the first band measures the speed."""
Index = tuple[int, int, int]
Rays = Starts | CarriedRays


class Raycaster:
    """OpenGL ray caster of one rank: its program, and its bricks in GPU memory.

    Parameters
    ----------
    context : a context that this thread has current
    plan : the first plan to draw, which decides the variant, the slots and the encoding of bricks
    block_bytes : largest size of a GPU buffer, for tests
    limit_bytes : GPU memory beyond which no free slots are added; None: no limit
    band_pixels : larger pictures are drawn in bands; None: `MOST_PIXELS_AT_ONCE`
    packs : whether pictures are packed on the device before they are read; None: unless that is software

    Attributes
    ----------
    reader : reads pictures back, and counts bytes
    slot : layout of a brick
    pool : the bricks
    """

    def __init__(
        self,
        context: moderngl.Context,
        plan: Plan,
        block_bytes: int | None = None,
        limit_bytes: int | None = None,
        band_pixels: int | None = None,
        packs: bool | None = None,
    ) -> None:
        self._context, self._band_pixels = context, band_pixels or MOST_PIXELS_AT_ONCE
        self.slot = slot_of(plan)
        most = None if limit_bytes is None else limit_bytes // self.slot.bytes
        self.pool = BrickPool(context, self.slot, capacity(context, self.slot, block_bytes), most)
        self._programs, self._passes = self._compiled(plan), compile_passes(context, plan)
        self._primitives, self._last_frame = TableCache(), LastFrame()
        packs = not is_software(self.renderer) if packs is None else packs
        self.reader = PictureReader(Device(context, None if packs else False), packs)
        self.forget()

    def forget(self) -> None:
        """Forget what earlier draws have found; it changes the dispatches of a draw."""
        self._last_frame.forget()
        self._pools, self._last_ends = Pools(), LastEnds()

    @property
    def renderer(self) -> str:
        """OpenGL's name of the device."""
        return str(self._context.info["GL_RENDERER"])

    @property
    def driver(self) -> str:
        """Versions of OpenGL and of its driver."""
        return str(self._context.info["GL_VERSION"])

    @property
    def voxel_bytes(self) -> int:
        """Bytes of GPU memory of the bricks."""
        return self.pool.bytes

    def variant_of(self, plan: Plan) -> Variant:
        """Return the program that a plan needs on this context."""
        return variant_of(plan, self.slot, int(self._context.info["GL_MAX_UNIFORM_BLOCK_SIZE"]))

    def can_draw(self, plan: Plan) -> bool:
        """Return True if there are the programs of a plan."""
        needed = (plan, plan.crossing) if plan.layers else (plan,)
        has_passes = all(variant in self._passes for variant in find_variants(plan))
        return has_passes and all(self.variant_of(each) in self._programs for each in needed)

    def compile(self, plan: Plan) -> None:
        """Compile the program of another plan with the same slots; the bricks stay."""
        old = *self._programs.values(), *self._passes.values()
        self._programs, self._passes = self._compiled(plan), compile_passes(self._context, plan)
        for program in old:
            program.release()

    def _compiled(self, plan: Plan) -> dict[Variant, moderngl.ComputeShader]:
        """Compile the programs of a plan, and the kernel of frame coherence if it needs one."""
        if plan.march.frame_coherence is not None:
            prepare_reprojection()
        if plan.march.discard_margin is not None:
            prepare_discarding()
        variants = [self.variant_of(each) for each in ((plan, plan.crossing) if plan.layers else (plan,))]
        return {variant: compile_compute(self._context, variant.source) for variant in variants}

    def _program(self, variant: Variant) -> moderngl.ComputeShader:
        """Return a program, compiled when it is first needed."""
        if variant not in self._programs:
            self._programs[variant] = compile_compute(self._context, variant.source)
        return self._programs[variant]

    def load(self, plan: Plan, bricks: MutableMapping[Index, Any]) -> None:
        """Add bricks, removed from the mapping, and upload them at the latest when they are drawn.

        Parameters
        ----------
        bricks : samples (z, y, x), or the `ContentBrick` of several volumes, by index
        """
        if bricks:
            self._primitives = TableCache()
            self._last_frame.forget()
        # With early ray termination, a brick of one volume is uploaded only if a ray reaches it.
        later = plan.march.residual > 0 and plan.blend_mode.traits.composited and plan.content is None
        put = self.pool.put_later if later else self.pool.put
        put(bricks, store_as(plan, self.slot))

    def drop(self, bricks: Iterable[Index]) -> None:
        """Drop bricks."""
        if bricks := set(bricks):
            self._primitives = TableCache()
            self._last_frame.forget()
        self.pool.drop(bricks)

    def draw(
        self,
        plan: Plan,
        pieces: Iterable[Piece],
        progress: Progress = no_progress,
        carried: Sequence[CarriedRays] = (),
        passes: Passes | None = None,
        pixel: str = "float32",
    ) -> list[RenderResult]:
        """Draw one frame's pieces, whose visible bricks are loaded, unless `passes` does.

        Parameters
        ----------
        pieces : the iterator advances when a piece is drawn
        progress : called with the part of the pieces that is drawn, in [0, 1], if their number is known
        carried : rays of each piece, which are written: of a plan that only finds crossings, or paths that bend
        passes : loads the bricks of the pieces part by part
        pixel : format that partial images may have, if they are converted on the device anyway: float32, float16, uint8

        Returns
        -------
        drawn : one result for each piece; its partial image is the footprint of the piece
        """
        variant = self.variant_of(plan)
        self.reader.next_frame(pixel)
        with Buffers(self._context) as buffers:
            table, rows, sums = all_segments(plan)
            buffers.bind(4, table)
            records = buffers.make(_padded(rows, variant.block_bytes))
            records.bind_to_uniform_block(1) if variant.block_bytes else records.bind_to_storage_buffer(5)
            if sums is not None:
                buffers.bind(0, sums)
            for binding, block in content_blocks(plan.content) if plan.content else ():
                buffers.make(block).bind_to_uniform_block(binding)
            for binding, texels in content_tables(plan.content) if plan.content else ():
                buffers.table(texels).use(binding)
            if len(plan.clip):
                buffers.make(plan.clip).bind_to_uniform_block(3)
            if plan.blend_mode.surfaces:
                buffers.make(plan.blend_mode.surface_block()).bind_to_uniform_block(4)
            if plan.blend_mode.shading:
                buffers.make(plan.blend_mode.shading.block()).bind_to_uniform_block(2)
            if plan.blend_mode.grading:
                buffers.make(plan.blend_mode.grading.block()).bind_to_uniform_block(5)
                if plan.blend_mode.grading.table is not None:
                    buffers.table(plan.blend_mode.grading.table).use(1)
            return self._draw_pieces(plan, pieces, progress, carried, passes)

    def _draw_pieces(
        self,
        plan: Plan,
        pieces: Iterable[Piece],
        progress: Progress,
        carried: Sequence[CarriedRays],
        passes: Passes | None,
    ) -> list[RenderResult]:
        """Draw pieces; consecutive ones with the same bricks share their tables."""
        drawn: list[RenderResult] = []
        count = length_hint(pieces)
        if not carried:
            self._last_frame.next_frame()
            self._last_ends.next_frame()
        with ExitStack() as last:
            tables: _Tables | None = None
            for number, piece in enumerate(pieces):
                started, rect = perf_counter(), footprint(plan, piece)
                parts = passes.parts(piece) if passes else [piece]
                layers = [(one, layer) for one in parts for layer in layers_of(plan, one)]
                part = PartOf(progress, number, count)
                part(0.0)
                if not layers or not rect.pixels:
                    drawn.append(RenderResult(blank()))
                    continue
                starts: Rays | None = carried[number] if carried else None
                if plan.march.frame_coherence is not None:
                    starts = Starts.of(self._last_frame, plan, piece, rect)
                if len(layers) > 1:
                    drawn.append(self._draw_layers(plan, rect, layers, started, starts, passes))
                else:
                    if passes:
                        passes.load(piece)
                    if tables is None or not piece.shows_bricks_of(tables.piece):
                        last.close()
                        tables = last.enter_context(_Tables(self._context, self.pool, plan, piece))
                    hidden = self._last_ends.begin(plan, piece, rect)
                    drawn.append(self._draw_bands(plan, rect, tables, started, starts, hidden, part))
                    if hidden:
                        self._last_ends.finish(plan, piece, rect, hidden)
                        counts = hidden.counts(drawn[-1].fragments)
                        drawn[-1] = replace(drawn[-1], early_discarding=counts)
                if isinstance(starts, Starts):
                    drawn[-1] = replace(drawn[-1], frame_coherence=starts.finish(drawn[-1].partial.rgba[..., 3]))
        return drawn

    def _draw_bands(
        self,
        plan: Plan,
        rect: Rect,
        tables: _Tables,
        started: float,
        starts: Rays | None,
        hidden: HiddenPixels | None,
        progress: Progress,
    ) -> RenderResult:
        """Draw a large picture from top to bottom, in bands that take about `PROGRESS_SECONDS` each."""
        drawn: list[RenderResult] = []
        top, rows = rect.y_begin, rect.height
        if rect.pixels > self._band_pixels:
            rows = max(TILE, FIRST_BAND_PIXELS // rect.width // TILE * TILE)
        while top < rect.y_end:
            began, band = perf_counter(), replace(rect, y_begin=top, y_end=min(rect.y_end, top + rows))
            within = top - rect.y_begin, band.y_end - rect.y_begin
            own = starts and starts.rows(*within), hidden and hidden.rows(*within)
            try:
                drawn.append(self._draw_piece(plan, band, _only(tables), started, *own, ONLY if tables.alone else 1))
            except ManyFragmentsError:
                rows = max(TILE, band.height // 2 // TILE * TILE)
                continue
            started = perf_counter()
            progress((band.y_end - rect.y_begin) / rect.height)
            top, rows = band.y_end, max(TILE, int(rows * PROGRESS_SECONDS / (started - began)) // TILE * TILE)
        return joined_bands(rect, drawn)

    def _draw_layers(
        self,
        plan: Plan,
        rect: Rect,
        layers: Sequence[tuple[Piece, Piece]],
        started: float,
        starts: Rays | None,
        passes: Passes | None,
    ) -> RenderResult:
        """Draw layers of parts from front to back, without those that no ray reaches, whose bricks are not uploaded."""
        loading = passes.seconds if passes else 0.0

        def reached(march: March) -> Iterator[_Tables]:
            for number, (part, layer) in enumerate(layers):
                if number == 0 or march.reaches(frame_block(plan, layer.box, rect, self.slot)):
                    if passes:
                        passes.load(part, layer)
                    with _Tables(self._context, self.pool, plan, layer) as tables:
                        yield tables

        drawn = self._draw_piece(plan, rect, reached, started, starts)
        shown = sum(len(layer.members(plan.cost > 0)) for _, layer in layers)
        seconds = drawn.seconds_render - (passes.seconds - loading if passes else 0.0)
        return replace(drawn, occluded=shown - drawn.bricks, seconds_render=seconds)

    def _draw_piece(
        self,
        plan: Plan,
        rect: Rect,
        layers: Callable[[March], Iterator[_Tables]],
        started: float,
        starts: Rays | None = None,
        hidden: HiddenPixels | None = None,
        first: int = 1,
    ) -> RenderResult:
        """Draw parts front to back, each behind the pixels so far; `first` is the first one's `first_box`."""
        plan = with_fill(plan, self._pools)
        groups, bricks = (-(-rect.width // TILE), -(-rect.height // TILE)), dict[BrickBox, int]()
        tiles = dict[BrickBox, TileLists]()
        ahead, squares = 1 + rect.pixels, groups[0] * groups[1]
        content = plan.content.layers if plan.content else ()
        fragments = np.zeros((rect.height, rect.width) if content else (0, 0), np.int32)
        counts = list[KBufferCounts]()
        with Buffers(self._context) as buffers:
            pixels = buffers.reserve(1, 2 * PIXEL_BYTES * rect.pixels)
            if isinstance(starts, CarriedRays):
                pixels.write(starts.pixels.tobytes())
            planes = starts.planes if starts else np.zeros(0, np.float32)
            walks = np.zeros(walk_planes(plan.content) * rect.pixels, np.uint32)
            parts = np.zeros(ahead + squares, np.uint32), planes.view(np.uint32).ravel(), walks
            progress = buffers.bind(2, np.concatenate(parts))
            march = March(self._context, self._program(self.variant_of(plan)), buffers, progress, groups)
            for again in (False, True) if starts or hidden else (False,):
                if hidden:
                    if not again:
                        hidden.begin()
                    kept = buffers.bind(HIDDEN_BINDING, hidden.pixels)
                    first = 0 if again else first
                if starts:
                    buffers.make(rays_block(plan, again)).bind_to_uniform_block(BINDING)
                    # Rays that are drawn again begin with the zeros that were kept.
                    first = 0 if again or isinstance(starts, CarriedRays) else 1
                for tables in layers(march):
                    bricks[tables.piece.box] = tables.bricks
                    for box in tables.bind_each():
                        block = frame_block(plan, box, rect, self.slot)
                        block["first_box"], first = first, 0
                        block["optics"][0, 3] = ITERATIONS["llvmpipe" in self.renderer]
                        if table := self._primitives.table(content, *tables.primitives_of(box)):
                            buffers.make(block).bind_to_uniform_block(0)
                            limits = hidden.limits if hidden else None
                            tiles[box] = list_primitives(self._context, plan, table, rect, limits, tiles.get(box))
                            given = plan, table, tiles[box], rect, buffers.make, self._pools
                            found = bind_fragments(self._context, self._passes, *given)
                            fragments += found[0]
                            for size in found[2]:
                                found[1].write(np.uint32(size).tobytes(), offset=4 * DRAWN_CLASS)
                                program = self._program(of_size(self.variant_of(plan), size))
                                replace(march, program=program).through(block)
                            if plan.content and plan.content.kbuffer:
                                counted = np.frombuffer(found[1].read(), np.uint32).reshape(-1, 2)[: rect.pixels]
                                counts.append(KBufferCounts.of(counted))
                                fragments += counted[:, 0].astype(np.int32).reshape(fragments.shape)
                        else:
                            march.through(block)
                if hidden:
                    hidden.pixels[:] = np.frombuffer(kept.read(), HIDDEN).reshape(hidden.pixels.shape)
                if hidden and (again or not hidden.draw_again()):
                    break
                if starts:
                    noted = np.frombuffer(progress.read(planes.nbytes, offset=4 * (ahead + squares)), np.float32)
                    if not starts.keep(noted.reshape(-1, rect.height, rect.width)):
                        break
            rendered = perf_counter()
            beside = [(progress, 4 * ahead, 4 * squares)]
            if walks.size:  # those that were cut short
                beside.append((progress, 4 * (ahead + squares + planes.size + rect.pixels), 4 * rect.pixels))
            before = self.reader.device.counts.read
            rgba, (read, *cut_short) = self.reader.begin(pixels, rect, beside=beside).finish()
            work = read.view(np.uint32).reshape(groups[::-1]).copy()
            if isinstance(starts, Paths):
                starts.pixels[:] = np.frombuffer(pixels.read(), np.float32).reshape(starts.pixels.shape)
            taken = int(work.sum(dtype=np.int64))
        seconds = rendered - started, perf_counter() - rendered
        partial, shown = PartialImage(rect, rgba), sum(bricks.values())
        return RenderResult(
            partial,
            taken,
            shown,
            *seconds,
            work,
            fragments=fragments,
            cut_short=sum(int(each.view(np.uint32).sum()) for each in cut_short),
            kbuffer=all_counts(counts),
            bytes_read=self.reader.device.counts.read - before,
        )

    def release(self) -> None:
        """Free all GPU resources."""
        self.pool.release()
        self.reader.release()
        for program in (*self._programs.values(), *self._passes.values()):
            program.release()


class _Tables:
    """Offsets and visible groups of the bricks of a piece, in GPU buffers."""

    def __init__(self, context: moderngl.Context, pool: BrickPool, plan: Plan, piece: Piece) -> None:
        self.piece, self._buffers = piece, Buffers(context)
        members = piece.members(plan.cost > 0)
        self.bricks = len(members)
        self._parts = []
        self._members: dict[BrickBox, tuple[NDArray[np.int64], Callable[..., Any], Callable[..., Any]]] = {}
        for atlas, part in pool.parts(plan, members) if self.bricks else ():
            box = bounding_box(part)
            offsets, visible = map(self._buffers.make, atlas.tables(plan, box, part))
            self._parts.append((atlas, box, offsets, visible))
            self._members[box] = part, atlas.primitives, atlas.cells
        if plan.refraction and len(self._parts) > 1:
            # A ray that bends may come back to what lies in another buffer.
            found, allowed = (
                f"bricks in {len(self._parts)} buffers",
                "one; set cluster.memory_limit to load them in turn",
            )
            raise InputError(
                "too many bricks for rays that bend", where="optics.refraction", found=found, allowed=allowed
            )

    @property
    def alone(self) -> bool:
        """True if all bricks are in one box."""
        return len(self._parts) == 1

    def bind_each(self) -> Iterator[BrickBox]:
        """Yield the boxes of bricks from front to back, each bound for drawing."""
        for atlas, box, offsets, visible in self._parts:
            offsets.bind_to_storage_buffer(3)
            visible.bind_to_storage_buffer(6)
            atlas.bind()
            yield box

    def primitives_of(self, box: BrickBox) -> tuple[NDArray[np.int64], Callable[..., Any], Callable[..., Any]]:
        """Return the bricks of a box, and functions that find their primitives and tetrahedra."""
        return self._members[box]

    def __enter__(self) -> _Tables:
        return self

    def __exit__(self, *error: object) -> None:
        self._buffers.__exit__(*error)


def _only(tables: _Tables) -> Callable[[March], Iterator[_Tables]]:
    """Return the layers of a piece that has only one."""
    return lambda march: iter([tables])


def _padded(records: NDArray[Any], size: int) -> NDArray[np.uint8]:
    """Return the bytes of an array, padded to the size of the uniform block that the program declares."""
    data = np.zeros(max(size, records.nbytes), np.uint8)
    data[: records.nbytes] = records.view(np.uint8)
    return data


MOST_LAYERS = 64
LEAST_BRICKS = 2
"""Least bricks of a layer; each layer costs a test of all rays."""


def layers_of(plan: Plan, piece: Piece) -> list[Piece]:
    """Return the visible bricks of a piece in disjoint boxes, from front to back.

    There is only one layer if no ray ends early, with geometry or grids, or if the piece is a part of the screen that
    shares its bricks with others.
    """
    members = piece.members(plan.cost > 0)
    count = min(MOST_LAYERS, len(members) // LEAST_BRICKS)
    if plan.content and plan.content.layers:
        count = min(1, len(members))
    if count < 2 or not plan.march.residual or not plan.blend_mode.traits.composited or piece.rect is not None:
        return [piece] if len(members) else []
    box = bounding_box(members)
    present = np.zeros(box.shape_zyx)
    present[tuple((members - box.begin_zyx).T)] = 1.0
    tree = build_tree(present, count)
    order = front_to_back(tree, plan.eye_in_bricks(box.begin_zyx), plan.view.forward)
    found = [np.argwhere(present[tree.leaves[leaf].box.slices]) + tree.leaves[leaf].box.begin_zyx for leaf in order]
    return [piece.part(bricks + box.begin_zyx) for bricks in found if len(bricks)]


class Buffers:
    """Buffers and textures that live for one draw or one piece."""

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
        """Return a texture of float32 (h, w, 4)."""
        texture = self._context.texture(texels.shape[1::-1], 4, texels.tobytes(), dtype="f4")
        texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._made.append(texture)
        return texture

    def __enter__(self) -> Buffers:
        return self

    def __exit__(self, *_: object) -> None:
        for buffer in self._made:
            buffer.release()


@dataclass(frozen=True)
class March:
    """Dispatches for the pixels of a piece.

    Attributes
    ----------
    context, program, buffers : those of the caster
    progress : buffer with the progress of each pixel, bound
    groups : number of work groups in x and y
    """

    context: moderngl.Context
    program: moderngl.ComputeShader
    buffers: Buffers
    progress: moderngl.Buffer
    groups: tuple[int, int]

    def through(self, block: NDArray[np.void]) -> None:
        """Dispatch until all rays are done; rays of more than some thousand slabs take several dispatches."""
        block["first_dispatch"] = 1
        while self._dispatch(block):
            block["first_dispatch"] = 0

    def reaches(self, block: NDArray[np.void]) -> bool:
        """Return True if any ray that meets the block's box has not ended in front of it."""
        block["first_dispatch"] = ASK
        # Behind an opaque pixel nothing matters, even if rays do not end early.
        block["optics"][0, 1] = max(0.0, block["optics"][0, 1])
        return self._dispatch(block)

    def _dispatch(self, block: NDArray[np.void]) -> bool:
        """Run the program once; return True if a ray is not done."""
        self.buffers.make(block).bind_to_uniform_block(0)
        self.progress.write(b"\0\0\0\0")
        run_compute(self.program, self.groups)
        self.context.memory_barrier()
        return bool(np.frombuffer(self.progress.read(4), np.uint32)[0])
