"""The loop: one frame from a scene to a picture, on all ranks together.

    open -> read a share -> complete the scene -> plan -> partition -> load -> draw -> composite -> collect -> write

Stages are functions from values to values, and only this file calls them. What reads or draws is done alone, and the
ranks agree at its end on whether it failed, so that a failure on one becomes the same failure on all. What talks is
done together: a failure there ends the job, since the others wait for messages that will never come.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm import Channel, abort_on_failure, agree
from clusterviz.composite import Compositor, collect, compile_kernels, composite
from clusterviz.data import open_source
from clusterviz.data.bricks import BrickLayout, read_bricks
from clusterviz.data.source import Index, Source
from clusterviz.data.summary import VolumeSummary, summarise
from clusterviz.errors import ClustervizError
from clusterviz.image.compare import compare
from clusterviz.image.partial import PartialImage, blank
from clusterviz.partition import BspTree, bricks_of, build_tree, front_to_back
from clusterviz.plan.look import margin_of
from clusterviz.plan.plan import Plan, brick_cost, make_plan
from clusterviz.render.projection import project
from clusterviz.report.machine import memory
from clusterviz.report.statistics import STAGES, Clock, FrameStatistics, RankFrame, peak_memory_bytes
from clusterviz.scene.complete import VolumeFacts, complete_scene
from clusterviz.scene.values import Scene

Voxels = NDArray[Any]
Image = NDArray[np.float32]
CHECK_TOLERANCE = 1e-5
HELD_SHARE_OF_MEMORY = 0.4
STEPS = (
    *("open", "read", "summarise", "plan", "load", "context", "shaders", "upload", "render"),
    *("kernels", "composite", "check", "write"),
)
"""What `Options.progress` is told, in this order; a frame may leave some out."""


@dataclass(frozen=True)
class Rendered:
    """A picture and what it cost; the image on rank 0 only.

    Attributes
    ----------
    image : float32 (h, w, 4), premultiplied, before the background; None on ranks other than 0
    scene : the completed scene that was drawn
    statistics : of all ranks, on every rank
    """

    image: Image | None
    scene: Scene
    statistics: FrameStatistics


@dataclass(frozen=True)
class Options:
    """How to run, none of which changes the picture.

    Attributes
    ----------
    device : EGL device index, instead of the round robin over the node's GPUs
    check : composite a second time, serially, and compare
    debug : show the traceback of a failure that ends the job
    progress : called on every rank with the name of each step as it begins
    write : called on rank 0 with the picture and the completed scene; its time counts as "finish"
    """

    device: int | None = None
    check: bool = False
    debug: bool = False
    progress: Callable[[str], None] = lambda step: None
    write: Callable[[Image, Scene], None] = lambda image, scene: None


@dataclass(frozen=True)
class Run:
    """What every stage needs: the channel, the options, and this rank's clock."""

    channel: Channel
    options: Options
    clock: Clock = field(default_factory=lambda: Clock(dict.fromkeys(STAGES, 0.0)))

    @contextmanager
    def alone(self, step: str, stage: str) -> Iterator[None]:
        """A step in which no rank talks; at its end they agree on whether it failed, and do not time the waiting."""
        self.options.progress(step)
        with agree(self.channel, 0, step), self.clock.stage(stage):
            yield

    @contextmanager
    def together(self, step: str, stage: str) -> Iterator[None]:
        """A step in which ranks talk: one that fails ends the job."""
        self.options.progress(step)
        with abort_on_failure(self.channel, 0, step, self.options.debug), self.clock.stage(stage):
            yield


@dataclass(frozen=True)
class Share:
    """What one rank has to draw, and what all ranks know alike.

    Attributes
    ----------
    scene : completed
    plan, tree : None where there is no volume
    order : the ranks from front to back
    bricks : this rank's, by index; emptied as they go to the GPU
    """

    scene: Scene
    plan: Plan | None
    tree: BspTree | None
    order: list[int]
    bricks: dict[Index, Voxels]


def render_frame(
    scene: Scene, channel: Channel, source: Source | None = None, options: Options | None = None
) -> Rendered:
    """Draw one frame; collective.

    Parameters
    ----------
    scene : as given by the user; what it leaves open is chosen from the data
    channel : to the other ranks
    source : the volume's data, instead of the file that the scene names

    Raises
    ------
    RankError, InputError, DeviceError
        The same on every rank.
    """
    run = Run(channel, options or Options())
    with run.clock.stage("total"):
        share = prepare(run, scene, source)
        partial, counts = _draw(run, share)
        image, counts = _composite(run, share, partial, counts)
        with run.alone("write", "finish"):
            if image is not None:
                run.options.write(image, share.scene)
    counts = replace(counts, seconds=run.clock.seconds, peak_memory_bytes=peak_memory_bytes())
    return Rendered(image, share.scene, FrameStatistics(tuple(channel.allgather(counts))))


def prepare(run: Run, scene: Scene, source: Source | None = None) -> Share:
    """Everything before drawing: read the data, complete the scene, plan the frame, deal out the bricks; collective."""
    if not scene.volumes:
        with run.alone("plan", "plan"):
            return Share(complete_scene(scene, ()), None, None, list(range(run.channel.size)), {})
    with run.alone("open", "load"):
        source = source or open_source(scene.volumes[0].path, scene.volumes[0].array)
        layout = BrickLayout(source.grid.shape_zyx, scene.cluster.brick, margin_of(scene.volumes[0]))
    held, summary = _summarise(run, source, layout)
    with run.alone("plan", "plan"):
        completed = complete_scene(scene, _facts(source, summary))
        plan = make_plan(completed, source.grid, source.dtype, layout, summary)
        tree = build_tree(plan.cost, run.channel.size)
        order = _visibility_order(plan, tree)
    with run.alone("load", "load"):
        mine = {_index(i) for i in bricks_of(tree, run.channel.rank, plan.cost)}
        bricks = {index: samples for index, samples in held.items() if index in mine}
        held.clear()
        bricks.update(read_bricks(source, layout, mine - bricks.keys()))
    return Share(completed, plan, tree, order, bricks)


def _summarise(run: Run, source: Source, layout: BrickLayout) -> tuple[dict[Index, Voxels], VolumeSummary]:
    """Read an equal share of the bricks, and learn together what the volume holds; the share is kept for drawing."""
    with run.together("read", "load"):
        most_bytes = HELD_SHARE_OF_MEMORY * memory().available_bytes / run.channel.place().local_size
    with run.alone("read", "load"):
        cells = brick_cost(layout, np.zeros(layout.counts_zyx, bool))
        share = [_index(i) for i in bricks_of(build_tree(cells, run.channel.size), run.channel.rank, cells)]
        fits = len(share) * (layout.brick + 1 + 2 * layout.margin) ** 3 * source.dtype.itemsize <= most_bytes
        held = dict(read_bricks(source, layout, share)) if fits else {}
    with run.together("summarise", "load"):
        # A share larger than the memory is read again for each pass; of it only what is visible is ever held.
        again = (lambda: iter(held.items())) if fits else (lambda: read_bricks(source, layout, share))
        return held, summarise(source.dtype, layout, again, run.channel.allgather)


def _draw(run: Run, share: Share) -> tuple[PartialImage, RankFrame]:
    """Draw this rank's bricks. A rank without any starts no OpenGL."""
    from clusterviz.gl.context import open_context
    from clusterviz.render.raycast import Raycaster

    plan, tree, bricks = share.plan, share.tree, share.bricks
    counts = RankFrame({}, bricks=len(bricks), voxels=sum(samples.size for samples in bricks.values()))
    if plan is None or tree is None:
        return blank(), counts
    with run.together("context", "context"):
        place = run.channel.place()
    with run.alone("context", "context"):
        context = open_context(place.local_rank, run.options.device) if bricks else None
    with run.alone("shaders", "shaders"):
        caster = Raycaster(context, plan, tree.leaves[run.channel.rank].trimmed) if context else None
    with run.alone("upload", "load"):
        if caster:
            caster.load(plan, bricks)
    run.options.progress("render")
    with agree(run.channel, 0, "render"):
        if not caster or not context:
            return blank(), counts
        drawn = caster.draw(plan)
        run.clock.add("render", drawn.seconds_render)
        run.clock.add("readback", drawn.seconds_readback)
        counts = replace(
            counts,
            bricks_drawn=drawn.bricks,
            samples=drawn.samples,
            voxel_bytes=caster.voxel_bytes,
            renderer=caster.renderer,
        )
        caster.release()
        context.release()
        return drawn.partial, counts


def _composite(run: Run, share: Share, partial: PartialImage, counts: RankFrame) -> tuple[Image | None, RankFrame]:
    """From partial images to the picture on rank 0."""
    if share.plan is not None and share.plan.look.operator != "over":
        return _project(run, share, share.plan, partial), counts
    cluster, size, channel = share.scene.cluster, share.scene.image.size, run.channel
    with run.together("kernels", "kernels"):
        compile_kernels(channel)
    run.options.progress("composite")
    with abort_on_failure(channel, 0, "composite", run.options.debug):
        # One frame is over before it is learnt which codec pays.
        codec = "raw" if cluster.codec == "auto" else cluster.codec
        compositor = Compositor(channel, size, algorithm=cluster.compositing, codec=codec, transport=cluster.transport)
        composed, counters = compositor.composite(partial, share.order)
        # The picture may lie in memory that goes with the compositor.
        image = cast("Image | None", composed if composed is None else composed.copy())
        compositor.close()
    total = counters.total
    run.clock.add("encode", total.seconds_encode)
    run.clock.add("exchange", total.seconds_wait + counters.seconds_agree)
    run.clock.add("blend", total.seconds_blend)
    run.clock.add("collect", counters.seconds_collect)
    if run.options.check:
        _check(run, share, partial, image)
    return image, replace(
        counts,
        bytes_raw=total.bytes_raw,
        bytes_sent=total.bytes_sent,
        messages_sent=total.messages_sent,
        compositing={**asdict(counters), "seconds": counters.seconds},
    )


def _project(run: Run, share: Share, plan: Plan, partial: PartialImage) -> Image | None:
    """A picture that is not composited: its parts are merged on rank 0, one after the other."""
    with run.together("composite", "collect"):
        parts = run.channel.gather(partial)
        return project(plan, [parts[rank] for rank in share.order]) if parts is not None else None


def _check(run: Run, share: Share, partial: PartialImage, image: Image | None) -> None:
    """Composite again by the plain serial algorithm; the pictures must agree to rounding."""
    with run.together("check", "check"):
        piece, _ = composite(partial, share.order, run.channel, "serial", "raw")
        plain = collect(piece, share.scene.image.size, run.channel)
    with run.alone("check", "check"):
        if image is not None and plain is not None:
            difference = compare(image, plain, CHECK_TOLERANCE)
            if difference.count:
                name = share.scene.cluster.compositing
                raise ClustervizError(f"{name} and serial compositing disagree: {difference}")


def _visibility_order(plan: Plan, tree: BspTree) -> list[int]:
    """The ranks from front to back."""
    view = plan.view
    return front_to_back(tree, None if view.parallel else view.eye, view.forward, plan.layout.brick)


def _facts(source: Source, summary: VolumeSummary) -> VolumeFacts:
    """What completing a scene needs to know of its volume."""
    grid = source.grid
    low, high = summary.value_range
    percentile_1, percentile_99 = summary.percentile(1.0), summary.percentile(99.0)
    return VolumeFacts(grid.shape_zyx, grid.spacing, grid.corners, low, high, percentile_1, percentile_99)


def _index(row: NDArray[np.int64]) -> Index:
    z, y, x = (int(n) for n in row)
    return z, y, x
