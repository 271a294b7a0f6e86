"""Binary swap with remainders: in each round a rank without a partner sends its halves to the last pair.

What: pairs swap halves, as in binary swap. In a group with an odd number of ranks, the last one sends one half to each
rank of the last pair and drops out.
When: numbers of ranks that are no power of two: no more rounds than binary swap, and no whole image goes to one rank.
When not: a power of two, where it is binary swap; sparse images.
Cost: ⌊log₂ n⌋ rounds; M(m) = m − (m mod 2) + 2(m mod 2) + 2·M(⌊m/2⌋) messages with M(1) = 0; a rank that drops out
sends P in all, the others less.
Limits: one partial image a rank, or several adjacent in depth.
Reference: K. Moreland, LDAV 2018, as for binary swap.
"""

from __future__ import annotations

from clusterviz.composite.schedules import radix_k
from clusterviz.composite.schedules.schedule import Patches, Schedule


def schedule(ranks: int, pixels: int, footprints: Patches = ()) -> Schedule:
    """Return the schedule: radix-k with factors 2, which has these remainders."""
    return radix_k.schedule(ranks, pixels, footprints, factors=[2] * (ranks.bit_length() - 1))
