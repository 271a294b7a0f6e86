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
    flat = _read_only(pixels.reshape(-1).view(np.uint8))
    packed = None
    if chain.flag and pixels.size:
        target = np.empty(flat.size, np.uint8) if out is None else out[: flat.size]
        packed = _packed(pixels, flat, chain, rows or Rows(0, len(pixels)), target)
    return pixels.reshape(-1).view(np.uint8) if packed is None else packed


def _packed(pixels: Pixels, flat: Bytes, chain: Chain, rows: Rows, target: Bytes) -> Bytes | None:
    """The shorter of the message with all stages and that with the selection alone; None where neither is."""
    shortest, flag, head, body = flat.size, 0, (0, len(pixels)), flat
    table_bytes = 0
    selected = chain.selection.select(pixels, rows) if chain.selection else None
    if chain.selection and selected:
        table, runs, kept = selected
        size = HEADER_BYTES + table.size + kept * 4 * pixels.itemsize
        if size < shortest:
            shortest, flag, head, table_bytes = size, chain.selection.bit, (table.size, kept), table.size
            body = _gathered(flat, table, runs, 4 * pixels.itemsize, target[:size])
    squeezed = None
    if chain.squeeze:
        squeezed = chain.squeeze.compress(_filtered(body, table_bytes, chain, pixels.dtype))
    if chain.squeeze and squeezed is not None and HEADER_BYTES + squeezed.size < shortest:
        shortest = HEADER_BYTES + squeezed.size
        target[HEADER_BYTES:shortest] = squeezed
        flag += chain.flag - (chain.selection.bit if chain.selection else 0)
    if not flag:
        return None
    target[:HEADER_BYTES] = np.array([flag, *head], _HEADER).view(np.uint8)
    return target[:shortest]


def _gathered(flat: Bytes, table: Bytes, runs: Runs, pixel_bytes: int, target: Bytes) -> Bytes:
    """The body of a selection, put where it will be in the message: the table, then the pixels of the runs."""
    from clusterviz.codec import run_kernels

    body = target[HEADER_BYTES:]
    body[: table.size] = table
    run_kernels.gather(flat, _read_only(runs), pixel_bytes, body[table.size :])
    return body


def _filtered(body: Bytes, table_bytes: int, chain: Chain, dtype: np.dtype[Any]) -> Bytes:
    """The body with its pixels through the filters."""
    for stage in chain.filters:
        filtered = np.empty_like(body)
        filtered[:table_bytes] = body[:table_bytes]
        stage.apply(_read_only(body[table_bytes:]), filtered[table_bytes:], dtype)
        body = filtered
    return body


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
    for stage in reversed(chain.filters):
        restored = np.empty_like(pixels)
        stage.undo(_read_only(pixels), restored, dtype)
        pixels = restored
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
    from clusterviz.codec import run_kernels

    pixels, runs = open_message(message, count, dtype, rows)
    if runs is None:
        return pixels
    whole: Pixels = np.empty((count, 4), dtype) if out is None else out
    packed = _read_only(pixels.reshape(-1).view(np.uint8))
    run_kernels.scatter(packed, runs, 4 * dtype.itemsize, whole.reshape(-1).view(np.uint8))
    return whole


def _read_only(array: Any) -> Any:
    """A read-only view: such arrays are a type of their own to numba, and one type is compiled once."""
    view = array.view()
    view.flags.writeable = False
    return view
