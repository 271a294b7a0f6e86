"""The balance room: from frame n to frame n + 1. Pure; what sends bricks and draws them is told by these values.

- expected.py   samples that a camera should take in each brick
- measure.py    what frames cost, as a factor a brick
- rebalance.py  which bricks change hands in a frame
- migration.py  who draws what while bricks are on their way, and what is kept in case they come back
- memory.py     whether shares fit, and how many ranks would do
- dynamic.py    all of it as one value that goes from frame to frame
"""

from __future__ import annotations

from clusterviz.balance.dynamic import Balance, Policy, begin, land, learn, steer
from clusterviz.balance.expected import expected_samples
from clusterviz.balance.measure import Measured, measure, predict, rank_costs, unmeasured
from clusterviz.balance.memory import check_memory
from clusterviz.balance.migration import Flight, Migration, arrive, dispatch, forget, launch, settled, switch, withdraw
from clusterviz.balance.rebalance import Move, Wish, rebalance

__all__ = [
    "Balance",
    "Flight",
    "Measured",
    "Migration",
    "Move",
    "Policy",
    "Wish",
    "arrive",
    "begin",
    "check_memory",
    "dispatch",
    "expected_samples",
    "forget",
    "land",
    "launch",
    "learn",
    "measure",
    "predict",
    "rank_costs",
    "rebalance",
    "settled",
    "steer",
    "switch",
    "unmeasured",
    "withdraw",
]
