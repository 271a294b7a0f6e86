"""Compositing of a frame: from the partial images of all ranks to the picture on rank 0, and its costs.

In a loop, a thread of each rank composites and writes a frame while the next one is drawn. OpenGL stays with the
drawing thread. The compositing thread has its own channel, so that neither waits for the other's messages.
"""

from __future__ import annotations

import threading
import warnings
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from queue import SimpleQueue
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm import Channel
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
from clusterviz.content.visibility import visibility_warnings
from clusterviz.errors import ClustervizError
from clusterviz.frame.run import Image, Run
from clusterviz.frame.work import DrawnFrame, RankWork, Rendered
from clusterviz.image.compare import compare
from clusterviz.image.merge import Operator
from clusterviz.image.partial import PartialImage, joined
from clusterviz.image.picture import Image as Picture
from clusterviz.image.picture import layers_of
from clusterviz.render.crossing import named_layers
from clusterviz.render.render_result import finish_projection
from clusterviz.report.counts import all_counts
from clusterviz.report.decisions import Change
from clusterviz.report.provenance import Provenance
from clusterviz.report.statistics import FrameStatistics, RankFrame, peak_memory_bytes
from clusterviz.report.trace import composition_spans

CHECK_TOLERANCE = 1e-5
ROW = "compositing"
"""Row of the compositing thread in the trace."""


class Compositing:
    """Compositor of a loop; its buffers are made for the first frame and kept, if several frames may come."""

    def __init__(self, several: bool) -> None:
        self._several = several
        self._warned = set[str]()
        self._made_for: object = None
        self._compositor: Compositor | None = None
        self._tiles: TileCollector | None = None

    def for_one_frame(self) -> Compositing:
        """Return a compositor of a single frame, which warns of nothing that this one has warned of."""
        single = Compositing(several=False)
        single._warned = self._warned
        return single

    def picture(
        self, run: Run, work: RankWork, partials: Sequence[PartialImage], counts: RankFrame
    ) -> tuple[Image | None, RankFrame]:
        """Return the picture, on rank 0, and this rank's counts with those of compositing; collective."""
        pixel = work.scene.quality.pixel
        if pixel != "float32":
            with run.collective("kernels", "kernels"):
                compile_kernels(run.channel)
            with run.clock.stage("encode", "round"):
                partials = [rounded(partial, pixel) for partial in partials]
        made_for = _canvas_size(work), _operator(work)
        if made_for != self._made_for:
            self.close()
            self._tiles, self._made_for = None, made_for
        if work.mode == "sort-first":
            return self._collected(run, work, partials, counts)
        if work.mode == "hybrid":
            # A rank's tiles do not overlap, and the order of its group's ranks is the same in all of them.
            partials = [joined(partials)] if run.channel.rank in work.order else []
        compositor = self._compositor = self._compositor or self._open(run, work)
        with run.collective("composite"):
            began = perf_counter()
            composed, counters = compositor.composite(partials, work.order)
            image = _finished(run, work, composed)
            counts = _counted(run, began, counters, counts)
            self._warn_of_change(run, work.scene.cluster.compositing, counters)
            if not self._several:
                self.close()
        if run.options.check:
            _check(run, work, partials, work.order, image)
        return image, counts

    def _layer(self, run: Run, work: RankWork, partials: Sequence[PartialImage]) -> Image | None:
        """Return what ranks found for other layers, on rank 0, composited as the picture is; collective."""
        cluster, size, channel = work.scene.cluster, work.scene.image.size, run.channel
        if work.plan is None:
            return None
        if work.mode == "hybrid":
            partials = [joined(partials)] if channel.rank in work.order else []
        with run.collective("composite", "exchange"):
            if work.mode == "sort-first":
                found, _ = TileCollector(channel, size, codec="raw").collect(partials)
                return None if found is None else as_floats(found)
            algorithm, transport = cluster.compositing, cluster.transport
            compositor = Compositor(channel, size, algorithm=algorithm, codec="raw", transport=transport)
            found, _ = compositor.composite(partials, work.order)
            layer = None if found is None else as_floats(found)
            compositor.close()
            return layer

    def _collected(
        self, run: Run, work: RankWork, tiles: Sequence[PartialImage], counts: RankFrame
    ) -> tuple[Image | None, RankFrame]:
        """Collect tiles: they do not overlap, so no blend mode needs blending."""
        channel, codec = run.channel, work.scene.cluster.codec
        with run.collective("composite"):
            # A single frame gives no time to measure codecs.
            codec = "raw" if codec == "auto" and not self._several else codec
            size, pixel = _canvas_size(work), work.scene.quality.pixel
            if self._tiles is None or self._tiles.pixel != pixel:
                self._tiles = TileCollector(channel, size, codec=codec, pixel=pixel)
            began = perf_counter()
            collected, counters = self._tiles.collect(tiles)
            image = _finished(run, work, collected)
            counts = _counted(run, began, counters, counts)
        if run.options.check:
            with run.collective("check", "check"):
                each = channel.allgather(len(tiles))
            _check(run, work, tiles, [rank for rank, count in enumerate(each) for _ in range(count)], image)
        return image, counts

    def _warn_of_change(self, run: Run, asked: str, counters: CompositeCounters) -> None:
        used = counters.algorithm
        if asked in ("auto", used) or counters.transport == "shared" or "compositing" in self._warned:
            return
        self._warned.add("compositing")
        if run.channel.rank == 0:
            reason = "images of other ranks lie between those of a rank"
            warnings.warn(str(Change("cluster.compositing", asked, used, reason)), stacklevel=2)

    def finish(self, run: Run, drawn: DrawnFrame) -> tuple[Image | None, RankFrame]:
        """Composite a frame, and call `Options.write` with its picture on rank 0; collective."""
        image, counts = self.picture(run, drawn.work, drawn.partials, drawn.counts)
        return self.write(run, drawn, image), counts

    def write(self, run: Run, drawn: DrawnFrame, image: Image | None) -> Image | None:
        """Return the picture of a frame with what is not composited, after `Options.write` was called with it."""
        if image is not None and drawn.painted is not None:
            image += drawn.painted
        if names := drawn.work.scene.image.layers:
            where, normals = (self._layer(run, drawn.work, [each[n] for each in drawn.layers]) for n in (0, 1))
            if image is not None:
                image = Picture(image, layers=named_layers(names, image, where, normals))
        with run.local("write", "finish"):
            if image is not None and run.options.annotate:
                image = _annotated(image, drawn)
            if image is not None:
                run.options.write(image, drawn.work.scene, _provenance(run, drawn))
        return image

    def gather(self, run: Run, drawn: DrawnFrame, image: Image | None, counts: RankFrame) -> Rendered:
        """Gather the costs of a finished frame from all ranks; collective.

        Rank 0 warns of volumes that are not visible, once a run for each reason.
        """
        clock, work = run.clock, drawn.work
        counts = replace(counts, seconds=clock.seconds, peak_memory_bytes=peak_memory_bytes())
        gathered = run.channel.allgather((counts, image is not None and not image[..., 3].any()))
        per_rank, is_blank = tuple(counts for counts, _ in gathered), gathered[0][1]
        # What may be wrong with the picture, in a sentence for each topic.
        reasons = visibility_warnings(work.scene, drawn.infos, is_blank)
        kbuffer = all_counts(rank.kbuffer for rank in per_rank)
        if kbuffer and kbuffer.wrong_pixels:
            reasons["grids[0].visibility"] = f"grids[0].visibility: {kbuffer}"
        cut_short, bends = sum(rank.cut_short for rank in per_rank), work.plan is not None and work.plan.refraction
        if bends and (passes := max(rank.passes for rank in per_rank)):
            reasons["refraction"] = (
                f"volumes[0].optics: not all bricks fit into a rank's memory, and rays that bend may need any, so that "
                f"they are loaded in up to {passes} passes; cluster.memory_limit says how much a rank may hold"
            )
        if bends and cut_short:
            reasons["cut short"] = (
                f"volumes[0].optics: {cut_short} rays were cut short, as they did not leave the volume; no light "
                "passes there"
            )
        elif cut_short:
            reasons["cut short"] = (
                f"grids: {cut_short} walks of rays were cut short, as they went in circles through cells thinner than "
                "float32 resolves; pixels may miss cells behind"
            )
        # Each topic is told once in a run.
        for topic in [topic for topic in reasons if topic not in self._warned]:
            self._warned.add(topic)
            if run.channel.rank == 0:
                warnings.warn(reasons[topic], stacklevel=2)
        remarks = (drawn.changes, tuple(reasons.values()), work.plan.detail if work.plan else ())
        flows = tuple(one.summary for one in drawn.infos if one.summary)
        statistics = FrameStatistics(per_rank, drawn.number, work.accuracy, work.sharing, *remarks, flows)
        kept = drawn if run.options.keep_drawn else None
        return Rendered(image, work.scene, statistics, tuple(clock.spans or ()), kept)

    def close(self) -> None:
        """Free shared memory; collective."""
        if self._compositor is not None:
            self._compositor.close()
            self._compositor = None

    def _open(self, run: Run, work: RankWork) -> Compositor:
        cluster, size, channel = work.scene.cluster, _canvas_size(work), run.channel
        with run.collective("kernels", "kernels"):
            compile_kernels(channel)
        with run.collective("composite"):
            # A single frame gives no time to measure codecs.
            codec = "raw" if cluster.codec == "auto" and not self._several else cluster.codec
            algorithm, transport = cluster.compositing, cluster.transport
            operator = _operator(work)
            return Compositor(channel, size, algorithm=algorithm, codec=codec, transport=transport, operator=operator)


def _counted(run: Run, began: float, counters: CompositeCounters, counts: RankFrame) -> RankFrame:
    """Add the cost of compositing to the clock, the trace and this rank's counts."""
    clock, total = run.clock, counters.total
    compositing = {**asdict(counters), "seconds": counters.seconds}
    clock.note(*composition_spans(began, perf_counter(), compositing))
    clock.add("encode", total.seconds_encode)
    clock.add("exchange", total.seconds_wait + counters.seconds_agree)
    clock.add("blend", total.seconds_blend)
    clock.add("collect", counters.seconds_collect)
    sent = {name: getattr(total, name) for name in ("bytes_raw", "bytes_sent", "messages_sent")}
    return replace(counts, **sent, compositing=compositing)


def _finished(run: Run, work: RankWork, composed: NDArray[Any] | None) -> Image | None:
    """Finish merged pixels; the result is a copy, since the compositor reuses its memory."""
    if composed is None:
        return None
    if work.plan is None or (composed.dtype != np.float32 and not work.plan.lens):
        return as_floats(composed)
    with run.clock.stage("finish", "project"):
        pixels = as_floats(composed) if work.plan.lens else composed
        finished = finish_projection(work.plan, pixels)
    return composed.copy() if finished is composed else finished


def _annotated(image: Image, drawn: DrawnFrame) -> Image:
    if drawn.work.scene.annotations.is_empty:
        return image
    from clusterviz.annotations import annotated

    found = annotated(np.asarray(image), drawn.work.scene, drawn.infos)
    return Picture(found, layers=layers_of(image)) if isinstance(image, Picture) else found


def _check(
    run: Run, work: RankWork, partials: Sequence[PartialImage], order: Sequence[int], image: Image | None
) -> None:
    """Composite again by the serial algorithm and compare: the pictures must agree to rounding."""
    with run.collective("check", "check"):
        channel, pixel = run.channel, work.scene.quality.pixel
        piece, _ = composite(partials, order, channel, "serial", "raw", _operator(work))
        expected = _finished(run, work, collect(piece, _canvas_size(work), channel))
    with run.local("check", "check"):
        if image is not None and expected is not None:
            bound = 0.0 if pixel == "float32" else rounding_bound(pixel, len(order))
            difference = compare(image, expected, max(CHECK_TOLERANCE, bound))
            if difference.count:
                name = work.scene.cluster.compositing
                raise ClustervizError(f"{name} and serial compositing disagree: {difference}")


def _provenance(run: Run, drawn: DrawnFrame) -> Provenance:
    work, counts = drawn.work, drawn.counts
    rounding = rounding_bound(work.scene.quality.pixel, max(1, len(work.order)))
    detail = work.plan.detail if work.plan else ()
    device = counts.renderer, counts.driver
    return Provenance(drawn.number, run.channel.size, *device, rounding, work.accuracy, detail)


def _operator(work: RankWork) -> Operator:
    return work.plan.blend_mode.operator if work.plan else "over"


def _canvas_size(work: RankWork) -> tuple[int, int]:
    return work.plan.canvas_size if work.plan else work.scene.image.size


class AsyncCompositing:
    """Compositing thread of this rank, which holds at most one frame.

    All ranks learn of a failure when they take that frame. A failure in the thread of a single rank ends the job. Only
    this thread uses the channel.
    """

    def __init__(self, channel: Channel) -> None:
        self._channel = channel
        self._compositing = Compositing(several=True)
        self._given: SimpleQueue[tuple[Run, DrawnFrame] | None] = SimpleQueue()
        self._done: SimpleQueue[Rendered | BaseException] = SimpleQueue()
        self._is_busy = False
        # A daemon: a program that ends for another reason does not wait for it.
        self._thread = threading.Thread(target=self._work, name=ROW, daemon=True)
        self._thread.start()

    def put(self, run: Run, drawn: DrawnFrame) -> None:
        """Composite and write a frame, whose clock goes on there; the frame before must have been taken."""
        self._given.put((Run(self._channel, run.options, drawn.number, run.clock), drawn))
        self._is_busy = True

    def take(self) -> Rendered | None:
        """Wait for the frame that was put last, and raise its error, if any; None if there is no such frame."""
        if not self._is_busy:
            return None
        done, self._is_busy = self._done.get(), False
        if isinstance(done, BaseException):
            raise done
        return done

    def __enter__(self) -> AsyncCompositing:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None and not issubclass(kind, Exception):
            return
        # A frame that all ranks have drawn is written even if the next one failed.
        with suppress(Exception):
            self.take()
        self._given.put(None)
        self._thread.join()
        if kind is None:
            self._compositing.close()

    def _work(self) -> None:
        while (given := self._given.get()) is not None:
            try:
                self._done.put(self._finish(*given))
            except BaseException as error:
                self._done.put(error)

    def _finish(self, run: Run, drawn: DrawnFrame) -> Rendered:
        run.clock.row = ROW
        with run.clock.stage("total", f"frame {drawn.number}"):
            image, counts = self._compositing.finish(run, drawn)
        return self._compositing.gather(run, drawn, image, counts)


def open_async_compositing(run: Run) -> AsyncCompositing | None:
    """Start the compositing thread; None if the options exclude it or some rank cannot have one; collective."""
    channel = run.channel.for_thread() if run.options.overlap else None
    return AsyncCompositing(channel) if channel is not None else None
