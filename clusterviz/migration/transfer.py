"""Transfer of bricks between ranks while frames are drawn: one message for each part of a brick.

No rank waits for a message. All ranks know all flights, so each receive is posted before its message arrives. Messages
have their own channel, so compositing does not wait for them either. Each rank packs, unpacks and stores as many parts
as its time budget allows. Other ranks need not know how many: a brick is in flight until its receiver has stored it.
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np

from clusterviz.codec.auto import MIN_BYTES
from clusterviz.codec.contract import Bytes, CodecError, Pixels, Rows
from clusterviz.comm import Channel
from clusterviz.composite.messages import compile_codecs, packer
from clusterviz.composite.model.network import default_network
from clusterviz.data.source import Index
from clusterviz.distribution.flights import Flight
from clusterviz.migration.time_budget import TimeBudget
from clusterviz.migration.wire_format import WireFormat
from clusterviz.render.stored_brick import Stored
from clusterviz.report.trace import Span

TAGS = 30_000  # messages in flight from one rank to another; MPI guarantees 32,767 tags
NOTHING = np.empty(0, np.uint8)
Read = Callable[[Index, WireFormat], Stored | None]
Store = Callable[[Index, int, Stored], bool]


@dataclass(eq=False)
class _Outgoing:
    """Brick that this rank sends: its bytes, once read, and the number of parts sent; void: no longer wanted."""

    flight: Flight
    wire_format: WireFormat
    tags: range
    stream: Bytes | None = None
    voxels: int = 0
    sent: int = 0
    is_void: bool = False


@dataclass(eq=False)
class _Incoming:
    """Brick that this rank receives, and the number of parts to unpack; void: damaged, or no longer wanted."""

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
    """Part of a brick that will arrive, and its buffer."""

    brick: _Incoming
    number: int
    buffer: Bytes
    pending: Any


@dataclass
class Delivery:
    """Flights that ended at this rank."""

    arrived: list[int] = field(default_factory=list)  # numbers of flights whose bricks are stored
    lost: list[int] = field(default_factory=list)  # numbers of flights whose messages were damaged or outdated
    spans: list[Span] = field(default_factory=list)  # of their messages, for the trace


class BrickTransfer:
    """Sends and receives of bricks on one rank; its making and closing are collective.

    Parameters
    ----------
    channel : to the other ranks
    wire_format : of the first bricks, for which codecs are compiled
    time_budget : of this rank

    Attributes
    ----------
    bytes_sent, bytes_raw : so far, packed and not packed
    bytes_opened : bytes unpacked so far
    bricks_stored : so far
    """

    def __init__(self, channel: Channel, wire_format: WireFormat, time_budget: TimeBudget) -> None:
        self._channel, self._time_budget = channel.duplicate(), time_budget
        nodes = len(channel.nodes())
        if wire_format.most_bytes(0) > MIN_BYTES:  # smaller ones are never packed
            compile_codecs(channel)
        self._pack = packer("auto", default_network(nodes), nodes)
        self._outgoing: deque[_Outgoing] = deque()
        self._awaited: list[_Awaited] = []
        self._arrived: deque[tuple[_Awaited, int]] = deque()
        self._whole: deque[_Incoming] = deque()
        self._numbers = 0
        self._messages: dict[tuple[int, int], int] = defaultdict(int)
        self.bytes_sent = self.bytes_raw = self.bytes_opened = self.bricks_stored = 0

    def post(self, flights: Sequence[Flight], wire_format: WireFormat) -> range:
        """Post receives for flights to this rank, and queue flights from it for `send`.

        Returns numbers of the flights, the same on every rank.

        Parameters
        ----------
        flights : of all ranks, the same on each
        wire_format : of their bricks
        """
        numbers = range(self._numbers, self._numbers + len(flights))
        self._numbers = numbers.stop
        with self._time_budget.step("post" if flights else ""):
            for number, flight in zip(numbers, flights, strict=True):
                route, own = (flight.source, flight.target), wire_format.of(flight.brick)
                tags = range(self._messages[route], self._messages[route] + own.parts)
                self._messages[route] = tags.stop
                if flight.source == self._channel.rank:
                    self._outgoing.append(_Outgoing(flight, own, tags))
                elif flight.target == self._channel.rank:
                    self._expect(_Incoming(number, flight, own, perf_counter(), own.parts), tags)
        return numbers

    def send(self, read: Read) -> None:
        """Send parts of bricks while there is time.

        `read`: returns a stored brick; None if this rank has dropped it, or stores it in another format.
        """
        while self._outgoing and self._send_part(self._outgoing[0], read):
            if self._outgoing[0].sent == self._outgoing[0].wire_format.parts:
                self._outgoing.popleft()

    def collect(self, store: Store) -> Delivery:
        """Unpack parts that have arrived, and store bricks that are complete, while there is time.

        `store`: called with each brick, the stamp of its storage format and its data; returns False if it is outdated.
        """
        delivery = Delivery()
        with self._time_budget.step():
            while done := dict(self._channel.test_some([each.pending for each in self._awaited])):
                self._arrived.extend((self._awaited[at], size) for at, size in done.items())
                self._awaited = [each for at, each in enumerate(self._awaited) if at not in done]
        while self._store_brick(store, delivery) if self._whole else self._open_part():
            pass
        return delivery

    def void(self) -> None:
        """Make all flights void: no more work is done for them, and they count as lost when they end."""
        parts = (*self._awaited, *(part for part, _ in self._arrived))
        for brick in (*self._whole, *(part.brick for part in parts)):
            brick.is_void = True
        for outgoing in self._outgoing:
            outgoing.is_void = True

    def close(self) -> None:
        """Complete all messages and close the channel; collective."""
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

    def _send_part(self, brick: _Outgoing, read: Read) -> bool:
        """Send the next part of a brick, an empty message if it is void; False if there was no time."""
        size, message, target = brick.wire_format.most_bytes(brick.sent), NOTHING, brick.flight.target
        if not brick.is_void and brick.stream is None and not self._read(brick, read):
            return False
        if brick.stream is not None and not brick.is_void:
            if not self._time_budget.allows("pack", size):
                return False

            def pack(pixels: Pixels, rows: Rows) -> Bytes:
                return self._pack(pixels, rows, (0, target))

            with self._time_budget.step("pack", size):
                message = brick.wire_format.wrap(brick.flight.brick, brick.voxels, brick.stream, brick.sent, pack)
                self._channel.isend(message, target, brick.tags[brick.sent] % TAGS)
            self.bytes_raw += size
            self.bytes_sent += message.nbytes
        else:
            self._channel.isend(message, target, brick.tags[brick.sent] % TAGS)
        brick.sent += 1
        return True

    def _read(self, brick: _Outgoing, read: Read) -> bool:
        """Read a brick, or make it void if it is not here; False if there was no time."""
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

    def _open_part(self) -> bool:
        """Unpack the next part that has arrived; False if there was none, or no time."""
        if not self._arrived:
            return False
        part, size = self._arrived[0]
        brick = part.brick
        if not brick.is_void:
            unpacked = part.buffer.nbytes
            if not self._time_budget.allows("open", unpacked):
                return False
            with self._time_budget.step("open", unpacked):
                self._unwrap(part, size)
            self.bytes_opened += unpacked
        self._arrived.popleft()
        brick.missing -= 1
        brick.bytes += size
        if brick.missing == 0:
            self._whole.append(brick)
        return True

    def _unwrap(self, part: _Awaited, size: int) -> None:
        """Unpack a part into its brick; a damaged part makes the brick void, and its sender still draws it."""
        brick = part.brick
        if brick.stream is None:
            brick.stream = np.empty(brick.wire_format.stream_bytes, np.uint8)
        try:
            brick.voxels = brick.wire_format.unwrap(part.buffer[:size], brick.flight.brick, part.number, brick.stream)
        except CodecError:
            brick.is_void = True

    def _store_brick(self, store: Store, delivery: Delivery) -> bool:
        """Store the first complete brick; False if there was no time."""
        brick = self._whole[0]
        flight, wire_format = brick.flight, brick.wire_format
        if brick.is_void or brick.stream is None:
            delivery.lost.append(brick.number)
        else:
            if not self._time_budget.allows("store", wire_format.stream_bytes):
                return False
            with self._time_budget.step("store", wire_format.stream_bytes):
                is_stored = store(flight.brick, wire_format.stamp, wire_format.brick(brick.stream, brick.voxels))
            (delivery.arrived if is_stored else delivery.lost).append(brick.number)
            self.bricks_stored += is_stored
        self._whole.popleft()
        details = {"brick": flight.brick, "from": flight.source, "bytes": brick.bytes}
        delivery.spans.append(Span("brick", "migrate", brick.posted, perf_counter(), details))
        return True
