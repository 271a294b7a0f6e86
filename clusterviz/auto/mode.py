"""Automatic mode: sort-last, hybrid or sort-first, chosen before the first frame and again when the cost changes.

With more groups of ranks that share the screen each rank holds more data, drawing is more even, rays end earlier, and
less is blended. A cost probe predicts the samples of each rank and their time. A time model predicts compositing
(docs/concepts/time-model.md). Sharing the screen must win clearly, since the model ignores some of its costs: other
views, and bricks that are read when tiles move.

The first choice uses the measured time of a sample. Later choices use only counts, which are the same in every run.
The choice is repeated, with a new cost probe, when samples have changed much, as when the camera comes near. All ranks
have the same counts, and rank 0 decides for all.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from clusterviz.auto.cost_probe import UNKNOWN, CostProbe, drawing_seconds, leaf_bricks, probe_cost, samples_of_ranks
from clusterviz.comm.placement import Nodes
from clusterviz.composite.model.choice import Request, fastest
from clusterviz.composite.model.communication import ImageStatistics
from clusterviz.composite.model.network import Network, default_network
from clusterviz.composite.model.prediction import place_ranks, predict
from clusterviz.content.table import entries_of
from clusterviz.data.source import Index
from clusterviz.distribution.contract import Distribution, DistributionHooks, distribution_of, groups_of, sharing_of
from clusterviz.distribution.memory_budget import MemoryBudget, memory_budget_of
from clusterviz.frame.run import Run
from clusterviz.frame.work import DrawnFrame, Planning
from clusterviz.image.partial import bounding_rect
from clusterviz.partition import build_tree, leaf_pieces, owners_of
from clusterviz.partition.screen import rank_groups
from clusterviz.plan.plan import Plan
from clusterviz.render.render_result import footprint
from clusterviz.report.decisions import Accuracy, Forecast
from clusterviz.report.statistics import RankFrame
from clusterviz.scene.values import Scene

CHANGED = 1.5  # factor on samples, up or down, of all ranks or the busiest, that repeats the choice
PAUSE = 8  # least number of frames between choices
LEAST_GAIN = 0.9  # part of sort-last's predicted time, below which ranks share the screen
DOUBT = 0.05  # uncertainty of the time of drawing, on an idle machine
LEAST_GAIN_AGAIN = 0.8  # part of the present mode's predicted time, below which it changes: bricks may have to be read


HooksOf = Callable[[Distribution], DistributionHooks | None]


class AutoMode:
    """Present mode and its distribution; the same on every rank.

    Parameters
    ----------
    run : of the opening
    hooks_of : makes the hooks of a distribution, if it has some
    is_open : whether there is something to draw
    scene : completed
    several : True if more than one frame may come

    Attributes
    ----------
    distribution : of the mode; sort-last before the first choice
    hooks : of the distribution, if any
    sharing : mode and forecasts, for the statistics

    Raises
    ------
    InputError
        As `groups_of` does; the same on every rank.
    """

    def __init__(self, run: Run, hooks_of: HooksOf, is_open: bool, scene: Scene, several: bool) -> None:
        self._hooks_of, self._several = hooks_of, several
        self._cluster, self._ranks = scene.cluster, run.channel.size
        with run.local("plan", "plan"):
            self._candidates = groups_of(scene, self._ranks, several)
        shares_screen = self._candidates != [1] or self._cluster.mode in ("sort-first", "hybrid")
        with run.collective("plan", "plan"):
            has_surfaces = any(entry.kind.must_fit for entry in entries_of(scene))
            self._budget = memory_budget_of(run, self._cluster, shares_screen, has_surfaces)
        self._is_open = is_open and len(self._candidates) > 1
        self._groups = self._candidates[0] if not self._is_open else None
        self._seconds_per_sample: float | None = None
        self._held_cost: object = None
        self._frames, self._counted, self._has_changed = 0, (0, 0), False
        self.hooks: DistributionHooks | None = None
        self._take(self._groups or 1, ())

    def update(
        self,
        run: Run,
        scene: Scene,
        plan: Plan,
        holds: frozenset[Index] = frozenset(),
        accuracy: Accuracy | None = None,
    ) -> Planning[None]:
        """Choose the mode before a frame, if it is due; collective.

        `run`, `scene`, `plan`: of the frame, with all settings of its quality. `holds`: bricks of this rank in the last
        frame. `accuracy`: of the settings chosen for `quality.max_error`, from which the format of pixels follows.
        """
        if not self._is_open or (self._groups is not None and not self._is_due and self._can_hold(plan)):
            return
        with run.local("plan", "plan"):
            fitting = [n for n in self._candidates if self._fits(held_bytes(plan, self._budget, self._ranks, n))]
        found: tuple[Forecast, ...] = ()
        if len(fitting) > 1 and plan.cost.any():
            pixels = {groups: self._pixel(scene, plan, groups, accuracy) for groups in fitting}
            found = yield from self._forecasts(run, scene, plan, pixels, holds)
        present, self._frames = self._groups if self._groups in fitting else None, 0
        chosen = choose(found, present) if found else present or (fitting or self._candidates)[0]
        if chosen != self._groups:
            self._take(chosen, found)
        elif found:
            self.sharing = sharing_of(self.distribution, found)
        self._groups = chosen

    def learn(self, run: Run, drawn: DrawnFrame, costs: Sequence[RankFrame]) -> None:
        """Learn from the cost of a drawn frame on each rank; collective."""
        if drawn.work.plan is None:
            return
        self.distribution.learn(drawn.work.plan, costs)
        self._record(costs)
        if self.hooks:
            self.hooks.after(run, drawn, costs)

    def close(self) -> None:
        """Free the resources of the hooks; collective."""
        if self.hooks:
            self.hooks.close()

    def _record(self, costs: Sequence[RankFrame]) -> None:
        """Record the samples of a frame, whose change makes a choice due."""
        self._frames += 1
        samples = [rank.samples - rank.samples_estimate for rank in costs]
        now = sum(samples), max(samples)
        if self._frames == 1:
            self._counted = now
        self._has_changed = any(max(a, b) > CHANGED * min(a, b) for a, b in zip(now, self._counted, strict=True))

    @property
    def _is_due(self) -> bool:
        return self._frames >= PAUSE and self._has_changed

    def _can_hold(self, plan: Plan) -> bool:
        if self._groups in (None, 1) or plan.cost is self._held_cost:  # as where only the camera moved
            return True
        self._held_cost = plan.cost
        return self._fits(held_bytes(plan, self._budget, self._ranks, self._groups or 1))

    def _fits(self, held: int) -> bool:
        limit = self._budget.limit_bytes
        return limit is None or held <= limit

    def _take(self, groups: int, found: tuple[Forecast, ...]) -> None:
        self.close()
        self.distribution = distribution_of(self._cluster, self._ranks, groups, self._budget, self._several)
        self.hooks = self._hooks_of(self.distribution)
        self.sharing = sharing_of(self.distribution, found)

    def _pixel(self, scene: Scene, plan: Plan, groups: int, accuracy: Accuracy | None) -> str:
        if accuracy is None:
            return scene.quality.pixel
        from clusterviz.auto.error_bound import pixel_of

        return pixel_of(plan, accuracy, -(-self._ranks // groups), self._ranks).value

    def _forecasts(
        self, run: Run, scene: Scene, plan: Plan, pixels: Mapping[int, str], holds: frozenset[Index]
    ) -> Planning[tuple[Forecast, ...]]:
        """Predict the time of each number of groups; empty if the cost probe does not fit into memory."""
        channel = run.channel
        with run.collective("plan", "plan"):
            nodes = channel.nodes()
        with run.local("plan", "plan"):
            bricks = leaf_bricks(plan, channel.rank, channel.size) | holds
            held = len(bricks) * int(self._budget.brick_bytes(plan).max())
        if self._groups is not None and not self._fits(channel.maximum(held)):
            return ()
        probe = yield from probe_cost(run, scene, plan, holds, self._seconds_per_sample)
        result: tuple[tuple[Forecast, ...], float] = (), UNKNOWN
        with run.local("plan", "choose"):
            if probe is not None:
                network = default_network(len(nodes))
                common = plan, self._budget, nodes
                found = tuple(forecast(*common, n, network, probe, pixel) for n, pixel in pixels.items())
                result = found, probe.seconds_per_sample
        with run.collective("plan", "choose"):
            found, seconds = channel.broadcast(result)
        self._seconds_per_sample = seconds if seconds != UNKNOWN else None
        return found


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
    places, pixels = place_ranks(range(ranks), nodes), max(1, bounding_rect(rects).pixels)
    size = 4 * np.dtype(pixel).itemsize * plan.pictures
    if groups == ranks:
        scene = ImageStatistics(ranks, pixels, 1 / ranks, 1 / ranks, size, True)
        return predict("serial", "messages", scene, places, network)
    covers = np.array([rect.pixels for rect in rects] or [0]) / pixels / groups
    scene = ImageStatistics(ranks, pixels, max(float(covers.mean()), 1e-9), float(covers.max()), size, True)
    return fastest(Request("auto", "auto", "auto"), scene, places, False, network).seconds_predicted


def choose(found: Sequence[Forecast], present: int | None = None) -> int:
    """Choose the number of groups with the least predicted time, unless the present number is nearly as good.

    Among numbers with nearly equal times the smallest is chosen, which needs the least memory. So the choice depends
    less on other processes. `found`: forecasts. `present`: number of groups now; None before the first choice, which is
    compared with sort-last.
    """
    best = min(found, key=lambda each: each.seconds)
    kept, gain = (1, LEAST_GAIN) if present is None else (present, LEAST_GAIN_AGAIN)
    now = next((each for each in found if each.groups == kept), None)
    enough = gain * now.seconds if now else np.inf
    if not best.seconds < enough:
        return kept
    nearly_best = best.seconds + DOUBT * best.seconds_drawing
    return min(each.groups for each in found if each.seconds < enough and each.seconds <= nearly_best)
