"""Bartlett analysis of 3 × 3 pixels: the triangle [1 2 1] / 4 along each axis around every second pixel.

What: a pass of four fetches. Variance 1/2 of a pixel along each axis.
When to use: with midpoint or cubic synthesis, whose pixels lie alike. When not: moving pictures, since odd and even
pixels have different weights.
Alignment: grid. Reference: Strengert 2010, section 4.1.2, two box filters of opposite shifts, of which the second one
reduces. It counts six fetches; there are five for each pixel of the result, four of the first filter and one of the
second. A single pass needs four.
"""

from clusterviz.image.pyramid.contract import Filter, Pass

BARTLETT_3 = Filter("bartlett 3 x 3", (Pass("reduce", 1.0, spread=0.5),), "grid")
