"""Simulation of any algorithm on up to 65,536 ranks, without MPI: its load, and its predicted time.

Dense images: direct send, SLIC and the parallel pipeline, which have n² transfers, have closed forms; for all others
every transfer of the schedule is counted. Sparse images: direct send is counted by rows of the footprints, the
pipelines by pieces, SLIC by blocks, and the others by following the bounding rectangles through the schedule exactly
as the exchange sends them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from clusterviz.composite.fragment import Patch
from clusterviz.composite.model.network import Network
from clusterviz.composite.schedules import direct_send, pipeline, radix_k, slic
from clusterviz.composite.schedules.algorithms import ALGORITHMS, candidates, check_algorithm
from clusterviz.composite.schedules.rectangles import Rectangles
from clusterviz.composite.schedules.schedule import Algorithm, Load, Schedule, count_transfers
from clusterviz.composite.simulation.loads import (
    count_sparse,
    direct_send_dense,
    direct_send_sparse,
    parallel_pipeline_dense,
    parallel_pipeline_sparse,
    pipeline_sparse,
)
from clusterviz.errors import InputError
from clusterviz.image.partial import Rect

# View along the diagonal of the unit cube, from large coordinates. Rows: screen right, screen down.
SCREEN_FROM_WORLD = np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, -2.0]]) / np.sqrt([[2.0], [6.0]])


def cube_footprints(ranks: int, size: tuple[int, int]) -> Rectangles:
    """Return bounding rectangles of the bricks of a cube, front to back, in parallel projection along its diagonal.

    `ranks`: number of bricks; boxes are halved across their longest side until there is one for each rank. `size`:
    (width, height) of the picture; the cube touches its borders in at least one direction. Returns rectangles on a
    canvas that is the union of all of them.
    """
    boxes = _bricks(ranks)
    middle, half = (boxes[:, 0] + boxes[:, 1]) / 2, (boxes[:, 1] - boxes[:, 0]) / 2
    reach = np.abs(SCREEN_FROM_WORLD).sum(axis=1)
    scale = min(size[0] / reach[0], size[1] / reach[1])
    centre = ((middle - 0.5) @ SCREEN_FROM_WORLD.T) * scale + np.array(size) / 2
    spread = half @ np.abs(SCREEN_FROM_WORLD).T * scale
    begin = np.clip(np.floor(centre - spread + 1e-9).astype(np.int64), 0, np.array(size) - 1)
    end = np.clip(np.ceil(centre + spread - 1e-9).astype(np.int64), begin + 1, size)
    corner = begin.min(axis=0)
    width, height = (int(side) for side in end.max(axis=0) - corner)
    begin, end = begin - corner, end - corner
    whole = np.zeros(ranks, np.int64), np.full(ranks, width * height, np.int64)
    return Rectangles(width, height, *whole, begin[:, 0], begin[:, 1], end[:, 0], end[:, 1])


def _bricks(ranks: int) -> NDArray[np.float64]:
    """Return boxes (ranks, 2, 3) in the unit cube, front to back."""
    found = []
    waiting: list[tuple[int, tuple[float, ...], tuple[float, ...]]] = [(ranks, (0.0,) * 3, (1.0,) * 3)]
    while waiting:
        count, low, high = waiting.pop()
        if count == 1:
            found.append((low, high))
            continue
        axis = max(range(3), key=lambda i: high[i] - low[i])
        near = count // 2
        border = high[axis] - (high[axis] - low[axis]) * near / count
        waiting.append((count - near, low, (*high[:axis], border, *high[axis + 1 :])))
        waiting.append((near, (*low[:axis], border, *low[axis + 1 :]), high))
    return np.array(found)


MOST_RANKS = 65_536
# The number of SLIC's cells grows with n² for sparse images: 3000 ranks took a minute and 1.6 GB at 2048×2048.
MOST_SPARSE_RANKS = {"slic": 4096}


@dataclass(frozen=True)
class Simulation:
    """Simulated cost of one frame, without the final gather."""

    algorithm: str
    ranks: int
    size: tuple[int, int]
    footprints: str  # "dense" or "cubes"
    network: str
    counted: str  # "closed form", or "schedule" if all transfers were counted
    bytes_per_pixel: int
    # sums over all ranks
    messages_sent: int
    pixels_sent: int
    bytes_sent: int
    rounds: int
    seconds: float  # prediction of the time model of `network`
    worst_rank: int  # position whose messages, bytes and pixels take longest, and its load
    worst_rank_messages_sent: int
    worst_rank_messages_received: int
    worst_rank_pixels_sent: int
    worst_rank_pixels_received: int


@dataclass(frozen=True)
class Options:
    """Options of some algorithms; None for the default."""

    factors: tuple[int, ...] | None = None
    owners: int | None = None
    bands: int | None = None
    batches: int | None = None

    def algorithm(self, name: str) -> Algorithm:
        """Return the schedule function of an algorithm with its option.

        Raises InputError if an option is given that the algorithm does not have.
        """
        options: dict[str, tuple[Callable[..., Schedule], dict[str, object]]] = {
            "radix-k": (radix_k.schedule, {"factors": self.factors}),
            "direct-send": (direct_send.schedule, {"owners": self.owners, "bands": self.bands}),
            "pipeline": (pipeline.schedule, {"batches": self.batches}),
        }
        for owner, (function, values) in options.items():
            given = {option: value for option, value in values.items() if value is not None}
            if given and owner != name:
                text = f"an option that {name} does not have"
                raise InputError(text, found=", ".join(given), allowed=f"with {owner} only")
            if given:
                return partial(function, **given)
        return ALGORITHMS[name]


def simulate(
    algorithm: str,
    ranks: int,
    size: tuple[int, int],
    network: Network,
    *,
    footprints: str = "dense",
    bytes_per_pixel: int = 16,
    options: Options | None = None,
) -> Simulation:
    """Count and predict one frame without its final gather, so that any rank may be the root.

    `algorithm`: registered name, or "auto", the fastest of `candidates`. `footprints`: "dense": every rank covers the
    picture; "cubes": each has a brick of a cube, see `cube_footprints`. Raises InputError for an unknown name, an
    option that does not fit, or more ranks than can be simulated.
    """
    check_algorithm(algorithm)
    options = options or Options()
    if algorithm == "auto":
        every = (
            simulate(name, ranks, size, network, footprints=footprints, bytes_per_pixel=bytes_per_pixel)
            for name in candidates(ranks)
        )
        return min(every, key=lambda simulation: simulation.seconds)
    load, counted = count_load(algorithm, ranks, size, footprints, options)
    busy = (
        np.maximum(load.messages_sent, load.messages_received) * network.overhead_seconds
        + np.maximum(load.pixels_sent, load.pixels_received) * bytes_per_pixel * network.seconds_per_byte
        + load.pixels_received * network.seconds_per_pixel
    )
    worst = int(np.argmax(busy))
    pixels = load.pixels
    columns = (load.messages_sent, load.messages_received, load.pixels_sent, load.pixels_received)
    return Simulation(
        algorithm, ranks, size, footprints, network.name, counted, bytes_per_pixel,
        load.messages, pixels, pixels * bytes_per_pixel, load.rounds,
        network.seconds(load, bytes_per_pixel), worst, *(int(column[worst]) for column in columns),
    )  # fmt: skip


def build_schedule(name: str, ranks: int, size: tuple[int, int], footprints: str, options: Options) -> Schedule:
    """Return the schedule itself, to be drawn."""
    function = options.algorithm(name)
    if footprints == "dense":
        return function(ranks, size[0] * size[1], ())
    rectangles = cube_footprints(ranks, size)
    sides = zip(*(column.tolist() for column in rectangles.columns()[2:]), strict=True)
    patches = [Patch(rectangles.width, 0, rectangles.canvas_pixels, Rect(*rect)) for rect in sides]
    return function(ranks, rectangles.canvas_pixels, patches)


def count_load(name: str, ranks: int, size: tuple[int, int], footprints: str, options: Options) -> tuple[Load, str]:
    """Return the load of each rank, and how it was counted: "closed form" or "schedule". Errors as of `simulate`."""
    _check(name, ranks, footprints)
    algorithm, pixels = options.algorithm(name), size[0] * size[1]
    if footprints == "dense":
        if dense := DENSE.get(name):
            return dense(ranks, pixels, options), "closed form"
        return algorithm(ranks, pixels, ()).counts(), "schedule"
    known = cube_footprints(ranks, size)
    if sparse := SPARSE.get(name):
        return sparse(known, options), "closed form"
    if name == "slic":
        # A sender covers all that SLIC sends, so all of it travels.
        table, rows = slic.assign_blocks(ranks, known)
        moved = rows * (table[:, 3] - table[:, 2])
        return count_transfers(ranks, np.zeros_like(rows), table[:, 0], table[:, 1], moved), "schedule"
    return count_sparse(algorithm(ranks, known.canvas_pixels, ()), known), "schedule"


DENSE: dict[str, Callable[[int, int, Options], Load]] = {
    "direct-send": lambda ranks, pixels, options: direct_send_dense(ranks, pixels, options.owners, options.bands),
    "slic": lambda ranks, pixels, options: direct_send_dense(ranks, pixels),
    "parallel-pipeline": lambda ranks, pixels, options: parallel_pipeline_dense(ranks, pixels),
}
SPARSE: dict[str, Callable[[Rectangles, Options], Load]] = {
    "direct-send": lambda known, options: direct_send_sparse(known, options.owners, options.bands),
    "pipeline": lambda known, options: pipeline_sparse(known, options.batches),
    "parallel-pipeline": lambda known, options: parallel_pipeline_sparse(known),
}


def _check(name: str, ranks: int, footprints: str) -> None:
    if footprints not in ("dense", "cubes"):
        raise InputError("unknown footprints", found=footprints, allowed="dense, cubes")
    most = MOST_SPARSE_RANKS.get(name, MOST_RANKS) if footprints == "cubes" else MOST_RANKS
    if not 1 <= ranks <= most:
        kind = "sparse" if footprints == "cubes" else "dense"
        text = f"cannot simulate {name} of {kind} images on so many ranks"
        raise InputError(text, where="ranks", found=ranks, allowed=f"1 to {most}")
