"""Quadratic analysis of 4 × 4 pixels: [1 3 3 1] / 8 along each axis; its limit is the biquadratic B-spline (C¹).

What: a pass of four fetches. Variance 3/4 of a pixel along each axis.
When to use: blurring that is to be near a Gaussian, as all pixels have the same share in the result, and none is moved.
When not: where a third less of time counts more; box 4 × 4 has two fetches.
Alignment: cell. Reference: Strengert 2010, section 4.1.2, a Bartlett filter on the fine image, and a box filter that
reduces: three lookups, as it counts, but two of them for each pixel of the fine image, so nine for each of the result.
A single pass needs four.
"""

from clusterviz.image.pyramid.contract import Filter, Pass

QUADRATIC_4 = Filter("quadratic 4 x 4", (Pass("reduce", 0.5, spread=0.75),))
