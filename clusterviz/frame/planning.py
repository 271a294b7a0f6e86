"""Planning of a frame: all its decisions, from the completed scene to the work of each rank.

    scene -> settings for `quality.max_error` -> plan -> mode and distribution -> pieces -> format of pixels -> work

Small pictures may be asked for on the way: to keep an error bound, to choose the mode, or to balance tiles. The loop
draws them, see `Planning`.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import replace
from typing import TYPE_CHECKING

from clusterviz.auto.calibration import SmallPicture
from clusterviz.auto.mode import AutoMode
from clusterviz.content.diff import check_same_volume
from clusterviz.content.facts import Facts
from clusterviz.distribution.contract import Distribution, DistributionHooks
from clusterviz.distribution.sort_first import SortFirst
from clusterviz.frame.drawing import Drawing
from clusterviz.frame.opening import Opened
from clusterviz.frame.run import Run
from clusterviz.frame.work import DrawingRequest, Planning, RankWork
from clusterviz.gl.devices import prefers_cpu
from clusterviz.plan.plan import Plan
from clusterviz.plan.view import make_view
from clusterviz.report.decisions import Accuracy, Sharing
from clusterviz.scene.values import Scene

if TYPE_CHECKING:
    from clusterviz.auto.error_bound import ErrorBoundController


class FramePlanner:
    """Planner of a loop's frames; it keeps what earlier frames have taught, the same on every rank.

    Bricks of the drawing may migrate. `several` says that more than one frame may come.

    Attributes
    ----------
    opened : content at the time steps of the frame
    auto_mode : present mode and distribution
    """

    def __init__(self, run: Run, drawing: Drawing, opened: Opened, scene: Scene, several: bool) -> None:
        self.opened, self._drawing = opened, drawing
        self._error_bound: ErrorBoundController | None = None
        self._last: RankWork | None = None
        self.auto_mode = self._auto_mode(run, scene, several)

    def plan(self, run: Run, scene: Scene) -> Planning[RankWork]:
        """Plan a frame of a completed scene; collective.

        Raises
        ------
        SceneError, InputError, RankError
            The same on every rank.
        """
        with run.local("plan", "plan"):
            if self._last is not None:
                check_same_volume(self._last.scene, scene)
            plan = self._plan(scene) if scene.quality.max_error is None else None
        accuracy = None
        if scene.quality.max_error is not None and self.opened.infos:
            scene, accuracy = yield from self._settled(run, scene, self.opened.infos)
            with run.local("plan", "plan"):
                plan = self._plan(scene)
        self._last = yield from self._work(run, scene, plan, accuracy)
        return self._last

    def forget(self, run: Run, scene: Scene) -> None:
        """Forget what earlier frames have taught, so that the next frame is planned as a single one; collective."""
        self.auto_mode.close()
        self.auto_mode = self._auto_mode(run, scene, several=False)
        self._error_bound = None

    def _auto_mode(self, run: Run, scene: Scene, several: bool) -> AutoMode:
        """Return the automatic mode, and what its distributions do around drawing; bricks migrate between frames."""

        def hooks_of(distribution: Distribution) -> DistributionHooks | None:
            if isinstance(distribution, SortFirst):
                from clusterviz.distribution.tile_scheduler import TileScheduler

                return TileScheduler(distribution)
            if several and self.opened.infos and scene.cluster.distribution == "dynamic":
                from clusterviz.distribution.dynamic import Dynamic
                from clusterviz.migration.driver import MigrationDriver

                if isinstance(distribution, Dynamic):
                    return MigrationDriver(distribution, self._drawing)
            return None

        return AutoMode(run, hooks_of, bool(self.opened.infos), scene, several)

    @property
    def last_plan(self) -> Plan | None:
        """Plan of the last frame; None without one."""
        return self._last.plan if self._last else None

    def _plan(self, scene: Scene) -> Plan | None:
        """Plan the drawing of a scene; where only the camera moved, reuse all but the view of the last plan."""
        opened, last = self.opened, self._last
        has_lens = scene.camera.aperture > 0 or bool(last and last.scene.camera.aperture)
        if not has_lens and last and last.plan and scene == last.scene.model_copy(update={"camera": scene.camera}):
            view = make_view(scene.camera, scene.image.size, last.plan.content.domain.grid)
            return opened.with_detail(replace(last.plan, view=view), scene)
        return opened.plan(scene)

    def _settled(self, run: Run, scene: Scene, facts: Sequence[Facts]) -> Planning[tuple[Scene, Accuracy]]:
        """Choose settings that keep `quality.max_error`; the format of pixels is chosen with the pieces."""
        if self._error_bound is None:
            from clusterviz.auto.error_bound import ErrorBoundController

            self._error_bound = ErrorBoundController(self._small_picture)
        spacing = min(one.smallest_spacing for one in facts if one.smallest_spacing)
        return (yield from self._error_bound.settle(run, scene, spacing))

    def _work(self, run: Run, scene: Scene, plan: Plan | None, accuracy: Accuracy | None) -> Planning[RankWork]:
        """Choose mode and distribution, and assign the pieces of a frame."""
        auto_mode = self.auto_mode
        if plan is None:
            return RankWork(scene, None, (), frozenset(), sharing=auto_mode.sharing)
        yield from auto_mode.update(run, scene, plan, self._last.holds if self._last else frozenset(), accuracy)
        if auto_mode.hooks:
            yield from auto_mode.hooks.prepare(run, scene, plan)
        return _assigned(run, scene, plan, auto_mode.distribution, accuracy, auto_mode.sharing)

    def _small_picture(self, run: Run, scene: Scene) -> Planning[SmallPicture]:
        """Ask for a picture of a calibration."""
        with run.local("plan", "plan"):
            plan = self.opened.plan(scene)
        assert plan is not None, "only what shows a volume has settings to choose"
        # A copy, since the distribution must not learn from these pictures.
        work = _assigned(run, scene, plan, deepcopy(self.auto_mode.distribution))
        drawn = yield DrawingRequest(run, work, loads=work, composited=True)
        every = run.channel.allgather((drawn.counts.samples, drawn.seconds, not prefers_cpu(run.options.device)))
        samples, slowest = sum(one[0] for one in every), max(one[1] for one in every)
        is_textured, volumes = all(one[2] for one in every), len(plan.content.volume_layers)
        return SmallPicture(drawn.image, samples, slowest, plan.filter, is_textured, volumes)


def _assigned(
    run: Run,
    scene: Scene,
    plan: Plan,
    distribution: Distribution,
    accuracy: Accuracy | None = None,
    sharing: Sharing | None = None,
) -> RankWork:
    with run.local("plan", "plan"):
        pieces = distribution.assign(plan)
        if accuracy is not None:
            from clusterviz.auto.error_bound import with_pixel

            scene, accuracy = with_pixel(scene, plan, pieces, accuracy, run.channel.size)
        holds = distribution.holds(run.channel.rank)
        return RankWork(scene, plan, pieces, holds, distribution.mode, accuracy, sharing)
