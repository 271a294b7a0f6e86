"""Cubic analysis of 5 × 5 pixels: [1 4 6 4 1] / 16 along each axis; its limit is the bicubic B-spline (C²).

What: three box filters on the fine image and one that reduces: four lookups, 3 · 4 + 1 fetches for each pixel of the
result. Variance 1 of a pixel along each axis.
When to use: with cubic synthesis, for the smoothest levels. When not: where time counts.
Alignment: grid. Reference: Strengert 2010, section 4.1.2, where the arrows of the shifts cannot all be right: that of
the first box filter is that of the last one.
"""

from clusterviz.image.pyramid.contract import Filter, Pass

CUBIC_5 = Filter(
    "cubic 5 x 5",
    (Pass("keep", -0.5, more=3), Pass("keep", 0.5, more=2), Pass("keep", 0.5, more=1), Pass("reduce", 0.5)),
    "grid",
)
