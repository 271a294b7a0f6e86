"""Merge operators of partial images: over, and those of projections.

A pixel is four floats. All zeros mean that the part has no sample in the pixel, whatever the operator, so blank pixels
need not be sent. Otherwise they are:

- `over`: premultiplied colour and opacity.
- `maximum`, `minimum`: the scalar, 0, 0, 1.
- `sum`: the sum of opacity × scalar × slabs, 0, 0, and the number of slabs with samples, cut slabs by their share.
- `run`: the largest scalar of the first run of samples at or above a threshold, the largest scalar of all, the
  state of the run (a sum of `STARTS`, `CLOSED`, `EXISTS`), 1.
- `two-flux`: reflectance seen from the front, reflectance seen from behind, transmittance, and a number that is not 0:
  what is not transmitted as it was drawn, 1 as it was merged.

Scalars are in units of clim. All operators are associative, `sum` and `two-flux` up to rounding. `over`, `run` and
`two-flux` need the order from front to back, the others (`ORDER_FREE`) do not. `finish_projection` in
`render/render_result.py` makes the picture from merged pixels.

References
----------
Y. Sato et al.: Local maximum intensity projection (LMIP), Journal of Computer Assisted Tomography 22(6), 1998.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from clusterviz.image.partial import PartialImage

Operator = Literal["over", "maximum", "minimum", "sum", "run", "two-flux"]
Pixels = NDArray[Any]
ORDER_FREE: frozenset[Operator] = frozenset(("maximum", "minimum", "sum"))
STARTS, CLOSED, EXISTS = 1, 2, 4
"""The run includes the part's first sample; a later sample has ended it; there is a run."""


def over(front: Pixels, behind: Pixels) -> Pixels:
    """Porter and Duff's over operator for premultiplied pixels."""
    pixels: Pixels = front + (1 - front[..., 3:]) * behind
    return pixels


def maximum(front: Pixels, behind: Pixels) -> Pixels:
    """Larger scalar, of the parts that have samples."""
    return _where_both(front, behind, np.maximum(front, behind))


def minimum(front: Pixels, behind: Pixels) -> Pixels:
    """Smaller scalar, of the parts that have samples."""
    return _where_both(front, behind, np.minimum(front, behind))


def total(front: Pixels, behind: Pixels) -> Pixels:
    """Sums and numbers of slabs, added."""
    pixels: Pixels = front + behind
    return pixels


def first_run(front: Pixels, behind: Pixels) -> Pixels:
    """First run: that of the front, continued by the part behind if it is open, or else that of the part behind."""
    ahead, after = front[..., 2].astype(int), behind[..., 2].astype(int)
    exists, open_end = ahead & EXISTS > 0, ahead & (EXISTS | CLOSED) == EXISTS
    goes_on = open_end & (after & STARTS > 0)
    pixels = np.maximum(front, behind)
    pixels[..., 0] = np.where(exists, np.where(goes_on, pixels[..., 0], front[..., 0]), behind[..., 0])
    ended = np.where(goes_on, ahead | (after & CLOSED), ahead | CLOSED)
    pixels[..., 2] = np.where(exists, ended, after & ~STARTS)
    return _where_both(front, behind, pixels)


def two_flux(front: Pixels, behind: Pixels) -> Pixels:
    """Fluxes of two stacks of layers, with the light that is reflected between them."""
    from clusterviz.image.spectral.two_flux import Fluxes, stacked

    fluxes = stacked(*(Fluxes(*np.moveaxis(pixels, -1, 0)[:3]) for pixels in (front, behind)))
    return _where_both(front, behind, np.stack([*fluxes, np.ones_like(fluxes.front)], axis=-1))


MERGES: dict[Operator, Callable[[Pixels, Pixels], Pixels]] = {
    "over": over,
    "maximum": maximum,
    "minimum": minimum,
    "sum": total,
    "run": first_run,
    "two-flux": two_flux,
}


def merge_partials(partials: Iterable[PartialImage], size: tuple[int, int], operator: Operator) -> NDArray[np.float32]:
    """Merge partial images, the first in front, into a picture.

    Parameters
    ----------
    size : (width, height) of the picture

    Returns
    -------
    pixels : float32 (h, w, 4)
    """
    pixels = np.zeros((size[1], size[0], 4), np.float32)
    for partial in partials:
        rows, columns = slice(partial.rect.y_begin, partial.rect.y_end), slice(partial.rect.x_begin, partial.rect.x_end)
        pixels[rows, columns] = MERGES[operator](pixels[rows, columns], partial.rgba)
    return pixels


def _where_both(front: Pixels, behind: Pixels, both: Pixels) -> Pixels:
    """Return `both` where each part has samples, else the part that has."""
    merged = np.where(behind[..., 3:] == 0, front, both)
    return np.where(front[..., 3:] == 0, behind, merged)
