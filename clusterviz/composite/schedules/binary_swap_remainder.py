"""Binary swap with remainders: in each round a rank without a partner sends its halves to the last pair.

What: pairs swap halves, as in binary swap. Where a group has an odd number of ranks, its last one sends one half to
each rank of the last pair and drops out. Then those that hold one half go on among themselves.
When: rank counts that are no power of two; no round more than binary swap, and no whole image goes to one rank.
When not: a power of two (it is binary swap then); sparse images, which direct send moves with fewer bytes.
Cost: ⌊log₂ n⌋ rounds; M(m) = m − (m mod 2) + 2(m mod 2) + 2·M(⌊m/2⌋) messages with M(1) = 0; (n − 1)·P pixels; a rank
that drops out sends P in all, the others less.
Limits: any number of ranks and pixels.
One partial image a rank, or several side by side in depth: swaps merge neighbours in depth.
Reference: K. Moreland, "Comparing binary-swap algorithms for odd factors of processes", LDAV 2018.
"""

from __future__ import annotations

from collections.abc import Sequence

from clusterviz.composite.fragment import Patch
from clusterviz.composite.schedules import radix_k
from clusterviz.composite.schedules.schedule import Schedule

SEVERAL_IMAGES = False


def schedule(ranks: int, pixels: int, footprints: Sequence[Patch] = ()) -> Schedule:
    """Return the schedule: radix-k with factors 2, which has these remainders."""
    return radix_k.schedule(ranks, pixels, footprints, factors=[2] * (ranks.bit_length() - 1))
