"""Messages and pixels of each compositing round, measured and according to the schedule.

The expected numbers are those of `clusterviz simulate` for the rectangles that the ranks drew. The simulation evaluates
the schedule with whole arrays, independently of the compositor, which runs it rank by rank.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, zip_longest

from clusterviz.composite.fragment import Patch
from clusterviz.composite.schedules.algorithms import make_schedule
from clusterviz.composite.schedules.rectangles import Rectangles
from clusterviz.composite.simulation.simulate import Options, count_load
from clusterviz.composite.simulation.sparse import count_sparse
from clusterviz.image.region import EMPTY, Rect
from clusterviz.report.pages.scale.measure import Measured


@dataclass(frozen=True)
class Round:
    """One round of all ranks, without the final gather.

    Attributes
    ----------
    messages, bytes : counted by the compositor, for raw pixels
    messages_theory, bytes_theory : according to the schedule, for the rectangles of the ranks' images
    """

    messages: int
    messages_theory: int
    bytes: int
    bytes_theory: int

    @property
    def agrees(self) -> bool:
        """Whether the counts equal the expected numbers."""
        return (self.messages, self.bytes) == (self.messages_theory, self.bytes_theory)


def count_rounds(measured: Measured) -> tuple[Round, ...]:
    """Return the rounds of the counted frame; empty for one rank, or for several images of a rank."""
    drawn = [(rank, Rect(*measured.rects[rank])) for rank in measured.order]
    drawn = [(rank, rect) for rank, rect in drawn if rect.pixels]
    if not measured.algorithm or len(drawn) < 2:
        return ()
    theory = _theory(measured.algorithm, [rect for _, rect in drawn])
    ran = [[sum(column) for column in zip(*stage, strict=True)] for stage in _by_stage(measured.counted)]
    size = measured.bytes_per_pixel
    rows = zip_longest(ran, theory, fillvalue=(0, 0))
    return tuple(Round(m, expected, p * size, pixels * size) for (m, p), (expected, pixels) in rows)


def dense_bytes(measured: Measured) -> int:
    """Return the bytes that the algorithm would send if every image covered the canvas, an upper bound."""
    drawn = [Rect(*rect) for rect in measured.rects if Rect(*rect).pixels]
    if not measured.algorithm or len(drawn) < 2:
        return 0
    canvas = canvas_of(drawn)
    load, _ = count_load(measured.algorithm, len(drawn), (canvas.width, canvas.height), "dense", Options())
    return int(load.pixels_sent.sum()) * measured.bytes_per_pixel


def canvas_of(rects: Sequence[Rect]) -> Rect:
    """Return the bounding rectangle."""
    canvas = EMPTY
    for rect in rects:
        canvas = canvas.unite(rect)
    return canvas


def _by_stage(counted: Sequence[Sequence[tuple[int, int]]]) -> list[tuple[tuple[int, int], ...]]:
    """Return the counts by stage, then rank; ranks without pixels take part in no stage."""
    return list(zip_longest(*counted, fillvalue=(0, 0)))


def _theory(algorithm: str, rects: Sequence[Rect]) -> list[tuple[int, int]]:
    """Return messages and pixels of each stage, for images from front to back."""
    canvas = canvas_of(rects)
    x, y = canvas.x_begin, canvas.y_begin
    shifted = [Rect(r.x_begin - x, r.y_begin - y, r.x_end - x, r.y_end - y) for r in rects]
    patches = [Patch(canvas.width, 0, canvas.pixels, rect) for rect in shifted]
    schedule = make_schedule(algorithm, len(patches), canvas.pixels, patches, range(len(patches)))
    footprints = Rectangles.of_patches(patches)
    # Cumulative counts after each stage; a stage's counts are the differences.
    sums = [(0, 0)]
    for count in range(1, len(schedule.stages) + 1):
        load = count_sparse(replace(schedule, stages=schedule.stages[:count]), footprints)
        sums.append((int(load.messages_sent.sum()), int(load.pixels_sent.sum())))
    return [(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(sums)]
