"""What a codec is: a pair of functions between pixels and bytes.

`encode(pixels)` returns the encoded bytes, or None where it does not pay. `decode(data, count, dtype)` is its exact
inverse: it returns `count` pixels, and raises `CodecError` for anything that `encode` cannot have produced: it checks
every size and offset that it reads before it uses it, because the bytes come from outside.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import ClustervizError

Pixels = NDArray[np.float32] | NDArray[np.uint8]
Bytes = NDArray[np.uint8]


class CodecError(ClustervizError):
    """Bytes that are not what their codec wrote: damaged or cut off on the way."""


@dataclass(frozen=True)
class Codec:
    """One codec of the registry.

    Attributes
    ----------
    flag : the first byte of a message that this codec encoded, 0..255, never changed once given out
    encode : pixels (n, 4), C order -> uint8 (bytes,), or None
    decode : uint8 (bytes,), n, dtype -> pixels (n, 4); None where `encode` never returns bytes
    """

    flag: int
    encode: Callable[[Pixels], Bytes | None]
    decode: Callable[[Bytes, int, np.dtype[Any]], Pixels] | None
