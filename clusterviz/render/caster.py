"""Single-pass ray casting of one rank's bricks, on a GPU or on a CPU.

Bands of the picture are drawn one after the other. In each, rays march through the boxes of bricks, with the fragments
that have been found of primitives and tetrahedra. On OpenGL all dispatches of a piece are queued, and the host waits
once, for the picture; with early ray termination, bricks are stored there when a ray comes to them. On a CPU threads
take tiles of the picture from a counter.

References
----------
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, sections 3.3.1,
3.3.2 (early ray termination, here for whole bricks, too) and 5.3.3. I. Wald, P. Slusallek, C. Benthin, M. Wagner:
Interactive rendering with coherent ray tracing, Eurographics 2001 (packets of rays in vector registers).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, MutableMapping, Sequence
from dataclasses import replace
from functools import partial
from operator import length_hint
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import FullDeviceError
from clusterviz.image.partial import PartialImage, Rect, blank
from clusterviz.partition import BrickBox, Piece
from clusterviz.plan.plan import Plan
from clusterviz.render.abuffer.discarding import HIDDEN, HiddenPixels, LastEnds, prepare_discarding
from clusterviz.render.abuffer.fills import ManyFragmentsError
from clusterviz.render.abuffer.finder import FragmentFinder
from clusterviz.render.abuffer.tiles import TileLists
from clusterviz.render.content_bricks import store_as
from clusterviz.render.device import BricksApartError, Device, Rays, Step
from clusterviz.render.frame_block import ONLY
from clusterviz.render.frame_coherence import LastFrame, Starts, prepare_reprojection
from clusterviz.render.passes import Passes, is_reached
from clusterviz.render.refraction import CarriedRays, Paths, rays_block
from clusterviz.render.render_result import PartOf, Progress, RenderResult, footprint, joined_bands, no_progress
from clusterviz.render.storage import slot_of
from clusterviz.render.variant import Variant, of_size
from clusterviz.render.volume_layers import all_segments, content_tables, volume_blocks
from clusterviz.report.counts import KBufferCounts, all_counts

if TYPE_CHECKING:
    from clusterviz.gl.device import Counts

TILE = 8  # pixels, of which bands have whole ones
MOST_PIXELS_AT_ONCE, BAND_SECONDS = 1 << 18, 0.5
"""Of a device whose speed is not known yet; from then on, pictures that would take longer are drawn in bands, with
progress reports, and so that no driver takes the device for lost."""
Index = tuple[int, int, int]


class Caster:
    """Ray caster of one rank: its programs, and its bricks.

    Parameters
    ----------
    device : draws
    plan : the first plan to draw, which decides the program, and the layout and the encoding of bricks

    Attributes
    ----------
    device : the same
    slot : layout of a brick
    pool : the bricks
    """

    def __init__(self, device: Device, plan: Plan) -> None:
        self.device, self.slot = device, slot_of(plan)
        self.pool: Any = device.make_pool(self.slot)
        self._finder = FragmentFinder(device)
        # Where rays of the last frame hit something, and where they ended, piece by piece.
        self._hits, self._ends = LastFrame(), LastEnds()
        self._programs: dict[Variant, Any] = {}
        self._band_pixels, self._has_run = device.band_pixels or MOST_PIXELS_AT_ONCE, set[Variant]()
        self._shown: Any = None
        self._ends_at_once = False
        self.compile(plan)

    @property
    def counts(self) -> Counts | None:
        """Calls of OpenGL since the caster was made, without those that store bricks; None on a CPU."""
        return self.device.counts

    def variant_of(self, plan: Plan, tables: Any = None) -> Variant:
        """Return the program that a plan needs on this device, for certain bricks if they are given."""
        return self.device.variant_of(plan, self.slot, tables)

    def can_draw(self, plan: Plan) -> bool:
        """Return True if there are the programs of a plan."""
        return self._finder.can_draw(plan) and all(each in self._programs for each in self._variants_of(plan))

    def compile(self, plan: Plan) -> None:
        """Compile the programs of another plan with the same slots; the bricks stay."""
        if plan.march.frame_coherence is not None:
            prepare_reprojection()
        if plan.march.discard_margin is not None:
            prepare_discarding()
        old, variants = self._programs, self._variants_of(plan)
        self._programs = {variant: self.device.compile(variant) for variant in variants}
        self._finder.compile(plan)
        for program in old.values():
            program.release()

    def _variants_of(self, plan: Plan) -> list[Variant]:
        return [self.variant_of(each) for each in ((plan, plan.crossing) if plan.layers else (plan,))]

    def _program(self, variant: Variant) -> Any:
        """Return a program, compiled when it is first needed."""
        if variant not in self._programs:
            self._programs[variant] = self.device.compile(variant)
        return self._programs[variant]

    def load(self, plan: Plan, bricks: MutableMapping[Index, Any]) -> None:
        """Add bricks, removed from the mapping, and store them at the latest when they are drawn.

        Parameters
        ----------
        bricks : by index
        """
        if bricks:
            self._forget_bricks()
        self.device.load(plan, self.pool, bricks, store_as(plan, self.slot))

    def drop(self, bricks: Iterable[Index]) -> None:
        """Drop bricks."""
        if bricks := set(bricks):
            self._forget_bricks()
        self.pool.drop(bricks)

    def _forget_bricks(self) -> None:
        self._finder.forget_bricks()
        self._hits.forget()
        self.device.forget_bricks()

    def forget(self) -> None:
        """Forget what earlier draws have found; it changes the dispatches of a draw."""
        self._hits.forget()
        self._ends = LastEnds()
        self._finder.forget()

    def release(self) -> None:
        """Free all resources."""
        self.pool.release()
        self._finder.release()
        self.device.release()
        for program in self._programs.values():
            program.release()

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
        self.device.next_frame(plan, self.slot, pixel)
        self._give_constants(plan)
        if not carried:
            self._hits.next_frame()
            self._ends.next_frame()
        last: Piece | None = None
        count, drawn = length_hint(pieces), list[RenderResult]()
        for number, piece in enumerate(pieces):
            rect, part = footprint(plan, piece), PartOf(progress, number, count)
            part(0.0)
            repeats = last is not None and piece.shows_bricks_of(last)
            if not rect.pixels or not (repeats or len(piece.members(plan.cost > 0))):
                drawn.append(RenderResult(blank()))
                continue
            rays: Rays | None = carried[number] if carried else None
            if plan.march.frame_coherence is not None:
                rays = Starts.of(self._hits, plan, piece, rect)
            parts = passes.parts(piece) if passes else [piece]
            if passes and len(parts) > 1:
                drawn.append(self._draw_parts(plan, rect, rays, part, parts, passes))
                continue
            if passes:
                passes.load(piece)
            # Windows of the same bricks share their tables.
            if not repeats:
                self._shown = self.device.tables(plan, self.pool, self.slot, piece)
            last, hidden = None if passes else piece, self._ends.begin(plan, piece, rect)
            found = self._draw_bands(plan, rect, rays, hidden, part)
            if hidden:
                self._ends.finish(plan, piece, rect, hidden)
                found = replace(found, early_discarding=hidden.counts(found.fragments))
            drawn.append(found)
        return drawn

    def _give_constants(self, plan: Plan) -> None:
        """Bind what is the same for all pieces."""
        arrays, variant = self.device.arrays, self.variant_of(plan)
        buckets, records, sums = all_segments(plan)
        given = {"buckets": buckets, "records": _padded(records, variant.block_bytes)}
        given |= {"sums": sums} if sums is not None else {}
        given |= {"clip": plan.clip} if len(plan.clip) else {}
        for name, data in (given | volume_blocks(plan.content, variant.cpu is not None)).items():
            arrays.give(name, data)
        for name, texels in content_tables(plan.content).items():
            arrays.table(name, texels)

    def _draw_bands(
        self, plan: Plan, rect: Rect, rays: Rays | None, hidden: HiddenPixels | None, progress: Progress
    ) -> RenderResult:
        """Draw a picture that takes long from top to bottom, in bands of about `BAND_SECONDS`."""
        tables, drawn = self._shown, list[RenderResult]()
        top, most = rect.y_begin, rect.pixels
        while top < rect.y_end:
            began, rows = perf_counter(), -(-max(1, min(self._band_pixels, most)) // (TILE * rect.width)) * TILE
            band = replace(rect, y_begin=top, y_end=min(rect.y_end, top + rows))
            within = top - rect.y_begin, band.y_end - rect.y_begin
            own = rays and rays.rows(*within), hidden and hidden.rows(*within)
            # Rays that are drawn again read the rounding errors that rays of the only box do not write.
            first = ONLY if tables.alone and not hidden else 1
            inside = progress if band == rect else no_progress

            def all_bricks(_: Any, window: Rect = band) -> list[tuple[Any, Rect]]:
                return [(tables, window)]

            try:
                drawn.append(self._draw_piece(plan, band, all_bricks, *own, first, inside))
            except ManyFragmentsError:
                most = band.pixels // 2
                continue
            except BricksApartError:
                continue
            progress((band.y_end - rect.y_begin) / rect.height)
            top, seconds = band.y_end, perf_counter() - began
            if not self.device.band_pixels:
                self._adapt_bands(self.variant_of(plan), band.pixels, seconds)
        found = replace(joined_bands(rect, drawn), bricks=tables.reached, occluded=tables.occluded)
        if isinstance(rays, Starts):
            found = replace(found, frame_coherence=rays.finish(found.partial.rgba[..., 3]))
        return found

    def _adapt_bands(self, variant: Variant, pixels: int, seconds: float) -> None:
        """Choose the pixels of a band by the speed of a program, after its first run, in which drivers may compile."""
        if variant in self._has_run:
            by_speed = int(pixels * BAND_SECONDS / seconds)
            self._band_pixels = by_speed if seconds > BAND_SECONDS else max(by_speed, self._band_pixels)
        self._has_run.add(variant)

    def _draw_parts(
        self,
        plan: Plan,
        rect: Rect,
        rays: Rays | None,
        progress: Progress,
        parts: Sequence[Piece],
        passes: Passes,
    ) -> RenderResult:
        """Load and draw those parts of a piece that rays reach, from front to back."""
        loading, each = passes.seconds, dict[BrickBox, tuple[int, int]]()
        self._shown = None  # bricks of an earlier piece are not kept by their tables

        def is_open(part: Piece, opacity: NDArray[np.float32]) -> bool:
            window = self.device.window(plan, part, rect)
            return window.pixels > 0 and is_reached(plan, part, window, opacity[window.slices_in(rect)])

        def loaded(march: Any) -> Iterator[Any]:
            opacity, is_opaque = march.opacity(), False
            for number, part in enumerate(parts):
                if not is_open(part, opacity):
                    each[part.box] = 0, len(part.members(plan.cost > 0))
                    continue
                # What follows an opaque part is expected to lie beside this one, not behind it.
                expected = opacity.copy()
                expected[self.device.window(plan, part, rect).slices_in(rect)] += is_opaque
                following = (one for one in parts[number + 1 :] if is_open(one, expected))
                passes.load(part, following=next(following, part))
                tables = self.device.tables(plan, self.pool, self.slot, part)
                march.progress = PartOf(progress, number, len(parts))
                yield tables, self.device.window(plan, part, rect)
                each[part.box] = tables.reached, len(part.members(plan.cost > 0)) - tables.reached
                del tables
                opacity = march.opacity()
                is_opaque = not is_open(part, opacity)

        try:
            drawn = self._draw_piece(plan, rect, loaded, rays)
        except BricksApartError:
            raise FullDeviceError(
                f"{self.device.renderer} has no memory for the bricks of cluster.memory_limit"
            ) from None
        bricks, occluded = (sum(counts) for counts in zip(*each.values(), strict=True))
        seconds = drawn.seconds_render - (passes.seconds - loading)
        return replace(drawn, bricks=bricks, occluded=occluded, seconds_render=seconds)

    def _draw_piece(
        self,
        plan: Plan,
        rect: Rect,
        parts: Callable[[Any], Iterable[tuple[Any, Rect]]],
        rays: Rays | None = None,
        hidden: HiddenPixels | None = None,
        first: int = 1,
        progress: Progress = no_progress,
    ) -> RenderResult:
        """Draw parts front to back, each behind the pixels so far.

        Parameters
        ----------
        parts : yields tables of bricks, and the pixels in which these are drawn, given the march
        first : `first_box` of the first one
        """
        began, before = perf_counter(), self.counts.read if self.counts else 0
        arrays, plan = self.device.arrays, self._finder.with_fill(plan)
        march = self.device.march(plan, rect, rays)
        march.progress = progress
        found = _Found(rect, bool(plan.content.layers), not (rays or hidden))
        for again in (False, True):
            if hidden:
                if not again:
                    hidden.begin()
                kept = arrays.begin("hidden", hidden.pixels)
            if rays:
                name, block = rays_block(plan, again)
                arrays.give(name, block)
            # Rays that are drawn again begin with the zeros that were kept.
            if again or isinstance(rays, CarriedRays):
                first = 0
            elif rays and self.device.redraws:
                first = 1
            for tables, window in parts(march):
                draw = self._draw_content if found.has_content else self._draw_boxes
                draw(plan, window, march, tables, first, found, hidden)
                first = 0
                del tables  # and with them the bricks, before others are loaded
            if hidden:
                read = arrays.read(kept, hidden.pixels.nbytes)
                hidden.pixels[:] = np.frombuffer(read, HIDDEN).reshape(hidden.pixels.shape)
            has_late = rays is not None and rays.keep(march.planes()) and self.device.redraws
            has_cut = hidden is not None and not again and hidden.draw_again()
            if again or not (has_late or has_cut):
                break
        picture = march.picture()
        if isinstance(rays, Paths):
            read = arrays.read(march.pixels, rays.pixels.nbytes)
            rays.pixels[:] = np.frombuffer(read, np.float32).reshape(rays.pixels.shape)
        return RenderResult(
            PartialImage(rect, picture.rgba),
            int(picture.work.sum(dtype=np.int64)),
            seconds_render=picture.drawn_at - began,
            seconds_readback=perf_counter() - picture.drawn_at if self.counts else 0.0,
            work=picture.work,
            fragments=found.fragments,
            cut_short=picture.cut_short,
            kbuffer=all_counts(found.kbuffer),
            bytes_read=self.counts.read - before if self.counts else 0,
        )

    def _block(self, plan: Plan, rect: Rect, part: Any, first: int) -> NDArray[np.void]:
        """Return the block of the frame for a box of bricks."""
        block = self.device.frame(plan, part.box, rect, self.slot)
        block["first_box"] = first
        return block

    def _draw_boxes(self, plan: Plan, window: Rect, march: Any, tables: Any, first: int, *_: object) -> None:
        """Draw boxes of bricks; where a ray waits for a brick, store the bricks that were noted, and go on."""
        program = self._program(self.variant_of(plan, tables))
        steps = [
            Step(partial(tables.bind, number), program, self._block(plan, window, part, 0 if number else first))
            for number, part in enumerate(tables.parts)
        ]
        awaited = tables if tables.waits else None
        self._ends_at_once = march.run(steps, window, reads=self._ends_at_once, awaited=awaited)[0]

    def _draw_content(
        self,
        plan: Plan,
        window: Rect,
        march: Any,
        tables: Any,
        first: int,
        found: _Found,
        hidden: HiddenPixels | None,
    ) -> None:
        """Draw boxes of bricks with primitives or tetrahedra, found before."""
        variant, at_once = self.variant_of(plan, tables), True
        for number, part in enumerate(tables.parts):
            tables.bind(number)
            block, is_last = self._block(plan, window, part, first), number == len(tables.parts) - 1
            table = self._finder.table(plan, part)
            self.device.arrays.give("frame", block)
            # What the first box has drawn can be drawn again.
            given = plan, table, window, found.tiles, part.box, hidden.limits if hidden else None
            fragments = self._finder.find(*given, waits=not (found.repeats and first))
            steps = [
                Step(partial(fragments.choose, self.device.arrays, size), self._program(of_size(variant, size)), block)
                for size in fragments.sizes
            ]
            once, lists = march.run(steps, window, reads=is_last and self._ends_at_once, beside=fragments.beside)
            if not fragments.are_all(lists):
                march.begin()
                fragments = self._finder.find(*given, waits=True)
                once, lists = march.run(steps, window, beside=fragments.beside)
            found.add(fragments.counts(lists), window)
            if plan.content.kbuffer:
                found.kbuffer.append(KBufferCounts.of(lists[0].view(np.uint32).reshape(-1, 2)))
            first, at_once = 0, at_once and once
        self._ends_at_once = at_once


class _Found:
    """What draws of one piece have found, beside the pixels.

    Attributes
    ----------
    has_content : whether there are primitives or tetrahedra
    repeats : whether the first box may be drawn again
    """

    def __init__(self, rect: Rect, has_content: bool, repeats: bool) -> None:
        self._rect, self.has_content, self.repeats = rect, has_content, repeats
        self.fragments = np.zeros((rect.height, rect.width) if has_content else (0, 0), np.int32)
        self.kbuffer: list[KBufferCounts] = []
        self.tiles: dict[BrickBox, TileLists] = {}

    def add(self, counts: NDArray[np.int32], window: Rect) -> None:
        """Add fragments of the pixels of a window."""
        self.fragments[window.slices_in(self._rect)] += counts.reshape(window.height, window.width)


def _padded(records: NDArray[Any], size: int) -> NDArray[Any]:
    """Return an array, or its bytes padded to the size of the uniform block that the program declares."""
    if size <= records.nbytes:
        return records
    data = np.zeros(size, np.uint8)
    data[: records.nbytes] = records.view(np.uint8)
    return data
