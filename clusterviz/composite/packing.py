"""How pixels of one sender are packed from message to message, and what has to be compiled for it beforehand."""

from __future__ import annotations

from typing import Any

import numpy as np

from clusterviz.codec import AutoCodec, pack, prepare_codecs
from clusterviz.comm import Channel
from clusterviz.composite.gather import Pack
from clusterviz.composite.model.network import Network


def packer(codec: str, network: Network, nodes: int) -> Pack:
    """How messages are packed: always alike, or as it pays on the slowest link."""
    if codec == "auto":
        return AutoCodec(network.seconds_per_byte if nodes > 1 else network.node_seconds_per_byte).pack
    return lambda pixels, rows, key: pack(pixels, codec, rows)


def compile_codecs(channel: Channel, dtype: np.dtype[Any]) -> None:
    """Compile what codecs need, once: one rank of each node does, and the others find it done; collective."""
    if channel.placement().local_rank == 0:
        prepare_codecs((dtype,))
    channel.barrier()
    prepare_codecs((dtype,))
