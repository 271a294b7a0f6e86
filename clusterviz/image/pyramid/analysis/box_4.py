"""Box analysis of 4 × 4 pixels: blocks overlap by half, so the limit of reductions is continuous (C⁰).

What: mask 1/16 of ones; a box filter of 2 × 2 pixels that reduces, and one of the opposite shift after it, so two
fetches. Variance 5/4 of a pixel along each axis.
When to use: blurring and scattered data; twice the cost of 2 × 2, without its flicker.
Limits: the first pass has one more pixel along each axis.
Alignment: cell. Reference: Strengert 2010, section 4.1.2. The text there counts four fetches, as a single pass would
need (`Pass("reduce", 0.5, spread=1.0)`), section 4.2.1 two, since the second pass works on the reduced image. Of the
two orders of shifts, the one that begins with the smaller intermediate image moves the picture by a pixel; this is the
other one.
"""

from clusterviz.image.pyramid.contract import Filter, Pass

BOX_4 = Filter("box 4 x 4", (Pass("reduce", -0.5, more=1), Pass("keep", 0.5)))
