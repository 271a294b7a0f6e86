"""A frame that all ranks have drawn: composited, written, and what it cost told to all."""

from __future__ import annotations

import warnings
from dataclasses import replace

from clusterviz.frame.compositing import Compositing
from clusterviz.frame.run import Image, Rendered, Run
from clusterviz.frame.share import DrawnFrame
from clusterviz.report.statistics import FrameStatistics, RankFrame, peak_memory_bytes
from clusterviz.scene.visibility import visibility_warnings


def finish_frame(run: Run, compositing: Compositing, drawn: DrawnFrame) -> tuple[Image | None, RankFrame]:
    """The picture, on rank 0, which has been handed to whoever writes it; collective."""
    image, counts = compositing.picture(drawn.share, drawn.partials, drawn.counts)
    with run.alone("write", "finish"):
        if image is not None:
            run.options.write(image, drawn.share.scene, drawn.number)
    return image, counts


def tell_costs(run: Run, drawn: DrawnFrame, image: Image | None, counts: RankFrame) -> Rendered:
    """Bring together what a frame cost, by the run's clock, which begins anew; collective.

    Rank 0 warns of what is not seen, of each thing once in a run.
    """
    clock = run.start_frame()
    counts = replace(counts, seconds=clock.seconds, peak_memory_bytes=peak_memory_bytes())
    told = run.channel.allgather((counts, image is not None and not image[..., 3].any()))
    per_rank, is_blank, scene = tuple(counts for counts, _ in told), told[0][1], drawn.share.scene
    reasons = visibility_warnings(scene, drawn.facts, is_blank)
    for about in [about for about in reasons if about not in run.warned]:
        run.warned.add(about)
        if run.channel.rank == 0:
            warnings.warn(reasons[about], stacklevel=2)
    said = (drawn.changes, tuple(reasons.values()))
    statistics = FrameStatistics(per_rank, drawn.number, drawn.accuracy, drawn.sharing, *said)
    kept = drawn if run.options.keep_drawn else None
    return Rendered(image, scene, statistics, tuple(clock.spans or ()), kept)
