"""A frame that all ranks have drawn: composited, written, and what it cost told to all."""

from __future__ import annotations

from dataclasses import replace

from clusterviz.frame.compositing import Compositing
from clusterviz.frame.run import Image, Rendered, Run
from clusterviz.frame.share import DrawnFrame
from clusterviz.report.statistics import FrameStatistics, RankFrame, peak_memory_bytes


def finish_frame(run: Run, compositing: Compositing, drawn: DrawnFrame) -> tuple[Image | None, RankFrame]:
    """The picture, on rank 0, which has been handed to whoever writes it; collective."""
    image, counts = compositing.picture(drawn.share, drawn.partials, drawn.counts)
    with run.alone("write", "finish"):
        if image is not None:
            run.options.write(image, drawn.share.scene, drawn.number)
    return image, counts


def tell_costs(run: Run, drawn: DrawnFrame, image: Image | None, counts: RankFrame) -> Rendered:
    """Bring together what a frame cost, by the run's clock, which begins anew; collective."""
    clock = run.start_frame()
    counts = replace(counts, seconds=clock.seconds, peak_memory_bytes=peak_memory_bytes())
    per_rank = tuple(run.channel.allgather(counts))
    statistics = FrameStatistics(per_rank, drawn.number, drawn.accuracy, drawn.sharing, drawn.changes)
    kept = drawn if run.options.keep_drawn else None
    return Rendered(image, drawn.share.scene, statistics, tuple(clock.spans or ()), kept)
