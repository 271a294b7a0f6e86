"""The partition room: which rank holds which bricks, and in which order their pictures lie over each other. Pure.

- tree.py     planes, and one rank's share at each leaf
- bsp.py      costs per brick to a tree, one leaf a rank
- order.py    a tree and an eye to the ranks from front to back
- assign.py   a rank to its bricks
- drawing.py  a tree as text

Arrays and boxes count bricks along (z, y, x); positions and directions are (x, y, z) in index space, where sample i
lies at i, a cell is [i, i + 1], and the plane before brick b lies at b · brick_cells.
"""

from __future__ import annotations

from clusterviz.partition.assign import bricks_of
from clusterviz.partition.bsp import build_tree
from clusterviz.partition.drawing import draw
from clusterviz.partition.order import front_to_back
from clusterviz.partition.tree import BrickBox, BspTree, Leaf, Node, Split

__all__ = ["BrickBox", "BspTree", "Leaf", "Node", "Split", "bricks_of", "build_tree", "draw", "front_to_back"]
