"""Drawing of spectral volumes: each piece once for each wavelength."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from operator import length_hint

import numpy as np

from clusterviz.image.partial import PartialImage, blank
from clusterviz.partition import Piece
from clusterviz.plan.plan import Plan
from clusterviz.render.passes import Passes
from clusterviz.render.render_result import PartOf, Progress, RenderResult, no_progress

Draw = Callable[..., list[RenderResult]]
"""`draw` of a ray caster."""


def draw_wavelengths(
    draw: Draw, plan: Plan, pieces: Iterable[Piece], progress: Progress, passes: Passes | None = None
) -> list[RenderResult]:
    """Draw pieces at all wavelengths of a plan.

    Parameters
    ----------
    draw : draws pieces at the wavelength of a plan that has one
    pieces : the iterator advances when a piece is drawn at all wavelengths
    passes : loads the bricks of the pieces part by part
    """
    if plan.refraction:
        return _draw_bent(draw, plan, pieces, progress, passes)
    count, drawn = plan.wavelengths, []
    for piece in pieces:
        each = ((plan.at_wavelength(number), PartOf(progress, number, count)) for number in range(count))
        drawn.append(_tall(plan, (draw(one, [piece], part, passes=passes)[0] for one, part in each)))
    return drawn


def _draw_bent(
    draw: Draw, plan: Plan, pieces: Iterable[Piece], progress: Progress, passes: Passes | None
) -> list[RenderResult]:
    """Draw pieces whose rays bend: in passes all of them together, so that each loads bricks for all."""
    from clusterviz.render.refraction import Paths, draw_paths

    def on(one: Plan, piece: Piece, paths: Paths) -> RenderResult:
        return draw(one, [piece], no_progress, crossings=[paths])[0]

    each = [plan.at_wavelength(number) for number in range(plan.wavelengths)]
    if passes:
        return [_tall(plan, iter(results)) for results in draw_paths(on, each, list(pieces), passes)]
    drawn, count = [], length_hint(pieces)
    for number, piece in enumerate(pieces):
        drawn.append(_tall(plan, iter(draw_paths(on, each, [piece], None)[0])))
        PartOf(progress, number, count)(1.0)
    return drawn


def _tall(plan: Plan, results: Iterator[RenderResult]) -> RenderResult:
    """Return the results of a piece at each wavelength as one, with the tall picture of all."""
    assert plan.spectrum, "there are wavelengths"
    kept, count = list[RenderResult](), plan.wavelengths
    for number, result in enumerate(results):
        rect = result.partial.rect
        if number == 0:
            rgba = np.empty((rect.height, count, rect.width, 4), np.float32)
        rgba[:, number] = result.partial.rgba
        # Without its pixels, which would be kept for all wavelengths.
        kept.append(replace(result, partial=blank()))
    partial = PartialImage(plan.spectrum.tall(rect), rgba.reshape(rect.height * count, rect.width, 4))
    return replace(
        kept[0],
        partial=partial,
        samples=sum(one.samples for one in kept),
        seconds_render=sum(one.seconds_render for one in kept),
        seconds_readback=sum(one.seconds_readback for one in kept),
        cut_short=sum(one.cut_short for one in kept),
        work=np.sum([one.work for one in kept], axis=0, dtype=np.uint32),
    )
