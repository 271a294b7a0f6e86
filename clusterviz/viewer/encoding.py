"""Encoding of pictures for clients: JPEG while something moves, lossless PNG when it is still.

A PNG holds the bytes that `render` writes for the same picture, with alpha if the background is transparent. A JPEG
has no alpha: over a transparent background it is blended over the mean of the page's checkerboard.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass, field
from threading import Lock
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from clusterviz.errors import ClustervizError, installation
from clusterviz.image.finish import Colour, finish
from clusterviz.viewer.messages import pack

CHECKERBOARD_MEAN: Colour = (0.5, 0.5, 0.5)
PNG_LEVEL = 1
"""Level of zlib; level 6 takes three times as long for pictures that are a sixth smaller."""


@dataclass(frozen=True)
class Encoding:
    """Format of a picture on its way to a client."""

    format: Literal["jpeg", "png"]
    quality: int = 85  # of libjpeg, 1 to 100
    reduction: int = 1  # sides are divided by this number


LOSSLESS = Encoding("png")
LOSSY = (
    Encoding("jpeg", 85),
    Encoding("jpeg", 70),
    Encoding("jpeg", 50),
    Encoding("jpeg", 50, 2),
    Encoding("jpeg", 30, 2),
)
"""Encodings of pictures that move, for ever slower links."""


@dataclass(frozen=True, eq=False)
class Picture:
    """Picture with what a client needs to know of it."""

    rgba: NDArray[np.float32]  # float32 (h, w, 4), premultiplied
    background: Colour | None  # (r, g, b) in [0, 1], or None for transparent
    number: int  # rises from picture to picture
    revision: int
    inputs: Mapping[int, int]  # newest input that it shows, by the number of the client that sent it
    still: bool  # whether it has the scene's full quality
    camera: dict[str, Any]  # position, focal_point, view_up, view_angle and parallel_scale
    seconds: float  # time that it took to draw
    _files: dict[Encoding, bytes] = field(default_factory=dict, init=False, repr=False)
    _lock: Lock = field(default_factory=Lock, init=False, repr=False)

    def message(self, encoding: Encoding, client: int) -> bytes:
        """Return the picture as a binary message to a client; it is encoded once, for all clients and threads."""
        with self._lock:
            if encoding not in self._files:
                self._files[encoding] = encode(self.rgba, self.background, encoding)
        height, width = self.rgba.shape[:2]
        header = {
            "kind": "picture",
            "picture": self.number,
            "revision": self.revision,
            "input": self.inputs.get(client, 0),
            "still": self.still,
            "width": width,
            "height": height,
            "format": encoding.format,
            "camera": self.camera,
            "seconds": self.seconds,
        }
        return pack(header, self._files[encoding])


def encode(rgba: NDArray[np.float32], background: Colour | None, encoding: Encoding) -> bytes:
    """Return a picture as a file.

    `rgba`: float32 (h, w, 4), premultiplied. `background`: (r, g, b) in [0, 1], or None for transparent. Raises
    ClustervizError: the package that encodes JPEGs is missing.
    """
    if encoding.format == "png":
        file = io.BytesIO()
        Image.fromarray(finish(rgba, background)).save(file, format="png", compress_level=PNG_LEVEL)
        return file.getvalue()
    try:
        from simplejpeg import encode_jpeg
    except ImportError:
        raise ClustervizError(f"the viewer needs simplejpeg: {installation('view')}") from None
    pixels = finish(rgba, CHECKERBOARD_MEAN if background is None else background)
    if encoding.reduction > 1:
        pixels = np.asarray(Image.fromarray(pixels).reduce(encoding.reduction))
    found: bytes = encode_jpeg(pixels, quality=encoding.quality, colorsubsampling="420", fastdct=True)
    return found
