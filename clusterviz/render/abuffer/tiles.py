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
from clusterviz.plan.plan import Plan
from clusterviz.render.abuffer.primitives import PrimitiveTable

CPU_TILE, GPU_TILE = 4, 8  # pixels along the side of a tile: a packet of 16 lanes, and a work group
EARLY = 8  # fragments of a pixel that are kept as they are counted
LEAST = 1 << 13  # primitives or vertices of a task
GEOMETRY = np.dtype(
    [
        ("right", "f8", 4),  # the camera's axes in cells of the domain, and what is added
        ("up", "f8", 4),
        ("forward", "f8", 4),
        ("eye", "f8", 4),  # depth of the eye
        ("counts", "i4", 4),  # layers, tiles across, tiles, lights
    ]
)
GEOMETRY_BINDING = 8
GEOMETRY_BLOCK = glsl_block("geometry", GEOMETRY_BINDING, GEOMETRY)
Floats = NDArray[np.float64]
_SOURCES = [Path(__file__).with_name("tile_kernel.py")]
_MOVE = {
    kind: CompiledKernel(
        "clusterviz.render.abuffer.tile_kernel",
        f"move-{kind}",
        f"float64[:,::1]; float64[::1]; {kind}[:,::1]; float32[::1]; float32[:,::1]",
        _SOURCES,
    )
    for kind in ("float32", "float64")
}
_LIST = CompiledKernel(
    "clusterviz.render.abuffer.tile_kernel",
    "list_tiles",
    "float64[::1]; int64; int64; int64; float32[:,::1]; int32[:,::1]; int64[:,::1]; uint32[::1]",
    _SOURCES,
)


MOST_BYTES = 1 << 30
"""Memory for the fragments of a rectangle, beyond which it is divided."""
LEAST_ROWS = 8
"""Rows of pixels that are not divided."""


class ManyFragmentsError(Exception):
    """A rectangle needs more memory for its fragments than is meant for them, and can be divided."""


def check_memory(rect: Rect, fragments: int, most: int = 0) -> None:
    """Check the memory of a rectangle's fragments.

    Parameters
    ----------
    fragments : found so far
    most : bytes of the largest buffer; 0: only `MOST_BYTES` counts

    Raises
    ------
    ManyFragmentsError
        It is too much.
    """
    size = 8 * max(fragments, EARLY * rect.pixels)
    if rect.height > LEAST_ROWS and size > min(MOST_BYTES, most or MOST_BYTES):
        raise ManyFragmentsError


@dataclass(frozen=True, eq=False)
class TileLists:
    """Primitives of a box in a frame.

    Attributes
    ----------
    block : GEOMETRY (1,)
    vertices : float32 (n, 4), in the camera's coordinates, and radii
    begins : uint32 (tiles + 1,), of each tile in `rows`
    rows : uint32 (k,), at least one, rows of primitives, ascending in each tile
    """

    block: NDArray[np.void]
    vertices: NDArray[np.float32]
    begins: NDArray[np.uint32]
    rows: NDArray[np.uint32]


def prepare_tiles() -> None:
    """Compile the kernels, or load them."""
    for kernel in (*_MOVE.values(), _LIST):
        kernel.prepare()


def camera_block(plan: Plan, rect: Rect, lights: int, tile: int) -> NDArray[np.void]:
    """Return the block `geometry`; `GEOMETRY` (1,).

    The camera's coordinates are relative to the point of the domain that is nearest to the eye, on every rank.
    """
    assert plan.content, "there is geometry"
    view, block = plan.view, np.zeros(1, GEOMETRY)
    eye = np.array(view.eye)
    centre = np.clip(eye, 0.0, plan.extent)
    for name in ("right", "up", "forward"):
        axis = np.array(getattr(view, name))
        axis /= np.linalg.norm(axis)
        block[name][0] = *axis, -(axis @ centre)
    block["eye"][0, 0] = block["forward"][0, :3] @ (eye - centre)
    across, down = -(-rect.width // tile), -(-rect.height // tile)
    block["counts"][0] = len(plan.content.geometry), across, across * down, lights
    return block


def lens_of(plan: Plan, block: NDArray[np.void], rect: Rect) -> Floats:
    """Return how the camera's coordinates become pixels of a rectangle.

    Depth of the eye, and its place to the right and up; pixels a unit; column and row of the line of sight; 1 for
    perspective, and the largest slope of a ray.
    """
    assert plan.content, "there is geometry"
    view, eye = plan.view, np.array(plan.view.eye)
    aside = [float(block[name][0, :3] @ eye + block[name][0, 3]) for name in ("right", "up")]
    pixels = (plan.content.domain.spacing if view.parallel else 1.0) / view.pixel
    column, row = view.size[0] / 2 - 0.5 - rect.x_begin, view.size[1] / 2 - 0.5 - rect.y_begin
    slope = 0.0 if view.parallel else view.pixel * (view.size[0] + view.size[1])
    return np.array([block["eye"][0, 0], *aside, pixels, column, row, not view.parallel, slope])


def make_lists(
    plan: Plan, table: PrimitiveTable, rect: Rect, lights: int, tile: int, threads: Executor, count: int
) -> TileLists:
    """Return the lists of a rectangle of pixels.

    Parameters
    ----------
    lights : number of lights
    tile : pixels along the side of a tile
    threads : do the work, in `count` tasks
    """
    assert plan.content, "there is geometry"
    block = camera_block(plan, rect, lights, tile)
    lens = lens_of(plan, block, rect)
    camera = np.stack([block[name][0] for name in ("right", "up", "forward")])
    vertices = np.empty((table.vertices, 4), np.float32)
    unit = np.array([1 / plan.content.domain.spacing])
    tasks, first = [], 0
    for layer, positions, radii in zip(plan.content.geometry, table.positions, table.radii, strict=True):
        matrix = camera[:, :3] @ layer.index_from_file
        matrix[:, 3] += camera[:, 3]
        kind = positions.dtype.name
        for begin, end in _parts(len(positions), count):
            target = vertices[first + begin : first + end]
            tasks.append(threads.submit(_MOVE[kind], matrix, unit, positions[begin:end], radii[begin:end], target))
        first += len(positions)
    for task in tasks:
        task.result()
    begins, shares = table.layers["table"][:, 0].tolist(), list[tuple[Any, ...]]()
    for kind, begin, end in zip(
        table.layers["table"][:, 1].tolist(), begins, [*begins[1:], len(table.corners)], strict=True
    ):
        shares += [(kind, begin + a, table.corners[begin + a : begin + b]) for a, b in _parts(end - begin, count)]
    across, tiles = block["counts"][0, 1:3].tolist()
    places = np.zeros((len(shares), tiles // across, across), np.int64)

    def list_all(rows: NDArray[np.uint32]) -> None:
        waiting = [
            threads.submit(_LIST, lens, tile, kind, row, vertices, corners, own, rows)
            for (kind, row, corners), own in zip(shares, places, strict=True)
        ]
        for one in waiting:
            one.result()

    list_all(np.zeros(0, np.uint32))
    # By tiles, and in a tile by shares, whose rows ascend.
    counts = places.reshape(len(shares), tiles).T.copy()
    ends = np.cumsum(counts).reshape(counts.shape) if counts.size else counts
    total = int(ends[-1, -1]) if counts.size else 0
    places[:] = (ends - counts).T.reshape(places.shape)
    starts = np.append((ends - counts)[:, 0], total) if counts.size else np.zeros(tiles + 1)
    rows = np.zeros(max(1, total), np.uint32)
    if total:
        list_all(rows)
    return TileLists(block, vertices, starts.astype(np.uint32), rows)


def _parts(size: int, count: int) -> list[tuple[int, int]]:
    """Divide a range in parts, as many as tasks but not small ones."""
    count = max(1, min(count, size // LEAST))
    edges = [size * n // count for n in range(count + 1)]
    return [(a, b) for a, b in pairwise(edges) if a < b]
