"""Stage six: many partial images become one picture.

A *schedule* says who sends which pixels to whom (one file an algorithm, pure data). *Traffic* says what of it travels,
given where the images are not blank. The *exchange* runs it over a channel; *chains* fix the order of merging; *blend*
is the over operator; *gather* brings the pieces to one rank.

**Adding an algorithm**: one file with `schedule(ranks, pixels, footprints) -> Schedule` and its manual as docstring,
one line in `ALGORITHMS`, and the shared checks of `tests/composite` run it for every number of ranks.
"""

from __future__ import annotations

from collections.abc import Sequence
from time import perf_counter

import numpy as np

from clusterviz.codec import choose_codec
from clusterviz.comm.agree import mark_agreed
from clusterviz.comm.channel import Channel
from clusterviz.composite import (
    binary_swap,
    binary_swap_remainder,
    binary_swap_telescope,
    binary_tree,
    direct_send,
    parallel_pipeline,
    pipeline,
    radix_k,
    serial,
    slic,
    swap_2_3,
)
from clusterviz.composite.blend import compile_kernels
from clusterviz.composite.counters import CompositeCounters, StageCounters
from clusterviz.composite.exchange import run_exchange
from clusterviz.composite.footprints import gather_footprints
from clusterviz.composite.fragment import Fragment
from clusterviz.composite.gather import collect
from clusterviz.composite.piece import Piece
from clusterviz.composite.schedule import Algorithm, Schedule
from clusterviz.composite.traffic import plan_traffic
from clusterviz.errors import InputError
from clusterviz.image.partial import PartialImage

ALGORITHMS: dict[str, Algorithm] = {
    "serial": serial.schedule,
    "pipeline": pipeline.schedule,
    "tree": binary_tree.schedule,
    "direct-send": direct_send.schedule,
    "binary-swap": binary_swap.schedule,
    "binary-swap-telescope": binary_swap_telescope.schedule,
    "binary-swap-remainder": binary_swap_remainder.schedule,
    "2-3-swap": swap_2_3.schedule,
    "radix-k": radix_k.schedule,
    "parallel-pipeline": parallel_pipeline.schedule,
    "slic": slic.schedule,
}

# Above this many ranks the n² messages of direct send cost more than the bytes that it saves.
DIRECT_SEND_RANKS = 32

__all__ = [
    "ALGORITHMS",
    "CompositeCounters",
    "Piece",
    "Schedule",
    "StageCounters",
    "choose_algorithm",
    "collect",
    "compile_kernels",
    "composite",
]


def choose_algorithm(name: str, participants: int) -> str:
    """The algorithm to use; `auto` takes direct send up to 32 ranks that have pixels, and binary swap above.

    Raises
    ------
    InputError
        There is no such algorithm.
    """
    if name == "auto":
        return "direct-send" if participants <= DIRECT_SEND_RANKS else "binary-swap"
    if name not in ALGORITHMS:
        allowed = ", ".join([*ALGORITHMS, "auto"])
        raise InputError("unknown compositing algorithm", where="cluster.compositing", found=name, allowed=allowed)
    return name


def composite(
    partial: PartialImage, order: Sequence[int], channel: Channel, algorithm: str = "auto", codec: str = "auto"
) -> tuple[Piece, CompositeCounters]:
    """Blend the partial images of all ranks; collective.

    Parameters
    ----------
    partial : this rank's image; never changed
    order : the ranks from front to back, the same on every rank
    channel : to the other ranks
    algorithm, codec : a name of their registries, or "auto"

    Returns
    -------
    piece : the part of the picture that this rank owns now; `collect` brings them together
    counters : what it cost on this rank

    Raises
    ------
    InputError
        On every rank: an unknown name, a partial image of a wrong type or shape, images of different types.
    """
    try:
        codec = choose_codec(codec)
        choose_algorithm(algorithm, channel.size)
    except InputError as error:
        raise mark_agreed(error) from None
    started = perf_counter()
    footprints = gather_footprints(partial, order, channel)
    seconds_agree = perf_counter() - started
    count = len(footprints.order)
    algorithm = choose_algorithm(algorithm, count)
    fragments: tuple[Fragment, ...] = ()
    stages: tuple[StageCounters, ...] = ()
    if channel.rank in footprints.order:
        position = footprints.order.index(channel.rank)
        schedule = ALGORITHMS[algorithm](count, footprints.canvas.pixels, footprints.patches)
        pixels = np.require(partial.rgba, requirements=["C", "A"]).reshape(-1, 4)
        own = Fragment(footprints.patches[position], pixels, writable=False)
        moved = plan_traffic(schedule, position, footprints.patches)
        fragments, stages = run_exchange(own, moved, footprints.order, position, channel, codec)
    piece = Piece(footprints.canvas, footprints.dtype, fragments)
    return piece, CompositeCounters(algorithm, codec, count, seconds_agree, stages)
