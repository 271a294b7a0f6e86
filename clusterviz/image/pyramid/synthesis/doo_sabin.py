"""Doo-Sabin synthesis: weights 3/4 and 1/4 along each axis; its limit is the biquadratic B-spline (C¹).

What: one fetch, a quarter of a pixel off the nearest one. Variance 3/4 of a pixel of the result along each axis.
When to use: blurring, scattered data and zooming: smooth at the price of one lookup. When not: pixels must keep their
values, as it approximates.
Alignment: cell. Reference: Strengert 2010, section 4.1.3, figure 4.6; Catmull, Clark 1978; Doo, Sabin 1978.
"""

from clusterviz.image.pyramid.contract import Filter, Pass

DOO_SABIN = Filter("doo-sabin", (Pass("double", -0.25, odd=0.25),))
