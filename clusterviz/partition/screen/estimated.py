"""Cost estimation: a coarse pre-pass counts samples, and the screen is cut by what it found.

When to use: the camera jumps, or a single frame is dear: nothing of the last frame is needed. When not: frames follow
each other closely, as the last one then says the same for nothing. The pre-pass draws one ray for `COARSE`² pixels
with slabs `LONGER` times as long, so it takes about one sample for `COARSE`² · `LONGER`; the groups share it, and tell
each other what they counted.

References
----------
B. Moloney, D. Weiskopf, T. Möller, M. Strengert: Scalable sort-first parallel direct volume rendering with dynamic load
balancing, EGPGV 2007; M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart
2010, section 5.2.3, cost estimation.
"""

from __future__ import annotations

from dataclasses import replace

from clusterviz.image.region import Rect
from clusterviz.partition.screen.mosaic import Mosaic
from clusterviz.plan.plan import Plan

COARSE = 4
LONGER = 4


def coarse_plan(plan: Plan, scale: int = COARSE) -> Plan:
    """The plan of the pre-pass: a picture of the same view, `scale` times smaller, with longer slabs.

    The transfer function stays that of short slabs, so transmittance falls to its root only: rays that end early end at
    the root of what may be left.
    """
    view, march = plan.view, plan.march
    width, height = (-(-side // scale) for side in view.size)
    return replace(
        plan,
        view=replace(view, size=(width, height), pixel=view.pixel * scale),
        march=replace(march, step_world=march.step_world * LONGER, residual=march.residual ** (1 / LONGER)),
    )


def coarse_mosaic(mosaic: Mosaic) -> Mosaic:
    """Who draws which part of the pre-pass, where each draws nearly what it sees in the picture itself."""
    width, height = (-(-side // COARSE) for side in mosaic.size)

    def shrunk(edge: int, whole: int, coarse: int) -> int:
        # The borders of the picture are borders, and both pictures have one centre.
        fine = (whole - COARSE * coarse) / 2
        return coarse if edge >= whole else max(0, min(coarse, round((edge - fine) / COARSE))) if edge else 0

    def window(rect: Rect) -> Rect:
        (x, right), (y, bottom) = (
            (shrunk(begin, whole, coarse), shrunk(end, whole, coarse))
            for begin, end, whole, coarse in (
                (rect.x_begin, rect.x_end, mosaic.size[0], width),
                (rect.y_begin, rect.y_end, mosaic.size[1], height),
            )
        )
        return Rect(x, y, right, bottom)

    windows = tuple(
        tuple(small for small in map(window, each) if small.width and small.height) for each in mosaic.windows
    )
    return Mosaic((width, height), windows)
