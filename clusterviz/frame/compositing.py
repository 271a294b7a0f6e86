"""Compositing of a frame: from the partial images of all ranks to the picture on rank 0, and its costs."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import asdict, replace
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.composite import (
    CompositeCounters,
    Compositor,
    TileCollector,
    as_floats,
    collect,
    compile_kernels,
    composite,
    rounded,
    rounding_bound,
)
from clusterviz.errors import ClustervizError
from clusterviz.frame.run import Image, Rendered, Run
from clusterviz.frame.work import DrawnFrame, RankWork
from clusterviz.image.compare import compare
from clusterviz.image.merge import Operator
from clusterviz.image.partial import PartialImage, joined
from clusterviz.render.render_result import finish_projection
from clusterviz.report.decisions import Change
from clusterviz.report.statistics import FrameStatistics, RankFrame, peak_memory_bytes
from clusterviz.report.trace import composition_spans
from clusterviz.scene.visibility import visibility_warnings

CHECK_TOLERANCE = 1e-5


class Compositing:
    """Compositor of a loop; its buffers are made for the first frame and kept.

    Parameters
    ----------
    run : of the loop
    several : True if more than one frame may come
    """

    def __init__(self, run: Run, several: bool) -> None:
        self._run, self._several = run, several
        self._compositor: Compositor | None = None
        self._tiles: TileCollector | None = None

    def picture(
        self, work: RankWork, partials: Sequence[PartialImage], counts: RankFrame
    ) -> tuple[Image | None, RankFrame]:
        """Return the picture, on rank 0, and this rank's counts with those of compositing; collective."""
        run, pixel = self._run, work.scene.quality.pixel
        if pixel != "float32":
            with run.collective("kernels", "kernels"):
                compile_kernels(run.channel)
            with run.clock.stage("encode", "round"):
                partials = [rounded(partial, pixel) for partial in partials]
        if work.mode == "sort-first":
            return self._collected(work, partials, counts)
        if work.mode == "hybrid":
            # A rank's tiles do not overlap, and the order of its group's ranks is the same in all of them.
            partials = [joined(partials)] if run.channel.rank in work.order else []
        compositor = self._compositor = self._compositor or self._open(work)
        with run.collective("composite"):
            began = perf_counter()
            composed, counters = compositor.composite(partials, work.order)
            image = self._finished(work, composed)
            counts = self._counted(began, counters, counts)
            self._warn_of_change(work.scene.cluster.compositing, counters)
            if not self._several:
                self.close()
        if run.options.check:
            self._check(work, partials, work.order, image)
        return image, counts

    def _collected(
        self, work: RankWork, tiles: Sequence[PartialImage], counts: RankFrame
    ) -> tuple[Image | None, RankFrame]:
        """Collect tiles: they do not overlap, so no blend mode needs blending."""
        run, channel, codec = self._run, self._run.channel, work.scene.cluster.codec
        with run.collective("composite"):
            # A single frame gives no time to measure codecs.
            codec = "raw" if codec == "auto" and not self._several else codec
            size, pixel = work.scene.image.size, work.scene.quality.pixel
            if self._tiles is None or self._tiles.pixel != pixel:
                self._tiles = TileCollector(channel, size, codec=codec, pixel=pixel)
            began = perf_counter()
            collected, counters = self._tiles.collect(tiles)
            image = self._finished(work, collected)
            counts = self._counted(began, counters, counts)
        if run.options.check:
            with run.collective("check", "check"):
                each = channel.allgather(len(tiles))
            self._check(work, tiles, [rank for rank, count in enumerate(each) for _ in range(count)], image)
        return image, counts

    def _counted(self, began: float, counters: CompositeCounters, counts: RankFrame) -> RankFrame:
        """Add the cost of compositing to the clock, the trace and this rank's counts."""
        clock, total = self._run.clock, counters.total
        compositing = {**asdict(counters), "seconds": counters.seconds}
        clock.note(*composition_spans(began, perf_counter(), compositing))
        clock.add("encode", total.seconds_encode)
        clock.add("exchange", total.seconds_wait + counters.seconds_agree)
        clock.add("blend", total.seconds_blend)
        clock.add("collect", counters.seconds_collect)
        sent = {name: getattr(total, name) for name in ("bytes_raw", "bytes_sent", "messages_sent")}
        return replace(counts, **sent, compositing=compositing)

    def _warn_of_change(self, asked: str, counters: CompositeCounters) -> None:
        """Warn on rank 0, once a run, if another algorithm ran than the scene names."""
        used, run = counters.algorithm, self._run
        if asked in ("auto", used) or counters.transport == "shared" or "compositing" in run.warned:
            return
        run.warned.add("compositing")
        if run.channel.rank == 0:
            reason = "images of other ranks lie between those of a rank"
            warnings.warn(str(Change("cluster.compositing", asked, used, reason)), stacklevel=2)

    def close(self) -> None:
        """Free shared memory; collective."""
        if self._compositor is not None:
            self._compositor.close()
            self._compositor = None

    def _open(self, work: RankWork) -> Compositor:
        cluster, size, channel = work.scene.cluster, work.scene.image.size, self._run.channel
        with self._run.collective("kernels", "kernels"):
            compile_kernels(channel)
        with self._run.collective("composite"):
            # A single frame gives no time to measure codecs.
            codec = "raw" if cluster.codec == "auto" and not self._several else cluster.codec
            algorithm, transport = cluster.compositing, cluster.transport
            operator = _operator(work)
            return Compositor(channel, size, algorithm=algorithm, codec=codec, transport=transport, operator=operator)

    def _finished(self, work: RankWork, composed: NDArray[Any] | None) -> Image | None:
        """Finish merged pixels; the result is a copy, since the compositor reuses its memory."""
        if composed is None:
            return None
        if work.plan is None or composed.dtype != np.float32:
            return as_floats(composed)
        with self._run.clock.stage("finish", "project"):
            finished = finish_projection(work.plan, composed)
        return composed.copy() if finished is composed else finished

    def _check(
        self, work: RankWork, partials: Sequence[PartialImage], order: Sequence[int], image: Image | None
    ) -> None:
        """Composite again by the serial algorithm and compare: the pictures must agree to rounding."""
        with self._run.collective("check", "check"):
            channel, pixel = self._run.channel, work.scene.quality.pixel
            piece, _ = composite(partials, order, channel, "serial", "raw", _operator(work))
            expected = self._finished(work, collect(piece, work.scene.image.size, channel))
        with self._run.local("check", "check"):
            if image is not None and expected is not None:
                bound = 0.0 if pixel == "float32" else rounding_bound(pixel, len(order))
                difference = compare(image, expected, max(CHECK_TOLERANCE, bound))
                if difference.count:
                    name = work.scene.cluster.compositing
                    raise ClustervizError(f"{name} and serial compositing disagree: {difference}")


def _operator(work: RankWork) -> Operator:
    return work.plan.blend_mode.operator if work.plan else "over"


def finish_frame(run: Run, compositing: Compositing, drawn: DrawnFrame) -> tuple[Image | None, RankFrame]:
    """Composite a frame, and call `Options.write` with its picture on rank 0; collective."""
    image, counts = compositing.picture(drawn.work, drawn.partials, drawn.counts)
    with run.local("write", "finish"):
        if image is not None:
            run.options.write(image, drawn.work.scene, drawn.number)
    return image, counts


def gather_costs(run: Run, drawn: DrawnFrame, image: Image | None, counts: RankFrame) -> Rendered:
    """Gather the costs of a frame from all ranks, and restart the run's clock; collective.

    Rank 0 warns of volumes that are not visible, once a run for each reason.
    """
    clock = run.start_frame()
    counts = replace(counts, seconds=clock.seconds, peak_memory_bytes=peak_memory_bytes())
    gathered = run.channel.allgather((counts, image is not None and not image[..., 3].any()))
    per_rank, is_blank, scene = tuple(counts for counts, _ in gathered), gathered[0][1], drawn.work.scene
    reasons = visibility_warnings(scene, drawn.infos, is_blank)
    for topic in [topic for topic in reasons if topic not in run.warned]:
        run.warned.add(topic)
        if run.channel.rank == 0:
            warnings.warn(reasons[topic], stacklevel=2)
    remarks = (drawn.changes, tuple(reasons.values()))
    statistics = FrameStatistics(per_rank, drawn.number, drawn.accuracy, drawn.sharing, *remarks)
    kept = drawn if run.options.keep_drawn else None
    return Rendered(image, scene, statistics, tuple(clock.spans or ()), kept)
