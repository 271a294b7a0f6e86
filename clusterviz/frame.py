"""The loop: one frame from a scene to a picture, on all ranks together.

    open -> read a share -> complete the scene -> plan -> partition -> load -> draw -> composite -> collect

Stages are functions from values to values, and only this file calls them. What reads or draws runs under `agree`, so that a
failure on one rank becomes the same failure on all; what talks runs between.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm import Channel, agree
from clusterviz.composite import collect, compile_kernels, composite
from clusterviz.data import open_source
from clusterviz.data.bricks import BrickLayout, read_bricks
from clusterviz.data.source import Index, Source
from clusterviz.data.summary import VolumeSummary, summarise
from clusterviz.errors import ClustervizError
from clusterviz.image.compare import compare
from clusterviz.image.partial import PartialImage, blank
from clusterviz.partition import BspTree, bricks_of, build_tree, front_to_back
from clusterviz.plan.plan import Plan, brick_cost, make_plan
from clusterviz.report.statistics import Clock, FrameStatistics, RankFrame, peak_memory_bytes
from clusterviz.scene.complete import VolumeFacts, complete_scene
from clusterviz.scene.values import Scene

Voxels = NDArray[Any]
Image = NDArray[np.float32]
Progress = Callable[[str], None]
CHECK_TOLERANCE = 1e-5


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
    progress : called on every rank with the name of each stage as it begins
    """

    device: int | None = None
    check: bool = False
    progress: Progress = lambda stage: None


def render_frame(scene: Scene, channel: Channel, source: Source | None = None, options: Options | None = None) -> Rendered:
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
    run = _Run(channel, options or Options())
    with run.clock.stage("total"):
        if scene.volumes:
            completed, partial, order, counts = _draw_volume(run, scene, source)
        else:
            completed, partial, order, counts = complete_scene(scene, ()), blank(), list(range(channel.size)), RankFrame({})
        image, counts = _composite(run, completed, partial, order, counts)
    counts = replace(counts, seconds=run.clock.seconds, peak_memory_bytes=peak_memory_bytes())
    return Rendered(image, completed, FrameStatistics(tuple(channel.allgather(counts))))


@dataclass(frozen=True)
class _Run:
    """What every stage of a run needs: the channel, the options, and this rank's clock."""

    channel: Channel
    options: Options
    clock: Clock

    def __init__(self, channel: Channel, options: Options) -> None:
        object.__setattr__(self, "channel", channel)
        object.__setattr__(self, "options", options)
        object.__setattr__(self, "clock", Clock())

    @contextmanager
    def stage(self, name: str, agreed: str = "") -> Iterator[None]:
        """One stage, timed; with `agreed`, the ranks agree on whether it failed."""
        self.options.progress(agreed or name)
        with self.clock.stage(name):
            if agreed:
                with agree(self.channel, 0, agreed):
                    yield
            else:
                yield


def _draw_volume(run: _Run, scene: Scene, source: Source | None) -> tuple[Scene, PartialImage, list[int], RankFrame]:
    """From the scene to this rank's partial image, with the ranks from front to back and this rank's counts."""
    rank = run.channel.rank
    with run.stage("load", "open"):
        source = source or open_source(scene.volumes[0].path, scene.volumes[0].array)
        layout = BrickLayout(source.grid.shape_zyx, scene.cluster.brick)
    held, summary = _summarise(run, source, layout)
    with run.stage("plan", "plan"):
        completed = complete_scene(scene, _facts(source, summary))
        plan = make_plan(completed, source.grid, source.dtype, layout, summary)
        tree = build_tree(plan.cost, run.channel.size)
        order = _visibility_order(plan, tree)
    with run.stage("load", "load"):
        mine = {_index(i) for i in bricks_of(tree, rank, plan.cost)}
        bricks = {index: samples for index, samples in held.items() if index in mine}
        held.clear()
        bricks.update(read_bricks(source, layout, mine - bricks.keys()))
    partial, counts = _render(run, plan, tree, bricks)
    return completed, partial, order, counts


def _summarise(run: _Run, source: Source, layout: BrickLayout) -> tuple[dict[Index, Voxels], VolumeSummary]:
    """Read an equal share of the bricks, and learn together what the volume holds; the share is kept for drawing."""
    cells = brick_cost(layout, np.zeros(layout.counts_zyx, bool))
    share = [_index(i) for i in bricks_of(build_tree(cells, run.channel.size), run.channel.rank, cells)]
    with run.stage("load", "read"):
        held = dict(read_bricks(source, layout, share))
    with run.stage("load"):
        return held, summarise(source.dtype, layout, lambda: iter(held.items()), run.channel.allgather)


def _render(
    run: _Run, plan: Plan, tree: BspTree, bricks: dict[Index, Voxels]
) -> tuple[PartialImage, RankFrame]:
    """Draw this rank's bricks. A rank without any starts no OpenGL."""
    from clusterviz.gl.context import open_context
    from clusterviz.render.raycast import Raycaster

    counts = RankFrame({}, bricks=len(bricks), voxels=sum(samples.size for samples in bricks.values()))
    partial = blank()
    place = run.channel.place()
    caster = None
    with run.stage("context", "context"):
        context = open_context(place.local_rank, run.options.device) if bricks else None
    with run.stage("shaders", "shaders"):
        if context:
            caster = Raycaster(context, plan, tree.leaves[run.channel.rank].trimmed)
    with run.stage("load", "upload"):
        if caster:
            caster.load(plan, bricks)
            bricks.clear()
    run.options.progress("render")
    with agree(run.channel, 0, "render"):
        if caster and context:
            drawn = caster.draw(plan)
            partial = drawn.partial
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
    return partial, counts


def _composite(
    run: _Run, scene: Scene, partial: PartialImage, order: list[int], counts: RankFrame
) -> tuple[Image | None, RankFrame]:
    """From partial images to the picture on rank 0."""
    cluster, size, channel = scene.cluster, scene.image.size, run.channel
    with run.stage("kernels"):
        compile_kernels(channel)
    run.options.progress("composite")
    piece, counters = composite(partial, order, channel, cluster.compositing, cluster.codec)
    total = counters.total
    run.clock.add("encode", total.seconds_encode)
    run.clock.add("exchange", total.seconds_wait + counters.seconds_agree)
    run.clock.add("blend", total.seconds_blend)
    with run.stage("collect"):
        image = collect(piece, size, channel)
    if run.options.check:
        _check(run, scene, partial, order, image)
    counts = replace(
        counts, bytes_raw=total.bytes_raw, bytes_sent=total.bytes_sent, messages_sent=total.messages_sent
    )
    return image, counts  # type: ignore[return-value]


def _check(run: _Run, scene: Scene, partial: PartialImage, order: list[int], image: Any) -> None:
    """Composite again by the plain serial algorithm; the pictures must agree to rounding."""
    piece, _ = composite(partial, order, run.channel, "serial", "raw")
    plain = collect(piece, scene.image.size, run.channel)
    with run.stage("check", "check"):
        if image is not None and plain is not None:
            difference = compare(image, plain, CHECK_TOLERANCE)
            if difference.count:
                raise ClustervizError(f"{scene.cluster.compositing} and serial compositing disagree: {difference}")


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
