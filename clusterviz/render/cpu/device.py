"""The CPU as the ray caster's device: machine code of the shaders, and threads that take tiles of the picture.

As many threads are used as the rank has cores. A ray is drawn from end to end by one dispatch.
"""

from __future__ import annotations

from collections.abc import Callable, MutableMapping, Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm.placement import kernel_threads
from clusterviz.image.partial import Rect
from clusterviz.partition import BrickBox, Piece, bounding_box
from clusterviz.plan.content import VolumeLayer
from clusterviz.plan.plan import Plan
from clusterviz.render.abuffer.program import FindVariant
from clusterviz.render.abuffer.tiles import CPU_TILE
from clusterviz.render.caster import Caster
from clusterviz.render.cpu.arrays import COUNTER, Code, CpuArrays, compiled_variant
from clusterviz.render.cpu.empty_space import skips_of
from clusterviz.render.cpu.memory import BrickTable, Memory
from clusterviz.render.cpu.pieces import MOST, ROWS, Pieces, pieces_of
from clusterviz.render.device import Picture, Rays, Step
from clusterviz.render.frame_block import WIDEST_BATCH, frame_block, slabs_in_batch, voxels_a_slab
from clusterviz.render.group_box import skips_in_box
from clusterviz.render.refraction import CarriedRays
from clusterviz.render.render_result import SQUARE, Progress, footprint, no_progress
from clusterviz.render.sizes import is_far_apart, sizes_block
from clusterviz.render.storage import Slot, slot_of
from clusterviz.render.stored_brick import doubling_bits, packed_bits, visible_groups
from clusterviz.render.variant import Lanes, Variant, cpu_variant_of
from clusterviz.scene.transfer import TransferFunction
from clusterviz.spmd.width import Width, cpu_name, host_width

if TYPE_CHECKING:
    from clusterviz.gl.device import Counts
    from clusterviz.render.abuffer.raster import Rasteriser

TILE = 32  # pixels along the side of a tile, as in tiles.glsl
AHEAD = 2  # numbers of `progress` before the samples of squares
MAX_SKIP_TABLES = 64  # tables that are kept
LONGEST_BATCH = 32  # slabs
EXACT = 1 << 23  # whole numbers up to here, and sums of two, are float32


class Cpu:
    """A CPU that draws; see `render/device.py`.

    Parameters
    ----------
    width : of the vectors; by default the CPU's own
    """

    counts: Counts | None = None
    rasteriser: Rasteriser | None = None
    band_pixels: int | None = 1 << 62
    list_tile, class_tile, loop_limit, most_bytes, redraws = CPU_TILE, TILE, 0, 0, False
    driver, choices = "", dict[str, str]()

    def __init__(self, width: Width | None = None) -> None:
        self._width, self._threads = width or host_width(), kernel_threads()
        self.lanes, self.arrays = self._width.lanes, CpuArrays(self._threads)
        self._skips: dict[Any, NDArray[Any]] = {}
        self._pieces: dict[tuple[int, float], tuple[TransferFunction, Pieces | None]] = {}
        self._shown: tuple[Any, ...] | None = None

    @property
    def renderer(self) -> str:
        """What draws, in words."""
        return cpu_name(self._threads, self._width)

    def make_pool(self, slot: Slot) -> Memory:
        """Return memory for bricks."""
        return Memory(slot)

    def load(self, plan: Plan, pool: Memory, bricks: MutableMapping[Any, Any], stored: Callable[..., Any]) -> None:
        """Add bricks."""
        self.forget_bricks()
        pool.put(bricks, stored)

    def variant_of(self, plan: Plan, slot: Slot, tables: BricksShown | None = None) -> Variant:
        """Return the program that a plan needs, for certain bricks if they are given."""
        return tables.variant if tables else variant_for(plan, self.lanes, self._pieces_of(plan))

    def compile(self, variant: Variant | FindVariant) -> Code:
        """Return a program."""
        return compiled_variant(variant)

    def next_frame(self, plan: Plan, slot: Slot, pixel: str) -> None:
        """Bind numbers that are constants of other devices' programs, and pieces of transfer functions."""
        self.arrays.give("sizes", sizes_block(plan, slot))
        pieces = self._pieces_of(plan)
        if any(pieces):
            tables = [one.table if one else np.zeros((ROWS, MOST), np.float32) for one in pieces]
            self.arrays.give("pieces", np.concatenate(tables))

    def tables(self, plan: Plan, pool: Memory, slot: Slot, piece: Piece) -> BricksShown:
        """Return the bricks of a piece, as its windows show them."""
        bricks = piece.members(plan.cost > 0)
        box = piece.box if plan.refraction else bounding_box(bricks)
        table, variant = pool.table(box, bricks), self.variant_of(plan, slot)
        assert variant.cpu, "the variant is one of a CPU"
        far = variant.fetches_ahead and is_far_apart(plan, table.bytes)
        variant = replace(variant, cpu=replace(variant.cpu, wide=table.bases is not None, far=far))
        return BricksShown(
            self.arrays, pool, box, bricks, table, self._skips_of(plan, pool, slot, box, bricks), variant
        )

    def window(self, plan: Plan, part: Piece, rect: Rect) -> Rect:
        """Return the footprint of a part, enlarged to whole squares of the rectangle."""
        inside = footprint(plan, part).intersect(rect)
        x, y = (inside.x_begin - rect.x_begin) % SQUARE, (inside.y_begin - rect.y_begin) % SQUARE
        return replace(inside, x_begin=inside.x_begin - x, y_begin=inside.y_begin - y) if inside.pixels else inside

    def frame(self, plan: Plan, box: BrickBox, rect: Rect, slot: Slot) -> NDArray[np.void]:
        """Return the block of the frame; batches of voxels suit the whole numbers of float32."""
        frame = frame_block(plan, box, rect, replace(slot, textured=False))
        frame["first_dispatch"] = 1
        voxels = [(slot, voxels_a_slab(plan))]
        if slot.mixed:
            layers = zip(slot.parts, plan.content.volume_layers, strict=True)
            voxels = [(part, voxels_a_slab(plan, layer.cut)) for part, layer in layers]
        if voxels:
            most = slabs_in_batch(min(_widest_batch(part) / a_slab for part, a_slab in voxels), LONGEST_BATCH)
            frame["cells"][0, 3] = min(most, int(frame["cells"][0, 3]))
        return frame

    def march(self, plan: Plan, rect: Rect, rays: Rays | None) -> WholeRays:
        """Return the rays of a rectangle."""
        return WholeRays(self.arrays, rect, rays)

    def forget_bricks(self) -> None:
        """Forget how far rays may skip."""
        self._skips = {}

    def release(self) -> None:
        """Forget all."""
        self._skips = {}
        self.arrays.release()

    def _pieces_of(self, plan: Plan) -> list[Pieces | None]:
        """Return the pieces of each volume's transfer function, kept while it is; None if registers do not hold it.

        Of several volumes extinctions are added, so that pieces give the opacity of unit lengths.
        """
        content = plan.content
        if self.lanes < MOST:
            return [None] * len(content.volume_layers)
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

    def _skips_of(self, plan: Plan, pool: Memory, slot: Slot, box: BrickBox, bricks: NDArray[np.int64]) -> NDArray[Any]:
        """Return how far rays may skip from the groups of a box, or their bits if the step is adaptive.

        They are kept until the transfer function changes.
        """
        shown = plan.march.adaptive_step, *plan.content.shown_by
        if self._shown is None or any(a is not b for a, b in zip(self._shown, shown, strict=True)):
            self._skips, self._shown = {}, shown
        key = box, bricks.tobytes()
        if key not in self._skips:
            if len(self._skips) >= MAX_SKIP_TABLES:
                self._skips = {}
            self._skips[key] = _skips(plan, pool, slot, box, bricks)
        return self._skips[key]


@dataclass(frozen=True, eq=False)
class BricksShown:
    """The bricks of a piece: their box and addresses, how far rays may skip, and the program; see `BrickTables`."""

    arrays: CpuArrays
    atlas: Memory
    box: BrickBox
    bricks: NDArray[np.int64]
    table: BrickTable
    skips: NDArray[Any]
    variant: Variant
    waits, alone, occluded = False, True, 0

    @property
    def parts(self) -> list[BricksShown]:
        """All of them together."""
        return [self]

    @property
    def reached(self) -> int:
        """Number of bricks."""
        return len(self.bricks)

    def bind(self, number: int) -> None:
        """Bind the bricks."""
        table = self.table
        given = {"offsets": table.offsets, "groups": self.skips, "voxels": table.voxels}
        given |= {} if table.pitches is None else {"pitches": table.pitches}
        given |= {} if table.bases is None else {"bases": table.bases}
        for name, data in given.items():
            self.arrays.give(name, data)


class WholeRays:
    """Rays of a rectangle of pixels, each drawn from end to end by one dispatch; as `March`.

    Parameters
    ----------
    rays : what they carry

    Attributes
    ----------
    pixels : float32 (2, h, w, 4), pixels and their rounding errors
    progress : called with the part of the tiles that is drawn
    """

    def __init__(self, arrays: CpuArrays, rect: Rect, rays: Rays | None) -> None:
        self._arrays, self._rect = arrays, rect
        self._planes = rays.planes if rays else np.zeros((0, rect.height, rect.width), np.float32)
        shape = 2, rect.height, rect.width, 4
        self.pixels = (
            np.ascontiguousarray(rays.pixels) if isinstance(rays, CarriedRays) else np.zeros(shape, np.float32)
        )
        self._work = np.zeros((-(-rect.height // SQUARE), -(-rect.width // SQUARE)), np.uint32)
        self._cut_short = 0
        self.progress: Progress = no_progress

    def run(
        self, steps: Sequence[Step], window: Rect, *, beside: Sequence[tuple[Any, int, int]] = (), **_: object
    ) -> tuple[bool, list[NDArray[np.uint8]]]:
        """Draw boxes in a window that begins with whole squares of the rectangle."""
        inside, is_whole = window.slices_in(self._rect), window == self._rect
        pixels, planes = (each[(slice(None), *inside)] for each in (self.pixels, self._planes))
        sums = np.ascontiguousarray(pixels)
        squares = -(-window.height // SQUARE), -(-window.width // SQUARE)
        ahead = AHEAD + squares[0] * squares[1]
        state = np.concatenate([np.zeros(ahead, np.uint32), np.ascontiguousarray(planes).view(np.uint32).ravel()])
        self._arrays.begin("pixels", sums)
        self._arrays.begin("progress", state)
        for step in steps:
            step.bind()
            self._arrays.give("frame", step.block)
            state[COUNTER] = 0
            self._arrays.run(step.program, -(-window.width // TILE) * -(-window.height // TILE), self.progress)
        self._arrays.drop("voxels")  # which may be given up before others are bound
        y, x = (begin.start // SQUARE for begin in inside)
        self._work[y : y + squares[0], x : x + squares[1]] += state[AHEAD:ahead].reshape(squares)
        self._cut_short += int(state[0])
        if not is_whole:
            pixels[:] = sums
        planes[:] = state[ahead:].view(np.float32).reshape(planes.shape)
        return True, [self._arrays.read(buffer, size, first) for buffer, first, size in beside]

    def opacity(self) -> NDArray[np.float32]:
        """Return the opacity of the pixels so far, float32 (h, w)."""
        return self.pixels[0, ..., 3]

    def planes(self) -> NDArray[np.float32]:
        """Return what rays carry."""
        return self._planes

    def picture(self) -> Picture:
        """Return what was drawn."""
        return Picture(self.pixels[0], self._work, self._cut_short, perf_counter())


def _skips(plan: Plan, pool: Memory, slot: Slot, box: BrickBox, bricks: NDArray[np.int64]) -> NDArray[Any]:
    """Return how far rays may skip from the groups of a box, or their bits if the step is adaptive."""
    if slot.group_box:
        return skips_in_box(plan, slot.group_box, bricks, pool.ranges_of_each(bricks), far=True)
    ranges, (begin, end) = pool.ranges(bricks), plan.layout.unit_box(box.begin_zyx, box.end_zyx)
    visible, places = visible_groups(ranges, plan), plan.layout.units(bricks) - begin
    shape, unit = BrickBox(begin, end).shape_zyx, slot.unit
    if plan.march.adaptive_step is None:
        return skips_of(visible, places, shape, plan.layout.brick)
    found = np.zeros((*shape, unit.group_words), np.uint32)
    doublings = doubling_bits(ranges, pool.bends(bricks), plan, unit)
    found[tuple(places.T)] = np.concatenate([packed_bits(visible, unit), doublings], axis=1)
    return found


def _widest_batch(slot: Slot) -> float:
    """Return the voxels of a batch, at most, so that the number of a word is exact in float32."""
    _, y, x = slot.samples_zyx
    return float(min(EXACT / (x * y + x + 1) - 2, WIDEST_BATCH))


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


def cpu_caster(plan: Plan, width: Width | None = None) -> Caster:
    """Return a ray caster on the CPU; `width` is that of its vectors."""
    return Caster(Cpu(width), plan)
