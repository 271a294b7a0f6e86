"""Drawing of spectral volumes: each piece once for each wavelength."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clusterviz.image.partial import PartialImage
from clusterviz.partition import Piece
from clusterviz.plan.plan import Plan
from clusterviz.plan.spectrum import Spectrum
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
    each, drawn = [plan.at_wavelength(number) for number in range(plan.spectrum.count)], []
    for piece in pieces:
        results = [draw(one, [piece], PartOf(progress, number, len(each)))[0] for number, one in enumerate(each)]
        drawn.append(_joined(plan.spectrum, results))
    return drawn


def _joined(spectrum: Spectrum, drawn: Sequence[RenderResult]) -> RenderResult:
    """Return the results of one piece at all wavelengths as one."""
    rect = drawn[0].partial.rect
    rgba: NDArray[np.float32] = np.stack([one.partial.rgba for one in drawn], axis=1)
    rgba = rgba.reshape(rect.height * len(drawn), rect.width, 4)
    return replace(
        drawn[0],
        partial=PartialImage(spectrum.tall(rect), rgba),
        samples=sum(one.samples for one in drawn),
        seconds_render=sum(one.seconds_render for one in drawn),
        seconds_readback=sum(one.seconds_readback for one in drawn),
        work=np.sum([one.work for one in drawn], axis=0, dtype=np.uint32),
    )
