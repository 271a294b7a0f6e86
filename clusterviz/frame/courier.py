"""Bricks between ranks while frames are drawn: one message a brick, posted before a frame and looked for after it.

Nothing waits for a message. All ranks know all flights, so a receive is posted for each before its message can come;
messages have a channel of their own, so that compositing does not wait for them either.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np

from clusterviz.balance import Flight
from clusterviz.codec import AutoCodec
from clusterviz.codec.contract import Bytes, CodecError
from clusterviz.comm import Channel
from clusterviz.composite.model.network import default_network
from clusterviz.data.source import Index
from clusterviz.frame.parcel import Parcels
from clusterviz.render.stored import Stored
from clusterviz.report.trace import Span

TAGS = 30_000  # of messages under way at once; MPI promises 32,767


@dataclass(frozen=True, eq=False)
class _Awaited:
    """A message that shall come: its number, its brick, and where it is put."""

    number: int
    flight: Flight
    parcels: Parcels
    buffer: Bytes
    pending: Any
    posted: float


@dataclass(frozen=True, eq=False)
class Delivery:
    """What has come to this rank.

    Attributes
    ----------
    bricks : by the number of their flight, with the stamps of how they are stored
    lost : numbers of flights whose messages were damaged
    spans : of their messages, for a trace
    """

    bricks: dict[int, tuple[Index, int, Stored]]
    lost: list[int]
    spans: list[Span]


class Courier:
    """Sends and receives on one rank; made and closed on all ranks together.

    Parameters
    ----------
    channel : to the other ranks
    """

    def __init__(self, channel: Channel) -> None:
        self._channel = channel.beside()
        nodes = len(channel.nodes())
        network = default_network(nodes)
        self._codec = AutoCodec(network.seconds_per_byte if nodes > 1 else network.node_seconds_per_byte)
        self._awaited: list[_Awaited] = []
        self._numbers = 0
        self.bytes_sent = 0

    def post(self, flights: Sequence[Flight], parcels: Parcels, mine: Mapping[Index, Stored]) -> range:
        """Send this rank's bricks among the flights, and expect those that fly to it.

        Parameters
        ----------
        flights : of all ranks, the same on each
        parcels : how they travel
        mine : those whose source is this rank

        Returns
        -------
        numbers : of the flights, the same on every rank
        """
        numbers = range(self._numbers, self._numbers + len(flights))
        self._numbers = numbers.stop
        for number, flight in zip(numbers, flights, strict=True):
            if flight.target == self._channel.rank:
                buffer = np.empty(parcels.most_bytes, np.uint8)
                pending = self._channel.post_receive(buffer, flight.source, number % TAGS)
                self._awaited.append(_Awaited(number, flight, parcels, buffer, pending, perf_counter()))
        for number, flight in zip(numbers, flights, strict=True):
            if flight.source == self._channel.rank:
                pack = partial(self._codec.pack, key=flight.target)
                parcel = parcels.wrap(flight.brick, mine[flight.brick], pack)
                self._channel.isend(parcel, flight.target, number % TAGS)
                self.bytes_sent += parcel.nbytes
        return numbers

    def collect(self) -> Delivery:
        """What has come by now."""
        delivery = Delivery({}, [], [])
        while done := self._channel.test_some([each.pending for each in self._awaited]):
            self._open(done, delivery)
        return delivery

    def close(self) -> None:
        """Let everything arrive that is under way; collective."""
        while self._awaited:
            done = self._channel.wait_some([each.pending for each in self._awaited])
            self._awaited = [each for at, each in enumerate(self._awaited) if at not in {index for index, _ in done}]
        self._channel.wait_sends()
        self._channel.close()

    def _open(self, done: Iterable[tuple[int, int]], delivery: Delivery) -> None:
        came = dict(done)
        for at, size in came.items():
            each = self._awaited[at]
            flight, now = each.flight, perf_counter()
            told = {"brick": flight.brick, "from": flight.source, "bytes": size}
            delivery.spans.append(Span("brick", "migrate", each.posted, now, told))
            try:
                stored = each.parcels.unwrap(each.buffer[:size], flight.brick)
                delivery.bricks[each.number] = flight.brick, each.parcels.stamp, stored
            except CodecError:
                # The others learn of it, and the brick stays where it was.
                delivery.lost.append(each.number)
        self._awaited = [each for at, each in enumerate(self._awaited) if at not in came]
