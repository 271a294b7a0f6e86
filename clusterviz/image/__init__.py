"""The pixel room: what a picture is, where its pieces lie, and how it reaches the disk.

- region.py   rectangles of pixels
- partial.py  what one rank saw
- finish.py   over the background, to bytes
- files.py    .png, .npy and .exr, written whole or not at all
- replace.py  the temporary-name-and-rename behind every output
- compare.py  how far two pictures are apart
"""

from __future__ import annotations

from clusterviz.image.compare import Difference, compare
from clusterviz.image.files import check_writable, read_image, write_image
from clusterviz.image.finish import finish
from clusterviz.image.partial import PartialImage, blank
from clusterviz.image.region import EMPTY, Rect

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
