"""A tile of the picture: its packets of pixels, drawn a window of slabs at a time, all in turn."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import F32, I32, I64, Value
from clusterviz.render.cpu.job import Job
from clusterviz.render.cpu.marching.march import CHANNELS, March
from clusterviz.render.cpu.marching.split import SplitMarch
from clusterviz.render.cpu.marching.starts import Starts
from clusterviz.render.cpu.marching.state import BLOCKS, LOOK_VECTORS, NEVER, State
from clusterviz.render.render_result import SQUARE

TILE = 32


class Tile:
    """The tiles of a kernel, drawn one after the other in the same memory."""

    def __init__(self, code: Code, job: Job, march: March | SplitMarch, starts: Starts | None = None) -> None:
        self._code, self._job, self._march, self._starts = code, job, march, starts
        self._across, self._down = BLOCKS[code.lanes]
        self._columns = TILE // self._across
        self._packets = self._columns * TILE // self._down
        self._state = State(code, self._packets, march.keeps_more)
        self._next = code.scratch(4 * self._packets)

    def draw(self, tile: Value) -> Value:
        """Draw a tile by its number, and write its pixels; samples taken, int64."""
        code, samples = self._code, Variable(self._code.number(I64, 0))
        row = Value(code.builder, code.builder.sdiv(tile.raw, self._job["tiles_across"].raw))
        corner = (tile - row * self._job["tiles_across"]) * TILE, row * TILE
        with _counted(code, self._packets) as number:
            self._begin(number, *self._pixels(number, *corner))
        least = Variable(code.number(I32, 0))
        with code.loop(lambda: least.now < NEVER):
            last = least.now | (self._job["window"] - 1)
            least.set(code.number(I32, NEVER))
            with _counted(code, self._packets) as number:
                with code.when(code.load(I32, self._spot(number)) <= last):
                    self._go_on(number, last)
                least.set(code.least(least.now, code.load(I32, self._spot(number))))
        with _counted(code, self._packets) as number:
            samples.set(samples.now + self._finish(number, *self._pixels(number, *corner)))
        return samples.now

    def _pixels(self, number: Value, x: Value, y: Value) -> tuple[Value, Value]:
        """Where a packet's pixels lie in the footprint, int32; the tile begins at (x, y)."""
        code, lanes = self._code, range(self._code.lanes)
        shift = self._columns.bit_length() - 1
        column, row = number & (self._columns - 1), number >> shift
        right = code.vector(I32, [lane % self._across for lane in lanes]) + (x + column * self._across)
        return right, code.vector(I32, [lane // self._across for lane in lanes]) + (y + row * self._down)

    def _spot(self, number: Value) -> Value:
        """Where it says with which slab a packet goes on."""
        return self._next + number.to(I64) * 4

    def _begin(self, number: Value, x: Value, y: Value) -> None:
        code, job, packet = self._code, self._job, self._state.packet(number)
        inside = (x < job.part("rect", 2)) & (y < job.part("rect", 3))
        code.store(code.number(I32, NEVER), self._spot(number))
        for vector in range(LOOK_VECTORS):
            packet.set("look", code.same(F32, 0.0), vector)
        packet.set("done", code.same(I32, 1))
        packet.set("samples", code.same(I32, 0))
        depth = self._starts.depths(packet, inside, x, y) if self._starts else None
        drawn = inside & self._starts.meets(depth) if self._starts and depth else inside
        with code.when(code.any(drawn)):
            rays = self._march.rays_through(x + job.part("rect", 0), y + job.part("rect", 1))
            hit = self._march.begin(packet, rays, inside)
            if self._starts and depth:
                self._starts.read(packet, rays, depth)
            code.store(code.select(hit, code.number(I32, 0), NEVER), self._spot(number))

    def _go_on(self, number: Value, last: Value) -> None:
        code, packet = self._code, self._state.packet(number)
        kept = packet.blend_mode
        code.store(self._march.go_on(packet, kept, last), self._spot(number))
        packet.keep_look(kept)

    def _finish(self, number: Value, x: Value, y: Value) -> Value:
        code, job, packet = self._code, self._job, self._state.packet(number)
        samples = Variable(code.number(I64, 0))
        inside = (x < job.part("rect", 2)) & (y < job.part("rect", 3))
        with code.when(code.any(inside)):
            kept = packet.blend_mode
            with code.when(code.any(packet.get("done").equals(0) | (packet.get("samples") > 0))):
                samples.set(code.total(self._march.finish(packet, kept).to(I64)))
                self._note(x.lane(0), y.lane(0), samples.now)
            if self._starts:
                self._starts.finish(packet, kept[3].now, x, y)
            pixels = [variable.now for variable in kept[:CHANNELS]]
            for lane in range(code.lanes):
                place = job["pixels"] + (y * job["stride"] + x).lane(lane).to(I64) * 16
                pixel = code.vector(F32, [0.0] * CHANNELS)
                for channel, value in enumerate(pixels):
                    pixel = pixel.with_lane(channel, value.lane(lane))
                code.store(pixel, place)
        return samples.now

    def _note(self, x: Value, y: Value, samples: Value) -> None:
        """Count a packet's samples in its square of pixels, which is all in this tile."""
        job, shift = self._job, SQUARE.bit_length() - 1
        place = job["work"] + ((y >> shift) * job["squares_across"] + (x >> shift)).to(I64) * 4
        self._code.store(self._code.load(I32, place) + samples.to(I32), place)


@contextmanager
def _counted(code: Code, count: int) -> Iterator[Value]:
    """For each number below a count."""
    number = Variable(code.number(I32, 0))
    with code.loop(lambda: number.now < count):
        yield number.now
        number.set(number.now + 1)
