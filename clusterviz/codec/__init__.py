"""The tool room where pixels become bytes and bytes become pixels.

**The message.** Sender and receiver both know how many pixels a message holds and their type, hence its raw size. A
message of exactly the raw size holds the pixels as they lie in memory. A shorter one was encoded: its first byte is
the flag of its codec, the rest is the codec's. A longer one does not exist, so a receiver posts a buffer of the raw
size. Raw pixels therefore travel without a copy, and every codec falls back to raw where it does not pay.

**Adding a codec**: one file with `encode` and `decode` as in `contract.py`, and one line below.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from clusterviz.codec import raw
from clusterviz.codec.contract import Bytes, Codec, CodecError, Pixels
from clusterviz.errors import InputError

CODECS: dict[str, Codec] = {
    "raw": Codec(0, raw.encode, None),
}

__all__ = ["CODECS", "Codec", "CodecError", "choose_codec", "pack", "unpack"]


def choose_codec(name: str) -> str:
    """The codec to use; `auto` is raw for now.

    Raises
    ------
    InputError
        There is no such codec.
    """
    if name == "auto":
        return "raw"
    if name not in CODECS:
        raise InputError("unknown codec", where="cluster.codec", found=name, allowed=", ".join([*CODECS, "auto"]))
    return name


def pack(pixels: Pixels, codec: str) -> Bytes:
    """The message for pixels (n, 4), C order: encoded where that is shorter, else a view of the pixels themselves."""
    raw_bytes = pixels.reshape(-1).view(np.uint8)
    body = CODECS[codec].encode(pixels)
    if body is None or body.size + 1 >= raw_bytes.size:
        return raw_bytes
    return np.concatenate([np.array([CODECS[codec].flag], np.uint8), body])


def unpack(message: Bytes, count: int, dtype: np.dtype[Any]) -> Pixels:
    """The pixels (count, 4) of a message: a view where it is raw.

    Raises
    ------
    CodecError
        The size or the flag is impossible, or the codec refuses the bytes.
    """
    raw_size = count * 4 * dtype.itemsize
    if message.size == raw_size:
        return message.view(dtype).reshape(count, 4)
    if message.size > raw_size or message.size == 0:
        raise CodecError(f"a message of {message.size} bytes cannot hold {count} pixels of {dtype}")
    for codec in CODECS.values():
        if codec.flag == message[0] and codec.decode is not None:
            return codec.decode(message[1:], count, dtype)
    raise CodecError(f"a message of {message.size} bytes for {count} pixels starts with the unknown flag {message[0]}")
