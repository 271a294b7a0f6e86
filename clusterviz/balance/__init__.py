"""The balance room: from frame n to frame n + 1. Pure; what sends bricks and draws them is told by these values.

- expected.py   samples that a camera should take in each brick
- measure.py    what frames cost, as a factor a brick
- rebalance.py  which bricks change hands in a frame
- migration.py  who draws what while bricks are on their way, and what is kept in case they come back
- handover.py   which of the bricks that have arrived change hands
- pace.py       how many bytes may be under way, by a share of the frames' time
- memory.py     whether shares fit, and how many ranks would do
- dynamic.py    all of it as one value that goes from frame to frame
"""

from __future__ import annotations

from clusterviz.balance.dynamic import Balance, Policy, begin, first_owners, land, learn, rest, steer
from clusterviz.balance.expected import expected_samples
from clusterviz.balance.handover import hand_over
from clusterviz.balance.measure import Measured, measure, predict, rank_costs, unmeasured
from clusterviz.balance.memory import check_memory
from clusterviz.balance.migration import Flight, Migration, arrive, dispatch, forget, launch, settled, switch, withdraw
from clusterviz.balance.pace import WHOLE, Pace
from clusterviz.balance.rebalance import Move, Wish, rebalance

__all__ = [
    "WHOLE",
    "Balance",
    "Flight",
    "Measured",
    "Migration",
    "Move",
    "Pace",
    "Policy",
    "Wish",
    "arrive",
    "begin",
    "check_memory",
    "dispatch",
    "expected_samples",
    "first_owners",
    "forget",
    "hand_over",
    "land",
    "launch",
    "learn",
    "measure",
    "predict",
    "rank_costs",
    "rebalance",
    "rest",
    "settled",
    "steer",
    "switch",
    "unmeasured",
    "withdraw",
]
