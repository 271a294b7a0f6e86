"""Messages: pixels packed by a codec, and what a receiver makes of them.

Sender and receiver both know how many pixels a message holds, their type, and how they lie in rows; hence its raw size.
A message of exactly the raw size holds the pixels as they lie in memory. A shorter one was packed. A longer one does
not exist, so a receiver posts a buffer of the raw size. A packed message is

    uint32  the bits of its stages in the lowest byte, else 0         little-endian
    uint32  bytes of the table (0 without a selection)
    uint32  how many pixels it holds (all of them without a selection)
    body    the table, then the pixels, through the filters; both together through the squeeze

The numbers of table and pixels are as the sender's processor writes them, as they are in a raw message.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from clusterviz.codec.chain import BY_FLAG, CODECS, Chain
from clusterviz.codec.contract import Bytes, CodecError, Pixels, Rows, Runs
from clusterviz.codec.scratch import scratch

HEADER_BYTES = 12
_HEADER = np.dtype("<u4")
# Pixels and tables are read in place, so that a message begins where any of them may.
_ALIGNMENT = 4


def pack(pixels: Pixels, codec: str, rows: Rows | None = None, out: Bytes | None = None) -> Bytes:
    """The message for some pixels.

    Parameters
    ----------
    pixels : uint8, float16 or float32 (n, 4), C order
    codec : a name from `CODECS`
    rows : how the pixels lie in rows; in a single one where it is not given
    out : uint8, at least as many bytes as the pixels, none of theirs: where a packed message is put, if given

    Returns
    -------
    message : uint8, fewer bytes than the pixels, or a view of the pixels themselves where no stage pays
    """
    chain = CODECS[codec]
    flat: Bytes = pixels.reshape(-1).view(np.uint8)
    if not chain.flag or not flat.size:
        return flat
    target = np.empty(flat.size, np.uint8) if out is None else out[: flat.size]
    flag, table_bytes, kept, body = _selected(pixels, flat, chain, rows or Rows(0, len(pixels)), target)
    if chain.squeeze:
        squeezed = chain.squeeze.compress(_filtered(body, table_bytes, chain, pixels.dtype))
        # A selection that paid has a header already; without one the squeeze must make up for it.
        if squeezed is not None and squeezed.size + (0 if flag else HEADER_BYTES) < body.size:
            flag |= chain.flag - (chain.selection.bit if chain.selection else 0)
            body = target[HEADER_BYTES : HEADER_BYTES + squeezed.size]
            body[:] = squeezed
    if not flag:
        return flat
    target[:HEADER_BYTES] = np.array([flag, table_bytes, kept], _HEADER).view(np.uint8)
    return target[: HEADER_BYTES + body.size]


def _selected(pixels: Pixels, flat: Bytes, chain: Chain, rows: Rows, target: Bytes) -> tuple[int, int, int, Bytes]:
    """Flag, bytes of the table, number of pixels and body after the selection, or of all pixels where it does not pay.

    The body is put where it will be in the message: the table, then the pixels of the runs.
    """
    from clusterviz.codec import run_kernels

    selected = chain.selection.select(pixels, rows) if chain.selection else None
    if chain.selection and selected:
        table, runs, kept = selected
        size = HEADER_BYTES + table.size + kept * 4 * pixels.itemsize
        if size < flat.size:
            body = target[HEADER_BYTES:size]
            body[: table.size] = table
            run_kernels.gather(_read_only(flat), _read_only(runs), 4 * pixels.itemsize, body[table.size :])
            return chain.selection.bit, table.size, kept, body
    return 0, 0, len(pixels), flat


def _filtered(body: Bytes, table_bytes: int, chain: Chain, dtype: np.dtype[Any]) -> Bytes:
    """The body with its pixels through the filters, in memory that the next message reuses."""
    for number, stage in enumerate(chain.filters):
        filtered = scratch(body.size, number % 2)
        filtered[:table_bytes] = body[:table_bytes]
        stage.apply(_read_only(body[table_bytes:]), filtered[table_bytes:], dtype)
        body = filtered
    return body


def _unfilter(pixels: Bytes, chain: Chain, dtype: np.dtype[Any]) -> None:
    """Take the pixels back through the filters, in place."""
    source, target = pixels, scratch(pixels.size, 0) if chain.filters else pixels
    for stage in reversed(chain.filters):
        stage.undo(_read_only(source), target, dtype)
        source, target = target, source
    if source is not pixels:
        pixels[:] = source


def open_message(
    message: Bytes, count: int, dtype: np.dtype[Any], rows: Rows | None = None
) -> tuple[Pixels, Runs | None]:
    """The pixels of a message as they lie in it.

    Parameters
    ----------
    message : uint8 (bytes,)
    count, dtype, rows : of the pixels, as they were when they were packed

    Returns
    -------
    pixels : (count, 4), or those of the runs, one run after the other; views of the message where no stage changed them
    runs : int32 (k, 2) of [first pixel, length], ascending and disjoint, read-only; pixels outside are blank. None
        where there are all pixels

    Raises
    ------
    CodecError
        The message is not what `pack` makes of such pixels: its size, its header or what it holds.
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
    if chain.squeeze:
        body = chain.squeeze.expand(body, size)
    if body.size != size:
        raise CodecError(f"a message of {message.size} bytes whose header says {HEADER_BYTES + size}")
    runs = None
    if chain.selection:
        runs, held = chain.selection.restore(body[:table_bytes], count, rows or Rows(0, count))
        if held != kept:
            raise CodecError(f"runs of {held} pixels in a message that says that it holds {kept}")
        runs = _read_only(runs)
    pixels = body[table_bytes:]
    _unfilter(pixels, chain, dtype)
    return pixels.view(dtype).reshape(-1, 4), runs


def _read_header(message: Bytes, count: int, dtype: np.dtype[Any]) -> tuple[Chain, int, int]:
    """The stages, the table's bytes and the number of pixels, none of them larger than a packed message can have."""
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
    """All pixels of a message.

    Parameters
    ----------
    message, count, dtype, rows : as for `open_message`
    out : (count, 4), C order: where the pixels are put if they must be copied, if given

    Returns
    -------
    pixels : (count, 4); a view of the message where it holds them as they are

    Raises
    ------
    CodecError
        As `open_message`.
    """
    pixels, runs = open_message(message, count, dtype, rows)
    if runs is None:
        return pixels
    from clusterviz.codec import run_kernels

    whole: Pixels = np.empty((count, 4), dtype) if out is None else out
    packed = _read_only(pixels.reshape(-1).view(np.uint8))
    run_kernels.scatter(packed, runs, 4 * dtype.itemsize, whole.reshape(-1).view(np.uint8))
    return whole


def _read_only(array: Any) -> Any:
    """A read-only view: such arrays are a type of their own to numba, and one type is compiled once."""
    view = array.view()
    view.flags.writeable = False
    return view
