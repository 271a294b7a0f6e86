"""Polygons of slices, sent or found on the GPU, and composited front to back into float32 pixels.

What is sent for a brick depends on the generator:

- `brute-force`, `iterative`, `marching-cubes-table`: the vertices, three floats each, and the first one of each slice;
- `vertex-shader`: the corners of the brick and the level of its first slice;
- `vertex-array-template`: an offset and the six faces that clip the template, which is sent once.

A slab has its whole thickness wherever its plane meets the volume: unlike the ray caster, polygons do not cut the first
and the last slab of a ray at the volume's faces.

References
----------
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 5.3.3.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter, process_time
from typing import Any

import moderngl
import numpy as np
from numpy.typing import ArrayLike, NDArray

from clusterviz.data.source import Index
from clusterviz.gl.drawing import compile_program
from clusterviz.gl.shader import assemble
from clusterviz.image.partial import Rect
from clusterviz.partition import BrickBox
from clusterviz.plan.content import Bricks
from clusterviz.plan.encoding import in_units_of_clim
from clusterviz.plan.plan import Plan
from clusterviz.plan.segments import RECORD
from clusterviz.plan.slices import GENERATORS, Cuts
from clusterviz.plan.slices.contract import FAR, MOST_VERTICES
from clusterviz.plan.slices.marching_cubes_table import marching_cubes_table
from clusterviz.plan.slices.planes import plane_levels
from clusterviz.plan.slices.vertex_array_template import moves_of
from clusterviz.render.frame_block import FRAME_BLOCK, frame_block
from clusterviz.render.storage import slot_of
from clusterviz.render.volume_layers import all_segments

TEMPLATE = "vertex-array-template"
FAN = np.array([(0, n, n + 1) for n in range(1, 5)], np.int32)
"""Triangles of a polygon of six vertices."""
CLIP_DISTANCE = 0x3000
SENT = "vertices", "firsts"
"""Buffers of a brick, by their bindings; all else are uniforms."""
CORNERS = FAR.astype(np.float64)
POLYGONS = {"vertex-shader": "six_vertices.glsl", TEMPLATE: "template_vertices.glsl"}
"""Files of generators that run on the GPU."""
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Drawn:
    """A picture made of slices, and what it took.

    Attributes
    ----------
    rgba : float32 (h, w, 4), premultiplied; or the number of slices at each pixel, in all channels
    bricks, slices, vertices : drawn; of a template without those that clipping adds
    bytes_sent : to the GPU, without what is sent once
    bytes_once : the template
    cpu_seconds : of the CPU, to find what is sent
    seconds : from the first draw call until the picture is done
    gpu_seconds : of these, of the GPU, by its own clock; on llvmpipe without meaning
    """

    rgba: NDArray[np.float32]
    bricks: int
    slices: int
    vertices: int
    bytes_sent: int
    bytes_once: int
    cpu_seconds: float
    seconds: float
    gpu_seconds: float


@dataclass(frozen=True)
class _Brick:
    """What is sent for a brick, by name."""

    index: Index
    slices: int
    vertices: int
    data: dict[str, NDArray[Any]]

    @property
    def counts(self) -> tuple[int, int, int]:
        """Slices, vertices and bytes."""
        return self.slices, self.vertices, sum(each.nbytes for each in self.data.values())


class SliceDrawing:
    """Drawing of the slices of bricks of one composited volume.

    Parameters
    ----------
    context : a current context
    plan : of a scene with one volume and `quality.renderer: slices`; its layout has no margin
    bricks : all visible ones
    generator : one of `GENERATORS`
    counted : slices are counted instead of composited
    """

    def __init__(
        self,
        context: moderngl.Context,
        plan: Plan,
        bricks: Bricks,
        generator: str,
        counted: bool = False,
    ) -> None:
        self._context, self._plan, self._generator, self._counted = context, plan, generator, counted
        self._levels = plane_levels(plan.view, plan.slice_planes)
        self._template = self._template_vertices() if generator == TEMPLATE else np.zeros(1, np.float32)
        self._program = self._compiled()
        self._textures = {index: self._texture(brick.samples[0]) for index, brick in bricks.items()}
        self._order = sorted(bricks, key=self._depth)
        self._triangles = context.vertex_array(self._program, [], index_buffer=context.buffer(FAN.tobytes()))
        self._buffers = [context.buffer(self._template.tobytes()), context.buffer(reserve=4)]

    def draw(self) -> Drawn:
        """Draw all bricks, front to back."""
        started = process_time()
        found = [each for each in map(self._found, self._order) if each.slices]
        cpu_seconds = process_time() - started
        context, size = self._context, self._plan.view.size
        target = context.framebuffer([context.renderbuffer(size, 4, dtype="f4")])
        target.use()
        target.clear()
        context.enable(moderngl.BLEND)
        weight = moderngl.ONE if self._counted else moderngl.ONE_MINUS_DST_ALPHA
        context.blend_func = weight, moderngl.ONE
        self._clip(context.enable_direct)
        blocks = self._bind()
        context.finish()
        began, query = perf_counter(), context.query(time=True)
        with query:
            for each in found:
                self._textures[each.index].use(0)
                self._send(each.data)
                self._triangles.render(moderngl.TRIANGLES, instances=each.slices)
        context.finish()
        seconds = perf_counter() - began
        self._clip(context.disable_direct)
        rgba = np.frombuffer(target.read(components=4, dtype="f4"), np.float32).reshape(size[1], size[0], 4)[::-1]
        for block in blocks:
            block.release()
        target.release()
        slices, vertices, sent = (sum(numbers) for numbers in zip(*(each.counts for each in found), strict=True))
        once = self._template.nbytes if self._generator == TEMPLATE else 0
        return Drawn(rgba, len(found), slices, vertices, sent, once, cpu_seconds, seconds, query.elapsed * 1e-9)

    def release(self) -> None:
        """Free everything on the GPU."""
        gpu: list[Any] = [*self._textures.values(), *self._buffers, self._triangles, self._program]
        for each in gpu:
            each.release()

    def _found(self, index: Index) -> _Brick:
        """Return what is sent for a brick: uniforms, and vertices with the first of each slice."""
        begin, end = self._plan.layout.cells_of(index, (index[0] + 1, index[1] + 1, index[2] + 1))
        low, high = np.array(begin[::-1], np.float64), np.array(end[::-1], np.float64)
        levels, normal = self._levels.between(low, high), self._levels.normal
        count = levels.size
        if not count:
            return _Brick(index, 0, 0, {})
        data = _float32(low=low, high=high, first_plane=np.rint(levels[0] - self._levels.first))
        if self._generator == TEMPLATE:
            moves = moves_of(Cuts(low[None], high[None], normal, levels[:1]))
            data |= _float32(offset=moves.offset[0], first_slice=moves.template.level[0])
        elif self._generator == "vertex-shader":
            data |= _float32(first_level=levels[0])
        else:
            cuts = Cuts(np.tile(low, (count, 1)), np.tile(high, (count, 1)), normal, levels)
            polygons = GENERATORS[self._generator](cuts)
            kept = np.arange(polygons.vertices.shape[1]) < polygons.counts[:, None]
            firsts = np.concatenate([[0], np.cumsum(polygons.counts)]).astype(np.int32)
            data |= {"vertices": polygons.vertices[kept].astype(np.float32), "firsts": firsts}
            return _Brick(index, count, int(firsts[-1]), data)
        return _Brick(index, count, MOST_VERTICES * count, data)

    def _send(self, found: dict[str, NDArray[Any]]) -> None:
        for name, data in found.items():
            if name not in SENT:
                self._set(name, data)
                continue
            buffer = self._buffers[SENT.index(name)]
            buffer.orphan(data.nbytes)
            buffer.write(data.tobytes())
            buffer.bind_to_storage_buffer(SENT.index(name))

    def _set(self, name: str, value: NDArray[Any]) -> None:
        """Set a uniform, unless the program does not need it."""
        if name in self._program:
            self._program[name] = tuple(value.tolist()) if value.ndim else float(value)

    def _bind(self) -> list[moderngl.Buffer]:
        """Bind what all bricks share; return the buffers to free."""
        plan = self._plan
        buckets, records, _ = all_segments(plan)
        whole = BrickBox((0, 0, 0), plan.layout.counts_zyx)
        block = frame_block(plan, whole, Rect(0, 0, *plan.view.size), slot_of(plan))
        block["lens"][..., 2] = plan.view.size[1] - block["lens"][..., 2]  # rows of fragments are counted from below
        frame, rows, table = (self._context.buffer(array.tobytes()) for array in (block, records, buckets))
        frame.bind_to_uniform_block(0)
        rows.bind_to_storage_buffer(5)
        table.bind_to_storage_buffer(4)
        self._buffers[0].bind_to_storage_buffer(0)
        self._program["clip_from_index"] = tuple(plan.view.clip_from_index.T.ravel().tolist())
        self._set("normal", self._levels.normal)
        self._set("slack", np.array(self._slack))
        return [frame, rows, table]

    def _clip(self, switch: Callable[[int], None]) -> None:
        for plane in range(6 if self._generator == TEMPLATE else 0):
            switch(CLIP_DISTANCE + plane)

    def _compiled(self) -> moderngl.Program:
        segments = self._plan.volume.segments
        constants = [
            f"const bool COUNTED = {str(self._counted).lower()};",
            f"const bool CLIPPED = {str(self._generator == TEMPLATE).lower()};",
            f"const int FIRST_BUCKET = 0, FURTHER_STARTS = {segments.further_starts};",
            f"const int PARTS = {RECORD.itemsize // 16};",
        ]
        file = POLYGONS.get(self._generator, "sent_vertices.glsl")
        vertices = assemble("slice_vertices.glsl", {"POLYGON": file})
        fragments = assemble("slice_fragments.glsl", {"CONSTANTS": "\n".join(constants) + "\n", "FRAME": FRAME_BLOCK})
        return compile_program(self._context, vertices, fragments)

    def _texture(self, samples: Any) -> moderngl.Texture3D:
        units = in_units_of_clim(samples.astype(np.float64), *self._plan.volume.transfer.domain).astype(np.float32)
        return self._context.texture3d(samples.shape[::-1], 1, units.tobytes(), dtype="f4")

    def _template_vertices(self) -> NDArray[np.float32]:
        """Return the template: six vertices for each slice of the largest box."""
        normal, side = self._levels.normal, float(self._plan.layout.brick)
        box = Cuts(np.zeros((1, 3)), np.full((1, 3), side), normal, np.zeros(1))
        count = math.ceil(float(box.corner_levels[0, 7] - box.corner_levels[0, 0])) + 1
        first = moves_of(Cuts(box.low, box.high, normal, box.corner_levels[:, 0]), 2 * self._slack).template
        low, high = (np.tile(corner, (count, 1)) for corner in (first.low, first.high))
        return marching_cubes_table(Cuts(low, high, normal, np.arange(float(count)))).vertices.astype(np.float32)

    @property
    def _slack(self) -> float:
        """Voxels that cover an eighth of the largest pixel of the volume, more than rasterisation rounds."""
        view, extent = self._plan.view, np.array(self._plan.extent)
        farthest = 1.0 if view.parallel else float(view.depths(CORNERS * extent).max())
        return view.pixel / 8 * farthest * float(np.abs([view.right, view.up]).sum())

    def _depth(self, index: Index) -> tuple[float, ...]:
        """Return a key that sorts bricks of one grid front to back."""
        eye = self._plan.eye_in_bricks()
        if eye is None:
            return (float(np.dot(self._plan.view.forward, index[::-1])),)
        # By whole bricks between each and the eye's: on every ray these rise.
        return (sum(abs(number - math.floor(at)) for number, at in zip(index[::-1], eye, strict=True)),)


def _float32(**values: ArrayLike) -> dict[str, NDArray[Any]]:
    return {name: np.asarray(value, np.float32) for name, value in values.items()}
