"""Drawing of several pictures at once: a spectral volume at each wavelength, or the sub-images of a lens.

Row y of picture n is row y · pictures + n of one tall picture, so that partial images of all are composited together.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from clusterviz.image.partial import PartialImage, blank
from clusterviz.partition import Piece
from clusterviz.plan.plan import Plan
from clusterviz.render.render_result import PartOf, Progress, RenderResult, footprint

Draw = Callable[[Plan, Sequence[Piece], Progress], list[RenderResult]]


def draw_tall_picture(draw: Draw, plan: Plan, pieces: Iterable[Piece], progress: Progress) -> list[RenderResult]:
    """Draw the pieces of all pictures of a plan.

    Parameters
    ----------
    draw : draws the pieces of one picture
    pieces : the iterator advances when a piece is drawn in all pictures

    Returns
    -------
    drawn : one result for each piece; its partial image is one of the tall picture
    """
    drawn = []
    for piece in pieces:
        rect, results = footprint(plan, piece), list[RenderResult]()
        each = plan.pictures_of(piece.box.begin_zyx, piece.box.end_zyx) if rect.pixels else {}
        rgba = np.zeros((rect.height if each else 0, plan.pictures, rect.width, 4), np.float32)
        for done, (number, one) in enumerate(each.items()):
            result = draw(one, [piece], PartOf(progress, done, len(each)))[0]
            if result.partial.rect.pixels:
                rgba[:, number] = result.partial.rgba
            # Without its pixels, which would be kept for all pictures.
            results.append(replace(result, partial=blank()))
        if not any(result.bricks for result in results):
            drawn.append(RenderResult(blank()))
            continue
        tall = PartialImage(plan.tall(rect), rgba.reshape(-1, rect.width, 4))
        drawn.append(_joined(results, tall))
    return drawn


def _joined(drawn: Sequence[RenderResult], partial: PartialImage) -> RenderResult:
    """Return the results of one piece in all pictures as one."""
    shown = [one for one in drawn if one.bricks]
    return replace(
        shown[0],
        partial=partial,
        samples=sum(one.samples for one in shown),
        seconds_render=sum(one.seconds_render for one in shown),
        seconds_readback=sum(one.seconds_readback for one in shown),
        work=np.sum([one.work for one in shown], axis=0, dtype=np.uint32),
        cut_short=sum(one.cut_short for one in shown),
    )
