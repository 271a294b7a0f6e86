"""Messages: pixels packed by a codec, their layout, and unpacking.

Sender and receiver both know the number of pixels of a message, their type and their rows, hence its raw size. A
message of the raw size holds the pixels as they lie in memory, and is sent without a copy. A shorter one is packed. A
longer one is invalid, so a receiver posts a buffer of the raw size. Every codec falls back to raw where it saves no
bytes. A packed message is

    uint32  the bits of its stages in the lowest byte, else 0         little-endian
    uint32  bytes of the table (0 without a selection)
    uint32  number of pixels in it (all of them without a selection)
    body    the table, then the filtered pixels; both together compressed

Table and pixels have the sender's byte order, as in a raw message.
"""

from __future__ import annotations

import threading
from typing import Any

import numpy as np

from clusterviz.codec import kernels
from clusterviz.codec.chain import BY_FLAG, CODECS, Chain
from clusterviz.codec.contract import Bytes, CodecError, Pixels, Rows, Runs

HEADER_BYTES = 12
_HEADER = np.dtype("<u4")
# Pixels and tables are read in place, so a message needs the alignment of their numbers.
_ALIGNMENT = 4

# Largest scratch array that is kept; a thread keeps at most two.
KEEP_BYTES = 64 << 20


def pack(pixels: Pixels, codec: str, rows: Rows | None = None, out: Bytes | None = None) -> Bytes:
    """Return the message of pixels.

    Returns uint8, fewer bytes than the pixels, or a view of the pixels if no stage saves bytes.

    Parameters
    ----------
    pixels : uint8, float16 or float32 (n, 4), C order
    codec : a name from `CODECS`
    rows : layout of the pixels in rows; by default a single row
    out : uint8, buffer for a packed message, at least as large as the pixels and not overlapping them
    """
    chain = CODECS[codec]
    flat: Bytes = pixels.reshape(-1).view(np.uint8)
    if not chain.flag or not flat.size:
        return flat
    target = np.empty(flat.size, np.uint8) if out is None else out[: flat.size]
    flag, table_bytes, kept, body = _selected(pixels, flat, chain, rows or Rows(0, len(pixels)), target)
    if chain.compressor:
        compressed = chain.compressor.compress(_filtered(body, table_bytes, chain, pixels.dtype))
        # Without a selection the compressor must save more than the header takes.
        if compressed is not None and compressed.size + (0 if flag else HEADER_BYTES) < body.size:
            flag |= chain.flag - (chain.selection.bit if chain.selection else 0)
            body = target[HEADER_BYTES : HEADER_BYTES + compressed.size]
            body[:] = compressed
    if not flag:
        return flat
    target[:HEADER_BYTES] = np.array([flag, table_bytes, kept], _HEADER).view(np.uint8)
    return target[: HEADER_BYTES + body.size]


def _selected(pixels: Pixels, flat: Bytes, chain: Chain, rows: Rows, target: Bytes) -> tuple[int, int, int, Bytes]:
    """Apply the selection: flag, bytes of the table, number of pixels, and body; all pixels if it saves no bytes.

    The body is written at its position in the message: the table, then the pixels of the runs.
    """
    selected = chain.selection.select(pixels, rows) if chain.selection else None
    if chain.selection and selected:
        table, runs, kept = selected
        size = HEADER_BYTES + table.size + kept * 4 * pixels.itemsize
        if size < flat.size:
            body = target[HEADER_BYTES:size]
            body[: table.size] = table
            kernels.gather(flat, runs, 4 * pixels.itemsize, body[table.size :])
            return chain.selection.bit, table.size, kept, body
    return 0, 0, len(pixels), flat


def _filtered(body: Bytes, table_bytes: int, chain: Chain, dtype: np.dtype[Any]) -> Bytes:
    """Return the body with filtered pixels, in scratch memory."""
    for number, stage in enumerate(chain.filters):
        filtered = scratch(body.size, number % 2)
        filtered[:table_bytes] = body[:table_bytes]
        stage.apply(body[table_bytes:], filtered[table_bytes:], dtype)
        body = filtered
    return body


def _unfilter(pixels: Bytes, chain: Chain, dtype: np.dtype[Any]) -> None:
    source, target = pixels, scratch(pixels.size, 0) if chain.filters else pixels
    for stage in reversed(chain.filters):
        stage.undo(source, target, dtype)
        source, target = target, source
    if source is not pixels:
        pixels[:] = source


def open_message(
    message: Bytes, count: int, dtype: np.dtype[Any], rows: Rows | None = None
) -> tuple[Pixels, Runs | None]:
    """Return the pixels of a message, with their runs.

    Raises CodecError if `pack` cannot have made the message from such pixels.

    `count`, `dtype`, `rows`: of the pixels that were packed.

    Returns
    -------
    pixels : (count, 4), or those of the runs, one run after the other; views of the message if no stage changed them
    runs : int32 (k, 2) of [first pixel, length], ascending and disjoint, read-only; pixels outside are blank. None if
        all pixels are there
    """
    raw_size = count * 4 * dtype.itemsize
    if message.size > raw_size or (message.size < HEADER_BYTES and message.size != raw_size):
        raise CodecError(f"a message of {message.size} bytes cannot hold {count} pixels of {dtype}")
    if message.__array_interface__["data"][0] % _ALIGNMENT:
        message = message.copy()
    if message.size == raw_size:
        return message.view(dtype).reshape(count, 4), None
    chain, table_bytes, kept = _read_header(message, count, dtype)
    size = table_bytes + kept * 4 * dtype.itemsize
    body = message[HEADER_BYTES:]
    if chain.compressor:
        body = chain.compressor.decompress(body, size)
    if body.size != size:
        raise CodecError(f"a message of {message.size} bytes whose header says {HEADER_BYTES + size}")
    runs = None
    if chain.selection:
        runs, held = chain.selection.restore(body[:table_bytes], count, rows or Rows(0, count))
        if held != kept:
            raise CodecError(f"runs of {held} pixels in a message that says that it holds {kept}")
    pixels = body[table_bytes:]
    _unfilter(pixels, chain, dtype)
    return pixels.view(dtype).reshape(-1, 4), runs


def _read_header(message: Bytes, count: int, dtype: np.dtype[Any]) -> tuple[Chain, int, int]:
    """Return the stages, the table's bytes and the number of pixels, all checked to be possible."""
    flag, table_bytes, kept = message[:HEADER_BYTES].view(_HEADER).tolist()
    chain = BY_FLAG.get(flag)
    if chain is None:
        raise CodecError(f"a message of {message.size} bytes for {count} pixels starts with the unknown flag {flag}")
    if chain.selection:
        possible = HEADER_BYTES + table_bytes + kept * 4 * dtype.itemsize < count * 4 * dtype.itemsize
    else:
        possible = table_bytes == 0 and kept == count
    if not possible:
        raise CodecError(
            f"a message for {count} pixels that says that it holds {kept}, and a table of {table_bytes} bytes"
        )
    return chain, table_bytes, kept


def unpack(
    message: Bytes, count: int, dtype: np.dtype[Any], rows: Rows | None = None, out: Pixels | None = None
) -> Pixels:
    """Return all pixels of a message.

    Returns (count, 4); a view of the message if it is raw. Errors as of `open_message`.

    `out`: (count, 4), C order: buffer for the pixels if they must be copied.
    """
    pixels, runs = open_message(message, count, dtype, rows)
    if runs is None:
        return pixels
    whole: Pixels = np.empty((count, 4), dtype) if out is None else out
    packed = pixels.reshape(-1).view(np.uint8)
    kernels.scatter(packed, runs, 4 * dtype.itemsize, whole.reshape(-1).view(np.uint8))
    return whole


def prepare_codecs() -> None:
    """Compile the kernels of all codecs, or load them, ahead of the first frame."""
    for each in kernels.KERNELS:
        each.prepare()


class _Kept(threading.local):
    """Scratch arrays of a thread; the ranks of a loopback channel are threads."""

    def __init__(self) -> None:
        self.arrays: dict[int, Bytes] = {}


_kept = _Kept()


def scratch(size: int, slot: int) -> Bytes:
    """Return uint8 (size,) of any content, the same memory for the same slot (0 or 1) in every call of a thread.

    First touches of new memory would cost more than the filters, for messages of megabytes.
    """
    if size > KEEP_BYTES:
        return np.empty(size, np.uint8)
    array = _kept.arrays.get(slot)
    if array is None or array.size < size:
        array = _kept.arrays[slot] = np.empty(size, np.uint8)
    return array[:size]
