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
