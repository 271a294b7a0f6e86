"""Ray casting of one rank's bricks on the CPU, by the shaders: no OpenGL, and no upload.

Threads take tiles of the picture from a counter. As many are used as the rank has cores.

References
----------
I. Wald, P. Slusallek, C. Benthin, M. Wagner: Interactive rendering with coherent ray tracing, Eurographics 2001
(packets of rays in vector registers).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, MutableMapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm.placement import kernel_threads
from clusterviz.image.partial import PartialImage, Rect, blank
from clusterviz.partition import BrickBox, Piece, bounding_box
from clusterviz.plan.content import ContentBrick, VolumeLayer
from clusterviz.plan.plan import Plan
from clusterviz.render.abuffer.discarding import HIDDEN_BINDING, HiddenPixels, prepare_discarding
from clusterviz.render.abuffer.fills import LEAST_SIDE, LISTS, ManyFragmentsError, Pools, with_fill
from clusterviz.render.abuffer.on_cpu import find_fragments, list_primitives, prepare_passes
from clusterviz.render.abuffer.primitives import PrimitiveTable, TableCache
from clusterviz.render.abuffer.program import COUNTED_BINDING
from clusterviz.render.abuffer.resolves import DRAWN_CLASS, classified, counts_of
from clusterviz.render.abuffer.tiles import TileLists
from clusterviz.render.content_bricks import store_as
from clusterviz.render.cpu.empty_space import skips_of
from clusterviz.render.cpu.memory import Memory
from clusterviz.render.cpu.pieces import MOST, Pieces, pieces_of
from clusterviz.render.cpu.tables import Blocks, brick_buffers, frame_of, textures, uniform_blocks
from clusterviz.render.frame_coherence import BINDING, Starts, prepare_reprojection
from clusterviz.render.group_box import skips_in_box
from clusterviz.render.passes import Passes, is_reached
from clusterviz.render.piece_loop import LastDraws, Rays, Task
from clusterviz.render.refraction import CarriedRays, rays_block
from clusterviz.render.render_result import (
    SQUARE,
    PartOf,
    Progress,
    RenderResult,
    footprint,
    joined_bands,
    no_progress,
)
from clusterviz.render.sizes import is_far_apart
from clusterviz.render.storage import slot_of
from clusterviz.render.stored_brick import doubling_bits, packed_bits, visible_groups
from clusterviz.render.variant import Lanes, Variant, cpu_variant_of, of_size
from clusterviz.report.counts import KBufferCounts
from clusterviz.scene.transfer import TransferFunction
from clusterviz.spmd.machine_code import addresses, compiled
from clusterviz.spmd.threads import run_threads, thread_pool
from clusterviz.spmd.width import Width, cpu_name, host_width

Index = tuple[int, int, int]
Cast = Callable[[int], None]
TILE = 32  # pixels along the side of a tile, as in tiles.glsl
COUNTER, AHEAD = 1, 2  # of `progress`: the counter of tiles, and the numbers before the samples of squares
MAX_SKIP_TABLES = 64  # tables that are kept
ONE_GROUP = np.zeros(7, np.uint32)  # the shader's system block: a thread is a work group


@dataclass(frozen=True, eq=False)
class _Shown:
    """The bricks that a piece shows in any window: their number, box, tables, program and primitives."""

    bricks: int
    box: BrickBox
    uniforms: Blocks
    buffers: Blocks
    textures: Blocks
    variant: Variant
    geometry: PrimitiveTable | None


class VectorCaster:
    """Ray caster of one rank on the CPU: its program, and its bricks.

    Parameters
    ----------
    plan : the first plan to draw, which decides the program and the layout of bricks
    width : of the vectors; by default the CPU's own

    Attributes
    ----------
    slot : layout of a brick
    pool : the bricks
    """

    def __init__(self, plan: Plan, width: Width | None = None) -> None:
        self._width, self._threads = width or host_width(), kernel_threads()
        self.slot = slot_of(plan)
        self.pool = Memory(self.slot)
        self._skips: dict[Any, NDArray[Any]] = {}
        self._pieces: dict[tuple[int, float], tuple[TransferFunction, Pieces | None]] = {}
        self._shown: tuple[Any, ...] | None = None
        self._tables, self._pools = TableCache(), Pools()
        self._last = LastDraws()
        self.compile(plan)

    @property
    def renderer(self) -> str:
        """What draws, in words."""
        return cpu_name(self._threads, self._width)

    @property
    def driver(self) -> str:
        """There is none."""
        return ""

    @property
    def voxel_bytes(self) -> int:
        """Memory taken by voxels."""
        return self.pool.bytes

    def can_draw(self, plan: Plan) -> bool:
        """Whether the programs are those of a plan."""
        return self._variants == self._variants_of(plan)

    def compile(self, plan: Plan) -> None:
        """Compile the programs of another plan with the same slots; the bricks stay."""
        self._variants = self._variants_of(plan)
        for variant in self._variants:
            compiled_variant(variant)
        if plan.march.frame_coherence is not None:
            prepare_reprojection()
        if plan.march.discard_margin is not None:
            prepare_discarding()
        prepare_passes(plan, self._width.lanes)

    def load(self, plan: Plan, bricks: MutableMapping[Index, ContentBrick]) -> None:
        """Keep bricks beside those that are there, taken out as they are laid out.

        Parameters
        ----------
        bricks : by index
        """
        self._skips, self._tables = {}, TableCache()
        if bricks:
            self._last.hits.forget()
        self.pool.put(bricks, store_as(plan, self.slot))

    def drop(self, bricks: Iterable[Index]) -> None:
        """Give up bricks that are there."""
        if bricks := set(bricks):
            self._tables = TableCache()
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
        """Draw one frame's pieces. See `Raycaster.draw`; partial images are float32."""
        return self._last.draw(plan, pieces, progress, carried, passes, self._draw_whole, self._draw_parts)

    def forget(self) -> None:
        """Forget what the last frame has found."""
        self._last.forget()
        self._pools = Pools()

    def release(self) -> None:
        """Forget the bricks."""
        self._skips, self._tables, self.pool = {}, TableCache(), Memory(self.slot)

    def _variants_of(self, plan: Plan) -> list[Variant]:
        return [self._variant_of(each) for each in ((plan, plan.crossing) if plan.layers else (plan,))]

    def _variant_of(self, plan: Plan) -> Variant:
        return variant_for(plan, self._width.lanes, self._pieces_of(plan))

    def _pieces_of(self, plan: Plan) -> list[Pieces | None]:
        """Return the pieces of each volume's transfer function, kept while it is; None if registers do not hold it.

        Of several volumes extinctions are added, so that pieces give the opacity of unit lengths.
        """
        if self._width.lanes < MOST:
            return [None] * len(plan.content.volume_layers)
        content = plan.content
        asked = [
            None if _is_apart(layer, content.mixed) else (layer.transfer, 1.0 if content.mixed else layer.slab_units)
            for layer in content.volume_layers
        ]
        known, self._pieces = self._pieces, {}
        for one in filter(None, asked):
            key = id(one[0]), one[1]
            self._pieces[key] = known[key] if key in known else (one[0], pieces_of(*one))
        found = [self._pieces[id(one[0]), one[1]][1] if one else None for one in asked]
        return [one if one and one.fitted else None for one in found] if content.mixed else found

    def _shown_by(self, plan: Plan, piece: Piece) -> _Shown:
        """Return the bricks of a piece, as its windows show them."""
        bricks = piece.members(plan.cost > 0)
        box = piece.box if plan.refraction else bounding_box(bricks)
        table = self.pool.table(box, bricks)
        buffers = brick_buffers(plan, table, self._skips_of(plan, box, bricks), self._pieces_of(plan))
        uniforms = uniform_blocks(plan, self.slot)
        variant = self._variant_of(plan)
        assert variant.cpu, "the variant is one of a CPU"
        far = variant.fetches_ahead and is_far_apart(plan, table.bytes)
        variant = replace(variant, cpu=replace(variant.cpu, wide=table.bases is not None, far=far))
        return _Shown(
            len(bricks),
            box,
            uniforms,
            buffers,
            textures(plan),
            variant,
            self._tables.table(plan.content.layers, bricks, self.pool.members),
        )

    def _draw_whole(self, plan: Plan, task: Task) -> RenderResult:
        """Draw a piece whose bricks are there."""
        report = perf_counter(), task.progress
        if not task.repeats:
            self._piece = self._shown_by(plan, task.piece)
        return self._draw_rect(plan, task.rect, self._piece, report, task.rays, task.hidden)

    def _draw_parts(self, plan: Plan, task: Task, parts: Sequence[Piece], passes: Passes) -> RenderResult:
        """Load and draw those parts of a piece that rays reach, from front to back, each in its footprint."""
        rect, crossing = task.rect, task.rays if isinstance(task.rays, CarriedRays) else None
        sums = crossing.pixels if crossing else np.zeros((2, rect.height, rect.width, 4), np.float32)
        work = np.zeros((-(-rect.height // SQUARE), -(-rect.width // SQUARE)), np.uint32)
        drawn, occluded, is_opaque = list[RenderResult](), 0, False

        def is_open(part: Piece, opacity: NDArray[np.float32]) -> bool:
            window = footprint(plan, part).intersect(rect)
            return window.pixels > 0 and is_reached(plan, part, window, opacity[window.slices_in(rect)])

        for number, part in enumerate(parts):
            if not is_open(part, sums[0, ..., 3]):
                occluded += len(part.members(plan.cost > 0))
                continue
            window = _whole_squares(footprint(plan, part).intersect(rect), rect)
            # What follows an opaque part is expected to lie beside this one, not behind it.
            expected = sums[0, ..., 3].copy()
            expected[window.slices_in(rect)] += is_opaque
            following = (one for one in parts[number + 1 :] if is_open(one, expected))
            passes.load(part, following=next(following, part))
            inside = window.slices_in(rect)
            report = perf_counter(), PartOf(task.progress, number, len(parts))
            own = np.ascontiguousarray(sums[(slice(None), *inside)])
            rays = crossing.inside(rect, window) if crossing else None
            found = self._draw_piece(plan, window, self._shown_by(plan, part), report, rays, None, own)
            # Without its pixels, which would be kept for all parts.
            drawn.append(replace(found, partial=blank()))
            sums[(slice(None), *inside)] = own
            is_opaque = not is_open(part, sums[0, ..., 3])
            y, x = (begin.start // SQUARE for begin in inside)
            rows, columns = found.work.shape
            work[y : y + rows, x : x + columns] += found.work
        return RenderResult(
            PartialImage(rect, sums[0]),
            sum(each.samples for each in drawn),
            sum(each.bricks for each in drawn),
            sum(each.seconds_render for each in drawn),
            work=work,
            occluded=occluded,
        )

    def _draw_rect(
        self,
        plan: Plan,
        rect: Rect,
        shown: _Shown,
        report: tuple[float, Progress],
        rays: Rays | None,
        hidden: HiddenPixels | None,
    ) -> RenderResult:
        """Draw a rectangle of pixels, or its halves if it has too many fragments."""
        try:
            return self._draw_piece(plan, rect, shown, report, rays, hidden)
        except ManyFragmentsError:
            axis = int(rect.height <= LEAST_SIDE)
            side, begin = (rect.width, rect.x_begin) if axis else (rect.height, rect.y_begin)
            middle, name = begin + max(SQUARE, side // 2 // SQUARE * SQUARE), "yx"[axis]
            each = []
            for half in (replace(rect, **{f"{name}_end": middle}), replace(rect, **{f"{name}_begin": middle})):
                own = rays.inside(rect, half) if isinstance(rays, CarriedRays) else None
                window = half.slices_in(rect)
                part = hidden and HiddenPixels(hidden.pixels[window].copy())
                each.append(self._draw_rect(plan, half, shown, (perf_counter(), no_progress), own, part))
                if hidden and part:
                    hidden.pixels[window] = part.pixels
            return joined_bands(rect, each, axis)

    def _draw_piece(
        self,
        plan: Plan,
        rect: Rect,
        shown: _Shown,
        report: tuple[float, Progress],
        rays: Rays | None,
        hidden: HiddenPixels | None,
        sums: NDArray[np.float32] | None = None,
    ) -> RenderResult:
        """Draw a rectangle; rays go on from `sums`, float32 (2, h, w, 4) as `Crossing.pixels`, which are written."""
        started, progress = report
        plan = with_fill(plan, self._pools)
        squares = -(-rect.height // SQUARE), -(-rect.width // SQUARE)
        ahead, planes = AHEAD + squares[0] * squares[1], rays.planes if rays else np.zeros(0, np.float32)
        state = np.concatenate([np.zeros(ahead, np.uint32), planes.view(np.uint32).ravel()])
        frame = frame_of(plan, shown.box, rect, replace(self.slot, textured=False))
        uniforms = shown.uniforms | {0: frame} | ({BINDING: rays_block(plan, False)} if rays else {})
        if sums is not None or isinstance(rays, CarriedRays):
            frame["first_box"] = 0
        if sums is None:
            # Rays that are drawn again go on with their rounding errors, too.
            planes_of_sums = 2 if hidden else 1
            shape = planes_of_sums, rect.height, rect.width, 4
            sums = rays.pixels if isinstance(rays, CarriedRays) else np.zeros(shape, np.float32)
        pixels = sums[0]
        buffers, fragments = shown.buffers | {1: sums, 2: state}, np.zeros((0, 0), np.int32)
        variants, kbuffer = [shown.variant], plan.content.kbuffer
        tiles: TileLists | None = None
        if hidden:
            hidden.begin()
            buffers[HIDDEN_BINDING] = hidden.pixels
        for again in (False, True):
            if again and not (hidden and hidden.draw_again()):
                break
            if again:
                # Pixels that are not drawn again keep their colours, and the others have zeros.
                frame["first_box"] = 0
            if shown.geometry:
                threads, limits = (thread_pool(os.getpid()), self._threads), hidden.limits if hidden else None
                tiles = list_primitives(plan, shown.geometry, rect, threads, limits, tiles)
                found = find_fragments(
                    plan,
                    shown.geometry,
                    tiles,
                    rect,
                    uniforms,
                    buffers,
                    self._width.lanes,
                    self._take_tiles,
                    self._pools,
                )
                uniforms, buffers = uniforms | found[0], buffers | found[1]
            if shown.geometry and not kbuffer:
                counts = counts_of(buffers[LISTS], rect)
                fragments = fragments + counts if again else counts
                buffers[LISTS], sizes = classified(plan.content, buffers[LISTS], counts, TILE)
                variants = [of_size(shown.variant, size) for size in sizes]
            table = addresses(uniforms, buffers, ONE_GROUP, shown.textures)
            for variant in variants:
                state[COUNTER] = 0
                if variant.geometry and not kbuffer:
                    buffers[LISTS][DRAWN_CLASS] = variant.geometry.size
                self._run(variant, table, state, rect, progress)
        work, coherence = state[AHEAD:ahead].reshape(squares).copy(), None
        if rays:
            rays.keep(state[ahead:].view(np.float32).reshape(planes.shape))
        if isinstance(rays, Starts):
            coherence = rays.finish(pixels[..., 3])
        seconds, samples = perf_counter() - started, int(work.sum(dtype=np.int64))
        entries = None
        if kbuffer:
            counted = buffers[COUNTED_BINDING]
            entries, fragments = KBufferCounts.of(counted), counted[:, 0].astype(np.int32).reshape(pixels.shape[:2])
        return RenderResult(
            PartialImage(rect, pixels),
            samples,
            shown.bricks,
            seconds,
            work=work,
            frame_coherence=coherence,
            fragments=fragments,
            kbuffer=entries,
            cut_short=int(state[0]),
        )

    def _run(
        self, variant: Variant, table: NDArray[np.uint64], state: NDArray[np.uint32], rect: Rect, progress: Progress
    ) -> None:
        """Let all threads draw tiles until there are none."""
        self._take_tiles(
            compiled_variant(variant), table, state, -(-rect.width // TILE) * -(-rect.height // TILE), progress
        )

    def _take_tiles(
        self,
        cast: Cast,
        table: NDArray[np.uint64],
        state: NDArray[np.uint32],
        tiles: int,
        progress: Progress = no_progress,
    ) -> None:
        """Let all threads take tiles from a counter; this one waits, so that it can be interrupted."""

        def report() -> None:
            progress(min(1.0, int(state[COUNTER]) / tiles))

        run_threads(cast, table, state[COUNTER : COUNTER + 1], tiles, self._threads, report)

    def _skips_of(self, plan: Plan, box: BrickBox, bricks: NDArray[np.int64]) -> NDArray[Any]:
        """Return how far rays may skip from the groups of a box, or their bits if the step is adaptive.

        They are kept until the transfer function changes.
        """
        shown = plan.march.adaptive_step, *plan.content.shown_by
        if self._shown is None or any(a is not b for a, b in zip(self._shown, shown, strict=True)):
            self._skips, self._shown = {}, shown
        if (found := self._skips.get((box, bricks.tobytes()))) is not None:
            return found
        if len(self._skips) >= MAX_SKIP_TABLES:
            self._skips = {}
        if self.slot.group_box:
            each = self.pool.ranges_of_each(bricks)
            found = skips_in_box(plan, self.slot.group_box, bricks, each, far=True)
            self._skips[box, bricks.tobytes()] = found
            return found
        ranges, (begin, end) = self.pool.ranges(bricks), plan.layout.unit_box(box.begin_zyx, box.end_zyx)
        visible, places = visible_groups(ranges, plan), plan.layout.units(bricks) - begin
        shape, unit = BrickBox(begin, end).shape_zyx, self.slot.unit
        if plan.march.adaptive_step is None:
            found = skips_of(visible, places, shape, plan.layout.brick)
        else:
            found = np.zeros((*shape, unit.group_words), np.uint32)
            doublings = doubling_bits(ranges, self.pool.bends(bricks), plan, unit)
            found[tuple(places.T)] = np.concatenate([packed_bits(visible, unit), doublings], axis=1)
        self._skips[box, bricks.tobytes()] = found
        return found


def _whole_squares(inside: Rect, rect: Rect) -> Rect:
    """Return a window in a rectangle, enlarged to begin with whole squares of it."""
    x, y = (
        (begin - first) // SQUARE * SQUARE
        for begin, first in ((inside.x_begin, rect.x_begin), (inside.y_begin, rect.y_begin))
    )
    return replace(inside, x_begin=rect.x_begin + x, y_begin=rect.y_begin + y)


def _is_apart(layer: VolumeLayer, mixed: bool) -> bool:
    """Return whether pieces do not give the opacity of a volume."""
    mode, grading = layer.blend_mode, layer.blend_mode.grading
    if mixed:
        return layer.preintegrated or bool(grading and (grading.table is not None or grading.look))
    return layer.preintegrated or grading is not None or mode.blending != "composite"


def variant_for(plan: Plan, lanes: int, pieces: Sequence[Pieces | None]) -> Variant:
    """Return the program of a plan; numbers that it reads from memory do not matter.

    Parameters
    ----------
    pieces : of each volume's transfer function, if registers hold it
    """
    capacities, pitched = [one.capacity if one else 0 for one in pieces], plan.layout.edges_zyx is not None
    if plan.content.mixed:
        return cpu_variant_of(plan, slot_of(plan), Lanes(lanes, volumes=tuple(capacities)))
    fitted = bool(pieces[0] and pieces[0].fitted)
    return cpu_variant_of(plan, slot_of(plan), Lanes(lanes, capacities[0], fitted, pitched=pitched))


@cache
def compiled_variant(variant: Variant) -> Cast:
    """Return the machine code of a variant, a function of the address of a table of addresses."""
    assert variant.cpu, "the variant is one of a CPU"
    return compiled(variant.source, variant.name, variant.cpu.lanes)
