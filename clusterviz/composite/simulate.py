"""Any algorithm on up to 65,536 ranks, without MPI: what it moves, and how long that should take.

Dense images: direct send, SLIC and the parallel pipeline, which have n² transfers, are counted in closed form; all
others by counting every transfer of the schedule. Sparse images: direct send is counted row by row of the footprints,
the others by following the bounding rectangles through the schedule exactly as the exchange would send them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from clusterviz.composite import ALGORITHMS, choose_algorithm, direct_send, pipeline, radix_k
from clusterviz.composite.closed_forms import direct_send_dense, direct_send_sparse, parallel_pipeline_dense
from clusterviz.composite.cubes import cube_footprints
from clusterviz.composite.flow import count_sparse
from clusterviz.composite.load import Load, count_dense
from clusterviz.composite.network import Network
from clusterviz.composite.patch import Patch
from clusterviz.composite.rectangles import Rectangles
from clusterviz.composite.schedule import Algorithm, Schedule
from clusterviz.errors import InputError
from clusterviz.image.region import Rect

MOST_RANKS = 65_536
# Sparse images on many ranks: above this, following every patch of every rank through every round takes hours.
MOST_SPARSE_RANKS = {"slic": 256, "parallel-pipeline": 256, "pipeline": 1024}


@dataclass(frozen=True)
class Simulation:
    """What one composition would cost; the final gather is not in it.

    Attributes
    ----------
    footprints : "dense" or "cubes"
    counted : "closed form", or "schedule" where all transfers were counted
    messages_sent, pixels_sent, bytes_sent : of all ranks together
    seconds : predicted by the time model of `network`
    worst_rank : the position whose messages, bytes and pixels take longest, and its load below
    """

    algorithm: str
    ranks: int
    size: tuple[int, int]
    footprints: str
    network: str
    counted: str
    bytes_per_pixel: int
    messages_sent: int
    pixels_sent: int
    bytes_sent: int
    rounds: int
    seconds: float
    worst_rank: int
    worst_rank_messages_sent: int
    worst_rank_messages_received: int
    worst_rank_pixels_sent: int
    worst_rank_pixels_received: int


@dataclass(frozen=True)
class Options:
    """What some algorithms can be told; None leaves it to them."""

    factors: tuple[int, ...] | None = None
    owners: int | None = None
    batches: int | None = None

    def algorithm(self, name: str) -> Algorithm:
        """The schedule function of an algorithm with its option.

        Raises
        ------
        InputError
            An option is given that the algorithm does not have.
        """
        wanted: dict[str, tuple[str, object, Callable[..., Schedule]]] = {
            "radix-k": ("factors", self.factors, radix_k.schedule),
            "direct-send": ("owners", self.owners, direct_send.schedule),
            "pipeline": ("batches", self.batches, pipeline.schedule),
        }
        for owner, (option, value, function) in wanted.items():
            if value is not None and owner != name:
                raise InputError(f"an option that {name} does not have", found=option, allowed=f"with {owner} only")
            if value is not None:
                return partial(function, **{option: value})
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
    """Count and predict one composition.

    Parameters
    ----------
    algorithm : a name of the registry, or "auto"
    size : (width, height) of the picture
    footprints : "dense": every rank covers the picture; "cubes": each has a brick of a cube, see `cube_footprints`

    Raises
    ------
    InputError
        An unknown name, an option that does not fit, or more ranks than can be simulated.
    """
    name = choose_algorithm(algorithm, ranks)
    _check(name, ranks, footprints)
    options = options or Options()
    load, counted = _count(name, ranks, size, footprints, options)
    busy = (
        np.maximum(load.messages_sent, load.messages_received) * network.overhead_seconds
        + np.maximum(load.pixels_sent, load.pixels_received) * bytes_per_pixel * network.seconds_per_byte
        + load.pixels_received * network.seconds_per_pixel
    )
    worst = int(np.argmax(busy))
    pixels = int(load.pixels_sent.sum())
    columns = (load.messages_sent, load.messages_received, load.pixels_sent, load.pixels_received)
    return Simulation(
        name, ranks, size, footprints, network.name, counted, bytes_per_pixel,
        int(load.messages_sent.sum()), pixels, pixels * bytes_per_pixel, load.rounds,
        network.seconds(load, bytes_per_pixel), worst, *(int(column[worst]) for column in columns),
    )  # fmt: skip


def build_schedule(name: str, ranks: int, size: tuple[int, int], footprints: str, options: Options) -> Schedule:
    """The schedule itself, whatever its size: to be drawn, or counted where there is no closed form."""
    function = options.algorithm(name)
    if footprints == "dense":
        return function(ranks, size[0] * size[1], ())
    rectangles = cube_footprints(ranks, size)
    # Only SLIC looks at footprints; for the others, making 10⁵ patches would be for nothing.
    return function(ranks, rectangles.canvas_pixels, _patches(rectangles) if name == "slic" else ())


def _count(name: str, ranks: int, size: tuple[int, int], footprints: str, options: Options) -> tuple[Load, str]:
    """The load, and how it was counted."""
    options.algorithm(name)
    pixels, dense = size[0] * size[1], footprints == "dense"
    if name == "direct-send" and not dense:
        return direct_send_sparse(cube_footprints(ranks, size), options.owners), "closed form"
    if name in ("direct-send", "slic") and dense:
        return direct_send_dense(ranks, pixels, options.owners), "closed form"
    if name == "parallel-pipeline" and dense:
        return parallel_pipeline_dense(ranks, pixels), "closed form"
    schedule = build_schedule(name, ranks, size, footprints, options)
    # What SLIC sends is covered by its sender, so all of it travels.
    if dense or name == "slic":
        return count_dense(schedule), "schedule"
    return count_sparse(schedule, cube_footprints(ranks, size)), "schedule"


def _patches(footprints: Rectangles) -> list[Patch]:
    """The same, one by one, for schedules that look at them."""
    sides = zip(*(column.tolist() for column in footprints.columns()[2:]), strict=True)
    return [Patch(footprints.width, 0, footprints.canvas_pixels, Rect(*rect)) for rect in sides]


def _check(name: str, ranks: int, footprints: str) -> None:
    if footprints not in ("dense", "cubes"):
        raise InputError("unknown footprints", found=footprints, allowed="dense, cubes")
    most = MOST_SPARSE_RANKS.get(name, MOST_RANKS) if footprints == "cubes" else MOST_RANKS
    if not 1 <= ranks <= most:
        kind = "sparse" if footprints == "cubes" else "dense"
        text = f"cannot simulate {name} of {kind} images on so many ranks"
        raise InputError(text, found=ranks, allowed=f"1 to {most}")
