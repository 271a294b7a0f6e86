"""What a frame needs of the primitives of a box: vertices in the camera's coordinates, and lists of tiles of pixels."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.gl.layout import glsl_block
from clusterviz.image.partial import Rect
from clusterviz.kernels.compiled import CompiledKernel
from clusterviz.kernels.radix_sort import sorted_order
from clusterviz.plan.geometry import GeometryLayer
from clusterviz.plan.plan import Plan
from clusterviz.render.abuffer.primitives import PrimitiveTable

CPU_TILE, GPU_TILE = 4, 8  # pixels along the side of a tile: a packet of 16 lanes, and a work group
SMALL = 16  # pixels of a primitive's box, below which each pixel is a tile
SAMPLED = 4096  # primitives whose size is looked at
ENDS = np.array([[0, 1, 2], [1, 2, 2], [0, 0, 0], [0, 1, 2], [0, 1, 2]])  # corners that bound a primitive of each kind
LEAST = 1 << 13  # primitives or vertices of a task
GEOMETRY = np.dtype(
    [
        ("right", "f8", 4),  # the camera's axes in cells of the domain, and what is added
        ("up", "f8", 4),
        ("forward", "f8", 4),
        ("eye", "f8", 4),  # depth of the eye, and its place to the right and up
        ("counts", "i4", 4),  # layers, tiles across, log2 of a tile's side in pixels, lights
    ]
)
GEOMETRY_BLOCK = glsl_block("geometry", 8, GEOMETRY)
Floats = NDArray[np.float64]
_SOURCES = [Path(__file__).with_name("tile_kernel.py")]
_MOVE = {
    kind: CompiledKernel(
        "clusterviz.render.abuffer.tile_kernel",
        f"move-{kind}",
        f"float64[:,::1]; float64[::1]; float64[::1]; {kind}[:,::1]; float32[::1]; float32[:,::1]; float32[:,::1]",
        _SOURCES,
    )
    for kind in ("float32", "float64")
}
_LIST = CompiledKernel(
    "clusterviz.render.abuffer.tile_kernel",
    "list_tiles",
    "int64; int64; int64; float64[::1]; int64[:,::1]; int64; int64; float32[:,::1]; int32[:,::1]; float32[:,::1]; "
    "float32[::1]; float32[::1]; int64[::1]; int64[::1]",
    _SOURCES,
    1,
)
_PLACE = CompiledKernel(
    "clusterviz.render.abuffer.tile_kernel", "place", "int64[::1]; int64[::1]; uint32[::1]", _SOURCES
)


@dataclass(frozen=True, eq=False)
class TileLists:
    """Primitives of a box in a frame.

    Attributes
    ----------
    block : GEOMETRY (1,)
    vertices : float32 (n, 4), in the camera's coordinates, and radii
    begins : uint32 (tiles + 1,), of each tile in `rows`
    rows : uint32 (k,), at least one, rows of primitives, ascending in each tile
    corners : int32 (m, 4), of the table; of a k-buffer's faces by depth
    boxes : float32 (n, 4), pixels of the vertices, as in `tile_kernel.move`
    left_out : float32 (tiles,), depths that what is left out of each tile is not nearer than; (0,): nothing is left out
    """

    block: NDArray[np.void]
    vertices: NDArray[np.float32]
    begins: NDArray[np.uint32]
    rows: NDArray[np.uint32]
    corners: NDArray[np.int32]
    boxes: NDArray[np.float32]
    left_out: NDArray[np.float32]

    @property
    def lists(self) -> dict[str, NDArray[Any]]:
        """The lists by name, as in abuffer.glsl and discard.glsl."""
        return {"tiles": self.begins, "lists": self.rows, "leftout": self.left_out}

    def primitives(self, table: PrimitiveTable) -> dict[str, NDArray[Any]]:
        """Return the primitives of a table by name, as in primitives.glsl."""
        own = {"vertices": self.vertices, "corners": self.corners}
        return own | {"layers": table.layers, "attributes": table.attributes}


def prepare_tiles(plan: Plan) -> None:
    """Compile the kernels that a plan needs, or load them."""
    kinds = {layer.position_type.name for layer in plan.content.layers}
    for kernel in (*(_MOVE[kind] for kind in kinds), _LIST, _PLACE):
        kernel.prepare()


def camera_block(plan: Plan, lights: int) -> NDArray[np.void]:
    """Return the block `geometry`, but for its tiles; `GEOMETRY` (1,).

    The camera's coordinates are relative to the point of the domain that is nearest to the eye, on every rank.
    """
    view, block = plan.view, np.zeros(1, GEOMETRY)
    eye = np.array(view.eye)
    centre = np.clip(eye, 0.0, plan.extent)
    for name in ("right", "up", "forward"):
        axis = np.array(getattr(view, name))
        axis /= np.linalg.norm(axis)
        block[name][0] = *axis, -(axis @ centre)
    block["eye"][0, :3] = [block[name][0, :3] @ (eye - centre) for name in ("forward", "right", "up")]
    block["counts"][0] = len(plan.content.layers), 0, 0, lights
    return block


def lens_of(plan: Plan, block: NDArray[np.void], rect: Rect) -> Floats:
    """Return how the camera's coordinates become pixels of a rectangle.

    Depth of the eye, and its place to the right and up; pixels a unit; column and row of the line of sight; 1 for
    perspective; the largest slope of a ray; and 0, which is 1 for corners of cells.
    """
    view = plan.view
    pixels = (plan.content.domain.spacing if view.parallel else 1.0) / view.pixel
    column, row = view.centre[0] - 0.5 - rect.x_begin, view.centre[1] - 0.5 - rect.y_begin
    slope = 0.0 if view.parallel else view.pixel * sum(view.size) * (1 + max(map(abs, view.window_center)))
    return np.array([*block["eye"][0, :3], pixels, column, row, not view.parallel, slope, 0.0])


def make_lists(
    plan: Plan,
    table: PrimitiveTable,
    rect: Rect,
    lights: int,
    tile: int,
    threads: Executor,
    count: int,
    limits: NDArray[np.float32] | None = None,
    last: TileLists | None = None,
) -> TileLists:
    """Return the lists of a rectangle of pixels.

    Parameters
    ----------
    lights : number of lights
    tile : pixels along the side of a tile, a power of two, where primitives are not small
    threads : do the work, in `count` tasks
    limits : float32 (h, w), depths behind which primitives may be left out; None: all are listed
    last : lists of the same plan and pixels, with other limits
    """
    moved = (last.block, last.vertices, last.boxes) if last else _moved(plan, table, rect, lights, threads, count)
    block, vertices, boxes = moved
    corners = table.corners
    if plan.content.kbuffer:
        corners = corners[sorted_order(vertices[corners[:, :3], 2].sum(axis=1), count)]
    shift = 0 if _are_small(table, boxes, rect) else tile.bit_length() - 1
    across, down = ((side - 1 >> shift) + 1 for side in (rect.width, rect.height))
    block["counts"][0, 1:3] = across, shift
    layers = np.append(table.layers["table"][:, :2], [[len(table.corners), 0]], axis=0).astype(np.int64)
    shares = _parts(len(table.corners), count) or [(0, 0)]
    counts = np.zeros((len(shares), across * down), np.int64)
    farthest = _of_tiles(limits, 1 << shift) if limits is not None else np.zeros(0, np.float32)
    left_out = np.full((len(shares), len(farthest)), np.inf, np.float32)

    def pairs_of(share: tuple[int, int], nearest: NDArray[np.float32], own: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the pairs of a share of the primitives, and count them."""
        pairs = np.empty(4 * (share[1] - share[0]), np.int64)
        eye = np.array([-np.inf if plan.view.parallel else block["eye"][0, 0]])
        given = shift, rect.width, rect.height, eye, layers, *share, boxes, corners, vertices, farthest, nearest
        while True:
            found = _LIST(*given, own, pairs)
            if found <= len(pairs):
                return pairs[:found]
            own[:], pairs = 0, np.empty(found, np.int64)

    pairs = list(threads.map(pairs_of, shares, left_out, counts))
    # By tiles, and in a tile by shares, whose rows ascend.
    ends = np.cumsum(counts.T).reshape(-1, len(shares)).T
    places = np.ascontiguousarray(ends - counts)
    begins = np.append(places[0], ends[-1, -1]).astype(np.uint32)
    rows = np.zeros(max(1, int(begins[-1])), np.uint32)
    list(threads.map(_PLACE, pairs, places, [rows] * len(shares)))
    return TileLists(block, vertices, begins, rows, corners, boxes, left_out.min(axis=0))


def _of_tiles(limits: NDArray[np.float32], tile: int) -> NDArray[np.float32]:
    """Return the farthest limit of each tile, given those of pixels."""
    for axis, side in enumerate(limits.shape):
        limits = np.maximum.reduceat(limits, np.arange(0, side, tile), axis=axis)
    return np.ascontiguousarray(limits).ravel()


def _moved(
    plan: Plan, table: PrimitiveTable, rect: Rect, lights: int, threads: Executor, count: int
) -> tuple[NDArray[np.void], NDArray[np.float32], NDArray[np.float32]]:
    """Return the block, the vertices in the camera's coordinates, and their pixels."""
    block = camera_block(plan, lights)
    lens = lens_of(plan, block, rect)
    camera = np.stack([block[name][0] for name in ("right", "up", "forward")])
    vertices, boxes = (np.empty((table.vertices, 4), np.float32) for _ in range(2))
    unit, ones, whole = np.array([1 / plan.content.domain.spacing]), np.ones(1), np.append(lens[:-1], 1.0)
    tasks, first = [], 0
    for layer, positions, radii in zip(plan.content.layers, table.positions, table.radii, strict=True):
        matrix = camera[:, :3] @ layer.index_from_file
        matrix[:, 3] += camera[:, 3]
        kind = positions.dtype.name
        for begin, end in _parts(len(positions), count):
            moved = positions[begin:end], radii[begin:end], *(each[first:][begin:end] for each in (vertices, boxes))
            scales = (unit, lens) if isinstance(layer, GeometryLayer) else (ones, whole)
            tasks.append(threads.submit(_MOVE[kind], matrix, *scales, *moved))
        first += len(positions)
    for task in tasks:
        task.result()
    return block, vertices, boxes


def _are_small(table: PrimitiveTable, boxes: NDArray[np.float32], rect: Rect) -> bool:
    """Return whether those primitives that are seen are small in pixels, on average."""
    starts, kinds = table.layers["table"][:, :2].T
    rows = np.arange(0, len(table.corners), len(table.corners) // SAMPLED + 1)
    ends = ENDS[kinds[np.searchsorted(starts, rows, "right") - 1]]
    found = boxes[np.take_along_axis(table.corners[rows], ends, axis=1)]
    low, high = np.maximum(found[..., ::2].min(axis=1), 0), found[..., 1::2].max(axis=1)
    sides = np.minimum(high, (rect.width, rect.height)) - low
    seen = (sides > 0).all(axis=1)
    return bool(seen.any()) and float(sides[seen].prod(axis=1).mean()) < SMALL


def _parts(size: int, count: int) -> list[tuple[int, int]]:
    """Divide a range in parts, as many as tasks but not small ones."""
    count = max(1, min(count, size // LEAST))
    edges = [size * n // count for n in range(count + 1)]
    return [(a, b) for a, b in pairwise(edges) if a < b]
