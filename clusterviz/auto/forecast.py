"""What `mode: auto` means in a loop of frames: how many groups of ranks share the screen, by a model of their time.

More groups hold more data a rank, draw more evenly, end rays earlier, and blend less. What each rank would draw is
known from a pre-pass, with what a sample costs there; what compositing should take, from its time model
(docs/concepts/time-model.md). Sharing the screen has to win clearly, since its model knows less of what may go wrong:
other views, and bricks that are read as tiles move.
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

LEAST_GAIN = 0.9  # of sort-last's predicted time, below which sharing the screen is chosen
DOUBT = 0.05  # of the time of drawing: so well is known what a sample takes on an idle machine
LEAST_GAIN_AGAIN = 0.8  # of the time of what is there already, below which it is given up: bricks may have to be read


def held_bytes(plan: Plan, budget: MemoryBudget, ranks: int, groups: int) -> int:
    """Bytes of bricks of the rank that holds most: the smallest group may come to see all that is shown."""
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
    """What a number of groups should take and hold.

    Parameters
    ----------
    holding : how bricks are counted
    nodes : the ranks of each
    groups : 1 … ranks, whose sizes differ by one at most
    sounding : what a pre-pass found
    pixel : format of partial images
    """
    ranks = sum(map(len, nodes))
    samples = samples_of_ranks(probe, plan, rank_groups(ranks, groups))
    drawing = drawing_seconds(probe, samples, nodes)
    compositing = compositing_seconds(plan, nodes, groups, network, pixel)
    return Forecast(groups, float(samples.max()), drawing, compositing, held_bytes(plan, budget, ranks, groups))


def compositing_seconds(plan: Plan, nodes: Nodes, groups: int, network: Network, pixel: str) -> float:
    """What joining the partial images of a number of groups should take; tiles are taken to be even among them."""
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
    """The number of groups that should take least, unless what they are measured by is nearly as good.

    Of numbers that a clock does not tell apart the fewest groups are taken, which hold least: two runs of the same
    scene shall not differ by what else the machine did.

    Parameters
    ----------
    present : groups that share the screen now; None before a first choice, which is measured by sort-last
    """
    best = min(found, key=lambda each: each.seconds)
    kept, gain = (1, LEAST_GAIN) if present is None else (present, LEAST_GAIN_AGAIN)
    now = next((each for each in found if each.groups == kept), None)
    enough = gain * now.seconds if now else np.inf
    if not best.seconds < enough:
        return kept
    alike = best.seconds + DOUBT * best.seconds_drawing
    return min(each.groups for each in found if each.seconds < enough and each.seconds <= alike)
