"""Forecast for `mode: auto`: the time of a frame for each number of groups that share the screen.

With more groups each rank holds more data, drawing is more even, rays end earlier, and less is blended. The cost probe
predicts the samples of each rank and their time. A time model predicts compositing (docs/concepts/time-model.md).
Sharing the screen must win clearly, since the model ignores some of its costs: other views, and bricks that are read
when tiles move.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clusterviz.auto.cost_probe import CostProbe, drawing_seconds, samples_of_ranks
from clusterviz.comm.placement import Nodes
from clusterviz.composite.model.choice import Request, fastest
from clusterviz.composite.model.communication import ImageStatistics
from clusterviz.composite.model.network import Network
from clusterviz.composite.model.prediction import place_ranks, predict
from clusterviz.distribution.memory_budget import MemoryBudget
from clusterviz.image.region import EMPTY
from clusterviz.partition import build_tree, leaf_pieces, owners_of
from clusterviz.partition.screen import rank_groups
from clusterviz.plan.plan import Plan
from clusterviz.render.render_result import footprint
from clusterviz.report.decisions import Forecast

LEAST_GAIN = 0.9  # part of sort-last's predicted time, below which ranks share the screen
DOUBT = 0.05  # uncertainty of the time of drawing, on an idle machine
LEAST_GAIN_AGAIN = 0.8  # part of the present mode's predicted time, below which it changes: bricks may have to be read


def held_bytes(plan: Plan, budget: MemoryBudget, ranks: int, groups: int) -> int:
    """Return the most bytes of bricks of any rank, if the smallest group holds all visible bricks."""
    return int(owners_of(build_tree(plan.cost, ranks // groups)).sums(budget.brick_bytes(plan)).max())


def forecast(
    plan: Plan,
    budget: MemoryBudget,
    nodes: Nodes,
    groups: int,
    network: Network,
    probe: CostProbe,
    pixel: str = "float32",
) -> Forecast:
    """Predict time and memory for a number of groups.

    Parameters
    ----------
    plan : of the picture
    budget : memory of a rank for bricks
    nodes : ranks of each node
    groups : in 1 … ranks; their sizes differ by at most one
    network : for the time model
    probe : of the cost
    pixel : format of partial images
    """
    ranks = sum(map(len, nodes))
    samples = samples_of_ranks(probe, plan, rank_groups(ranks, groups))
    drawing = drawing_seconds(probe, samples, nodes)
    compositing = compositing_seconds(plan, nodes, groups, network, pixel)
    return Forecast(groups, float(samples.max()), drawing, compositing, held_bytes(plan, budget, ranks, groups))


def compositing_seconds(plan: Plan, nodes: Nodes, groups: int, network: Network, pixel: str) -> float:
    """Predict the time of compositing for a number of groups, assuming even tiles."""
    ranks = sum(map(len, nodes))
    tree = build_tree(plan.cost, ranks // groups)
    pieces = leaf_pieces(tree, plan.cost, plan.eye_in_bricks(), plan.view.forward)
    rects = [footprint(plan, piece) for piece in pieces]
    canvas = EMPTY
    for rect in rects:
        canvas = canvas.unite(rect)
    places, pixels, size = place_ranks(range(ranks), nodes), max(1, canvas.pixels), 4 * np.dtype(pixel).itemsize
    if groups == ranks:
        scene = ImageStatistics(ranks, pixels, 1 / ranks, 1 / ranks, size, True)
        return predict("serial", "messages", scene, places, network)
    covers = np.array([rect.pixels for rect in rects] or [0]) / pixels / groups
    scene = ImageStatistics(ranks, pixels, max(float(covers.mean()), 1e-9), float(covers.max()), size, True)
    return fastest(Request("auto", "auto", "auto"), scene, places, False, True, network).seconds_predicted


def choose(found: Sequence[Forecast], present: int | None = None) -> int:
    """Choose the number of groups with the least predicted time, unless the present number is nearly as good.

    Among numbers with nearly equal times the smallest is chosen, which needs the least memory. So the choice depends
    less on other processes.

    Parameters
    ----------
    found : forecasts
    present : number of groups now; None before the first choice, which is compared with sort-last
    """
    best = min(found, key=lambda each: each.seconds)
    kept, gain = (1, LEAST_GAIN) if present is None else (present, LEAST_GAIN_AGAIN)
    now = next((each for each in found if each.groups == kept), None)
    enough = gain * now.seconds if now else np.inf
    if not best.seconds < enough:
        return kept
    nearly_best = best.seconds + DOUBT * best.seconds_drawing
    return min(each.groups for each in found if each.seconds < enough and each.seconds <= nearly_best)
