"""Cubic synthesis: weights [1 6 1] / 8 at pixels and [1 1] / 2 between them; its limit is the bicubic B-spline (C²).

What: Doo-Sabin synthesis and a box filter on its result, two fetches. Variance 1 of a pixel of the result.
When to use: with grid analysis, for the smoothest pictures. When not: where Doo-Sabin synthesis, at half the cost, is
smooth enough.
Alignment: grid. Reference: Strengert 2010, section 4.1.3.
"""

from clusterviz.image.pyramid.contract import Filter, Pass

CUBIC = Filter("cubic", (Pass("double", -0.25, odd=0.25), Pass("keep", -0.5)), "grid")
