"""Nearest synthesis: each pixel becomes a block of 2 × 2; discontinuous.

What: one fetch. When to use: labels. When not: pictures.
Alignment: cell. Reference: Strengert 2010, section 4.1.3.
"""

from clusterviz.image.pyramid.contract import Filter, Pass

NEAREST = Filter("nearest", (Pass("double", 0.0, odd=0.0),))
