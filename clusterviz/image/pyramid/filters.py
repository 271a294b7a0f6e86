"""Table of the pyramid's filters, each with its manual.

| | basic | analysis | synthesis |
|---|---|---|---|
| discontinuous | box | box 2 x 2 | nearest |
| C⁰ | bartlett | box 4 x 4, bartlett 3 x 3 | midpoint |
| C¹ | gauss 5 x 5 | quadratic 4 x 4 | doo-sabin |
| C² | | cubic 5 x 5 | cubic |

Basic filters keep the size, analysis halves it, and synthesis doubles it. Variances are along each axis. A first pass
with a pixel `more` serves the passes behind it.

References
----------
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 4.1. Of the
shifts that its figures and formulas give differently, those are taken that do not move a picture. Where it counts more
fetches, several passes were joined to one of four fetches.
"""

from __future__ import annotations

from clusterviz.errors import InputError
from clusterviz.image.pyramid.contract import Filter, Pass

BOX = Filter("box", (Pass("keep", 0.5),))
"""Mean of a pixel and those right of it, below it, and beyond; one fetch, which shifts by half a pixel.

A part of other filters; not for use alone, for the shift. Section 4.1.1, figure 4.1.
"""

BARTLETT = Filter("bartlett", (Pass("keep", -0.5, more=1), Pass("keep", 0.5)))
"""The triangle [1 2 1] / 4 along each axis, with variance 1/2: two box filters of opposite shifts, two fetches.

For slight smoothing, and as a part of other filters; for wide smoothing there is `blur`. Section 4.1.1, figure 4.2.
"""


def gauss(size: int) -> Filter:
    """Return the binomial filter of n × n pixels, n = 3, 5, 7, …, with variance (n − 1) / 4.

    It has (n − 1) / 2 Bartlett filters one after another, so n − 1 box filters and fetches, of which the first one has
    all of the opposite shift. For smoothing by about a pixel: the cost grows with the square of the standard deviation.
    Section 4.1.1: two Bartlett filters give n = 5.

    Raises
    ------
    InputError
        The size is not odd, or not 3 to 63.
    """
    if size not in range(3, 64, 2):
        raise InputError("no such Gaussian filter", where="gauss", found=size, allowed="3, 5, 7, … 63 pixels")
    later = [Pass("keep", 0.5, more=more) for more in reversed(range(size - 2))]
    return Filter(f"gauss {size} x {size}", (Pass("keep", 1 - size / 2, more=size - 2), *later))


BOX_2 = Filter("box 2 x 2", (Pass("reduce", 0.5),))
"""Mean of each block, as in mipmaps, the low pass of the Haar wavelet: one fetch, variance 1/4, cell alignment.

Where speed counts, and where blocks must not mix; not for moving pictures and blurring, as it stays discontinuous after
any number of reductions, and flickers. Section 4.1.2, figure 4.4.
"""

BOX_4 = Filter("box 4 x 4", (Pass("reduce", -0.5, more=1), Pass("keep", 0.5)))
"""Blocks that overlap by half, continuous in the limit: two fetches, variance 5/4, cell alignment.

For blurring and scattered data, at twice the cost of 2 × 2 without its flicker. A single pass would need four fetches.
Section 4.1.2.
"""

BARTLETT_3 = Filter("bartlett 3 x 3", (Pass("reduce", 1.0, spread=0.5),), "grid")
"""The triangle [1 2 1] / 4 around every second pixel: four fetches, variance 1/2, grid alignment.

With midpoint or cubic synthesis, whose pixels lie alike; not for moving pictures, since odd and even pixels have
different weights. Section 4.1.2.
"""

QUADRATIC_4 = Filter("quadratic 4 x 4", (Pass("reduce", 0.5, spread=0.75),))
"""[1 3 3 1] / 8 along each axis, the biquadratic B-spline in the limit: four fetches, variance 3/4, cell alignment.

For blurring near a Gaussian: all pixels have the same share in the result, and none is moved. Section 4.1.2.
"""

CUBIC_5 = Filter(
    "cubic 5 x 5",
    (Pass("keep", -0.5, more=3), Pass("keep", 0.5, more=2), Pass("keep", 0.5, more=1), Pass("reduce", 0.5)),
    "grid",
)
"""[1 4 6 4 1] / 16 along each axis, the bicubic B-spline in the limit: 3 · 4 + 1 fetches, variance 1, grid alignment.

With cubic synthesis, for the smoothest levels; not where time counts. Section 4.1.2.
"""

NEAREST = Filter("nearest", (Pass("double", 0.0, odd=0.0),))
"""Each pixel becomes a block of 2 × 2: one fetch, cell alignment. For labels. Section 4.1.3."""

MIDPOINT = Filter("midpoint", (Pass("double", -0.5, odd=0.0),), "grid")
"""Pixels stay, and means come between them, bilinear in the limit: one fetch, grid alignment.

Where values at pixels must stay; not for blurring and zooming, for its diamonds. Section 4.1.3, figure 4.5.
"""

DOO_SABIN = Filter("doo-sabin", (Pass("double", -0.25, odd=0.25),))
"""Weights 3/4 and 1/4, the biquadratic B-spline in the limit: one fetch, variance 3/4 of the result, cell alignment.

For blurring, scattered data and zooming, smooth at the price of one lookup; it approximates: pixels do not keep their
values. Section 4.1.3, figure 4.6; Catmull, Clark 1978; Doo, Sabin 1978.
"""

CUBIC = Filter("cubic", (Pass("double", -0.25, odd=0.25), Pass("keep", -0.5)), "grid")
"""[1 6 1] / 8 at pixels and [1 1] / 2 between them, the bicubic B-spline in the limit: two fetches, variance 1, grid.

With grid analysis, for the smoothest pictures, at twice the cost of Doo-Sabin synthesis. Section 4.1.3.
"""

BASIC = {each.name: each for each in (BOX, BARTLETT, gauss(5))}
ANALYSIS = {each.name: each for each in (BOX_2, BOX_4, BARTLETT_3, QUADRATIC_4, CUBIC_5)}
SYNTHESIS = {each.name: each for each in (NEAREST, MIDPOINT, DOO_SABIN, CUBIC)}


def find(table: dict[str, Filter], name: str, where: str) -> Filter:
    """Return a filter by its name.

    Raises
    ------
    InputError
        There is none.
    """
    if name not in table:
        raise InputError("no such filter", where=where, found=name, allowed=", ".join(table))
    return table[name]
