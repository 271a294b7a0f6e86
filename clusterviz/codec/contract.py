"""Contracts of the stages of a codec: selection, filter and compressor, each a pair of exact inverses.

A *selection* drops blank pixels: it finds the runs of the other pixels and encodes them as a table. A *filter*
rearranges the bytes of pixels without changing their number, so that a compressor finds more repetition. A *compressor*
shortens bytes. `chain.py` defines their order, `message.py` the layout of messages.

The decoding half of each pair gets bytes from outside. It checks every size, offset and run before use, and raises
`CodecError` for anything that its encoding half cannot have written.
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
    """Bytes that their codec did not write: damaged or truncated in transfer."""


@dataclass(frozen=True, slots=True)
class Rows:
    """Layout of a message's pixels in rows: pixel k is in column (first + k) % width."""

    first: int  # column of the first pixel, 0 or more
    width: int  # pixels in a row, 1 or more


@dataclass(frozen=True)
class Selection:
    """Stage that keeps some runs of the pixels."""

    bit: int  # flag in the message's first byte; part of the format, so it never changes
    # pixels (n, 4), rows -> table uint8 (bytes,), runs int32 (k, 2) of [first pixel, length], ascending and disjoint,
    # and the number of their pixels; None if that is no shorter than the pixels
    select: Callable[[Pixels, Rows], tuple[Bytes, Runs, int] | None]
    restore: Callable[[Bytes, int, Rows], tuple[Runs, int]]  # table, n, rows -> runs and the number of their pixels


@dataclass(frozen=True)
class Filter:
    """Stage that rearranges bytes."""

    bit: int  # flag in the message's first byte; part of the format, so it never changes
    # source uint8 (bytes,), read-only, whole pixels; target of the same size; dtype of the pixels' components
    apply: Callable[[Bytes, Bytes, np.dtype[Any]], None]
    undo: Callable[[Bytes, Bytes, np.dtype[Any]], None]


@dataclass(frozen=True)
class Compressor:
    """Stage that shortens bytes."""

    bit: int  # flag in the message's first byte; part of the format, so it never changes
    compress: Callable[[Bytes], Bytes | None]  # uint8 (bytes,) -> fewer bytes, or None if nothing is saved
    decompress: Callable[[Bytes, int], Bytes]  # those bytes, original size -> uint8 (size,), writable


Stage = Selection | Filter | Compressor
