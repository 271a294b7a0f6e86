"""LZ4 block compression.

What: repeated byte sequences become references to earlier ones.
When: 8-bit images with smooth or flat regions, on links of about a gigabit a second and less.
When not: floats without `shuffle` before it, noise, links that are faster than the compressor.
Cost: about a nanosecond a byte where it finds repetition, far less where it does not; a third of that to decompress.
Limits: 2,113,929,216 bytes, LZ4's own; more is not compressed.
Reference: Y. Collet, "LZ4 block format description", github.com/lz4/lz4, doc/lz4_Block_format.md. For compressed
transfer of partial images: the Fast Ethernet measurements of LZO in sort-first rendering with 64 KB as the least size.
"""

from __future__ import annotations

import numpy as np

from clusterviz.codec.contract import Bytes, CodecError

MAX_BYTES = 0x7E000000


def compress(data: Bytes) -> Bytes | None:
    """Return one block without its size; None if it is no shorter than the data."""
    from lz4 import block  # type: ignore[import-untyped]

    if not 0 < data.size <= MAX_BYTES:
        return None
    compressed = block.compress(data, store_size=False)
    return np.frombuffer(compressed, np.uint8) if len(compressed) < data.size else None


def decompress(data: Bytes, size: int) -> Bytes:
    """Return the `size` bytes of a block, uint8 (size,), writable.

    Raises CodecError if the data is no LZ4 block, or decompresses to another size.
    """
    from lz4 import block

    if size > MAX_BYTES:
        raise CodecError(f"an LZ4 block for {size} bytes, more than it can hold")
    try:
        # A bytearray, so that the pixels are writable; the size limits the allocation.
        decompressed = block.decompress(np.ascontiguousarray(data), uncompressed_size=size, return_bytearray=True)
    except block.LZ4BlockError as error:
        raise CodecError(f"a damaged LZ4 block: {error}") from None
    if len(decompressed) != size:
        raise CodecError(f"an LZ4 block of {len(decompressed)} bytes instead of {size}")
    return np.frombuffer(decompressed, np.uint8)
