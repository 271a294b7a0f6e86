"""Lossless compression of pixels for messages.

- contract.py      kinds of stages of a codec, and their contracts
- chain.py         codecs as chains of stages: the registry
- message.py       packing and unpacking of messages, and their layout
- active.py, rectangle.py, delta.py, shuffle.py, lz4_block.py    the stages
- kernels.py, active_kernels.py, filter_kernels.py, intrinsics.py    their compiled loops
- auto.py          automatic choice of a codec for each message
"""

from __future__ import annotations

from clusterviz.codec.auto import AutoCodec
from clusterviz.codec.chain import CODECS, STAGES, choose_codec
from clusterviz.codec.contract import CodecError, Rows
from clusterviz.codec.message import open_message, pack, prepare_codecs, unpack

__all__ = [
    "CODECS",
    "STAGES",
    "AutoCodec",
    "CodecError",
    "Rows",
    "choose_codec",
    "open_message",
    "pack",
    "prepare_codecs",
    "unpack",
]
