"""Partition of the bricks among the ranks, and the visibility order of their images. Pure functions.

Arrays and boxes count bricks along (z, y, x); positions and directions are (x, y, z) in units of bricks, in which the
plane before brick b lies at b.

"M. Strengert 2010" is Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010.
"""

from __future__ import annotations

from clusterviz.partition.bsp import build_tree
from clusterviz.partition.edges import refined_edges, units
from clusterviz.partition.fronts import PARALLEL_ORIGIN, RayOrigin, front_owners, ray_origin
from clusterviz.partition.interleave import interleave
from clusterviz.partition.owners import UNASSIGNED, Owners, bricks_of, owners_of
from clusterviz.partition.pieces import BrickGroup, Piece, bounding_box, leaf_pieces, owner_pieces, visible_groups
from clusterviz.partition.replicate import Replicas, assign_replicas, replicate
from clusterviz.partition.search import busiest, move_planes, search_tree
from clusterviz.partition.tree import BrickBox, BspTree, Leaf, Node, Split, front_to_back
