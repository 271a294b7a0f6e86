"""Contract of pyramid filters: a filter is data, a sequence of passes of bilinear fetches.

A pass computes an image from another one. Along each axis, pixel r of the result is fetched at

    2 r + offset       reduce: half as many pixels
    r + offset         keep: as many
    r // 2 + offset    double: twice as many; the offset is another one at odd r

where pixel k of the source lies at k; or it is the mean of the fetches at ± spread beside that place, four in a
picture, eight in a grid. A fetch between pixels interpolates linearly along each axis, so in a picture it is one
bilinear lookup of a GPU, in a grid one trilinear lookup. Beyond the border the nearest pixel counts.

Sizes: n pixels become ⌈n / 2⌉, and these become n again, as the executor crops what is doubled. A pass may have some
`more` pixels along each axis for those that follow. So a filter of several passes is the convolution with its mask at
the border too, and what is clamped is always the image itself.

Alignment: of `cell` filters, pixel k of the coarse image lies in the middle between pixels 2 k and 2 k + 1 of the fine
one, of `grid` filters at pixel 2 k + 1 (even masks have the one, odd masks the other). Analysis and synthesis of one
alignment do not shift a picture. All filters keep constants exactly, and away from the border linear ramps up to
rounding.

To add a filter: a literal `Filter` with its manual in `filters.py`, and its mask in `clusterviz/reference/pyramid.py`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Step = Literal["reduce", "keep", "double"]


@dataclass(frozen=True)
class Pass:
    """One bilinear fetch for each pixel, or the mean of some.

    Attributes
    ----------
    step : how many pixels the result has
    offset : of the fetch, in pixels of the source; of doubling, at even pixels
    odd : of doubling, at odd pixels
    spread : distance of several fetches from that place along each axis; 0: there is one
    more : pixels of the result beyond the size that the image has after the step, along each axis
    """

    step: Step
    offset: float
    odd: float = 0.0
    spread: float = 0.0
    more: int = 0

    def fetches(self, axes: int) -> int:
        """Return the fetches for a pixel of the result."""
        return 2**axes if self.spread else 1


@dataclass(frozen=True)
class Filter:
    """Filter of a pyramid, or of one of its levels.

    Attributes
    ----------
    alignment : of the coarse and the fine pixels; of a basic filter without meaning
    """

    name: str
    passes: tuple[Pass, ...]
    alignment: Literal["cell", "grid"] = "cell"

    def fetches(self, axes: int = 2) -> float:
        """Return fetches for each pixel of the result, of a large image: a pass before a reduction counts 2^axes."""
        count, share = 0.0, 1.0
        for each in reversed(self.passes):
            count += share * each.fetches(axes)
            share *= {"reduce": 2.0**axes, "keep": 1.0, "double": 0.5**axes}[each.step]
        return count
