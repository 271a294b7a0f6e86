"""Image collection: tiles that do not overlap become one picture; nothing is blended, and each pixel travels once.

Each rank sends what it drew straight to the root, in one message, behind a header that says where its tiles lie: who
draws which tile may be known only afterwards, and nobody but the root has to know at all.

References
----------
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 5.2.2.
"""

from __future__ import annotations

from collections.abc import Sequence
from time import perf_counter
from typing import Any

import numpy as np

from clusterviz.codec import Rows, choose_codec
from clusterviz.codec.contract import Bytes, Pixels
from clusterviz.comm import Channel
from clusterviz.comm.agree import mark_agreed
from clusterviz.composite.counters import CompositeCounters, StageCounters
from clusterviz.composite.fragment import Fragment
from clusterviz.composite.gather import collect
from clusterviz.composite.model.network import Network, default_network
from clusterviz.composite.packing import compile_codecs, packer
from clusterviz.composite.patch import Patch
from clusterviz.composite.piece import Piece
from clusterviz.errors import InputError
from clusterviz.image.partial import PartialImage
from clusterviz.image.region import Rect


class TileCollector:
    """Makes one picture of the tiles of all ranks, as often as asked; every method is collective.

    Parameters
    ----------
    channel : to the other ranks
    size : (width, height) of the picture
    codec : a name of the registry, or "auto"
    pixel : the type of the tiles: float32, float16 or uint8
    network : the constants by which codecs are judged; those that `clusterviz bench network` kept where None

    Raises
    ------
    InputError
        On every rank: an unknown codec.

    Attributes
    ----------
    pixel : the same
    """

    def __init__(
        self,
        channel: Channel,
        size: tuple[int, int],
        *,
        codec: str = "auto",
        pixel: str = "float32",
        network: Network | None = None,
    ) -> None:
        try:
            choose_codec(codec)
        except InputError as error:
            raise mark_agreed(error) from None
        self._channel, self._size, self._codec, self._dtype = channel, size, codec, np.dtype(pixel)
        self.pixel = pixel
        nodes = len(channel.nodes())
        self._pack = packer(codec, network or default_network(nodes), nodes)
        if codec != "raw":
            compile_codecs(channel, self._dtype)

    def collect(self, tiles: Sequence[PartialImage]) -> tuple[Pixels | None, CompositeCounters]:
        """One picture.

        Parameters
        ----------
        tiles : of this rank, of the collector's type, inside the picture; none of any rank reaches where another lies

        Returns
        -------
        picture : (height, width, 4), of that type, on rank 0; None elsewhere. Where no tile lies it is 0
        counters : what it cost on this rank
        """
        whole = Rect(0, 0, *self._size)
        drawn = [tile for tile in tiles if tile.rect.pixels]
        patches = (Patch(whole.width, 0, whole.pixels, tile.rect) for tile in drawn)
        fragments = tuple(
            Fragment(patch, np.asarray(tile.rgba, self._dtype).reshape(-1, 4))
            for patch, tile in zip(patches, drawn, strict=True)
        )
        everybody = tuple(range(self._channel.size))
        counted = _Counted(self._pack)
        started = perf_counter()
        picture: Any = collect(
            Piece(whole, self._dtype, fragments, everybody, disjoint=True), self._size, self._channel, pack=counted
        )
        return picture, self._counters(counted, perf_counter() - started)

    def _counters(self, counted: _Counted, seconds: float) -> CompositeCounters:
        stage = StageCounters(
            messages_sent=counted.messages,
            pixels_sent=counted.pixels,
            bytes_raw=counted.pixels * 4 * self._dtype.itemsize,
            bytes_sent=counted.bytes,
            seconds_encode=counted.seconds,
            seconds_wait=seconds - counted.seconds,
        )
        return CompositeCounters("tiles", self._codec, "messages", self._channel.size, 0.0, 0.0, (stage,))


class _Counted:
    """Packs messages, and counts what it does."""

    def __init__(self, pack: Any) -> None:
        self._pack = pack
        self.messages = self.pixels = self.bytes = 0
        self.seconds = 0.0

    def __call__(self, pixels: Pixels, rows: Rows, key: tuple[int, int]) -> Bytes:
        started = perf_counter()
        message: Bytes = self._pack(pixels, rows, key)
        self.seconds += perf_counter() - started
        self.messages, self.pixels, self.bytes = (
            self.messages + 1,
            self.pixels + len(pixels),
            self.bytes + message.nbytes,
        )
        return message
