"""Drawing of several pictures at once: a spectral volume at each wavelength, or the sub-images of a lens.

Row y of picture n is row y · pictures + n of one tall picture, so that partial images of all are composited together.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from operator import length_hint

import numpy as np

from clusterviz.image.partial import PartialImage, Rect, blank
from clusterviz.partition import Piece
from clusterviz.plan.plan import Plan
from clusterviz.render.passes import Passes
from clusterviz.render.render_result import PartOf, Progress, RenderResult, footprint, no_progress

Draw = Callable[..., list[RenderResult]]
"""`draw` of a ray caster."""


def draw_tall_picture(
    draw: Draw, plan: Plan, pieces: Iterable[Piece], progress: Progress, passes: Passes | None = None
) -> list[RenderResult]:
    """Draw the pieces of all pictures of a plan.

    Parameters
    ----------
    draw : draws the pieces of one picture
    pieces : the iterator advances when a piece is drawn in all pictures
    passes : loads the bricks of the pieces part by part

    Returns
    -------
    drawn : one result for each piece; its partial image is one of the tall picture
    """
    if plan.refraction:
        return _draw_bent(draw, plan, pieces, progress, passes)
    drawn = []
    for piece in pieces:
        each = plan.pictures_of(piece.box.begin_zyx, piece.box.end_zyx) if footprint(plan, piece).pixels else {}
        parts = ((n, one, PartOf(progress, done, len(each))) for done, (n, one) in enumerate(each.items()))
        drawn.append(_tall(plan, ((n, draw(one, [piece], part, passes=passes)[0]) for n, one, part in parts)))
    return drawn


def _draw_bent(
    draw: Draw, plan: Plan, pieces: Iterable[Piece], progress: Progress, passes: Passes | None
) -> list[RenderResult]:
    """Draw pieces whose rays bend: in passes all of them together, so that each loads bricks for all."""
    from clusterviz.render.refraction import Paths, draw_paths

    def on(one: Plan, piece: Piece, paths: Paths) -> RenderResult:
        return draw(one, [piece], no_progress, carried=[paths])[0]

    each = [plan.at_wavelength(number) for number in range(plan.pictures)]
    if passes:
        return [_tall(plan, enumerate(results)) for results in draw_paths(on, each, list(pieces), passes)]
    drawn, count = [], length_hint(pieces)
    for number, piece in enumerate(pieces):
        drawn.append(_tall(plan, enumerate(draw_paths(on, each, [piece], None)[0])))
        PartOf(progress, number, count)(1.0)
    return drawn


def _tall(plan: Plan, results: Iterable[tuple[int, RenderResult]]) -> RenderResult:
    """Return the results of one piece in some pictures, by their numbers, as one, with the tall picture of all."""
    rect, rgba, kept = Rect(0, 0, 0, 0), np.zeros((0, 0, 0, 4), np.float32), list[RenderResult]()
    for number, result in results:
        if not result.partial.rect.pixels:
            continue
        if not kept:
            rect = result.partial.rect
            rgba = np.zeros((rect.height, plan.pictures, rect.width, 4), np.float32)
        rgba[:, number] = result.partial.rgba
        # Without its pixels, which would be kept for all pictures.
        kept.append(replace(result, partial=blank()))
    if not kept:
        return RenderResult(blank())
    return replace(
        kept[0],
        partial=PartialImage(plan.tall(rect), rgba.reshape(-1, rect.width, 4)),
        samples=sum(one.samples for one in kept),
        seconds_render=sum(one.seconds_render for one in kept),
        seconds_readback=sum(one.seconds_readback for one in kept),
        work=np.sum([one.work for one in kept], axis=0, dtype=np.uint32),
        cut_short=sum(one.cut_short for one in kept),
        bytes_read=sum(one.bytes_read for one in kept),
    )
