"""Result of a ray caster, footprint of a piece, progress reports, and the last step from pixels to colours."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from clusterviz.image.merge import EXISTS
from clusterviz.image.partial import PartialImage, Rect
from clusterviz.partition import Piece
from clusterviz.plan.plan import Plan
from clusterviz.report.counts import EarlyDiscarding, FrameCoherence, KBufferCounts, all_counts

SQUARE = 8  # pixels along the side of the squares in which samples are counted
Progress = Callable[[float], None]
"""Progress callback; its argument is the part of the drawing that is done, in [0, 1]."""


def no_progress(done: float) -> None:
    """Ignore progress."""


@dataclass(frozen=True)
class PartOf:
    """Progress callback for one of several equal parts; it reports nothing if their number is unknown (0)."""

    progress: Progress
    number: int
    count: int

    def __call__(self, done: float) -> None:
        """Report the progress of the whole from that of this part."""
        if self.count:
            self.progress(min(1.0, (self.number + done) / self.count))


@dataclass(frozen=True)
class RenderResult:
    """Partial image of one piece, with statistics.

    Attributes
    ----------
    partial : float32, or the format that was asked for; `image/merge.py` defines the four floats for each operator
    samples : number of samples of the field
    bricks : number of bricks drawn
    seconds_render, seconds_readback : time for drawing, and for reading pixels back
    occluded : bricks not drawn, as all rays ended in front of them
    frame_coherence : counts of rays; None without frame coherence
    early_discarding : counts of fragments; None if all are stored
    kbuffer : counts of a k-buffer; None without one
    fragments : int32 (h, w), fragments of meshes, lines and points, or of a k-buffer, at each pixel; (0, 0) without any
    bytes_read : bytes of the picture, and of what is counted beside it, that were read from a GPU
    cut_short : walks through unstructured grids that were ended, as they went in a circle
    work : uint32 (rows, columns), samples in each square of `SQUARE` pixels of the partial image, from its corner
    """

    partial: PartialImage
    samples: int = 0
    bricks: int = 0
    seconds_render: float = 0.0
    seconds_readback: float = 0.0
    work: NDArray[np.uint32] = field(default_factory=lambda: np.zeros((0, 0), np.uint32))
    occluded: int = 0
    frame_coherence: FrameCoherence | None = None
    fragments: NDArray[np.int32] = field(default_factory=lambda: np.zeros((0, 0), np.int32))
    early_discarding: EarlyDiscarding | None = None
    kbuffer: KBufferCounts | None = None
    cut_short: int = 0
    bytes_read: int = 0


def joined_bands(rect: Rect, drawn: Sequence[RenderResult]) -> RenderResult:
    """Return the result of a rectangle that was drawn in bands of whole squares, from top to bottom."""
    parts = ((d.partial.rgba, d.work, d.fragments) for d in drawn)
    rgba, work, fragments = (np.concatenate(part) for part in zip(*parts, strict=True))
    return RenderResult(
        PartialImage(rect, rgba),
        sum(each.samples for each in drawn),
        drawn[0].bricks,
        sum(each.seconds_render for each in drawn),
        sum(each.seconds_readback for each in drawn),
        work,
        fragments=fragments,
        cut_short=sum(each.cut_short for each in drawn),
        kbuffer=all_counts(each.kbuffer for each in drawn),
        bytes_read=sum(each.bytes_read for each in drawn),
    )


def footprint(plan: Plan, piece: Piece) -> Rect:
    """Return the pixels that a piece may cover, within its rectangle of the screen if it has one.

    Rays that bend may come to its bricks from all that is shown.
    """
    begin, end = plan.layout.cells_of(piece.box.begin_zyx, piece.box.end_zyx)
    if plan.refraction:
        begin, end = plan.refraction.begin[::-1], plan.refraction.end[::-1]
    rect = plan.view.footprint(begin[::-1], end[::-1])
    return rect if piece.rect is None else rect.intersect(piece.rect)


Pixels = NDArray[np.float32]


def finish_projection(plan: Plan, merged: Pixels) -> Pixels:
    """Return the picture of merged pixels, by the `resolve` step of the blend mode.

    Scalars get their colour and opacity, not corrected for any length. An average is the mean of opacity × scalar along
    the ray through valid voxels, a sum is that times the length of the ray in opacity unit distances; both are grey and
    opaque, and scalars are clamped to clim, as in VTK. Of spectral volumes it is an
    `Image` in daylight, with the arrays of `SpectralPicture` as its layers.

    Parameters
    ----------
    merged : float32 (h, w, 4), see `image/merge.py`; of several pictures the tall one, see `Plan.tall`

    Returns
    -------
    rgba : float32 (h, w, 4), premultiplied; composited pixels are returned as they are
    """
    resolve = plan.blend_mode.traits.resolve
    if plan.lens is not None:
        from clusterviz.render.lens import depth_of_field

        return depth_of_field(merged, plan.lens)
    if resolve == "none":
        return merged
    if resolve == "light":
        return _in_daylight(plan, merged)
    rgba = np.zeros(merged.shape, np.float32)
    hit = merged[..., 3] > 0
    pixels = merged[hit].astype(np.float64)
    if resolve in ("mean", "integral"):
        grey = pixels[:, 0] * plan.volume.slab_units if resolve == "integral" else pixels[:, 0] / pixels[:, 3]
        rgba[hit] = np.append(np.repeat(np.clip(grey, 0, 1)[:, None], 3, axis=1), np.ones((len(grey), 1)), axis=1)
        return rgba
    units = pixels[:, 0]
    if resolve == "colour of run":
        units = np.where(pixels[:, 2].astype(int) & EXISTS, units, pixels[:, 1])
    low, high = plan.volume.transfer.domain
    scalars = low * (1 - units) + high * units
    alpha = plan.volume.transfer.opacity(scalars)[:, None]
    rgba[hit] = np.append(plan.volume.transfer.colour(scalars) * alpha, alpha, axis=1)
    return rgba


def _in_daylight(plan: Plan, merged: Pixels) -> Pixels:
    """Return the picture of merged fluxes over the background."""
    from clusterviz.image.picture import Image
    from clusterviz.image.spectral import SpectralPicture, illuminant, illuminate

    assert plan.spectrum, "there are wavelengths"
    picture = SpectralPicture.of_pixels(merged, plan.spectrum.wavelengths)
    return Image(illuminate(picture, illuminant("D65"), plan.spectrum.background), layers=picture.layers)
