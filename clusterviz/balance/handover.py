"""Which of the bricks that have arrived change hands: not each as it comes, if a rank would then have too much.

Ranks exchange bricks as fronts turn with the camera. Bricks that come out of a cache are there at once, and those that
go the other way a frame later: drawn as they come, they would make one rank wait for the other.
"""

from __future__ import annotations

from clusterviz.balance.migration import Migration, switch
from clusterviz.partition.bsp import Costs

UNEVEN = 1.02  # busiest over mean, up to which bricks change hands whoever has more then


def hand_over(migration: Migration, cost: Costs) -> Migration:
    """As many of the bricks that have arrived, the oldest flights first, as leave the busiest rank with no more.

    Parameters
    ----------
    migration : before a frame
    cost : float64 (bz, by, bx), expected in that frame

    Returns
    -------
    migration : all have changed hands if nothing else is in flight, so none waits for ever
    """
    held = [flight for flight in migration.flights if flight.stage == "held"]
    if len(held) == len(migration.flights):
        return switch(migration)
    loads = migration.owners.loads(cost)
    limit, count = max(float(loads.max()), UNEVEN * float(loads.mean())), 0
    for number, flight in enumerate(held, start=1):
        loads[flight.source] -= cost[flight.brick]
        loads[flight.target] += cost[flight.brick]
        if loads.max() <= limit:
            count = number
    return switch(migration, [flight.brick for flight in held[:count]])
