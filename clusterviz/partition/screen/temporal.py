"""Temporal adaption: the screen's cuts move to where the last frame's cost, carried to the next camera, is even.

When to use: frames that follow each other closely. What the balance needs is known already, so no pass is added and
little is sent. When not: single frames, and jumps, for which the last frame says little; the first frame after one is
as uneven as the jump was far.
"""

from __future__ import annotations

import numpy as np

from clusterviz.image.partial import Rect
from clusterviz.partition.screen.cost_map import CostMap
from clusterviz.partition.screen.cuts import Cut, ScreenNode, ScreenTree, best_cut, build_cuts, halves, profile_of

STILL = 0.02  # a cut stays if the dearer side has at most this share more than at the best place
WORSE = 1.1  # cuts are made anew where moving them leaves the busiest this factor above that


def adapt(tree: ScreenTree, last: CostMap) -> ScreenTree:
    """The screen's cuts for the next frame.

    Returns the last tree with its cuts moved; new cuts where that is much better, as after a jump.

    `last`: what that frame cost, or what the next one should cost after it.

    Reference: F. Abraham, W. Celes, R. Cerqueira, J. Campos: A load-balancing strategy for sort-first distributed
    rendering, SIBGRAPI 2004; M. Strengert 2010, section 5.2.3, temporal adaption.
    """
    if not last.cost.any():
        return tree
    moved = ScreenTree(tree.size, tree.weights, _moved(tree.root, Rect(0, 0, *tree.size), tree.weights, last))
    anew = build_cuts(last, tree.weights)
    return anew if moved.busiest(last) > WORSE * anew.busiest(last) else moved


def carried(last: CostMap, before: CostMap, now: CostMap) -> CostMap:
    """What the next frame should cost: the cost of the last one, and the change that a model expects.

    `before`, `now`: the model of the last frame, and of the next one; their scale is taken from `last`.
    """
    total = float(before.cost.sum())
    scale = float(last.cost.sum()) / total if total > 0 else 0.0
    found = np.maximum(0.0, last.cost + scale * (now.cost - before.cost))
    return CostMap(last.size, found) if found.any() else last


def _moved(node: ScreenNode, rect: Rect, weights: tuple[int, ...], cost: CostMap) -> ScreenNode:
    if not isinstance(node, Cut):
        return node
    low_weight, high_weight = (sum(weights[group] for group in _groups(side)) for side in (node.low, node.high))
    share = low_weight / (low_weight + high_weight)
    begin = rect.y_begin if node.axis == 0 else rect.x_begin
    profile = profile_of(cost, rect, node.axis)
    load, at = best_cut(profile, begin, share)
    if 0 < node.at - begin < len(profile) - 1:
        below, total = float(profile[node.at - begin]), float(profile[-1])
        at = node.at if max(below / share, (total - below) / (1 - share)) <= load * (1 + STILL) else at
    low, high = halves(rect, node.axis, at)
    return Cut(node.axis, at, _moved(node.low, low, weights, cost), _moved(node.high, high, weights, cost))


def _groups(node: ScreenNode) -> tuple[int, ...]:
    return (*_groups(node.low), *_groups(node.high)) if isinstance(node, Cut) else (node,)
