"""The loop: frames from scenes to pictures, on all ranks together.

    open -> read a share -> complete the scene -> plan -> partition -> load -> draw -> composite -> collect -> write

Stages are functions from values to values, and only this file calls them. What is dear is done once and kept: reading,
the summary, programs, the bricks in GPU memory, kernels, the compositor's memory. A further frame makes anew only what
its scene asks for. How a step that fails ends all ranks is said in `run.py`.
"""

from __future__ import annotations

from dataclasses import asdict, replace
from time import perf_counter
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm import Channel
from clusterviz.composite import Compositor, collect, compile_kernels, composite
from clusterviz.data import open_source
from clusterviz.data.bricks import BrickLayout, read_bricks
from clusterviz.data.source import Index, Source
from clusterviz.data.summary import summarise
from clusterviz.errors import ClustervizError
from clusterviz.frame.run import STEPS, Image, Options, Rendered, Run
from clusterviz.frame.share import OpenedVolume, Share, indices_of
from clusterviz.image.compare import compare
from clusterviz.image.partial import PartialImage, blank
from clusterviz.partition import build_tree, front_to_back
from clusterviz.plan.look import margin_of
from clusterviz.plan.plan import Plan, brick_cost, make_plan
from clusterviz.plan.view import make_view
from clusterviz.render.projection import project
from clusterviz.report.machine import memory
from clusterviz.report.statistics import FrameStatistics, RankFrame, peak_memory_bytes
from clusterviz.report.trace import composition_spans
from clusterviz.scene.complete import complete_scene
from clusterviz.scene.difference import check_same_volume
from clusterviz.scene.values import Scene

if TYPE_CHECKING:
    from clusterviz.render.lasting import LastingCaster

__all__ = ["STEPS", "FrameLoop", "Options", "Rendered", "Run", "prepare", "render_frame"]

CHECK_TOLERANCE = 1e-5
HELD_SHARE_OF_MEMORY = 0.4


def render_frame(
    scene: Scene, channel: Channel, source: Source | None = None, options: Options | None = None
) -> Rendered:
    """Draw one frame, one turn of the loop; collective.

    Parameters
    ----------
    scene : as given by the user; what it leaves open is chosen from the data
    channel : to the other ranks
    source : the volume's data, instead of the file that the scene names
    options : how to run

    Raises
    ------
    RankError, InputError, DeviceError
        The same on every rank.
    """
    with FrameLoop(scene, channel, source, options, several=False) as loop:
        return loop.frame()


def prepare(run: Run, scene: Scene, source: Source | None = None) -> Share:
    """Everything before drawing: read the data, complete the scene, plan the frame, deal out the bricks; collective."""
    opened = _open_volume(run, scene, source)
    share = _deal(run, opened, scene)
    return share if opened is None else replace(share, bricks=_load(run, opened, share))


def _open_volume(run: Run, scene: Scene, source: Source | None = None) -> OpenedVolume | None:
    """Read an equal share of the bricks, and learn together what the volume holds; the share is kept for drawing."""
    if not scene.volumes:
        return None
    with run.alone("open", "load"):
        source = source or open_source(scene.volumes[0].path, scene.volumes[0].array)
        margin = margin_of(scene.volumes[0], scene.quality.classification)
        layout = BrickLayout(source.grid.shape_zyx, scene.cluster.brick, margin)
    with run.together("read", "load"):
        most_bytes = HELD_SHARE_OF_MEMORY * memory().available_bytes / run.channel.place().local_size
    with run.alone("read", "load"):
        cells = brick_cost(layout, np.zeros(layout.counts_zyx, bool))
        share = indices_of(build_tree(cells, run.channel.size), run.channel.rank, cells)
        fits = len(share) * (layout.brick + 1 + 2 * layout.margin) ** 3 * source.dtype.itemsize <= most_bytes
        held = dict(read_bricks(source, layout, share)) if fits else {}
    with run.together("summarise", "load"):
        # A share larger than the memory is read again for each pass; of it only what is visible is ever held.
        again = (lambda: iter(held.items())) if fits else (lambda: read_bricks(source, layout, share))
        return OpenedVolume(source, layout, summarise(source.dtype, layout, again, run.channel.allgather), held)


def _deal(run: Run, opened: OpenedVolume | None, scene: Scene, last: Share | None = None) -> Share:
    """Complete the scene, plan the frame, and deal out the bricks, unless the last frame's deal will do."""
    with run.alone("plan", "plan"):
        completed = complete_scene(scene, opened.facts if opened else ())
        if last:
            check_same_volume(last.scene, completed)
        if opened is None:
            return Share(completed, None, None, None, list(range(run.channel.size)), {})
        plan = _plan(opened, completed, last)
        tree, dealt = (last.tree, last.dealt) if last and last.holds(plan) else (None, None)
        if tree is None or dealt is None:
            tree, dealt = build_tree(plan.cost, run.channel.size), plan.cost
        view = plan.view
        order = front_to_back(tree, None if view.parallel else view.eye, view.forward, plan.layout.brick)
        return Share(completed, plan, tree, dealt, order, {})


def _plan(opened: OpenedVolume, scene: Scene, last: Share | None) -> Plan:
    """A frame's decisions; of the last frame's only the view is made anew where only the camera is another."""
    source = opened.source
    if last and last.plan and scene == last.scene.model_copy(update={"camera": scene.camera}):
        return replace(last.plan, view=make_view(scene.camera, scene.image.size, source.grid))
    return make_plan(scene, source.grid, source.dtype, opened.layout, opened.summary)


def _load(run: Run, opened: OpenedVolume, share: Share, wanted: bool = True) -> dict[Index, NDArray[Any]]:
    """The bricks of this rank, if they are wanted; those that it does not hold are read."""
    with run.alone("load", "load"):
        if share.tree is None or share.dealt is None or not wanted:
            return {}
        mine = indices_of(share.tree, run.channel.rank, share.dealt)
        bricks = {index: samples for index, samples in opened.held.items() if index in mine}
        opened.held.clear()
        bricks.update(read_bricks(opened.source, opened.layout, mine - bricks.keys()))
        if run.options.keep_bricks:
            opened.held.update(bricks)
        return bricks


class FrameLoop:
    """Draws frame after frame of one volume, `scene` being its completed scene; every method is collective.

    Parameters
    ----------
    scene, channel, source, options : as in `render_frame`
    several : whether more than one frame may come; what pays only then is left out otherwise
    """

    def __init__(
        self,
        scene: Scene,
        channel: Channel,
        source: Source | None = None,
        options: Options | None = None,
        *,
        several: bool = True,
    ) -> None:
        self._run, self._several = Run(channel, options or Options()), several
        self._share: Share | None = None
        self._caster: LastingCaster | None = None
        self._compositor: Compositor | None = None
        self._counts = RankFrame({})
        with self._run.clock.stage("total", "open"):
            self._opened = _open_volume(self._run, scene, source)
            with self._run.alone("plan", "plan"):
                self.scene = complete_scene(scene, self._opened.facts if self._opened else ())

    def frame(self, scene: Scene | None = None, number: int = 0) -> Rendered:
        """Draw one frame; the first one's costs include the opening of the volume. Raises what `render_frame` does.

        Parameters
        ----------
        scene : differs from the loop's in nothing but camera and transfer function; the loop's own where None
        number : what failures and statistics call it
        """
        run, run.frame = self._run, number
        with run.clock.stage("total", f"frame {number}"):
            share = self._share = self._next_share(scene or self.scene)
            partial, counts = self._draw(share)
            image, counts = self._composite(share, partial, counts)
            with run.alone("write", "finish"):
                if image is not None:
                    run.options.write(image, share.scene)
        counts = replace(counts, seconds=run.clock.seconds, peak_memory_bytes=peak_memory_bytes())
        statistics = FrameStatistics(tuple(run.channel.allgather(counts)), number)
        return Rendered(image, share.scene, statistics, run.start_frame())

    def __enter__(self) -> FrameLoop:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        self._release()
        # After a failure the others may not come to a collective call.
        if kind is None:
            self._close_compositor()

    def _next_share(self, scene: Scene) -> Share:
        """Deal, and bring to the GPU what is not there; a rank without bricks starts no OpenGL."""
        from clusterviz.render.lasting import LastingCaster

        run = self._run
        share = _deal(run, self._opened, scene, self._share)
        plan, tree, dealt = share.plan, share.tree, share.dealt
        if self._opened is None or plan is None or tree is None or dealt is None:
            return share
        caster = self._caster = self._caster or LastingCaster(run.channel.rank)
        stale = caster.is_stale(plan, tree, dealt)
        if not run.channel.maximum(stale):
            return share
        bricks = _load(run, self._opened, share, stale)
        if stale:
            voxels = sum(samples.size for samples in bricks.values())
            self._counts = RankFrame({}, bricks=len(bricks), voxels=voxels)
        with run.together("context", "context"):
            place = run.channel.place()
        with run.alone("context", "context"):
            if bricks:
                caster.open(place.local_rank, run.options.device)
        with run.alone("shaders", "shaders"):
            if bricks:
                caster.compile(plan, tree, dealt)
        with run.alone("upload", "load"):
            if stale:
                caster.load(plan, tree, bricks)
        return share

    def _draw(self, share: Share) -> tuple[PartialImage, RankFrame]:
        """This rank's partial image."""
        run = self._run
        with run.alone("render"):
            began = perf_counter()
            drawn = self._caster.draw(share.plan) if self._caster and share.plan else None
            if self._caster is None or drawn is None:
                return blank(), self._counts
            rendered = run.clock.add_span("render", began, drawn.seconds_render)
            run.clock.add_span("readback", rendered, drawn.seconds_readback)
            counts = replace(self._counts, **self._caster.held, bricks_drawn=drawn.bricks, samples=drawn.samples)
            if not self._several:
                self._release()
            return drawn.partial, counts

    def _composite(self, share: Share, partial: PartialImage, counts: RankFrame) -> tuple[Image | None, RankFrame]:
        """From partial images to the picture on rank 0."""
        run = self._run
        if share.plan is not None and share.plan.look.operator != "over":
            # Projections are not composited: their parts are merged on rank 0, one after the other.
            with run.together("composite", "collect"):
                parts = run.channel.gather(partial)
                return project(share.plan, [parts[rank] for rank in share.order]) if parts else None, counts
        compositor = self._compositor = self._compositor or self._open_compositor(share)
        with run.together("composite"):
            began = perf_counter()
            composed, counters = compositor.composite(partial, share.order)
            # The picture may lie in memory that the next frame changes, or that goes with the compositor.
            image = cast("Image | None", composed if composed is None else composed.copy())
            compositing = {**asdict(counters), "seconds": counters.seconds}
            run.clock.note(*composition_spans(began, perf_counter(), compositing))
            if not self._several:
                self._close_compositor()
        total = counters.total
        run.clock.add("encode", total.seconds_encode)
        run.clock.add("exchange", total.seconds_wait + counters.seconds_agree)
        run.clock.add("blend", total.seconds_blend)
        run.clock.add("collect", counters.seconds_collect)
        if run.options.check:
            self._check(share, partial, image)
        sent = {name: getattr(total, name) for name in ("bytes_raw", "bytes_sent", "messages_sent")}
        return image, replace(counts, **sent, compositing=compositing)

    def _open_compositor(self, share: Share) -> Compositor:
        cluster, size, channel = share.scene.cluster, share.scene.image.size, self._run.channel
        with self._run.together("kernels", "kernels"):
            compile_kernels(channel)
        with self._run.together("composite"):
            # One frame is over before it is learnt which codec pays.
            codec = "raw" if cluster.codec == "auto" and not self._several else cluster.codec
            algorithm, transport = cluster.compositing, cluster.transport
            return Compositor(channel, size, algorithm=algorithm, codec=codec, transport=transport)

    def _close_compositor(self) -> None:
        if self._compositor is not None:
            self._compositor.close()
            self._compositor = None

    def _check(self, share: Share, partial: PartialImage, image: Image | None) -> None:
        """Composite again by the plain serial algorithm; the pictures must agree to rounding."""
        with self._run.together("check", "check"):
            piece, _ = composite(partial, share.order, self._run.channel, "serial", "raw")
            plain = collect(piece, share.scene.image.size, self._run.channel)
        with self._run.alone("check", "check"):
            if image is not None and plain is not None:
                difference = compare(image, plain, CHECK_TOLERANCE)
                if difference.count:
                    name = share.scene.cluster.compositing
                    raise ClustervizError(f"{name} and serial compositing disagree: {difference}")

    def _release(self) -> None:
        if self._caster is not None:
            self._caster.release()
            self._caster = None
