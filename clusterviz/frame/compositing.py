"""From the partial images of all ranks to the picture on rank 0, and what that cost."""

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
from clusterviz.frame.run import Image, Run
from clusterviz.frame.share import Share
from clusterviz.image.compare import compare
from clusterviz.image.merge import Operator
from clusterviz.image.partial import PartialImage, joined
from clusterviz.render.projection import finish_projection
from clusterviz.report.decisions import Change
from clusterviz.report.statistics import RankFrame
from clusterviz.report.trace import composition_spans

CHECK_TOLERANCE = 1e-5


class Compositing:
    """What composites, from frame to frame; opened by the first one that needs it.

    Parameters
    ----------
    run : of the loop
    several : whether more than one frame may come
    """

    def __init__(self, run: Run, several: bool) -> None:
        self._run, self._several = run, several
        self._compositor: Compositor | None = None
        self._tiles: TileCollector | None = None

    def picture(
        self, share: Share, partials: Sequence[PartialImage], counts: RankFrame
    ) -> tuple[Image | None, RankFrame]:
        """The picture, on rank 0, and this rank's counts with those of compositing; collective."""
        run, pixel = self._run, share.scene.quality.pixel
        if pixel != "float32":
            with run.together("kernels", "kernels"):
                compile_kernels(run.channel)
            with run.clock.stage("encode", "round"):
                partials = [rounded(partial, pixel) for partial in partials]
        if share.mode == "sort-first":
            return self._collected(share, partials, counts)
        if share.mode == "hybrid":
            # The windows of a rank do not overlap, and no rank of its group lies in front in one and behind in another.
            partials = [joined(partials)] if run.channel.rank in share.order else []
        compositor = self._compositor = self._compositor or self._open(share)
        with run.together("composite"):
            began = perf_counter()
            composed, counters = compositor.composite(partials, share.order)
            image = self._finished(share, composed)
            counts = self._counted(began, counters, counts)
            self._tell(share.scene.cluster.compositing, counters)
            if not self._several:
                self.close()
        if run.options.check:
            self._check(share, partials, share.order, image)
        return image, counts

    def _collected(
        self, share: Share, tiles: Sequence[PartialImage], counts: RankFrame
    ) -> tuple[Image | None, RankFrame]:
        """Tiles that do not overlap need no blending, whatever the look."""
        run, channel, codec = self._run, self._run.channel, share.scene.cluster.codec
        with run.together("composite"):
            # One frame is over before it is learnt which codec pays.
            codec = "raw" if codec == "auto" and not self._several else codec
            size, pixel = share.scene.image.size, share.scene.quality.pixel
            if self._tiles is None or self._tiles.pixel != pixel:
                self._tiles = TileCollector(channel, size, codec=codec, pixel=pixel)
            began = perf_counter()
            collected, counters = self._tiles.collect(tiles)
            image = self._finished(share, collected)
            counts = self._counted(began, counters, counts)
        if run.options.check:
            with run.together("check", "check"):
                each = channel.allgather(len(tiles))
            self._check(share, tiles, [rank for rank, count in enumerate(each) for _ in range(count)], image)
        return image, counts

    def _counted(self, began: float, counters: CompositeCounters, counts: RankFrame) -> RankFrame:
        """What compositing cost, in the clock, in the trace and in this rank's counts."""
        clock, total = self._run.clock, counters.total
        compositing = {**asdict(counters), "seconds": counters.seconds}
        clock.note(*composition_spans(began, perf_counter(), compositing))
        clock.add("encode", total.seconds_encode)
        clock.add("exchange", total.seconds_wait + counters.seconds_agree)
        clock.add("blend", total.seconds_blend)
        clock.add("collect", counters.seconds_collect)
        sent = {name: getattr(total, name) for name in ("bytes_raw", "bytes_sent", "messages_sent")}
        return replace(counts, **sent, compositing=compositing)

    def _tell(self, asked: str, counters: CompositeCounters) -> None:
        """Rank 0 warns, once in a run, where another algorithm ran than the one that was asked for."""
        used, run = counters.algorithm, self._run
        if asked in ("auto", used) or counters.transport == "shared" or "compositing" in run.warned:
            return
        run.warned.add("compositing")
        if run.channel.rank == 0:
            reason = "images of other ranks lie between those of a rank"
            warnings.warn(str(Change("cluster.compositing", asked, used, reason)), stacklevel=2)

    def close(self) -> None:
        """Give shared memory back; collective."""
        if self._compositor is not None:
            self._compositor.close()
            self._compositor = None

    def _open(self, share: Share) -> Compositor:
        cluster, size, channel = share.scene.cluster, share.scene.image.size, self._run.channel
        with self._run.together("kernels", "kernels"):
            compile_kernels(channel)
        with self._run.together("composite"):
            # One frame is over before it is learnt which codec pays.
            codec = "raw" if cluster.codec == "auto" and not self._several else cluster.codec
            algorithm, transport = cluster.compositing, cluster.transport
            operator = _operator(share)
            return Compositor(channel, size, algorithm=algorithm, codec=codec, transport=transport, operator=operator)

    def _finished(self, share: Share, composed: NDArray[Any] | None) -> Image | None:
        """The picture of merged pixels, in memory of its own: the compositor's changes with the next frame."""
        if composed is None:
            return None
        if share.plan is None or composed.dtype != np.float32:
            return as_floats(composed)
        with self._run.clock.stage("finish", "project"):
            finished = finish_projection(share.plan, composed)
        return composed.copy() if finished is composed else finished

    def _check(self, share: Share, partials: Sequence[PartialImage], order: Sequence[int], image: Image | None) -> None:
        """Composite again by the plain serial algorithm; the pictures must agree to rounding."""
        with self._run.together("check", "check"):
            channel, pixel = self._run.channel, share.scene.quality.pixel
            piece, _ = composite(partials, order, channel, "serial", "raw", _operator(share))
            plain = self._finished(share, collect(piece, share.scene.image.size, channel))
        with self._run.alone("check", "check"):
            if image is not None and plain is not None:
                bound = 0.0 if pixel == "float32" else rounding_bound(pixel, len(order))
                difference = compare(image, plain, max(CHECK_TOLERANCE, bound))
                if difference.count:
                    name = share.scene.cluster.compositing
                    raise ClustervizError(f"{name} and serial compositing disagree: {difference}")


def _operator(share: Share) -> Operator:
    return share.plan.look.operator if share.plan else "over"
