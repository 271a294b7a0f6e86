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
from dataclasses import replace
from functools import partial
from time import perf_counter
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import DeviceError, FullDeviceError
from clusterviz.gl.context import is_llvmpipe, is_software
from clusterviz.gl.device import Counts, Device
from clusterviz.gl.driver_needs import compile_checked
from clusterviz.gl.reals import ENVIRONMENT, EXTENSION, chosen_reals, has_doubles
from clusterviz.image.partial import PartialImage, Rect
from clusterviz.partition import BrickBox, Piece
from clusterviz.plan.plan import Plan
from clusterviz.render.abuffer.discarding import HIDDEN, HIDDEN_BINDING, HiddenPixels, prepare_discarding
from clusterviz.render.abuffer.fills import ManyFragmentsError
from clusterviz.render.abuffer.finder import FragmentFinder, Tiles
from clusterviz.render.brick_atlas import BrickPool, capacity
from clusterviz.render.brick_tables import BricksApartError, BrickTables, Part, waits_for_rays
from clusterviz.render.cells.table import walk_planes
from clusterviz.render.content_bricks import store_as
from clusterviz.render.frame_block import ONLY, frame_block
from clusterviz.render.frame_coherence import BINDING, Starts, prepare_reprojection
from clusterviz.render.march import FRAME, PIXELS, TILE, March, Step
from clusterviz.render.packed_picture import PIXEL_BYTES, PictureReader
from clusterviz.render.passes import Passes, is_reached
from clusterviz.render.piece_loop import LastDraws, Rays, Task
from clusterviz.render.refraction import CarriedRays, Paths, rays_block
from clusterviz.render.render_result import Progress, RenderResult, joined_bands, no_progress
from clusterviz.render.storage import slot_of
from clusterviz.render.variant import Variant, of_size, variant_of
from clusterviz.render.volume_layers import all_segments, content_tables, volume_blocks
from clusterviz.report.counts import KBufferCounts, all_counts

ITERATIONS = (1 << 16, 3600)
"""Of the loops of a ray in a dispatch, on GPUs and on llvmpipe, which silently leaves all loops after 65535 in total:
sixteen lanes that diverge may take sixteen times the iterations that each of them counts."""
MOST_PIXELS_AT_ONCE, BAND_SECONDS = 1 << 18, 0.5
"""Of a device whose speed is not known yet; from then on, pictures that would take longer are drawn in bands, with
progress reports, and so that no driver takes the device for lost."""
MOST_TABLES = 64
"""Pieces whose tables are kept from view to view."""
Index = tuple[int, int, int]


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
        self._programs, self._finder = self._compiled(plan), FragmentFinder(self._device, plan, raster)
        self._tables, self._has_run, self._last = dict[bytes, BrickTables](), set[Variant](), LastDraws()

    def forget(self) -> None:
        """Forget what earlier draws have found; it changes the dispatches of a draw."""
        self._last.forget()
        self._finder.forget()

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
    def choices(self) -> dict[str, str]:
        """What the device decides, by names, in a few words each; all give the same picture."""
        packs, reals = self.reader.packs, chosen_reals(self._context)
        return {
            "pictures": "packed, as they are copied from a GPU"
            if packs
            else "whole, as they lie in memory of the host",
            "ownership": f"{reals}, as {'double precision is fast' if reals == 'double' else 'no float64 is fast'}",
            "fragments": self._finder.choice,
        }

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
        return self._finder.can_draw(plan) and all(self.variant_of(each) in self._programs for each in needed)

    def compile(self, plan: Plan) -> None:
        """Compile the program of another plan with the same slots; the bricks stay."""
        old, self._programs = self._programs, self._compiled(plan)
        self._finder.compile(plan)
        for program in old.values():
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
        bricks : by index
        """
        if bricks:
            self._finder.forget_bricks()
            self._last.hits.forget()
        put = self.pool.put_later if waits_for_rays(plan) else self.pool.put
        put(bricks, store_as(plan, self.slot))

    def drop(self, bricks: Iterable[Index]) -> None:
        """Drop bricks."""
        if bricks := set(bricks):
            self._finder.forget_bricks()
            self._last.hits.forget()
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
        return self._last.draw(plan, pieces, progress, carried, passes, self._draw_bands, self._draw_parts)

    def _tables_of(self, plan: Plan, piece: Piece) -> BrickTables:
        """Return the tables of a piece: those of an earlier view if they hold."""
        members = piece.members(plan.cost > 0)
        key, self._tables = members.tobytes(), {} if len(self._tables) > MOST_TABLES else self._tables
        known = self._tables.get(key)
        if known is None or not known.hold_for(plan):
            known = self._tables[key] = BrickTables(self._device, self.pool, plan, members)
        known.begin()
        return known

    def _give_constants(self, plan: Plan) -> None:
        """Bind what is the same for all pieces."""
        give = self._device.give
        buckets, rows, sums = all_segments(plan)
        give(4, buckets)
        padded = self.variant_of(plan).block_bytes
        give(1 if padded else 5, _padded(rows, padded), "uniform" if padded else "storage")
        if sums is not None:
            give(0, sums)
        for binding, block in volume_blocks(plan.content):
            give(binding, block, "uniform")
        for unit, texels in content_tables(plan.content):
            self._device.table(unit, texels)
        if len(plan.clip):
            give(3, plan.clip, "uniform")

    def _draw_bands(self, plan: Plan, task: Task) -> RenderResult:
        """Draw a picture that takes long from top to bottom, in bands of about `BAND_SECONDS`."""
        rect, starts, hidden, drawn = task.rect, task.rays, task.hidden, list[RenderResult]()
        if not task.repeats:
            self._shown = self._tables_of(plan, task.piece)
        tables = self._shown
        top, most, program = rect.y_begin, rect.pixels, self.variant_of(plan)
        while top < rect.y_end:
            began, rows = perf_counter(), -(-max(1, min(self._band_pixels, most)) // (TILE * rect.width)) * TILE
            band = replace(rect, y_begin=top, y_end=min(rect.y_end, top + rows))
            within = top - rect.y_begin, band.y_end - rect.y_begin
            own = starts and starts.rows(*within), hidden and hidden.rows(*within)
            # Rays that are drawn again read the rounding errors that rays of the only box do not write.
            first = ONLY if tables.alone and not hidden else 1
            try:
                drawn.append(self._draw_piece(plan, band, lambda: [tables], *own, first=first))
            except ManyFragmentsError:
                most = band.pixels // 2
                continue
            except BricksApartError:
                continue
            task.progress((band.y_end - rect.y_begin) / rect.height)
            top, seconds = band.y_end, perf_counter() - began
            if not self._has_fixed_bands and program in self._has_run:  # a driver may compile when it first runs
                by_speed = int(band.pixels * BAND_SECONDS / seconds)
                self._band_pixels = by_speed if seconds > BAND_SECONDS else max(by_speed, self._band_pixels)
            self._has_run.add(program)
        found = replace(joined_bands(rect, drawn), bricks=tables.reached, occluded=tables.occluded)
        if isinstance(starts, Starts):
            found = replace(found, frame_coherence=starts.finish(found.partial.rgba[..., 3]))
        return found

    def _draw_parts(self, plan: Plan, task: Task, parts: Sequence[Piece], passes: Passes) -> RenderResult:
        """Draw parts of a piece whose bricks are loaded one part after the other, without those that no ray reaches."""
        rect, loading, drawn_parts = task.rect, passes.seconds, dict[BrickBox, BrickTables]()

        def loaded() -> Iterator[BrickTables]:
            for number, part in enumerate(parts):
                # With other modes, what is in front hides nothing.
                hides = number > 0 and plan.blend_mode.traits.composited
                if not hides or is_reached(plan, part, rect, self._drawn_pixels(rect)[..., 3]):
                    passes.load(part)
                    tables = drawn_parts[part.box] = self._tables_of(plan, part)
                    yield tables

        try:
            drawn = self._draw_piece(plan, rect, loaded, task.rays)
        except BricksApartError:
            raise FullDeviceError(f"{self.renderer} has no memory for the bricks of cluster.memory_limit") from None
        bricks = sum(tables.reached for tables in drawn_parts.values())
        occluded = sum(len(part.members(plan.cost > 0)) for part in parts) - bricks
        seconds = drawn.seconds_render - (passes.seconds - loading)
        return replace(drawn, bricks=bricks, occluded=occluded, seconds_render=seconds)

    def _draw_piece(
        self,
        plan: Plan,
        rect: Rect,
        parts: Callable[[], Iterable[BrickTables]],
        starts: Rays | None = None,
        hidden: HiddenPixels | None = None,
        first: int = 1,
    ) -> RenderResult:
        """Draw parts front to back, each behind the pixels so far; `first` is the first one's `first_box`."""
        began, before = perf_counter(), self.counts.read
        plan = self._finder.with_fill(plan)
        march = self._march(plan, rect, starts)
        found = _Found(rect, bool(plan.content.layers), not (starts or hidden))
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
            if starts and not starts.keep(march.planes()):
                break
        picture = march.picture()
        if isinstance(starts, Paths):
            read = self._device.read(march.pixels, starts.pixels.nbytes)
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
        planes = starts.planes if starts else np.zeros(0, np.float32)
        march = March(self.reader, rect, planes, walk_planes(plan.content) * rect.pixels)
        if isinstance(starts, CarriedRays):
            self._device.write(march.pixels, starts.pixels)
        return march

    def _drawn_pixels(self, rect: Rect) -> NDArray[np.float32]:
        """Return the pixels of a rectangle that was drawn last, float32 (h, w, 4)."""
        size = PIXEL_BYTES * rect.pixels
        read = self._device.read(self._device.reserve(PIXELS, 2 * size), size)
        return np.frombuffer(read, np.float32).reshape(rect.height, rect.width, 4)

    def _block(self, plan: Plan, rect: Rect, part: Part, first: int) -> NDArray[np.void]:
        """Return the block of the frame for a box of bricks."""
        block = frame_block(plan, part.box, rect, self.slot)
        block["first_box"] = first
        block["optics"][0, 3] = ITERATIONS[is_llvmpipe(self.renderer)]
        return block

    def _draw_boxes(self, plan: Plan, rect: Rect, march: March, tables: BrickTables, first: int, *_: object) -> None:
        """Draw boxes of bricks; where a ray waits for a brick, store the bricks that were noted, and go on."""
        program = self._program(self.variant_of(plan))
        steps = [
            Step(partial(tables.bind, number), program, self._block(plan, rect, part, 0 if number else first))
            for number, part in enumerate(tables.parts)
        ]
        awaited = tables if tables.waits else None
        self._ends_at_once = march.run(steps, reads=self._ends_at_once, awaited=awaited)[0]

    def _draw_content(
        self,
        plan: Plan,
        rect: Rect,
        march: March,
        tables: BrickTables,
        first: int,
        found: _Found,
        hidden: HiddenPixels | None,
    ) -> None:
        """Draw boxes of bricks with primitives or tetrahedra, found before."""
        variant, at_once = self.variant_of(plan), True
        for number, part in enumerate(tables.parts):
            tables.bind(number)
            block, is_last = self._block(plan, rect, part, first), number == len(tables.parts) - 1
            table = self._finder.table(plan, part)
            self._device.give(FRAME, block, "uniform")
            # What the first box has drawn can be drawn again.
            given = plan, table, rect, found.tiles, part.box, hidden.limits if hidden else None
            fragments = self._finder.find(*given, waits=not (found.repeats and first))
            steps = [
                Step(partial(fragments.choose, self._device, size), self._program(of_size(variant, size)), block)
                for size in fragments.sizes
            ]
            once, lists = march.run(steps, reads=is_last and self._ends_at_once, beside=fragments.beside)
            if not fragments.are_all(lists):
                march.begin()
                fragments = self._finder.find(*given, waits=True)
                once, lists = march.run(steps, beside=fragments.beside)
            found.add(fragments.counts(lists))
            if plan.content.kbuffer:
                found.kbuffer.append(KBufferCounts.of(lists[0].view(np.uint32).reshape(-1, 2)))
            first, at_once = 0, at_once and once
        self._ends_at_once = at_once

    def release(self) -> None:
        """Free all GPU resources."""
        self.pool.release()
        self._finder.release()
        self.reader.release()
        self._device.release()
        for program in self._programs.values():
            program.release()


class _Found:
    """What draws of one piece have found, beside the pixels.

    Attributes
    ----------
    has_content : whether there are primitives or tetrahedra
    repeats : whether the first box may be drawn again
    """

    def __init__(self, rect: Rect, has_content: bool, repeats: bool) -> None:
        self.has_content, self.repeats = has_content, repeats
        self.fragments = np.zeros((rect.height, rect.width) if has_content else (0, 0), np.int32)
        self.kbuffer: list[KBufferCounts] = []
        self.tiles: Tiles = {}

    def add(self, counts: NDArray[np.int32]) -> None:
        """Add fragments of pixels."""
        self.fragments += counts.reshape(self.fragments.shape)


def _padded(records: NDArray[Any], size: int) -> NDArray[np.uint8]:
    """Return the bytes of an array, padded to the size of the uniform block that the program declares."""
    data = np.zeros(max(size, records.nbytes), np.uint8)
    data[: records.nbytes] = records.view(np.uint8)
    return data
