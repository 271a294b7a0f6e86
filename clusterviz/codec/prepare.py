"""Compiling ahead: numba compiles a function when it is first called, which shall not be within a frame."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from typing import Any

import numpy as np

from clusterviz.codec.contract import Rows
from clusterviz.codec.message import pack, unpack

# Between them they use every kernel.
_CODECS = ("active", "rectangle+delta+shuffle+lz4")


def prepare_codecs(dtypes: Iterable[np.dtype[Any]]) -> None:
    """Compile all that packing and unpacking pixels of these types needs, or load it from numba's cache."""
    for dtype in dtypes:
        _prepare(np.dtype(dtype))


@cache
def _prepare(dtype: np.dtype[Any]) -> None:
    pixels = np.zeros((4096, 4), dtype)
    pixels[1000:2000] = 1
    for codec in _CODECS:
        unpack(pack(pixels, codec, Rows(0, 64)), len(pixels), dtype, Rows(0, 64))
