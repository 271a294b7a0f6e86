"""Gaussian-like filters of n × n pixels, n = 3, 5, 7, …: binomial coefficients, with variance (n − 1) / 4.

What: (n − 1) / 2 Bartlett filters one after another, so n − 1 box filters and fetches, of which the first one has all
of the opposite shift; by its two axes it would take 2 n − 2.
When to use: smoothing by about a pixel. When not: wide smoothing, since the cost grows with the square of the standard
deviation; `blur` takes the same for all widths.
Reference: Strengert 2010, section 4.1.1: two Bartlett filters give n = 5.
"""

from clusterviz.errors import InputError
from clusterviz.image.pyramid.contract import Filter, Pass


def gauss(size: int) -> Filter:
    """Return the filter of size × size pixels.

    Raises
    ------
    InputError
        The size is not odd, or not 3 to 63.
    """
    if size not in range(3, 64, 2):
        raise InputError("no such Gaussian filter", where="gauss", found=size, allowed="3, 5, 7, … 63 pixels")
    later = [Pass("keep", 0.5, more=more) for more in reversed(range(size - 2))]
    return Filter(f"gauss {size} x {size}", (Pass("keep", 1 - size / 2, more=size - 2), *later))


GAUSS_5 = gauss(5)
