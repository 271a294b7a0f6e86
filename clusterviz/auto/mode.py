"""Automatic mode: sort-last, hybrid or sort-first, chosen before the first frame and again when the cost changes.

The first choice uses the measured time of a sample. Later choices use only counts, which are the same in every run.
The choice is repeated, with a new cost probe, when samples have changed much, as when the camera comes near. All ranks
have the same counts, and rank 0 decides for all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from clusterviz.composite.model.network import default_network
from clusterviz.distribution.memory_budget import memory_budget_of
from clusterviz.distribution.select import distribution_of, groups_of, sharing_of
from clusterviz.frame.assignment import plan_frame
from clusterviz.frame.drawing import Drawing
from clusterviz.frame.hooks import DistributionHooks, hooks_of
from clusterviz.frame.opening import Opened
from clusterviz.frame.run import Run
from clusterviz.frame.work import RankWork
from clusterviz.plan.plan import Plan
from clusterviz.report.decisions import Accuracy, Forecast
from clusterviz.report.statistics import RankFrame
from clusterviz.scene.complete import complete_scene
from clusterviz.scene.values import Scene

CHANGED = 1.5  # factor on samples, up or down, of all ranks or the busiest, that repeats the choice
PAUSE = 8  # least number of frames between choices


class AutoMode:
    """Present mode and its distribution; the same on every rank.

    Parameters
    ----------
    run, drawing : of the loop; drawing keeps the bricks of a cost probe
    opened : volumes, if any
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

    def __init__(self, run: Run, drawing: Drawing, opened: Opened | None, scene: Scene, several: bool) -> None:
        self._run, self._drawing, self._opened, self._several = run, drawing, opened, several
        self._cluster, ranks = scene.cluster, run.channel.size
        with run.local("plan", "plan"):
            self._candidates = groups_of(scene, ranks, several)
        shares_screen = self._candidates != [1] or self._cluster.mode in ("sort-first", "hybrid")
        with run.collective("plan", "plan"):
            self._budget = memory_budget_of(run, self._cluster, shares_screen)
        self._is_open = opened is not None and len(self._candidates) > 1
        self._groups = self._candidates[0] if not self._is_open else None
        self._seconds_per_sample: float | None = None
        self._frames, self._counted, self._has_changed = 0, (0, 0), False
        self.hooks: DistributionHooks | None = None
        self._take(self._groups or 1, ())

    def update(self, scene: Scene, last: RankWork | None = None, accuracy: Accuracy | None = None) -> None:
        """Choose the mode before a frame, if it is due; collective.

        Parameters
        ----------
        scene : of the frame, with all settings of its quality
        last : work of the last frame
        accuracy : of the settings chosen for `quality.max_error`, from which the format of pixels follows
        """
        if not self._is_open or (self._groups is not None and not self._is_due):
            return
        run, opened = self._run, self._opened
        assert opened is not None, "without a volume the mode is not open"
        from clusterviz.auto.forecast import choose, held_bytes

        with run.local("plan", "plan"):
            scene = complete_scene(scene, opened.infos)
            plan = plan_frame(opened, scene, last)
            fitting = [n for n in self._candidates if self._fits(held_bytes(plan, self._budget, run.channel.size, n))]
        found: tuple[Forecast, ...] = ()
        if len(fitting) > 1 and plan.cost.any():
            pixels = {groups: self._pixel(scene, plan, groups, accuracy) for groups in fitting}
            found = self._forecasts(opened, scene, plan, pixels, last)
        present, self._frames = self._groups, 0
        chosen = choose(found, present) if found else present or (fitting or self._candidates)[0]
        if chosen != present:
            self._take(chosen, found)
        elif found:
            self.sharing = sharing_of(self.distribution, found)
        self._groups = chosen

    def record(self, costs: Sequence[RankFrame]) -> None:
        """Record the cost of a frame on each rank."""
        self._frames += 1
        samples = [rank.samples - rank.samples_estimate for rank in costs]
        now = sum(samples), max(samples)
        if self._frames == 1:
            self._counted = now
        self._has_changed = any(max(a, b) > CHANGED * min(a, b) for a, b in zip(now, self._counted, strict=True))

    def close(self) -> None:
        """Free the resources of the hooks; collective."""
        if self.hooks:
            self.hooks.close()

    @property
    def _is_due(self) -> bool:
        return self._frames >= PAUSE and self._has_changed

    def _fits(self, held: int) -> bool:
        limit = self._budget.limit_bytes
        return limit is None or held <= limit

    def _take(self, groups: int, found: tuple[Forecast, ...]) -> None:
        """Make the distribution and hooks for a number of groups."""
        self.close()
        ranks = self._run.channel.size
        self.distribution = distribution_of(self._cluster, ranks, groups, self._budget, self._several)
        self.hooks = hooks_of(self._run, self._drawing, self.distribution, self._several)
        self.sharing = sharing_of(self.distribution, found)

    def _pixel(self, scene: Scene, plan: Plan, groups: int, accuracy: Accuracy | None) -> str:
        if accuracy is None:
            return scene.quality.pixel
        from clusterviz.auto.error_bound import pixel_of

        ranks = self._run.channel.size
        return pixel_of(plan, accuracy, -(-ranks // groups), ranks).value

    def _forecasts(
        self, opened: Opened, scene: Scene, plan: Plan, pixels: Mapping[int, str], last: RankWork | None
    ) -> tuple[Forecast, ...]:
        """Predict the time of each number of groups; empty if the cost probe does not fit into memory."""
        from clusterviz.auto.cost_probe import UNKNOWN, leaf_bricks, probe_cost
        from clusterviz.auto.forecast import forecast

        run, channel = self._run, self._run.channel
        with run.collective("plan", "plan"):
            nodes = channel.nodes()
        holds = last.holds if last else frozenset()
        with run.local("plan", "plan"):
            bricks = leaf_bricks(plan, channel.rank, channel.size) | holds
            held = len(bricks) * int(self._budget.brick_bytes(plan).max())
        if last and not self._fits(channel.maximum(held)):
            return ()
        probe = probe_cost(run, self._drawing, opened, scene, plan, holds, self._seconds_per_sample)
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
