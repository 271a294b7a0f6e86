"""The frame loop: from scenes to pictures, on all ranks together.

    open -> read a share -> complete the scene -> plan -> assign -> load -> draw -> composite -> collect -> write

Each stage is a function from values to values, and only the loop calls it. `planning` decides on a frame, `drawing` and
`compositing` make its picture. Hooks of the distribution run around these stages. All ranks check that they agree on
the work of each.

Expensive results are kept for later frames: the summary of the volume, shaders, kernels, bricks in GPU memory, and the
compositor's buffers. `Run` describes how the failure of one step ends all ranks.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm import Channel
from clusterviz.content.complete import complete_scene
from clusterviz.content.diff import is_same_volume
from clusterviz.content.table import check_drawable, entries_of
from clusterviz.content.volume.opening import several_steps
from clusterviz.errors import ClustervizError, SceneError
from clusterviz.frame.brick_reader import BrickReader
from clusterviz.frame.compositing import Compositing, open_async_compositing
from clusterviz.frame.drawing import Drawing
from clusterviz.frame.driver import with_right_device
from clusterviz.frame.opening import Given, Opened, open_content, open_time_steps
from clusterviz.frame.planning import FramePlanner
from clusterviz.frame.run import STEPS, Image, Options, Progress, Run
from clusterviz.frame.work import (
    DrawingRequest,
    DrawingResult,
    DrawnFrame,
    Planning,
    RankWork,
    Rendered,
    T,
    check_consistency,
    check_cover,
)
from clusterviz.gl.devices import prefers_cpu
from clusterviz.plan.content import Bricks
from clusterviz.plan.plan import changed_settings
from clusterviz.report.decisions import Change
from clusterviz.report.statistics import RankFrame, summed
from clusterviz.scene.lens import eye_points, has_eye_points
from clusterviz.scene.values import Scene

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
    """Do all stages before drawing; return the work of this rank, and the bricks that it needs; collective.

    Raises
    ------
    SceneError
        The scene has `quality.max_error`: only the loop chooses settings. Or its rays bend: only the loop draws them.
    """
    if scene.quality.max_error is not None:
        bound, allowed = scene.quality.max_error, "null; give the settings that `render` chose"
        raise SceneError("no settings are chosen here", where="quality.max_error", found=bound, allowed=allowed)
    if scene.refracts:
        text, where = "only straight rays are measured here", "volumes[0].optics.refraction"
        raise SceneError(text, where=where, found=True, allowed="false")
    check_drawable(scene)
    scene, opened, bricks = open_content(run, scene, source)
    reader = BrickReader(opened, bricks)
    drawing = Drawing(reader)
    work = planned(drawing, FramePlanner(run, drawing, opened, scene, several=False).plan(run, scene))
    drawing.release()
    return work, reader.load(run, work.plan, work.holds) if work.plan else {}


def planned(drawing: Drawing, planning: Planning[T]) -> T:
    """Draw what a planning asks for, and return its decision; collective."""
    found: DrawingResult | None = None
    while True:
        try:
            request = planning.send(found)  # type: ignore[arg-type]  # None begins
        except StopIteration as decided:
            decision: T = decided.value
            return decision
        found = _found(drawing, request)


def _found(drawing: Drawing, request: DrawingRequest) -> DrawingResult:
    run, work = request.run, request.work
    if request.loads:
        drawing.load(run, request.loads)
    with run.unreported(request.stage) if request.stage else nullcontext(run) as timed:
        before = timed.clock.seconds.get("render", 0.0)
        partials, counts = drawing.draw(timed, work)
        seconds, image = timed.clock.seconds.get("render", 0.0) - before, None
    if request.composited:
        image, counts = Compositing(several=False).picture(run, work, partials, counts)
    return DrawingResult(partials, counts, drawing.sample_counts, seconds, image)


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
        with run.local("open"):
            check_drawable(scene)
            if run.options.annotate and not scene.annotations.is_empty:
                from clusterviz.annotations import check_library

                check_library()
        self._several, self._warned = several, set[Change]()
        self._compositing = Compositing(several)
        with run.clock.stage("total", "open"):
            if any(entry.kind.becomes for entry in entries_of(scene)):  # computed as they are opened
                run = with_right_device(run, scene, None, "open")
            self.scene, opened, bricks = open_content(run, scene, source)
            run = self._run = with_right_device(run, self.scene, opened, "plan")
            self._painter = opened.painter(run, self.scene)
        self._opened, self._is_given = opened, source is not None
        self._reader = BrickReader(opened, bricks)
        self._drawing = Drawing(self._reader)
        self._planner = FramePlanner(run, self._drawing, opened, self.scene, several)

    def frame(
        self, scene: Scene | None = None, number: int = 0, *, alone: bool = False, is_complete: bool = False
    ) -> Rendered:
        """Draw one frame; the costs of the first include opening the volume. Raises as `render_frame`.

        After an error that all ranks have raised another frame may be drawn.

        Parameters
        ----------
        scene : may differ from the loop's scene in camera, time steps, transfer function and quality; None: that one
        number : of the frame, for errors and statistics
        alone : forget what earlier frames have taught, so that the picture has the same bits as that of `render_frame`
        is_complete : the scene has been completed by the facts on this loop's content
        """
        run = self._run.numbered(number)
        self._run = run.restarted()
        scene = self.scene if scene is None else scene if is_complete else self._completed(run, scene)
        if alone:
            self._planner.forget(run, scene)
            self._drawing.forget()
        compositing = self._compositing.for_one_frame() if alone else self._compositing
        try:
            with run.clock.stage("total", f"frame {number}"):
                if has_eye_points(scene):
                    drawn, image, counts = self._averaged(run, scene, compositing)
                else:
                    drawn = self._draw(run, scene)
                    image, counts = compositing.finish(run, drawn)
        except ClustervizError:
            self._drawing.forget()
            raise
        rendered = compositing.gather(run, drawn, image, counts)
        self._planner.auto_mode.learn(self._run, drawn, rendered.statistics.per_rank)
        return rendered

    def frames(self, scenes: Iterable[tuple[int, Scene]]) -> Iterator[Rendered]:
        """Draw many frames, given by number and scene; each is composited and written while the next one is drawn.

        The drawing cost of frame n is known before frame n + 1 is assigned. In the statistics, `total` is the time from
        the beginning of a frame to its end; frames overlap, so the sum of totals exceeds the elapsed time. Without
        `Options.overlap`, or if MPI was started for one thread only, frames are drawn one after the other.
        """
        async_compositing = None if has_eye_points(self.scene) else open_async_compositing(self._run)
        if async_compositing is None:
            for number, scene in scenes:
                yield self.frame(scene, number)
            return
        with async_compositing:
            for number, scene in scenes:
                run = self._run.numbered(number)
                with run.clock.stage("total", f"frame {number}"):
                    drawn = self._draw(run, self._completed(run, scene))
                    costs = run.channel.allgather(replace(drawn.counts, seconds=run.clock.seconds))
                    self._planner.auto_mode.learn(run, drawn, costs)
                    with run.clock.stage("wait"):
                        before = async_compositing.take()
                async_compositing.put(run, drawn)
                self._run = run.restarted()
                if before is not None:
                    yield before
            last = async_compositing.take()
            if last is not None:
                yield last

    @property
    def opened(self) -> Opened:
        """The content."""
        return self._opened

    def suits(self, scene: Scene) -> bool:
        """Return whether a frame may show a completed scene; if not, its content has to be opened anew."""
        return is_same_volume(self.scene, scene) and self._opened.suits(scene)

    def _completed(self, run: Run, scene: Scene) -> Scene:
        """Complete a scene by what is known of the content, which is the same at all time steps."""
        with run.local("plan", "plan"):
            return scene if scene is self.scene else complete_scene(scene, self._opened.infos)

    def _draw(self, run: Run, scene: Scene) -> DrawnFrame:
        """Open what a completed scene shows anew, plan its frame, and draw this rank's part."""
        self._open_time_steps(run, scene)
        work = planned(self._drawing, self._planner.plan(run, scene))
        hooks = self._planner.auto_mode.hooks
        if run.options.check:
            check_cover(run, work)
        self._drawing.load(run, work)
        if work.accuracy and not run.options.keep_bricks:
            self._reader.clear()  # small pictures needed them, with other settings
        tiles = hooks.before(run, work) if hooks and work.plan else None
        check_consistency(run, work)
        partials, counts = self._drawing.draw(run, work, tiles)
        layers = self._drawing.find_layers(run, work, partials)
        painted = self._painter.paint(run, scene, layers) if self._painter else None
        counts = hooks.counted(counts) if hooks else counts
        if not self._several:
            self._drawing.release()
        found = self._opened.infos, self._changes(run, work), layers, self._drawing.fragments
        return DrawnFrame(run.frame, work, partials, counts, *found, painted, self._drawing.sample_counts)

    def _averaged(self, run: Run, scene: Scene, compositing: Compositing) -> tuple[DrawnFrame, Image | None, RankFrame]:
        """Draw a frame once for each eye point of its lens; return the last one, the mean on rank 0, and all costs."""
        count = scene.quality.lens.eye_points or 1
        total: NDArray[np.float64] | None = None
        counts = list[RankFrame]()
        for one in eye_points(scene, count):
            drawn = self._draw(run, one)
            image, found = compositing.picture(run, drawn.work, drawn.partials, drawn.counts)
            counts.append(found)
            if image is not None:
                total = image.astype(np.float64) if total is None else total + image
        drawn = replace(drawn, work=replace(drawn.work, scene=scene))
        mean = None if total is None else (total / count).astype(np.float32)
        return drawn, compositing.write(run, drawn, mean), summed(counts)

    def _open_time_steps(self, run: Run, scene: Scene) -> None:
        """Open the time steps of a frame, and drop the bricks that may differ from those of the last frame."""
        if problem := several_steps(scene):
            with run.local("open"):  # all ranks see it, and may go on with another scene
                raise problem
        before, plan = self._opened, self._planner.last_plan
        if not before.shows_other_times(scene):
            return
        if self._is_given:
            with run.local("open"):
                raise SceneError("data that are given have one time step", found="another time", allowed="files")
        opened, bricks = open_time_steps(run, scene, before)
        with run.local("load", "load"):
            held = self._reader.held | self._drawing.held
            changed = opened.changed(plan, before, held) if plan is not None else held
            self._opened = self._planner.opened = opened
            self._reader.replace(opened, changed, bricks)
            self._drawing.drop(changed)

    def _changes(self, run: Run, work: RankWork) -> tuple[Change, ...]:
        on_cpu = work.scene.quality.filter == "hardware" and prefers_cpu(run.options.device)
        changes = changed_settings(work.scene, run.channel.size, on_cpu)
        for change in changes:
            if run.channel.rank == 0 and change not in self._warned:
                warnings.warn(str(change), stacklevel=4)
        self._warned.update(changes)
        return changes

    def __enter__(self) -> FrameLoop:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        self._drawing.release()
        # After a failure other ranks may never reach a collective call.
        if kind is None:
            self._opened.free()
            self._compositing.close()
            self._planner.auto_mode.close()
