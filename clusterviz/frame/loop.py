"""The frame loop: from scenes to pictures, on all ranks together.

    open -> read a share -> complete the scene -> plan -> assign -> load -> draw -> composite -> collect -> write

Each stage is a function from values to values, and only the loop calls it. With `quality.max_error`, small pictures are
drawn before the plan to choose settings. With `cluster.mode: auto`, a cost probe chooses how ranks share the frame.
Hooks of the distribution run before and after drawing. All ranks check that they agree on the assignment.

Expensive results are kept for later frames: the summary of the volume, shaders, kernels, bricks in GPU memory, and the
compositor's buffers. `Run` describes how the failure of one step ends all ranks.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Sequence
from copy import deepcopy
from dataclasses import replace
from typing import TYPE_CHECKING

from clusterviz.auto.calibration import SmallPicture
from clusterviz.auto.mode import AutoMode
from clusterviz.comm import Channel
from clusterviz.errors import SceneError
from clusterviz.frame.assignment import assign_work
from clusterviz.frame.async_compositing import open_async_compositing
from clusterviz.frame.compositing import Compositing, finish_frame, gather_costs
from clusterviz.frame.consistency import check_consistency
from clusterviz.frame.drawing import Drawing
from clusterviz.frame.opening import Bricks, Given, load_bricks, open_volumes
from clusterviz.frame.run import STEPS, Options, Progress, Rendered, Run
from clusterviz.frame.work import DrawnFrame, RankWork
from clusterviz.plan.plan import changed_settings
from clusterviz.render.choice import on_cpu
from clusterviz.report.decisions import Accuracy, Change
from clusterviz.report.statistics import RankFrame
from clusterviz.scene.complete import complete_scene
from clusterviz.scene.values import Scene

if TYPE_CHECKING:
    from clusterviz.auto.error_bound import ErrorBoundController

__all__ = ["STEPS", "FrameLoop", "Options", "Progress", "Rendered", "Run", "prepare", "render_frame"]


def render_frame(scene: Scene, channel: Channel, source: Given = None, options: Options | None = None) -> Rendered:
    """Draw one frame; collective.

    Parameters
    ----------
    scene : as given by the user; settings that it leaves open are chosen from the data
    channel : to the other ranks
    source : the data of the volume, or of each, instead of the files that the scene names
    options : how to run

    Raises
    ------
    RankError, InputError, DeviceError
        The same on every rank.
    """
    with FrameLoop(scene, channel, source, options, several=False) as loop:
        return loop.frame()


def prepare(run: Run, scene: Scene, source: Given = None) -> tuple[RankWork, Bricks]:
    """Do all stages before drawing: read the data, complete the scene, plan the frame, assign bricks; collective.

    Returns
    -------
    work : of this rank
    bricks : that its work needs

    Raises
    ------
    SceneError
        The scene has `quality.max_error`: only the loop chooses settings.
    """
    if scene.quality.max_error is not None:
        bound, allowed = scene.quality.max_error, "null; give the settings that `render` chose"
        raise SceneError("no settings are chosen here", where="quality.max_error", found=bound, allowed=allowed)
    opened = open_volumes(run, scene, source)
    drawing = Drawing(run)
    auto_mode = AutoMode(run, drawing, opened, scene, False)
    auto_mode.update(scene)
    drawing.release()
    work = assign_work(run, opened, scene, auto_mode.distribution)
    return work, load_bricks(run, opened, work.plan, work.holds) if opened and work.plan else {}


class FrameLoop:
    """Frame loop over the same volumes; every method is collective.

    Parameters
    ----------
    scene, channel, source, options : as in `render_frame`
    several : False if only one frame comes: then nothing is prepared for later frames

    Attributes
    ----------
    scene : completed
    """

    def __init__(
        self,
        scene: Scene,
        channel: Channel,
        source: Given = None,
        options: Options | None = None,
        *,
        several: bool = True,
    ) -> None:
        run = self._run = Run(channel, options or Options())
        self._several = several
        self._drawing, self._compositing = Drawing(run), Compositing(run, several)
        self._work: RankWork | None = None
        self._warned = set[Change]()
        self._error_bound: ErrorBoundController | None = None
        with run.clock.stage("total", "open"):
            self._opened = open_volumes(run, scene, source)
            with run.local("plan", "plan"):
                self.scene = complete_scene(scene, self._opened.infos if self._opened else ())
        self._auto_mode = AutoMode(run, self._drawing, self._opened, self.scene, several)

    def frame(self, scene: Scene | None = None, number: int = 0) -> Rendered:
        """Draw one frame; the costs of the first include opening the volume. Raises as `render_frame`.

        Parameters
        ----------
        scene : may differ from the loop's scene in camera, transfer function and quality; None: the loop's scene
        number : of the frame, for errors and statistics
        """
        run, run.frame = self._run, number
        with run.clock.stage("total", f"frame {number}"):
            drawn = self._draw(scene or self.scene, number)
            image, counts = finish_frame(run, self._compositing, drawn)
        rendered = gather_costs(run, drawn, image, counts)
        self._learn(drawn.work, rendered.statistics.per_rank)
        return rendered

    def frames(self, scenes: Iterable[tuple[int, Scene]]) -> Iterator[Rendered]:
        """Draw many frames, given by number and scene; each is composited and written while the next one is drawn.

        The drawing cost of frame n is known before frame n + 1 is assigned. In the statistics, `total` is the time from
        the beginning of a frame to its end; frames overlap, so the sum of totals exceeds the elapsed time. Without
        `Options.overlap`, or if MPI was started for one thread only, frames are drawn one after the other.
        """
        run, async_compositing = self._run, open_async_compositing(self._run)
        if async_compositing is None:
            for number, scene in scenes:
                yield self.frame(scene, number)
            return
        with async_compositing:
            for number, scene in scenes:
                run.frame = number
                with run.clock.stage("total", f"frame {number}"):
                    drawn = self._draw(scene, number)
                    self._learn(drawn.work, run.channel.allgather(replace(drawn.counts, seconds=run.clock.seconds)))
                    with run.clock.stage("wait"):
                        before = async_compositing.take()
                async_compositing.put(drawn, run.start_frame())
                if before is not None:
                    yield before
            last = async_compositing.take()
            if last is not None:
                yield last

    def _draw(self, scene: Scene, number: int) -> DrawnFrame:
        scene, accuracy = self._settled(scene)
        self._auto_mode.update(scene, self._work, accuracy)
        work = self._work = assign_work(self._run, self._opened, scene, self._auto_mode.distribution, self._work)
        hooks, sharing = self._auto_mode.hooks, self._auto_mode.sharing
        if self._opened:
            self._drawing.load(self._opened, work)
            if accuracy and not self._run.options.keep_bricks:
                self._opened.held.clear()  # small pictures needed them, with other settings
            work = hooks.before(self._opened, work) if hooks else work
        if accuracy:
            from clusterviz.auto.error_bound import with_pixel

            work, accuracy = with_pixel(work, accuracy, self._run.channel.size)
        check_consistency(self._run, work)
        partials, counts = self._drawing.draw(work)
        counts = hooks.counted(counts) if hooks else counts
        if not self._several:
            self._drawing.release()
        infos = self._opened.infos if self._opened else ()
        return DrawnFrame(number, work, partials, counts, infos, accuracy, sharing, self._changes(work))

    def _changes(self, work: RankWork) -> tuple[Change, ...]:
        """Return settings of a frame that are not used as given; rank 0 warns of each once."""
        run = self._run
        no_cpu = work.plan is not None and run.options.device == "cpu" and not on_cpu(work.plan, "cpu")
        changes = changed_settings(work.scene, run.channel.size, no_cpu)
        for change in changes:
            if run.channel.rank == 0 and change not in self._warned:
                warnings.warn(str(change), stacklevel=4)
        self._warned.update(changes)
        return changes

    def _learn(self, work: RankWork, costs: Sequence[RankFrame]) -> None:
        if work.plan is not None:
            self._auto_mode.distribution.learn(work.plan, costs)
            self._auto_mode.record(costs)
            if self._auto_mode.hooks:
                self._auto_mode.hooks.after(work, costs)

    def _settled(self, scene: Scene) -> tuple[Scene, Accuracy | None]:
        """Choose settings that keep `quality.max_error`, if the scene has one."""
        if scene.quality.max_error is None or self._opened is None:
            return scene, None
        with self._run.local("plan", "plan"):
            scene = complete_scene(scene, self._opened.infos)
        if self._error_bound is None:
            from clusterviz.auto.error_bound import ErrorBoundController

            self._error_bound = ErrorBoundController(self._run, self._small_picture)
        return self._error_bound.settle(scene)

    def _small_picture(self, scene: Scene) -> SmallPicture:
        """Draw a picture for a calibration."""
        # A copy, since the distribution must not learn from these pictures.
        run, distribution = self._run, deepcopy(self._auto_mode.distribution)
        work = assign_work(run, self._opened, scene, distribution)
        if self._opened:
            self._drawing.load(self._opened, work)
        before, plan = run.clock.seconds.get("render", 0.0), work.plan
        partials, counts = self._drawing.draw(work)
        seconds = run.clock.seconds.get("render", 0.0) - before
        image, counts = Compositing(run, several=False).picture(work, partials, counts)
        assert plan is not None, "only what shows a volume has settings to choose"
        textured = not on_cpu(plan, run.options.device)
        every = run.channel.allgather((counts.samples, seconds, textured))
        samples, slowest = sum(one[0] for one in every), max(one[1] for one in every)
        return SmallPicture(image, samples, slowest, plan.march.filter, all(one[2] for one in every))

    def __enter__(self) -> FrameLoop:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        self._drawing.release()
        # After a failure other ranks may never reach a collective call.
        if kind is None:
            self._compositing.close()
            self._auto_mode.close()
