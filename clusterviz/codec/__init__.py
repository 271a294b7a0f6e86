"""The tool room where pixels become bytes and bytes become pixels.

- contract.py      what a stage of a codec is
- chain.py         codecs as chains of stages: the registry
- message.py       pack, open_message, unpack: how a message is laid out, and why a receiver need not trust it
- active.py, rectangle.py, delta.py, shuffle.py, lz4_block.py    the stages, one file each
- auto.py          which codec pays, message by message
- prepare.py       compiling ahead

**The message.** Sender and receiver both know how many pixels a message holds and their type, hence its raw size. A
message of exactly the raw size holds the pixels as they lie in memory. A shorter one was packed: its first byte says
by which stages. A longer one does not exist, so a receiver posts a buffer of the raw size. Raw pixels therefore travel
without a copy, and every codec falls back to raw where it does not pay.
"""

from __future__ import annotations

from clusterviz.codec.auto import AutoCodec
from clusterviz.codec.chain import CODECS, STAGES, Chain, choose_codec
from clusterviz.codec.contract import CodecError, Rows
from clusterviz.codec.message import open_message, pack, unpack
from clusterviz.codec.prepare import prepare_codecs

__all__ = [
    "CODECS",
    "STAGES",
    "AutoCodec",
    "Chain",
    "CodecError",
    "Rows",
    "choose_codec",
    "open_message",
    "pack",
    "prepare_codecs",
    "unpack",
]
