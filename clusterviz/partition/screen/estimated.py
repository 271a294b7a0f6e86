"""Cost estimation by a coarse pre-pass that counts samples, by which the screen is then cut.

When to use: the camera jumps, or a single frame is expensive; the last frame is not needed. When not: frames that
differ little, for which the last frame gives the same at no cost. The pre-pass draws one ray for `COARSE`² pixels with
slabs `LONGER` times as long, so it takes about one sample for `COARSE`² · `LONGER`. The groups share the pre-pass and
exchange their counts.

Reference: B. Moloney, D. Weiskopf, T. Möller, M. Strengert: Scalable sort-first parallel direct volume rendering with
dynamic load balancing, EGPGV 2007; M. Strengert 2010, section 5.2.3, cost estimation.
"""

from __future__ import annotations

from dataclasses import replace

from clusterviz.image.partial import Rect
from clusterviz.partition.screen.tiles import ScreenPartition
from clusterviz.plan.plan import Plan

COARSE = 4
LONGER = 4


def coarse_plan(plan: Plan, scale: int = COARSE) -> Plan:
    """Return the plan of the pre-pass: a picture of the same view, `scale` times smaller, with longer slabs.

    The transfer function stays that of short slabs, so transmittance falls only to its root; the threshold of early ray
    termination becomes its root, too.
    """
    view, march = plan.view, plan.march
    width, height = (-(-side // scale) for side in view.size)
    return replace(
        plan,
        view=replace(view, size=(width, height), pixel=view.pixel * scale),
        march=replace(march, step_world=march.step_world * LONGER, residual=march.residual ** (1 / LONGER)),
    )


def coarse_partition(partition: ScreenPartition) -> ScreenPartition:
    """Return the partition of the pre-pass, in which each group draws nearly its part of the picture."""
    width, height = (-(-side // COARSE) for side in partition.size)

    def shrunk(edge: int, whole: int, coarse: int) -> int:
        # Borders of the picture stay borders, and both pictures have the same centre.
        fine = (whole - COARSE * coarse) / 2
        return coarse if edge >= whole else max(0, min(coarse, round((edge - fine) / COARSE))) if edge else 0

    def rect(rect: Rect) -> Rect:
        (x, right), (y, bottom) = (
            (shrunk(begin, whole, coarse), shrunk(end, whole, coarse))
            for begin, end, whole, coarse in (
                (rect.x_begin, rect.x_end, partition.size[0], width),
                (rect.y_begin, rect.y_end, partition.size[1], height),
            )
        )
        return Rect(x, y, right, bottom)

    rects = tuple(tuple(small for small in map(rect, each) if small.width and small.height) for each in partition.rects)
    return ScreenPartition((width, height), rects)
