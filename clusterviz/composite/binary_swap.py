"""Binary swap: neighbours swap halves, then quarters, then eighths; folded for any number of ranks.

What: in round k ranks pair up at distance 2^k; each keeps one half of what it held and sends the other. Where n is not
a power of two, n − 2^d ranks first hand their whole image to the neighbour in front ("fold") and drop out.
When: tens to thousands of ranks with dense images: few messages, all ranks busy, every rank ends with one piece.
When not: sparse images, which direct send moves with fewer bytes; n just above a power of two, where the fold moves
whole images first.
Cost, n = 2^d: d rounds, n·d messages, (n − 1)·P pixels, a rank sends and receives (1 − 1/n)·P. With r = n − 2^d folded:
one round and r messages more, d·2^d messages in the swaps; a rank sends at most P and receives at most (2 − 2^−d)·P.
Limits: any number of ranks and pixels.
Reference: K.-L. Ma, J. S. Painter, C. D. Hansen, M. F. Krogh, "Parallel volume rendering using binary-swap
compositing", IEEE Computer Graphics and Applications 14(4), 1994. On folding: K. Moreland, "Comparing binary-swap
algorithms for odd factors of processes", LDAV 2018.
"""

from __future__ import annotations

from collections.abc import Sequence

from clusterviz.composite.patch import Patch
from clusterviz.composite.schedule import Schedule, Stage, Transfer, piece


def schedule(ranks: int, pixels: int, footprints: Sequence[Patch] = ()) -> Schedule:
    """Fold to a power of two, then swap."""
    rounds = ranks.bit_length() - 1
    folded = ranks - (1 << rounds) if ranks else 0
    # The first 2·folded ranks pair up, so the swappers remain in visibility order.
    swappers = [*range(0, 2 * folded, 2), *range(2 * folded, ranks)]
    stages = [Stage.of(Transfer(front + 1, front, 0, pixels) for front in swappers[:folded])] if folded else []
    stages += [_swap(swappers, round_, pixels) for round_ in range(rounds)]
    return Schedule(ranks, pixels, tuple(stages))


def _swap(swappers: list[int], round_: int, pixels: int) -> Stage:
    """Round `round_`: pieces of 2^round_ parts are halved between partners at distance 2^round_."""
    transfers = []
    for index, rank in enumerate(swappers):
        partner = index ^ (1 << round_)
        transfers.append(Transfer(rank, swappers[partner], *piece(_part(partner, round_ + 1), 2 << round_, pixels)))
    return Stage.of(transfers)


def _part(index: int, bits: int) -> int:
    """Which of 2^bits pieces a swapper holds after `bits` rounds: its lowest bits, first round most significant."""
    return int(f"{index & ((1 << bits) - 1):0{bits}b}"[::-1], 2)
