"""Pictures and partial images: pixels, rectangles, merge operators and files.

partial.py  partial image of one rank, and rectangles of pixels
merge.py    merge operators of partial images
finish.py   conversion to bytes over the background
picture.py  rendered picture as an array that can show and save itself
files.py    picture files: .png, .jpg, .gif, .npy, .exr
movie.py    movie files: .mp4, .gif
replace.py  atomic replacement of output files
compare.py  difference of two pictures
"""

from __future__ import annotations

from clusterviz.image.compare import Difference, compare
from clusterviz.image.files import check_writable, read_image, write_image
from clusterviz.image.finish import finish
from clusterviz.image.partial import EMPTY, PartialImage, Rect, blank

__all__ = [
    "EMPTY",
    "Difference",
    "PartialImage",
    "Rect",
    "blank",
    "check_writable",
    "compare",
    "finish",
    "read_image",
    "write_image",
]
