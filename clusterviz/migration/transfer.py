"""Bricks between ranks while frames are drawn: a message a piece, worked on in a slice of each frame's time.

Nothing waits for a message. All ranks know all flights, so a receive is posted for each piece before it can come;
messages have a channel of their own, so that compositing does not wait for them either. What is left of a slice decides
how many pieces are packed, opened and stored now, and how many later: nobody else needs to know, as bricks are
counted as sent until their receiver says that it has them.
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np

from clusterviz.codec import AutoCodec
from clusterviz.codec.auto import MIN_BYTES
from clusterviz.codec.contract import Bytes, CodecError
from clusterviz.comm import Channel
from clusterviz.composite.messages import compile_codecs
from clusterviz.composite.model.network import default_network
from clusterviz.data.source import Index
from clusterviz.distribution.flights import Flight
from clusterviz.migration.time_budget import TimeBudget
from clusterviz.migration.wire_format import PIXEL, WireFormat
from clusterviz.render.stored_brick import Stored
from clusterviz.report.trace import Span

TAGS = 30_000  # of messages under way at once from one rank to another; MPI promises 32,767
NOTHING = np.empty(0, np.uint8)
Read = Callable[[Index, WireFormat], Stored | None]
Store = Callable[[Index, int, Stored], bool]


@dataclass(eq=False)
class _Outgoing:
    """A brick that this rank sends: its bytes, once read, and how many pieces are gone; void: nobody wants it."""

    flight: Flight
    wire_format: WireFormat
    tags: range
    stream: Bytes | None = None
    voxels: int = 0
    sent: int = 0
    is_void: bool = False


@dataclass(eq=False)
class _Incoming:
    """A brick that comes to this rank, and how many of its pieces are not open; void: damaged, or not wanted."""

    number: int
    flight: Flight
    wire_format: WireFormat
    posted: float
    missing: int
    stream: Bytes | None = None
    voxels: int = 0
    bytes: int = 0
    is_void: bool = False


@dataclass(frozen=True, eq=False)
class _Awaited:
    """A piece that shall come, and where it is put."""

    brick: _Incoming
    number: int
    buffer: Bytes
    pending: Any


@dataclass
class Delivery:
    """What has come to this rank.

    Attributes
    ----------
    arrived, lost : numbers of flights whose bricks are stored here, and whose messages were damaged or out of date
    spans : of their messages, for a trace
    """

    arrived: list[int] = field(default_factory=list)
    lost: list[int] = field(default_factory=list)
    spans: list[Span] = field(default_factory=list)


class BrickTransfer:
    """Sends and receives on one rank; made and closed on all ranks together.

    Parameters
    ----------
    channel : to the other ranks
    parcels : as the first may be: what packs them is made ready before there are any
    time_slice : of this rank's time

    Attributes
    ----------
    bytes_sent, bytes_raw : so far, and what they would have been unpacked
    bytes_opened, bricks_stored : so far
    """

    def __init__(self, channel: Channel, wire_format: WireFormat, time_slice: TimeBudget) -> None:
        self._channel, self._time_budget = channel.duplicate(), time_slice
        nodes = len(channel.nodes())
        network = default_network(nodes)
        if wire_format.most_bytes(0) > MIN_BYTES:  # smaller ones are never packed
            compile_codecs(channel, PIXEL[wire_format.slot.kind])
        self._codec = AutoCodec(network.seconds_per_byte if nodes > 1 else network.node_seconds_per_byte)
        self._outgoing: deque[_Outgoing] = deque()
        self._awaited: list[_Awaited] = []
        self._arrived: deque[tuple[_Awaited, int]] = deque()
        self._whole: deque[_Incoming] = deque()
        self._numbers = 0
        self._messages: dict[tuple[int, int], int] = defaultdict(int)
        self.bytes_sent = self.bytes_raw = self.bytes_opened = self.bricks_stored = 0

    def post(self, flights: Sequence[Flight], wire_format: WireFormat) -> range:
        """Expect the bricks that fly to this rank, and send its own among them as there is time.

        Parameters
        ----------
        flights : of all ranks, the same on each
        parcels : how they travel

        Returns
        -------
        numbers : of the flights, the same on every rank
        """
        numbers = range(self._numbers, self._numbers + len(flights))
        self._numbers = numbers.stop
        with self._time_budget.step("post" if flights else ""):
            for number, flight in zip(numbers, flights, strict=True):
                way, own = (flight.source, flight.target), wire_format.of(flight.brick)
                tags = range(self._messages[way], self._messages[way] + own.pieces)
                self._messages[way] = tags.stop
                if flight.source == self._channel.rank:
                    self._outgoing.append(_Outgoing(flight, own, tags))
                elif flight.target == self._channel.rank:
                    self._expect(_Incoming(number, flight, own, perf_counter(), own.pieces), tags)
        return numbers

    def send(self, read: Read) -> None:
        """Send pieces while there is time.

        Parameters
        ----------
        read : gives a brick that is here as it is stored; None where it is here no more, or is stored in another way
        """
        while self._outgoing and self._send_piece(self._outgoing[0], read):
            if self._outgoing[0].sent == self._outgoing[0].wire_format.pieces:
                self._outgoing.popleft()

    def collect(self, store: Store) -> Delivery:
        """Open pieces that have come, and store bricks that are whole, while there is time.

        Parameters
        ----------
        store : is given bricks, with the stamps of how they are stored; says whether they are of use
        """
        delivery = Delivery()
        with self._time_budget.step():
            while came := dict(self._channel.test_some([each.pending for each in self._awaited])):
                self._arrived.extend((self._awaited[at], size) for at, size in came.items())
                self._awaited = [each for at, each in enumerate(self._awaited) if at not in came]
        while self._store_brick(store, delivery) if self._whole else self._open_piece():
            pass
        return delivery

    def void(self) -> None:
        """Nobody wants what is under way: it is not worked on, and counts as lost when it ends."""
        pieces = (*self._awaited, *(piece for piece, _ in self._arrived))
        for brick in (*self._whole, *(piece.brick for piece in pieces)):
            brick.is_void = True
        for leaving in self._outgoing:
            leaving.is_void = True

    def close(self) -> None:
        """Let everything arrive that is under way; collective."""
        self.void()
        self.send(lambda brick, wire_format: None)
        while self._awaited:
            done = self._channel.wait_some([each.pending for each in self._awaited])
            self._awaited = [each for at, each in enumerate(self._awaited) if at not in {index for index, _ in done}]
        self._channel.wait_sends()
        self._channel.close()

    def _expect(self, brick: _Incoming, tags: range) -> None:
        for number, tag in enumerate(tags):
            buffer = np.empty(brick.wire_format.most_bytes(number), np.uint8)
            pending = self._channel.post_receive(buffer, brick.flight.source, tag % TAGS)
            self._awaited.append(_Awaited(brick, number, buffer, pending))

    def _send_piece(self, brick: _Outgoing, read: Read) -> bool:
        """Whether there was time for the next piece of a brick; of a void one nothing is sent but that it ends."""
        size, message = brick.wire_format.most_bytes(brick.sent), NOTHING
        if not brick.is_void and brick.stream is None and not self._read(brick, read):
            return False
        if brick.stream is not None and not brick.is_void:
            if not self._time_budget.allows("pack", size):
                return False
            pack = partial(self._codec.pack, key=brick.flight.target)
            with self._time_budget.step("pack", size):
                message = brick.wire_format.wrap(brick.flight.brick, brick.voxels, brick.stream, brick.sent, pack)
                self._channel.isend(message, brick.flight.target, brick.tags[brick.sent] % TAGS)
            self.bytes_raw += size
            self.bytes_sent += message.nbytes
        else:
            self._channel.isend(message, brick.flight.target, brick.tags[brick.sent] % TAGS)
        brick.sent += 1
        return True

    def _read(self, brick: _Outgoing, read: Read) -> bool:
        """Whether there was time to read a brick; one that is not here is void."""
        size = brick.wire_format.stream_bytes
        if not self._time_budget.allows("read", size):
            return False
        with self._time_budget.step("read", size):
            stored = read(brick.flight.brick, brick.wire_format)
            if stored is None:
                brick.is_void = True
            else:
                brick.stream, brick.voxels = brick.wire_format.stream(stored), stored.voxels
        return True

    def _open_piece(self) -> bool:
        """Whether there was a piece, and time for it."""
        if not self._arrived:
            return False
        piece, size = self._arrived[0]
        brick = piece.brick
        if not brick.is_void:
            room = piece.buffer.nbytes
            if not self._time_budget.allows("open", room):
                return False
            with self._time_budget.step("open", room):
                self._unwrap(piece, size)
            self.bytes_opened += room
        self._arrived.popleft()
        brick.missing -= 1
        brick.bytes += size
        if brick.missing == 0:
            self._whole.append(brick)
        return True

    def _unwrap(self, piece: _Awaited, size: int) -> None:
        """Put a piece into its brick; the others learn of a damaged one, and the brick stays where it was."""
        brick = piece.brick
        if brick.stream is None:
            brick.stream = np.empty(brick.wire_format.stream_bytes, np.uint8)
        try:
            brick.voxels = brick.wire_format.unwrap(piece.buffer[:size], brick.flight.brick, piece.number, brick.stream)
        except CodecError:
            brick.is_void = True

    def _store_brick(self, store: Store, delivery: Delivery) -> bool:
        """Whether there was time to store the first of the whole bricks."""
        brick = self._whole[0]
        flight, wire_format = brick.flight, brick.wire_format
        if brick.is_void or brick.stream is None:
            delivery.lost.append(brick.number)
        else:
            if not self._time_budget.allows("store", wire_format.stream_bytes):
                return False
            with self._time_budget.step("store", wire_format.stream_bytes):
                useful = store(flight.brick, wire_format.stamp, wire_format.brick(brick.stream, brick.voxels))
            (delivery.arrived if useful else delivery.lost).append(brick.number)
            self.bricks_stored += useful
        self._whole.popleft()
        told = {"brick": flight.brick, "from": flight.source, "bytes": brick.bytes}
        delivery.spans.append(Span("brick", "migrate", brick.posted, perf_counter(), told))
        return True
