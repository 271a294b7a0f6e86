"""Profiles of a draw: what each pixel costs, and on CPUs each function and line of the shader.

Counts, times of pixels and times of lines come from draws of their own, so that none disturbs the others. The clock of
pixels is that of the shader, where the driver has one; else squares of pixels are drawn one by one, many times.

References
----------
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 7.2.1
(costs of pixels that are drawn alone).
"""

from __future__ import annotations

from collections.abc import MutableMapping
from dataclasses import dataclass, field, replace
from functools import cache
from time import thread_time
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from clusterviz.image.partial import Rect
from clusterviz.partition import Piece
from clusterviz.plan.plan import Plan
from clusterviz.render.caster import Caster
from clusterviz.render.choice import check_opengl
from clusterviz.render.cpu.arrays import Code, CpuArrays
from clusterviz.render.cpu.device import Cpu
from clusterviz.render.render_result import RenderResult, footprint
from clusterviz.render.variant import Profile, Variant
from clusterviz.spmd.ir import PROFILE_BLOCK
from clusterviz.spmd.profiling import Instrumented, Mode, Site, instrument

if TYPE_CHECKING:
    import moderngl

COUNTS = "slabs", "samples", "covered", "runs", "gaps", "skipped", "end"
"""Columns of the counts of a pixel, as in profile_counts.glsl: slabs of its ray, samples, slabs that these stand for,
runs of samples, gaps without anything visible, and slabs in them; and the end of the ray in the box."""
MOST_BLOCKS = 1 << 24
MODES: tuple[Mode, Mode] = ("functions", "lines")
REPEATS = 3
"""Draws of a timed program, of which the least time counts."""
SQUARE = 8  # pixels along the side of what is drawn alone
Maps = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class CodeProfile:
    """Profile of the shader's code, of one thread.

    Attributes
    ----------
    variant : whose shader it is
    counts : executions by packets, and by lanes, of each statement and function
    functions, lines : ticks, without those that measuring took
    ticks : of the draw without any measuring
    seconds : of the same
    """

    variant: Variant
    counts: dict[Site, tuple[int, int]]
    functions: dict[Site, float]
    lines: dict[Site, float]
    ticks: float
    seconds: float


@dataclass(frozen=True)
class PieceProfile:
    """Profile of a piece.

    Attributes
    ----------
    rect : pixels of the maps
    result : of the draw that counts
    maps : uint32 (h, w) by the names of `COUNTS`; and "ticks", float64
    clock : what a tick is, in words
    block_side : of blocks of cells
    sampled : bool (z, y, x), blocks of the volume in which samples were taken
    code : None on GPUs
    """

    rect: Rect
    result: RenderResult
    maps: Maps
    clock: str
    block_side: int
    sampled: NDArray[np.bool_]
    code: CodeProfile | None


def block_shift(cells_zyx: tuple[int, ...]) -> int:
    """Return the binary logarithm of the side of blocks, so that a volume has at most `MOST_BLOCKS`."""
    shift = 0
    while np.prod([(cells - 1 >> shift) + 1 for cells in cells_zyx]) > MOST_BLOCKS:
        shift += 1
    return shift


@dataclass
class _Counters:
    """Buffers of a profile, and what draws have left in them, with one rectangle of pixels each."""

    cells_zyx: tuple[int, ...]
    profile: Profile = ""
    found: list[tuple[Rect, NDArray[np.uint32]]] = field(default_factory=list)
    sampled: NDArray[np.uint32] = field(default_factory=lambda: np.zeros(0, np.uint32))

    def begin(self, profile: Profile) -> None:
        self.profile, self.found = profile, []
        shape = [(cells - 1 >> block_shift(self.cells_zyx)) + 1 for cells in self.cells_zyx]
        self.sampled = np.zeros(shape if profile == "counts" else 0, np.uint32)

    def row(self, rect: Rect) -> NDArray[np.uint32]:
        """Return the buffer of counts, zeros after the shift."""
        numbers = np.zeros(1 + rect.pixels * (len(COUNTS) if self.profile == "counts" else 2), np.uint32)
        numbers[0] = block_shift(self.cells_zyx)
        return numbers

    def planes(self, rect: Rect) -> NDArray[np.uint32]:
        """Return the counts of all draws, uint32 (h, w, counts)."""
        planes = None
        for band, numbers in self.found:
            values = numbers[1:].reshape(band.height, band.width, -1)
            if planes is None:
                planes = np.zeros((rect.height, rect.width, values.shape[2]), np.uint32)
            top, left = band.y_begin - rect.y_begin, band.x_begin - rect.x_begin
            planes[top : top + band.height, left : left + band.width] += values
        assert planes is not None, "something was drawn"
        return planes


class _InstrumentedArrays(CpuArrays):
    """Arrays of one thread of a CPU, which profiles code.

    Attributes
    ----------
    mode : what is found out about the code; "": nothing
    variant : of the code
    sites, ticks : counters of the code in the last draw, as `Instrumented.counters`
    seconds : of the CPU in the last draw
    """

    def __init__(self) -> None:
        super().__init__(1)
        self.mode: Mode | Literal[""] = ""
        self.sites, self.ticks = tuple[Site, ...](), np.zeros((0, 4), np.int64)
        self.seconds = 0.0
        self.variant: Variant | None = None

    def call(self, program: Code, table: Any, counter: Any, tiles: int, report: Any) -> None:
        """Run machine code in this thread."""
        if not isinstance(program.variant, Variant):
            super().call(program, table, counter, tiles, report)
            return
        call: Any = program.call
        if self.mode:
            code = _instrumented(program.variant, self.mode)
            call = code.call
            if program.variant != self.variant:
                self.variant, self.sites, self.ticks = program.variant, code.sites, code.counters()
        table[PROFILE_BLOCK] = self.ticks.ctypes.data
        began = thread_time()
        call(table.ctypes.data)
        self.seconds = thread_time() - began


class _ProfilingCaster(Caster):
    """Ray caster that profiles; of a CPU, the code, too."""

    def __init__(self, device: Any, plan: Plan) -> None:
        self.counters = _Counters(plan.layout.cells_zyx)
        self.code = device.arrays if isinstance(device.arrays, _InstrumentedArrays) else None
        super().__init__(device, plan)

    @property
    def clock(self) -> str:
        """What a tick is, in words; "" if there is no clock."""
        if self.code:
            return "cycles of one thread"
        known = "GL_ARB_shader_clock" in self.device.arrays.context.extensions
        return "ticks of the shader clock, of a pixel's SIMD unit" if known else ""

    def variant_of(self, plan: Plan, tables: Any = None) -> Variant:
        """Return the program that a plan needs, with counters."""
        found = replace(super().variant_of(plan, tables), profile=self.counters.profile)
        if self.code and self.code.mode and found.cpu:
            found = replace(found, cpu=replace(found.cpu, far=False))
        return found

    def _draw_piece(self, plan: Plan, rect: Rect, *given: Any) -> RenderResult:
        """Draw with one program, not with one for each class of tiles, if code is profiled."""
        if self.code and self.code.mode:
            self.code.variant = None
            if plan.content.resolve in ("optimised", "both"):
                plan = replace(plan, content=replace(plan.content, resolve="peeling"))
        if not self.counters.profile:
            return super()._draw_piece(plan, rect, *given)
        arrays, blocks = self.device.arrays, self.counters.sampled
        counts, sampled = self.counters.row(rect), blocks if blocks.size else np.zeros(1, np.uint32)
        held = [arrays.begin("counts", counts), arrays.begin("sampled", sampled)]
        drawn = super()._draw_piece(plan, rect, *given)
        read = [
            np.frombuffer(arrays.read(one, each.nbytes), np.uint32)
            for one, each in zip(held, (counts, sampled), strict=True)
        ]
        self.counters.found.append((rect, read[0]))
        if blocks.size:
            self.counters.sampled = read[1].reshape(blocks.shape)
        return drawn


def _cpu_caster(plan: Plan) -> _ProfilingCaster:
    """Return a ray caster on one thread of a CPU, which profiles."""
    device = Cpu()
    device.arrays = _InstrumentedArrays()
    return _ProfilingCaster(device, plan)


def _opengl_caster(context: moderngl.Context, plan: Plan) -> _ProfilingCaster:
    """Return an OpenGL ray caster that profiles."""
    check_opengl(plan)
    from clusterviz.render.opengl import OpenGL

    # Nothing is drawn twice, as the rasteriser's way is where there was too little room.
    return _ProfilingCaster(OpenGL(context, plan, raster=False), plan)


@cache
def _instrumented(variant: Variant, mode: Mode) -> Instrumented:
    assert variant.cpu, "the variant is one of a CPU"
    return instrument(variant.source, f"{mode}_of_code", variant.cpu.lanes, mode)


class Profiler:
    """Profiles of the pieces of a plan.

    Parameters
    ----------
    plan : without frame coherence, which would draw rays again
    bricks : of all pieces, by index; they are taken out
    context : of OpenGL; None: the CPU draws

    Raises
    ------
    InputError
        OpenGL cannot draw bricks of several sizes.
    """

    def __init__(self, plan: Plan, bricks: MutableMapping[Any, Any], context: moderngl.Context | None = None) -> None:
        self._plan = replace(plan, march=replace(plan.march, frame_coherence=None, discard_margin=None))
        self._caster = _opengl_caster(context, self._plan) if context else _cpu_caster(self._plan)
        self._caster.load(self._plan, bricks)

    @property
    def renderer(self) -> str:
        """What draws, in words."""
        return self._caster.device.renderer

    @property
    def voxel_bytes(self) -> int:
        """Bytes of a voxel in memory, of all volumes."""
        slots = self._caster.slot.parts or (self._caster.slot,)
        return sum({"u8": 1, "u16": 2, "f32": 4}[slot.kind] for slot in slots)

    def profile(self, piece: Piece, with_code: bool = True) -> PieceProfile | None:
        """Return the profile of a piece; None if it covers no pixel.

        Parameters
        ----------
        with_code : profile the shader's code, too, if a CPU draws
        """
        rect = footprint(self._plan, piece)
        if not rect.pixels:
            return None
        # A rectangle keeps a ray caster from dividing the piece into layers.
        piece = replace(piece, rect=rect)
        result = self._drawn(piece, "counts")
        maps: Maps = dict(zip(COUNTS, np.moveaxis(self._caster.counters.planes(rect), 2, 0), strict=True))
        del maps["end"]
        maps["fragments"] = result.fragments if result.fragments.size else np.zeros_like(maps["samples"])
        sampled = self._caster.counters.sampled > 0
        clock, maps["ticks"] = self._ticks(piece, rect)
        code = self._code(piece, self._caster.code) if with_code and self._caster.code else None
        return PieceProfile(rect, result, maps, clock, 1 << block_shift(self._plan.layout.cells_zyx), sampled, code)

    def release(self) -> None:
        """Free all resources."""
        self._caster.release()

    def _drawn(self, piece: Piece, profile: Profile) -> RenderResult:
        self._caster.counters.begin(profile)
        self._caster.compile(self._plan)
        drawn: RenderResult = self._caster.draw(self._plan, [piece])[0]
        return drawn

    def _ticks(self, piece: Piece, rect: Rect) -> tuple[str, NDArray[np.float64]]:
        """Return what a tick is, and the ticks of each pixel, float64 (h, w)."""
        if not self._caster.clock:
            return "nanoseconds of squares that are drawn alone", self._alone(piece, rect)
        least = np.full((rect.height, rect.width), np.inf)
        for _ in range(REPEATS):
            self._drawn(piece, "clock")
            low, high = np.moveaxis(self._caster.counters.planes(rect).astype(np.float64), 2, 0)
            least = np.minimum(least, low + 2.0**32 * high)
        return self._caster.clock, least

    def _alone(self, piece: Piece, rect: Rect) -> NDArray[np.float64]:
        """Return the nanoseconds of each pixel, by drawing squares one by one; an empty one's are taken off."""
        self._drawn(piece, "")
        tops, lefts = range(rect.y_begin, rect.y_end, SQUARE), range(rect.x_begin, rect.x_end, SQUARE)
        squares = [Rect(left, top, left + SQUARE, top + SQUARE).intersect(rect) for top in tops for left in lefts]
        seconds = []
        for square in squares:
            draws = self._caster.draw(self._plan, [replace(piece, rect=square)] * REPEATS)
            seconds.append(min(drawn.seconds_render for drawn in draws))
        each = [1e9 * (own - min(seconds)) / square.pixels for own, square in zip(seconds, squares, strict=True)]
        grid = np.array(each).reshape(len(tops), len(lefts))
        found: NDArray[np.float64] = np.kron(grid, np.ones((SQUARE, SQUARE)))[: rect.height, : rect.width]
        return found

    def _code(self, piece: Piece, code: _InstrumentedArrays) -> CodeProfile:
        """Return the profile of the code, which is compiled for each kind of measurement."""
        seconds, found = np.inf, list[tuple[Any, Any, Any]]()
        self._drawn(piece, "")
        for _ in range(REPEATS):
            self._caster.draw(self._plan, [piece])
            seconds = min(seconds, code.seconds)
        code.mode = "counts"
        self._caster.draw(self._plan, [piece])
        counted = zip(code.sites, code.ticks.tolist(), strict=True)
        counts = {site: (row[0], row[1]) for site, row in counted if row[0]}
        rate = 0.0  # ticks of a second
        for code.mode in MODES:
            draws = []
            for _ in range(REPEATS):
                self._caster.draw(self._plan, [piece])
                draws.append(code.ticks)
                rate = max(rate, code.ticks[:, 2].sum() / code.seconds)
            found.append((code.sites, np.min([draw[:, 2] for draw in draws], axis=0), draws[0][:, 3]))
        code.mode = ""
        ticks = seconds * rate
        functions, lines = (_without_switches(*one, ticks) for one in found)
        assert code.variant, "something was drawn"
        return CodeProfile(code.variant, counts, functions, lines, ticks, seconds)


def _without_switches(
    sites: tuple[Site, ...], ticks: NDArray[np.int64], switches: NDArray[np.int64], plain: float
) -> dict[Site, float]:
    """Return the ticks of sites without those of reading the counter, by what the whole takes without that."""
    each = max(0.0, (ticks.sum() - plain) / max(1, switches.sum()))
    return dict(zip(sites, np.maximum(ticks - each * switches, 0.0).tolist(), strict=True))
