"""Registry of compositing algorithms: names and their schedule functions."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import cast

from clusterviz.composite.fragment import Patch, unite
from clusterviz.composite.schedules import (
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
from clusterviz.composite.schedules.schedule import Algorithm, MultiImageAlgorithm, Schedule
from clusterviz.errors import InputError

_MODULES = {
    "serial": serial,
    "pipeline": pipeline,
    "tree": binary_tree,
    "direct-send": direct_send,
    "binary-swap": binary_swap,
    "binary-swap-telescope": binary_swap_telescope,
    "binary-swap-remainder": binary_swap_remainder,
    "2-3-swap": swap_2_3,
    "radix-k": radix_k,
    "parallel-pipeline": parallel_pipeline,
    "slic": slic,
}
ALGORITHMS: dict[str, Algorithm] = {name: module.schedule for name, module in _MODULES.items()}

# Algorithms of one round, in which every owner sorts all that it receives: ranks may have any number of images.
SEVERAL_IMAGES = frozenset(name for name, module in _MODULES.items() if hasattr(module, "SEVERAL_IMAGES"))


def check_algorithm(name: str) -> None:
    """Raise InputError if a name is neither an algorithm nor "auto"."""
    if name != "auto" and name not in ALGORITHMS:
        allowed = ", ".join([*ALGORITHMS, "auto"])
        raise InputError("unknown compositing algorithm", where="cluster.compositing", found=name, allowed=allowed)


def candidates(ranks: int) -> list[str]:
    """Return the algorithms that are the fastest for some scenes and networks, at this number of ranks.

    Up to its largest factor radix-k is direct send, and at powers of two all swaps are binary swap.
    """
    swaps = (
        ["binary-swap"] if ranks & (ranks - 1) == 0 else ["binary-swap-telescope", "binary-swap-remainder", "2-3-swap"]
    )
    return ["direct-send", *swaps, *(["radix-k"] if ranks > radix_k.LARGEST_FACTOR else []), "tree"]


def make_schedule(name: str, ranks: int, pixels: int, patches: Sequence[Patch], owners: Sequence[int]) -> Schedule:
    """Return the schedule of an algorithm for images with these patches, front to back; `owners` are their ranks.

    For an algorithm with one image per rank, adjacent images of a rank are united.
    """
    if len(patches) > ranks and name not in SEVERAL_IMAGES:
        groups = groupby(zip(owners, patches, strict=True), key=lambda pair: pair[0])
        patches = [unite(patches[0].width, 0, pixels, [patch for _, patch in group]) for _, group in groups]
        owners = range(ranks)
    if len(patches) == ranks and list(owners) == list(range(ranks)):
        return ALGORITHMS[name](ranks, pixels, patches)
    several = cast(MultiImageAlgorithm, ALGORITHMS[name])
    return several(ranks, pixels, patches, owners_of=owners)
