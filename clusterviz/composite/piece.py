"""The outcome of a composition on one rank: the part of the picture that it owns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clusterviz.codec.contract import Pixels
from clusterviz.composite.fragment import Fragment
from clusterviz.image.region import Rect


@dataclass(frozen=True, eq=False)
class Piece:
    """The pixels that one rank owns; those of all ranks make the picture, and none is owned twice.

    Attributes
    ----------
    canvas : the rectangle of the screen on which pixels are numbered, the same on every rank
    dtype : float32, float16 or uint8, the same on every rank
    fragments : ranges of the canvas with their pixels; none on ranks that own nothing
    owners : the channel's ranks that may own something; outside what they own the picture is transparent
    ranges : (owner, begin, end) of all that is owned, ascending, with blank pixels in the fragments too, where all
        ranks know it; None where each owner has to tell
    picture : (height, width, 4), where the transport has left the whole of it on this rank already
    disjoint : whether no fragment reaches where another one lies, so that blank pixels hide nothing
    gathered : whether it has done so on some rank, so that nothing is left to be collected; the same on every rank
    """

    canvas: Rect
    dtype: np.dtype[Any]
    fragments: tuple[Fragment, ...]
    owners: tuple[int, ...]
    ranges: tuple[tuple[int, int, int], ...] | None = None
    disjoint: bool = False
    picture: Pixels | None = None
    gathered: bool = False
