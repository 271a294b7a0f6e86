"""Sequential pipeline: batches of the picture travel from the rank at the back to the one in front.

What: each rank receives a batch from its neighbour behind, merges its own pixels in front of it, and sends it on. Rank
0 ends with the picture.
When: ranks that finish from back to front; links to neighbours only. No gather is needed.
When not: latency matters: the last batch passes through all ranks.
Cost: n − 1 rounds for one batch, n − 2 + batches for several; batches·(n − 1) messages; a rank sends and receives P.
Limits: one partial image a rank; by default a batch for each 16,384 pixels, 32 at most.
Reference: T.-Y. Lee et al., IEEE TVCG 2(3), 1996, as for the parallel pipeline.
"""

from __future__ import annotations

import numpy as np

from clusterviz.composite.schedules.schedule import Patches, Schedule, Stage, borders
from clusterviz.errors import InputError

BATCH_PIXELS = 16_384
MOST_BATCHES = 32


def schedule(ranks: int, pixels: int, footprints: Patches = (), *, batches: int | None = None) -> Schedule:
    """Return the schedule: batch b leaves rank r in round b + (ranks − 1 − r); InputError without a batch."""
    batches = automatic_batches(pixels) if batches is None else batches
    if batches < 1:
        raise InputError("too few batches for a pipeline", found=batches, allowed="1 and more")
    cuts, stages = borders(batches, pixels), []
    for number in range(ranks - 2 + batches if ranks > 1 else 0):
        batch = np.arange(max(0, number - ranks + 2), min(batches, number + 1), dtype=np.int64)
        source = ranks - 1 - number + batch
        stages.append(Stage.of_columns(source, source - 1, cuts[batch], cuts[batch + 1]))
    return Schedule(ranks, pixels, tuple(stages))


def automatic_batches(pixels: int) -> int:
    """Return the default number of batches."""
    return min(MOST_BATCHES, max(1, pixels // BATCH_PIXELS))
