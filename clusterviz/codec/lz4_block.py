"""LZ4: the fast compressor for bytes, one block a message.

What: repeated byte sequences become references to where they stood before.
When: 8-bit images of smooth or flat zones on links of about a gigabit a second and less.
When not: floats as they lie (put `shuffle` before it), noise, links that are faster than it is.
Cost: about a nanosecond a byte where it finds something, far less where it does not; the receiver a third of that.
Limits: 2,113,929,216 bytes, LZ4's own; more is left as it is.
Reference: Y. Collet, "LZ4 block format description", github.com/lz4/lz4, doc/lz4_Block_format.md. For compressed
transfer of partial images: the Fast Ethernet measurements of LZO in sort-first rendering with 64 KB as the least size.
"""

from __future__ import annotations

import numpy as np

from clusterviz.codec.contract import Bytes, CodecError

MOST_BYTES = 0x7E000000


def compress(data: Bytes) -> Bytes | None:
    """One block, without its size; None where it is no shorter."""
    from lz4 import block  # type: ignore[import-untyped]

    if not 0 < data.size <= MOST_BYTES:
        return None
    squeezed = block.compress(data, store_size=False)
    return np.frombuffer(squeezed, np.uint8) if len(squeezed) < data.size else None


def expand(data: Bytes, size: int) -> Bytes:
    """The `size` bytes that a block stands for.

    Raises
    ------
    CodecError
        It is no such block, or stands for more or fewer bytes.
    """
    from lz4 import block

    if size > MOST_BYTES:
        raise CodecError(f"a block of LZ4 for {size} bytes, more than it can hold")
    try:
        # A bytearray, so that the pixels can be written to; the size bounds what is allocated.
        expanded = block.decompress(np.ascontiguousarray(data), uncompressed_size=size, return_bytearray=True)
    except block.LZ4BlockError as error:
        raise CodecError(f"a damaged block of LZ4: {error}") from None
    if len(expanded) != size:
        raise CodecError(f"a block of LZ4 that stands for {len(expanded)} bytes instead of {size}")
    return np.frombuffer(expanded, np.uint8)
