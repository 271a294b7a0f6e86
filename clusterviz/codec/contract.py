"""What a stage of a codec is: one of three kinds, each a pair of exact inverses.

A *selection* drops blank pixels: it says in which runs of the message the others lie, and codes the runs as a table. A
*filter* rearranges the bytes of the pixels without changing their number, so that a squeeze finds more in them. A
*squeeze* makes bytes fewer. `chain.py` says in which order they join, `message.py` how a message is laid out.

The decoding half of each pair gets bytes from outside. It raises `CodecError` for anything that its encoding half
cannot have written: it checks every size, offset and run before it uses it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import ClustervizError

Pixels = NDArray[np.float32] | NDArray[np.float16] | NDArray[np.uint8]
Bytes = NDArray[np.uint8]
Runs = NDArray[np.int32]


class CodecError(ClustervizError):
    """Bytes that are not what their codec wrote: damaged or cut off on the way."""


@dataclass(frozen=True, slots=True)
class Rows:
    """How the pixels of a message lie in rows: pixel k is in column (first + k) % width.

    Attributes
    ----------
    first : the column of the first pixel, 0 or more
    width : pixels in a row, 1 or more
    """

    first: int
    width: int


@dataclass(frozen=True)
class Selection:
    """A stage that keeps some runs of the pixels.

    Attributes
    ----------
    bit : of the message's first byte, never changed once given out
    select : pixels (n, 4), rows -> table uint8 (bytes,), runs int32 (k, 2) of [first pixel, length], ascending and
        disjoint, and how many pixels they hold; None where that is no shorter than the pixels themselves
    restore : table, n, rows -> runs and how many pixels they hold
    """

    bit: int
    select: Callable[[Pixels, Rows], tuple[Bytes, Runs, int] | None]
    restore: Callable[[Bytes, int, Rows], tuple[Runs, int]]


@dataclass(frozen=True)
class Filter:
    """A stage that rearranges bytes.

    Attributes
    ----------
    bit : of the message's first byte, never changed once given out
    apply, undo : source uint8 (bytes,), read-only, whole pixels; target, as many; type of the pixels' components
    """

    bit: int
    apply: Callable[[Bytes, Bytes, np.dtype[Any]], None]
    undo: Callable[[Bytes, Bytes, np.dtype[Any]], None]


@dataclass(frozen=True)
class Squeeze:
    """A stage that makes bytes fewer.

    Attributes
    ----------
    bit : of the message's first byte, never changed once given out
    compress : uint8 (bytes,) -> fewer bytes, or None where it finds nothing to save
    expand : those bytes, how many they stand for -> uint8 (bytes,), writable
    """

    bit: int
    compress: Callable[[Bytes], Bytes | None]
    expand: Callable[[Bytes, int], Bytes]


Stage = Selection | Filter | Squeeze
