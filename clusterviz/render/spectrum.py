"""Drawing of spectral volumes: each piece once for each wavelength."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from clusterviz.image.partial import PartialImage, blank
from clusterviz.partition import Piece
from clusterviz.plan.plan import Plan
from clusterviz.render.render_result import PartOf, Progress, RenderResult

Draw = Callable[[Plan, Sequence[Piece], Progress], list[RenderResult]]


def draw_wavelengths(draw: Draw, plan: Plan, pieces: Iterable[Piece], progress: Progress) -> list[RenderResult]:
    """Draw pieces at all wavelengths of a plan.

    Parameters
    ----------
    draw : draws pieces at the wavelength of a plan that has one
    pieces : the iterator advances when a piece is drawn at all wavelengths

    Returns
    -------
    drawn : one result for each piece; its partial image is one of the tall picture, see `plan/spectrum.py`
    """
    assert plan.spectrum, "there are wavelengths"
    each, drawn = [plan.at_wavelength(number) for number in range(plan.wavelengths)], []
    for piece in pieces:
        results = list[RenderResult]()
        for number, one in enumerate(each):
            result = draw(one, [piece], PartOf(progress, number, len(each)))[0]
            rect = result.partial.rect
            if number == 0:
                rgba = np.empty((rect.height, len(each), rect.width, 4), np.float32)
            rgba[:, number] = result.partial.rgba
            # Without its pixels, which would be kept for all wavelengths.
            results.append(replace(result, partial=blank()))
        tall = PartialImage(plan.spectrum.tall(rect), rgba.reshape(rect.height * len(each), rect.width, 4))
        drawn.append(_joined(results, tall))
    return drawn


def _joined(drawn: Sequence[RenderResult], partial: PartialImage) -> RenderResult:
    """Return the results of one piece at all wavelengths as one."""
    return replace(
        drawn[0],
        partial=partial,
        samples=sum(one.samples for one in drawn),
        seconds_render=sum(one.seconds_render for one in drawn),
        seconds_readback=sum(one.seconds_readback for one in drawn),
        work=np.sum([one.work for one in drawn], axis=0, dtype=np.uint32),
    )
