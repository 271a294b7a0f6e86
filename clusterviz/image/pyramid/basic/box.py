"""Box filter of 2 × 2 pixels: the mean of a pixel and those right of it, below it, and beyond.

What: mask 1/4 [1 1; 1 1], one fetch. The result is shifted by half a pixel.
When to use: as a part of other filters. When not: alone, for the shift.
Reference: Strengert 2010, section 4.1.1, figure 4.1; it has four variants of opposite shifts.
"""

from clusterviz.image.pyramid.contract import Filter, Pass

BOX = Filter("box", (Pass("keep", 0.5),))
