"""Radix-k: rounds of direct send within groups of k ranks.

What: n is factored into k₁·k₂·…; in round i, groups of k_i ranks cut their range into k_i pieces and direct-send them
to each other. k = [n] is direct send, k = [2, 2, …] is binary swap; larger factors mean fewer rounds and more messages.
The ranks of a remainder only send, and drop out.
When: tens to thousands of ranks; k = 8 is a good start on networks that carry several messages at once.
When not: sparse images on few ranks (direct send moves less); networks with expensive messages (binary swap).
Cost, n = Π k_i: one round for each k_i, n·Σ(k_i − 1) messages; a rank sends and receives (1 − 1/n)·P. With remainders
M(m) = (m − r)(k − 1) + k·r + k·M(⌊m/k⌋) messages, r = m mod k, M(1) = 0; a rank sends at most P.
Limits: any k_i of which rounded-down division makes 1 of n, by default factors up to 8; one partial image a rank, or
several adjacent in depth.
Reference: T. Peterka et al., "A configurable algorithm for parallel image-compositing applications", SC 2009; W.
Kendall et al., "Accelerating and benchmarking radix-k image compositing at large scale", EGPGV 2010.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clusterviz.composite.schedules.schedule import Indices, Patches, Schedule, Stage, borders
from clusterviz.errors import InputError

LARGEST_FACTOR = 8


def schedule(ranks: int, pixels: int, footprints: Patches = (), *, factors: Sequence[int] | None = None) -> Schedule:
    """Return the schedule: one round for each factor, `automatic_factors` by default.

    Raises InputError if a factor is below 2, or dividing by all of them in turn, rounded down, does not make 1 of the
    ranks.
    """
    factors = automatic_factors(ranks) if factors is None else factors
    _check_factors(ranks, factors)
    # Row g holds the ranks that share piece g of as many pieces as there are rows, front to back.
    groups = np.arange(ranks, dtype=np.int64).reshape(1, -1)
    stages = []
    for factor in factors:
        stage, groups = _round(groups, factor, pixels)
        stages.append(stage)
    return Schedule(ranks, pixels, tuple(stages))


def automatic_factors(ranks: int) -> tuple[int, ...]:
    """Return factors from 4 to 8: in each round the one with the smallest remainder, the largest of equals."""
    factors = []
    while ranks > LARGEST_FACTOR:
        factors.append(min(range(LARGEST_FACTOR, 3, -1), key=lambda factor: ranks % factor))
        ranks //= factors[-1]
    return (*factors, ranks) if ranks > 1 else tuple(factors)


def _round(groups: Indices, factor: int, pixels: int) -> tuple[Stage, Indices]:
    count, members = groups.shape
    sets = members // factor
    grouped = groups[:, : sets * factor].reshape(count, sets, factor)
    cuts = borders(count * factor, pixels)
    # Member j of each set in group g keeps piece g·factor + j.
    part = (np.arange(count)[:, None] * factor + np.arange(factor)).reshape(count, 1, 1, factor)
    swaps = Stage.of_columns(grouped[..., :, None], grouped[..., None, :], cuts[part], cuts[part + 1])
    extra = groups[:, sets * factor :, None]
    rest = Stage.of_columns(extra, grouped[:, -1, None, :], cuts[part[:, 0]], cuts[part[:, 0] + 1])
    return Stage.join([swaps, rest]), grouped.transpose(0, 2, 1).reshape(count * factor, sets)


def _check_factors(ranks: int, factors: Sequence[int]) -> None:
    left = ranks
    for factor in factors:
        if factor < 2:
            raise InputError("a factor of radix-k is too small", found=factor, allowed="2 and more")
        left //= factor
    if left != min(ranks, 1):
        text = f"dividing {ranks} ranks by each factor of radix-k in turn must leave 1"
        raise InputError(text, found=list(factors), allowed=f"for example {list(automatic_factors(ranks))}")
