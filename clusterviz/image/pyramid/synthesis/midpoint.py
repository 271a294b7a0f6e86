"""Midpoint synthesis: pixels stay, and the means of two or four come between them; bilinear in the limit (C⁰).

What: one fetch. When to use: values at pixels must stay. When not: blurring and zooming, for its diamonds.
Alignment: grid. Reference: Strengert 2010, section 4.1.3, figure 4.5.
"""

from clusterviz.image.pyramid.contract import Filter, Pass

MIDPOINT = Filter("midpoint", (Pass("double", -0.5, odd=0.0),), "grid")
