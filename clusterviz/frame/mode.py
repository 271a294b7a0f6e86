"""What `mode: auto` means in a loop of frames: how many groups of ranks share the screen, by a model of their time.

More groups hold more data a rank, draw more evenly, and blend less. What is known before anything is drawn: the samples
that the plan expects in each brick, the bytes of bricks, and what compositing should take (docs/time-model.md). Sharing
the screen has to win clearly, since its model knows less of what may go wrong: bricks that are read as tiles move.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clusterviz.balance import expected_samples
from clusterviz.comm.nodes import Nodes
from clusterviz.composite.model.choice import Wanted, fastest
from clusterviz.composite.model.moves import Scene
from clusterviz.composite.model.network import Network
from clusterviz.composite.model.prediction import place_ranks, predict
from clusterviz.image.region import EMPTY
from clusterviz.partition import build_tree, leaf_pieces, owners_of
from clusterviz.plan.plan import Plan
from clusterviz.render.drawn import footprint
from clusterviz.render.storage import brick_bytes

SECONDS_PER_SAMPLE = 1e-8  # of a rank with a core or two; a GPU takes less, and then compositing decides
LEAST_GAIN = 0.8  # of sort-last's predicted time, below which sharing the screen is chosen
PIXEL_BYTES = 16


@dataclass(frozen=True)
class Forecast:
    """One way to share.

    Attributes
    ----------
    groups : of ranks, that share the screen
    seconds : of the busiest rank's samples, and of compositing
    bytes_held : of bricks, by the rank that holds most
    """

    groups: int
    seconds: float
    bytes_held: int


def forecast(plan: Plan, nodes: Nodes, groups: int, network: Network) -> Forecast:
    """What a number of groups should take and hold; tiles are taken to be even among them.

    Parameters
    ----------
    nodes : the ranks of each
    groups : 1 … ranks, whose sizes differ by one at most
    """
    ranks = sum(map(len, nodes))
    tree = build_tree(plan.cost, -(-ranks // groups))
    owners = owners_of(tree)
    samples = float(owners.loads(expected_samples(plan)).max()) / groups
    pieces = leaf_pieces(tree, plan.cost, plan.view.eye_point, plan.view.forward, plan.layout.brick)
    rects = [footprint(plan, piece) for piece in pieces]
    canvas = EMPTY
    for rect in rects:
        canvas = canvas.unite(rect)
    places, pixels = place_ranks(range(ranks), nodes), max(1, canvas.pixels)
    if groups == ranks:
        scene = Scene(ranks, pixels, 1 / ranks, 1 / ranks, PIXEL_BYTES, True)
        composite = predict("serial", "messages", scene, places, network)
    else:
        covers = np.array([rect.pixels for rect in rects] or [0]) / pixels / groups
        scene = Scene(ranks, pixels, max(float(covers.mean()), 1e-9), float(covers.max()), PIXEL_BYTES, True)
        composite = fastest(Wanted("auto", "auto", "auto"), scene, places, False, True, network).seconds_predicted
    held = int(owners.sums(brick_bytes(plan)).max())
    return Forecast(groups, samples * SECONDS_PER_SAMPLE + composite, held)


def choose_groups(plan: Plan, nodes: Nodes, limit_bytes: int, network: Network) -> int:
    """The number of groups that should take least, of those that fit; 1, sort-last, unless others are clearly better.

    Parameters
    ----------
    limit_bytes : of bricks a rank, the same on every rank
    """
    ranks = sum(map(len, nodes))
    if ranks == 1 or not plan.cost.any():
        return 1
    last = forecast(plan, nodes, 1, network)
    candidates = sorted({ranks // size for size in range(1, ranks)})
    found = [forecast(plan, nodes, groups, network) for groups in candidates]
    best = min((each for each in found if each.bytes_held <= limit_bytes), key=lambda each: each.seconds, default=last)
    return best.groups if best.seconds < LEAST_GAIN * last.seconds else 1
