"""Bartlett filter of 3 × 3 pixels: outer product of the triangle [1 2 1] / 4, with variance 1/2 along each axis.

What: two box filters of opposite shifts, two fetches. By its two axes it would take four.
When to use: slight smoothing, and as a part of other filters. When not: wide smoothing, for which there is `blur`.
Limits: the first pass has one more pixel along each axis.
Reference: Strengert 2010, section 4.1.1, figure 4.2. One of the two equations there has the same shift twice, which
would move the picture by a pixel; the opposite shifts of the other one are meant.
"""

from clusterviz.image.pyramid.contract import Filter, Pass

BARTLETT = Filter("bartlett", (Pass("keep", -0.5, more=1), Pass("keep", 0.5)))
