"""The outcome of a composition on one rank: the part of the picture that it owns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clusterviz.composite.fragment import Fragment
from clusterviz.image.region import Rect


@dataclass(frozen=True, eq=False)
class Piece:
    """The pixels that one rank owns; those of all ranks make the picture, and none is owned twice.

    Attributes
    ----------
    canvas : the rectangle of the screen on which pixels are numbered; outside it the picture is transparent
    dtype : float32 or uint8, the same on every rank
    fragments : ranges of the canvas with their pixels; none on ranks that own nothing
    """

    canvas: Rect
    dtype: np.dtype[Any]
    fragments: tuple[Fragment, ...]
