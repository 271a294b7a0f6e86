"""Pictures of pages as data URLs: thumbnails, heat maps and magnified errors."""

from __future__ import annotations

import base64
import io
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.image import finish
from clusterviz.scene.background import RGB

WIDTH = 400
MAX_FACTOR = 10.0**7

Bytes = NDArray[np.uint8]


def thumbnail_url(rgba: NDArray[Any], background: RGB | None) -> str:
    """Return a premultiplied picture (h, w, 4) over a background as a PNG data URL, at most `WIDTH` wide."""
    from PIL import Image

    picture = Image.fromarray(finish(np.asarray(rgba, np.float32), background))
    if picture.width > WIDTH:
        picture = picture.resize((WIDTH, max(1, round(picture.height * WIDTH / picture.width))), Image.Resampling.BOX)
    return data_url(picture)


def error_map_url(difference: NDArray[Any]) -> tuple[str, float]:
    """Return a map of each pixel's largest error, from black (0) over red and yellow to white (1 / factor or more).

    Parameters
    ----------
    difference : float (h, w, 4), difference of two pictures

    Returns
    -------
    url : a PNG data URL; a pixel of a reduced map has the largest error of its block
    factor : magnification: 1, 2 or 5 times a power of ten, at most `MAX_FACTOR`; all but 2 % of the wrong pixels are
        below white
    """
    from PIL import Image

    error = _largest_of_blocks(np.abs(difference).max(axis=2))
    wrong = error[error > 0]
    factor = _round_below(1 / float(np.percentile(wrong, 98))) if wrong.size else 1.0
    return data_url(Image.fromarray(heat(np.clip(error * factor, 0, 1)))), factor


def _round_below(value: float) -> float:
    """Round down to 1, 2, 5, 10, 20, …, from 1 to `MAX_FACTOR`."""
    if not 1 < value < MAX_FACTOR:
        return 1.0 if value <= 1 else MAX_FACTOR
    power = 10.0 ** math.floor(math.log10(value))
    return power * max(digit for digit in (1, 2, 5) if digit * power <= value * (1 + 1e-9))


def heat(values: NDArray[np.float64]) -> Bytes:
    """Map (h, w) in [0, 1] to colours (h, w, 3) from black over red and yellow to white."""
    rising = 3 * values[..., None] - np.arange(3)
    colours: Bytes = np.rint(255 * np.clip(rising, 0, 1)).astype(np.uint8)
    return colours


def _largest_of_blocks(error: NDArray[Any]) -> NDArray[np.float64]:
    """Reduce by a whole number with the maximum of each block, so that no wrong pixel is lost."""
    side = -(-error.shape[1] // WIDTH)
    height, width = (-(-length // side) for length in error.shape)
    padded = np.zeros((height * side, width * side))
    padded[: error.shape[0], : error.shape[1]] = error
    blocks: NDArray[np.float64] = padded.reshape(height, side, width, side).max(axis=(1, 3))
    return blocks


def file_url(path: Path) -> str:
    """Return a picture file as a PNG data URL."""
    from PIL import Image

    with Image.open(path) as picture:
        return data_url(picture)


def data_url(picture: Any) -> str:
    data = io.BytesIO()
    picture.save(data, format="png", optimize=True)
    return "data:image/png;base64," + base64.b64encode(data.getvalue()).decode()
