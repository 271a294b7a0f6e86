"""Single-pass ray casting of one rank's bricks in OpenGL.

All dispatches of a piece are queued, and the host waits once, for the picture. With early ray termination, bricks are
stored on the device when a ray comes to them: the ray stops, and the next dispatch continues.

References
----------
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, sections 3.3.1,
3.3.2 (early ray termination, here for whole bricks, too) and 5.3.3.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, MutableMapping, Sequence
from dataclasses import dataclass, replace
from operator import length_hint
from time import perf_counter
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import DeviceError, InputError
from clusterviz.gl.context import is_software
from clusterviz.gl.device import Counts, Device
from clusterviz.gl.reals import ENVIRONMENT, EXTENSION, chosen_reals, has_doubles
from clusterviz.gl.staging import Bytes, Part
from clusterviz.image.partial import PartialImage, Rect, blank
from clusterviz.partition import BrickBox, Piece, bounding_box
from clusterviz.plan.plan import Plan
from clusterviz.render.abuffer.discarding import HIDDEN, HIDDEN_BINDING, HiddenPixels, LastEnds, prepare_discarding
from clusterviz.render.abuffer.fills import ManyFragmentsError, Pools, with_fill
from clusterviz.render.abuffer.on_gl import bind_fragments, compile_passes, list_primitives
from clusterviz.render.abuffer.primitives import TableCache
from clusterviz.render.abuffer.program import find_variants
from clusterviz.render.abuffer.raster import Rasteriser
from clusterviz.render.abuffer.resolves import DRAWN_CLASS
from clusterviz.render.abuffer.tiles import TileLists
from clusterviz.render.brick_atlas import BrickAtlas, BrickPool, capacity
from clusterviz.render.cells.table import walk_planes
from clusterviz.render.content_bricks import store_as
from clusterviz.render.frame_block import ONLY, frame_block
from clusterviz.render.frame_coherence import BINDING, LastFrame, Starts, prepare_reprojection
from clusterviz.render.packed_picture import PIXEL_BYTES, PictureReader
from clusterviz.render.passes import Passes, is_reached
from clusterviz.render.refraction import CarriedRays, Paths, rays_block
from clusterviz.render.render_result import (
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
from clusterviz.spmd.driver_needs import compile_checked

TILE = SQUARE  # pixels along the side of a work group, as in raycast.glsl
PIXELS, PROGRESS = 1, 2  # bindings
ITERATIONS = (1 << 16, 3600)
"""Of the loops of a ray in a dispatch, on GPUs and on llvmpipe, which silently leaves all loops after 65535 in total:
sixteen lanes that diverge may take sixteen times the iterations that each of them counts."""
MOST_PIXELS_AT_ONCE, BAND_SECONDS = 1 << 18, 0.5
"""Of a device whose speed is not known yet; from then on, pictures that would take longer are drawn in bands, with
progress reports, and so that no driver takes the device for lost."""
MOST_QUEUED = 64
"""Boxes of bricks whose dispatches are queued without a wait."""
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
    band_pixels : larger pictures are drawn in bands; None: by the speed of the device
    packs : whether pictures are packed on the device before they are read; None: unless that is software
    raster : whether a rasteriser finds fragments; None: chosen by the device

    Attributes
    ----------
    reader : reads pictures back
    slot : layout of a brick
    pool : the bricks
    raster : finds fragments, where it serves
    """

    def __init__(
        self,
        context: moderngl.Context,
        plan: Plan,
        block_bytes: int | None = None,
        limit_bytes: int | None = None,
        band_pixels: int | None = None,
        packs: bool | None = None,
        raster: bool | None = None,
    ) -> None:
        self._context = context
        packs = not is_software(self.renderer) if packs is None else packs
        self._device = Device(context, None if packs else False)
        self.reader, self._ends_at_once = PictureReader(self._device, packs), False
        self._band_pixels, self._has_fixed_bands = band_pixels or MOST_PIXELS_AT_ONCE, band_pixels is not None
        self.slot = slot_of(plan)
        most = None if limit_bytes is None else limit_bytes // self.slot.bytes
        self.pool = BrickPool(context, self.slot, capacity(context, self.slot, block_bytes), most)
        self._programs, self._passes = self._compiled(plan), compile_passes(context, plan)
        self._primitives, self._last_frame = TableCache(), LastFrame()
        self.raster = Rasteriser(self._device, raster)
        self.forget()

    def forget(self) -> None:
        """Forget what earlier draws have found; it changes the dispatches of a draw."""
        self._last_frame.forget()
        self._pools, self._last_ends = Pools(), LastEnds()

    @property
    def counts(self) -> Counts:
        """Calls of OpenGL since the caster was made, without those that store bricks."""
        return self._device.counts

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
        info, reals = self._context.info, chosen_reals(self._context)
        found = variant_of(plan, self.slot, int(info["GL_MAX_UNIFORM_BLOCK_SIZE"]), reals)
        if found.reals == "double" and not has_doubles(self._context):
            raise DeviceError(
                f"{info['GL_RENDERER']} has no double precision in shaders ({EXTENSION}), "
                f"which is needed by: {', '.join(found.needs_doubles) or ENVIRONMENT}"
            )
        return found

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
        return {variant: compile_checked(self._context, variant.source) for variant in variants}

    def _program(self, variant: Variant) -> moderngl.ComputeShader:
        """Return a program, compiled when it is first needed."""
        if variant not in self._programs:
            self._programs[variant] = compile_checked(self._context, variant.source)
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
        put = self.pool.put_later if waits_for_rays(plan) else self.pool.put
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
        self.reader.next_frame(pixel)
        self._give_constants(plan)
        drawn: list[RenderResult] = []
        count = length_hint(pieces)
        if not carried:
            self._last_frame.next_frame()
            self._last_ends.next_frame()
        tables: _Tables | None = None
        for number, piece in enumerate(pieces):
            rect, part = footprint(plan, piece), PartOf(progress, number, count)
            part(0.0)
            if not len(piece.members(plan.cost > 0)) or not rect.pixels:
                drawn.append(RenderResult(blank()))
                continue
            starts: Rays | None = carried[number] if carried else None
            if plan.march.frame_coherence is not None:
                starts = Starts.of(self._last_frame, plan, piece, rect)
            parts = passes.parts(piece) if passes else [piece]
            if len(parts) > 1 and passes:
                drawn.append(self._draw_parts(plan, rect, parts, starts, passes))
            else:
                if passes:
                    passes.load(piece)
                if tables is None or not piece.shows_bricks_of(tables.piece):
                    tables = _Tables(self._device, self.pool, plan, piece)
                hidden = self._last_ends.begin(plan, piece, rect)
                drawn.append(self._draw_bands(plan, rect, tables, starts, hidden, part))
                if hidden:
                    self._last_ends.finish(plan, piece, rect, hidden)
                    counts = hidden.counts(drawn[-1].fragments)
                    drawn[-1] = replace(drawn[-1], early_discarding=counts)
            if isinstance(starts, Starts):
                drawn[-1] = replace(drawn[-1], frame_coherence=starts.finish(drawn[-1].partial.rgba[..., 3]))
        return drawn

    def _give_constants(self, plan: Plan) -> None:
        """Bind what is the same for all pieces."""
        give, table, mode = self._device.give, self._device.table, plan.blend_mode
        buckets, rows, sums = all_segments(plan)
        give(4, buckets)
        padded = self.variant_of(plan).block_bytes
        give(1 if padded else 5, _padded(rows, padded), "uniform" if padded else "storage")
        if sums is not None:
            give(0, sums)
        for binding, block in content_blocks(plan.content) if plan.content else ():
            give(binding, block, "uniform")
        for unit, texels in content_tables(plan.content) if plan.content else ():
            table(unit, texels)
        if len(plan.clip):
            give(3, plan.clip, "uniform")
        if mode.surfaces:
            give(4, mode.surface_block(), "uniform")
        if mode.shading:
            give(2, mode.shading.block(), "uniform")
        if mode.grading:
            give(5, mode.grading.block(), "uniform")
            if mode.grading.table is not None:
                table(1, mode.grading.table)

    def _draw_bands(
        self,
        plan: Plan,
        rect: Rect,
        tables: _Tables,
        starts: Rays | None,
        hidden: HiddenPixels | None,
        progress: Progress,
    ) -> RenderResult:
        """Draw a picture that takes long from top to bottom, in bands of about `BAND_SECONDS`."""
        drawn: list[RenderResult] = []
        top, most = rect.y_begin, rect.pixels
        # Rays that are drawn again read the rounding errors that rays of the only box do not write.
        first = ONLY if tables.alone and not hidden else 1
        while top < rect.y_end:
            began, rows = perf_counter(), -(-max(1, min(self._band_pixels, most)) // (TILE * rect.width)) * TILE
            band = replace(rect, y_begin=top, y_end=min(rect.y_end, top + rows))
            within = top - rect.y_begin, band.y_end - rect.y_begin
            own = starts and starts.rows(*within), hidden and hidden.rows(*within)
            try:
                drawn.append(self._draw_piece(plan, band, lambda: [tables], *own, first=first))
            except ManyFragmentsError:
                most = band.pixels // 2
                continue
            progress((band.y_end - rect.y_begin) / rect.height)
            top, seconds = band.y_end, perf_counter() - began
            if not self._has_fixed_bands:
                by_speed = int(band.pixels * BAND_SECONDS / seconds)
                self._band_pixels = by_speed if seconds > BAND_SECONDS else max(by_speed, self._band_pixels)
        return replace(joined_bands(rect, drawn), bricks=tables.reached, occluded=tables.occluded)

    def _draw_parts(
        self, plan: Plan, rect: Rect, parts: Sequence[Piece], starts: Rays | None, passes: Passes
    ) -> RenderResult:
        """Draw parts of a piece whose bricks are loaded one part after the other, without those that no ray reaches."""
        loading, drawn_parts = passes.seconds, dict[BrickBox, _Tables]()

        def loaded() -> Iterator[_Tables]:
            for number, part in enumerate(parts):
                # With other modes, what is in front hides nothing.
                hides = number > 0 and plan.blend_mode.traits.composited
                if not hides or is_reached(plan, part, rect, self._drawn_pixels(rect)[..., 3]):
                    passes.load(part)
                    tables = drawn_parts[part.box] = _Tables(self._device, self.pool, plan, part)
                    yield tables

        drawn = self._draw_piece(plan, rect, loaded, starts)
        bricks = sum(tables.reached for tables in drawn_parts.values())
        occluded = sum(len(part.members(plan.cost > 0)) for part in parts) - bricks
        seconds = drawn.seconds_render - (passes.seconds - loading)
        return replace(drawn, bricks=bricks, occluded=occluded, seconds_render=seconds)

    def _draw_piece(
        self,
        plan: Plan,
        rect: Rect,
        parts: Callable[[], Iterable[_Tables]],
        starts: Rays | None = None,
        hidden: HiddenPixels | None = None,
        first: int = 1,
    ) -> RenderResult:
        """Draw parts front to back, each behind the pixels so far; `first` is the first one's `first_box`."""
        began, before = perf_counter(), self.counts.read
        plan = with_fill(plan, self._pools)
        march = self._march(plan, rect, starts)
        found = _Found(rect, bool(plan.content and plan.content.layers))
        for again in (False, True) if starts or hidden else (False,):
            if hidden:
                if not again:
                    hidden.begin()
                kept = self._device.begin(HIDDEN_BINDING, hidden.pixels)
                first = 0 if again else first
            if starts:
                self._device.give(BINDING, rays_block(plan, again), "uniform")
                # Rays that are drawn again begin with the zeros that were kept.
                first = 0 if again or isinstance(starts, CarriedRays) else 1
            for tables in parts():
                draw = self._draw_content if found.has_content else self._draw_boxes
                draw(plan, rect, march, tables, first, found, hidden)
                first = 0
            if hidden:
                read = self._device.read(kept, hidden.pixels.nbytes)
                hidden.pixels[:] = np.frombuffer(read, HIDDEN).reshape(hidden.pixels.shape)
            if hidden and (again or not hidden.draw_again()):
                break
            if starts and not starts.keep(march.planes().reshape(-1, rect.height, rect.width)):
                break
        picture = march.picture or march.read_picture()
        if isinstance(starts, Paths):
            read = self._device.read(self._pixels(rect), starts.pixels.nbytes)
            starts.pixels[:] = np.frombuffer(read, np.float32).reshape(starts.pixels.shape)
        return RenderResult(
            PartialImage(rect, picture.rgba),
            int(picture.work.sum(dtype=np.int64)),
            seconds_render=picture.drawn_at - began,
            seconds_readback=perf_counter() - picture.drawn_at,
            work=picture.work,
            fragments=found.fragments,
            cut_short=picture.cut_short,
            kbuffer=all_counts(found.kbuffer),
            bytes_read=self.counts.read - before,
        )

    def _march(self, plan: Plan, rect: Rect, starts: Rays | None) -> March:
        """Return the march of a rectangle's rays, begun with what is known of them."""
        groups = -(-rect.width // TILE), -(-rect.height // TILE)
        planes = starts.planes if starts else np.zeros(0, np.float32)
        words = rect.pixels, groups[0] * groups[1], planes.size, walk_planes(plan.content) * rect.pixels
        pixels = self._pixels(rect)
        if isinstance(starts, CarriedRays):
            self._device.write(pixels, starts.pixels)
        march = March(self.reader, self._program(self.variant_of(plan)), rect, words, groups)
        march.begin(planes)
        return march

    def _pixels(self, rect: Rect) -> moderngl.Buffer:
        """Return the buffer of a rectangle's pixels, drawn last, and of what rays carry."""
        return self._device.reserve(PIXELS, 2 * PIXEL_BYTES * rect.pixels)

    def _drawn_pixels(self, rect: Rect) -> NDArray[np.float32]:
        """Return the pixels of a rectangle that was drawn last, float32 (h, w, 4)."""
        read = self._device.read(self._pixels(rect), PIXEL_BYTES * rect.pixels)
        return np.frombuffer(read, np.float32).reshape(rect.height, rect.width, 4)

    def _draw_boxes(self, plan: Plan, rect: Rect, march: March, tables: _Tables, first: int, *_: object) -> None:
        """Draw boxes of bricks; where a ray waits for a brick, store the bricks that were noted, and go on."""
        blocks = [frame_block(plan, part.box, rect, self.slot) for part in tables.parts]
        for block in blocks:
            block["first_box"], first = first, 0
            block["optics"][0, 3] = self._iterations
        bricks = tables.bricks_in_box if tables.waits else 0
        at = turns = 0
        goes_on = False
        while at < len(blocks):
            march.begin_turn(bricks)
            queued = range(at, min(at + MOST_QUEUED, len(blocks)))
            for number in queued:
                tables.bind(number)
                march.queue(blocks[number], number - at, begins=not (goes_on and number == at), notes=tables.waits)
            is_last = queued.stop == len(blocks)
            stopped, noted = march.end_turn(bricks, reads=is_last and self._ends_at_once)
            goes_on, at, turns = stopped is not None, queued.stop if stopped is None else at + stopped, turns + 1
            if tables.waits:
                tables.store(noted)
        self._ends_at_once = turns == 1

    def _draw_content(
        self,
        plan: Plan,
        rect: Rect,
        march: March,
        tables: _Tables,
        first: int,
        found: _Found,
        hidden: HiddenPixels | None,
    ) -> None:
        """Draw boxes of bricks with primitives or tetrahedra, found before."""
        assert plan.content, "there is content"
        for number, part in enumerate(tables.parts):
            tables.bind(number)
            block = frame_block(plan, part.box, rect, self.slot)
            block["first_box"], first = first, 0
            block["optics"][0, 3] = self._iterations
            members = part.bricks, part.atlas.primitives, part.atlas.cells
            table = self._primitives.table(plan.content.layers, *members)
            if not table:
                march.through(block)
                continue
            self._device.give(0, block, "uniform")
            with Buffers(self._context) as buffers:
                if self.raster.serves(plan, rect):
                    fragments, lists, sizes = self.raster.find(plan, table, rect)
                else:
                    limits, own = hidden.limits if hidden else None, found.tiles.get(part.box)
                    found.tiles[part.box] = list_primitives(self._context, plan, table, rect, limits, own)
                    given = plan, table, found.tiles[part.box], rect, buffers.make, self._pools
                    fragments, lists, sizes = bind_fragments(self._context, self._passes, *given)
                found.fragments += fragments
                for size in sizes:
                    lists.write(np.uint32(size).tobytes(), offset=4 * DRAWN_CLASS)
                    program = self._program(of_size(self.variant_of(plan), size))
                    replace(march, program=program).through(block)
                if plan.content.kbuffer:
                    counted = np.frombuffer(lists.read(), np.uint32).reshape(-1, 2)[: rect.pixels]
                    found.kbuffer.append(KBufferCounts.of(counted))
                    found.fragments += counted[:, 0].astype(np.int32).reshape(found.fragments.shape)

    @property
    def _iterations(self) -> int:
        """Iterations of a ray's loops, after which it has done its share of a dispatch."""
        return ITERATIONS["llvmpipe" in self.renderer]

    def release(self) -> None:
        """Free all GPU resources."""
        self.pool.release()
        self.raster.release()
        self.reader.release()
        self._device.release()
        for program in (*self._programs.values(), *self._passes.values()):
            program.release()


def waits_for_rays(plan: Plan) -> bool:
    """Return True if a brick is stored on the device when a ray comes to it, and never if all end in front of it."""
    is_alone = plan.content is None and not plan.refraction and plan.blend_mode.traits.composited
    # Slabs that are split at borders need the bricks behind them.
    return bool(plan.march.residual > 0 and is_alone and not plan.march.split)


class _Found:
    """What draws of one piece have found, beside the pixels."""

    def __init__(self, rect: Rect, has_content: bool) -> None:
        self.has_content = has_content
        self.fragments = np.zeros((rect.height, rect.width) if has_content else (0, 0), np.int32)
        self.kbuffer: list[KBufferCounts] = []
        self.tiles: dict[BrickBox, TileLists] = {}


@dataclass(frozen=True, eq=False)
class _Part:
    """Bricks of one atlas in a box, and their tables."""

    atlas: BrickAtlas
    box: BrickBox
    bricks: NDArray[np.int64]
    offsets: NDArray[Any]
    visible: NDArray[Any]


class _Tables:
    """Offsets and visible groups of the bricks of a piece, in parts from front to back."""

    def __init__(self, device: Device, pool: BrickPool, plan: Plan, piece: Piece) -> None:
        self.piece, self._device, self._pool, self._plan = piece, device, pool, plan
        self._members = piece.members(plan.cost > 0)
        self.waits = waits_for_rays(plan) and pool.holds_in_one(self._members)
        self._reached = np.zeros(len(self._members), np.bool_)
        self.parts = self._made()
        if plan.refraction and len(self.parts) > 1:
            # A ray that bends may come back to what lies in another buffer.
            found, allowed = (
                f"bricks in {len(self.parts)} buffers",
                "one; set cluster.memory_limit to load them in turn",
            )
            raise InputError(
                "too many bricks for rays that bend", where="optics.refraction", found=found, allowed=allowed
            )

    @property
    def alone(self) -> bool:
        """True if all bricks are in one box."""
        return len(self.parts) == 1

    @property
    def bricks_in_box(self) -> int:
        """Bricks of the only box, those of others and of nobody included."""
        return self.parts[0].offsets.size

    def bind(self, number: int) -> None:
        """Bind the bricks of a part."""
        part = self.parts[number]
        self._device.give(3, part.offsets)
        self._device.give(6, part.visible)
        part.atlas.bind()

    def store(self, noted: NDArray[np.bool_]) -> None:
        """Store those bricks of the only box that rays have come to."""
        (part,) = self.parts
        self._reached |= noted.reshape(part.offsets.shape)[tuple((self._members - part.box.begin_zyx).T)]
        if self._pool.fetch(self._members[self._reached]):
            self.parts = self._made()

    @property
    def reached(self) -> int:
        """Number of bricks that rays have come to, as far as that is known."""
        return int(self._reached.sum()) if self.waits else len(self._members)

    @property
    def occluded(self) -> int:
        """Number of bricks in front of which all rays have ended."""
        return len(self._members) - self.reached

    def _made(self) -> list[_Part]:
        found = []
        for atlas, bricks in self._pool.parts(self._plan, self._members, self.waits):
            box = bounding_box(bricks)
            found.append(_Part(atlas, box, bricks, *atlas.tables(self._plan, box, bricks)))
        return found


def _padded(records: NDArray[Any], size: int) -> NDArray[np.uint8]:
    """Return the bytes of an array, padded to the size of the uniform block that the program declares."""
    data = np.zeros(max(size, records.nbytes), np.uint8)
    data[: records.nbytes] = records.view(np.uint8)
    return data


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
class _Picture:
    """A drawn rectangle: pixels (h, w, 4); samples of each work group (rows, columns); walks that were ended; when."""

    rgba: NDArray[Any]
    work: NDArray[np.uint32]
    cut_short: int
    drawn_at: float


@dataclass
class March:
    """Dispatches for the pixels of a piece, and their words in `progress`: of each pixel, work groups, planes, walks.

    Attributes
    ----------
    reader, program, rect : those of the caster and the piece
    words : number of each kind
    groups : number of work groups in x and y
    picture : what was drawn, if it was read with the end of the last turn
    """

    reader: PictureReader
    program: moderngl.ComputeShader
    rect: Rect
    words: tuple[int, int, int, int]
    groups: tuple[int, int]
    picture: _Picture | None = None

    @property
    def device(self) -> Device:
        """The device with the words."""
        return self.reader.device

    def begin(self, planes: NDArray[np.float32]) -> None:
        """Begin all rays, with planes that the host gives."""
        buffer = self._progress()
        first = self._offset(1)
        self.device.clear(buffer, self._offset(4) - first, first)
        self.device.write(buffer, planes, self._offset(2))

    def begin_turn(self, bricks: int = 0) -> None:
        """Clear the notes of dispatches that are queued together, and of bricks."""
        self.picture = None
        buffer = self._progress(bricks)
        self.device.clear(buffer, 4)
        self.device.clear(buffer, 4 * (MOST_QUEUED + bricks), self._offset(4))

    def queue(self, block: NDArray[np.void], number: int, *, begins: bool = True, notes: bool = False) -> None:
        """Queue the dispatch of a box, the `number`-th of a turn."""
        first = sum(self.words)
        block["first_dispatch"] = begins
        block["notes"] = first + number, first + number - 1 if number else -1, first + MOST_QUEUED if notes else -1, -1
        self._dispatch(block)

    def end_turn(self, bricks: int = 0, *, reads: bool = False) -> tuple[int | None, NDArray[np.bool_]]:
        """Wait, and return the first box of the turn in which a ray has to go on, and the bricks that rays came to.

        Parameters
        ----------
        reads : the picture is read at the same time, and kept if no ray has to go on; None instead of that box
        """
        progress = self._progress(bricks)
        parts = [(progress, 0, 4), (progress, self._offset(4), 4 * (MOST_QUEUED + bricks))]
        if reads:
            begun = self.reader.begin(self._pixels(), self.rect, [*parts, *self._results()])
            rgba, (flag, notes, *results) = begun.finish()
            if flag.any():
                begun.discard()
            else:
                self.picture = self._picture(rgba, results, begun.drawn_at)
        else:
            flag, notes = self.device.arrived(self.device.copy(parts))
        words = notes.view(np.uint32)
        stopped = int(np.flatnonzero(words[:MOST_QUEUED])[0]) if flag.any() else None
        return stopped, words[MOST_QUEUED:].astype(np.bool_)

    def through(self, block: NDArray[np.void]) -> None:
        """Dispatch until all rays are done."""
        block["first_dispatch"], block["notes"] = 1, -1
        goes_on = True
        while goes_on:
            self.device.clear(self._progress(), 4)
            self._dispatch(block)
            block["first_dispatch"], goes_on = 0, bool(self._read(0, 1)[0])

    def planes(self) -> NDArray[np.float32]:
        """Return the planes."""
        return self._read(self._offset(2), self.words[2]).view(np.float32)

    def read_picture(self) -> _Picture:
        """Wait, and return what was drawn."""
        begun = self.reader.begin(self._pixels(), self.rect, self._results())
        rgba, results = begun.finish()
        return self._picture(rgba, results, begun.drawn_at)

    def _picture(self, rgba: NDArray[Any], results: Sequence[Bytes], drawn_at: float) -> _Picture:
        work, *walks = (each.view(np.uint32) for each in results)
        return _Picture(rgba, work.reshape(self.groups[::-1]).copy(), sum(int(each.sum()) for each in walks), drawn_at)

    def _results(self) -> list[Part]:
        """Return the parts of `progress` with the samples of work groups and with walks that were ended."""
        progress, pixels = self._progress(), self.words[0]
        walks = [(progress, self._offset(3) + 4 * pixels, 4 * pixels)] if self.words[3] else []
        return [(progress, self._offset(1), 4 * self.words[1]), *walks]

    def _pixels(self) -> moderngl.Buffer:
        return self.device.reserve(PIXELS, 2 * PIXEL_BYTES * self.rect.pixels)

    def _dispatch(self, block: NDArray[np.void]) -> None:
        self.device.give(0, block, "uniform")
        self.device.dispatch(self.program, self.groups)

    def _progress(self, bricks: int = 0) -> moderngl.Buffer:
        return self.device.reserve(PROGRESS, self._offset(4) + 4 * (MOST_QUEUED + bricks), keeps=True)

    def _offset(self, kind: int) -> int:
        """Return where the words of a kind begin, in bytes; behind the flag of rays that are unfinished."""
        return 4 * (1 + sum(self.words[:kind]))

    def _read(self, offset: int, words: int) -> NDArray[np.uint32]:
        return np.frombuffer(self.device.read(self._progress(), 4 * words, offset), np.uint32)
