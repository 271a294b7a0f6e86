"""Wire format of bricks: samples, value ranges, primitives, tetrahedra, in parts, packed by a codec, with checksums.

A brick's samples, the value ranges of its groups of cells, its primitives and tetrahedra are one stream of bytes. It
is divided into parts that take little time each. A message is a header and a part packed by `clusterviz.codec`. The
header has a checksum of itself and of the unpacked part, so damage is detected.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.codec.contract import Bytes, CodecError, Pixels, Rows
from clusterviz.codec.message import unpack
from clusterviz.data.source import Index
from clusterviz.plan.geometry import Layer, Members
from clusterviz.plan.plan import Plan
from clusterviz.render.content_bricks import pack_parts, parts_of
from clusterviz.render.storage import STORED_TYPE, Slot, slot_of
from clusterviz.render.stored_brick import Part, Stored, stamp_of

Pack = Callable[[Pixels, Rows], Bytes]
HEADER = np.dtype([("checksum", "<u4"), ("stamp", "<u4"), ("voxels", "<i8"), ("brick", "<i4", 3), ("number", "<i4")])
PART_BYTES = 1 << 18  # of a stream: four times the least size of codecs, and a fraction of a millisecond of work
# Codecs treat samples as the components of pixels of the same size.
PIXEL: dict[str, np.dtype[Any]] = {"u8": np.dtype(np.uint8), "u16": np.dtype(np.float16), "f32": np.dtype(np.float32)}


@dataclass(frozen=True)
class WireFormat:
    """Wire format of the bricks of one frame, the same for sender and receiver."""

    slot: Slot  # of the bricks in memory
    stamp: int  # of the storage format, which depends on the plan
    part_bytes: int  # length of a part of the stream, a multiple of 16
    # of geometry and of unstructured grids
    layers: tuple[Layer, ...] = field(default=(), compare=False)
    index_zyx: Index | None = None  # of the brick, if it has any, or is one of several volumes

    def of(self, brick: Index) -> WireFormat:
        """Return the wire format of one brick, as sizes may differ."""
        if self.layers or self.slot.mixed:
            return replace(self, index_zyx=brick)
        return self if self.slot.layout is None else replace(self, slot=self.slot.at(brick))

    @property
    def range_bytes(self) -> int:
        """Bytes of a brick's value ranges: lows, highs, and for the adaptive step bends of groups of cells."""
        bends = 8 * int(np.prod(self.slot.groups_zyx)) if self.slot.adaptive else 0
        return 16 * int(np.prod(self._range_shape)) + bends

    @property
    def stream_bytes(self) -> int:
        """Bytes of a brick's stream: samples, value ranges, primitives, and padding to a whole pixel."""
        used = self.slot.sample_bytes + self.range_bytes
        used += sum(int(layer.nbytes[self.index_zyx]) for layer in self.layers if self.index_zyx is not None)
        return -(-used // self._pixel_bytes) * self._pixel_bytes

    @property
    def parts(self) -> int:
        """Number of parts of a brick."""
        return -(-self.stream_bytes // self.part_bytes)

    def part(self, number: int) -> slice:
        """Return the bytes of a stream that are in a part."""
        return slice(number * self.part_bytes, min(self.stream_bytes, (number + 1) * self.part_bytes))

    def most_bytes(self, number: int) -> int:
        """Return the largest size of the message with a part, in bytes."""
        held = self.part(number)
        return int(HEADER.itemsize + held.stop - held.start)

    def stream(self, stored: Stored) -> Bytes:
        """Return a brick as bytes, uint8 (stream_bytes,)."""
        found = np.zeros(self.stream_bytes, np.uint8)
        samples = self._samples(found)
        if self.slot.mixed:
            samples[:] = pack_parts(stored.parts, self.slot)
        else:
            own: NDArray[Any] = stored.parts[0].samples  # type: ignore[union-attr]
            z, y, x = own.shape
            samples[:z, :y, :x] = own
            # The last samples of a smaller brick are repeated.
            samples[z:, :y, :x] = samples[z - 1 : z, :y, :x]
            samples[:, y:, :x] = samples[:, y - 1 : y, :x]
            samples[:, :, x:] = samples[:, :, x - 1 : x]
        parts = [stored.low, stored.high] if stored.bend is None else [stored.low, stored.high, stored.bend]
        parts += [array for one in stored.members if one for array in vars(one).values()]
        rest = np.concatenate([_bytes(part) for part in parts])
        found[self.slot.sample_bytes : self.slot.sample_bytes + rest.size] = rest
        return found

    def wrap(self, brick: Index, voxels: int, stream: Bytes, number: int, pack: Pack) -> Bytes:
        """Return the message with a part of a brick's stream, uint8 (bytes,); `voxels` as in `Stored`."""
        raw = stream[self.part(number)]
        message = pack(self._pixels(raw), Rows(0, raw.size // self._pixel_bytes))
        return np.concatenate([self._header(brick, voxels, number, raw).view(np.uint8), message])

    def unwrap(self, message: Bytes, brick: Index, number: int, stream: Bytes) -> int:
        """Unpack a message into its part of a stream; returns `voxels` as in `Stored`.

        Raises CodecError if the message is damaged, or of another brick or storage format.
        """
        if message.size <= HEADER.itemsize:
            raise CodecError(f"a message of {message.size} bytes has no part of a brick")
        header = message[: HEADER.itemsize].copy().view(HEADER)
        part = stream[self.part(number)]
        pixels = unpack(message[HEADER.itemsize :], part.size // self._pixel_bytes, PIXEL[self.slot.kind])
        part[:] = _bytes(pixels)
        voxels = int(header["voxels"][0])
        if header != self._header(brick, voxels, number, part):
            raise CodecError(f"a message differs from the one that was sent of brick {brick}")
        return voxels

    def brick(self, stream: Bytes, voxels: int) -> Stored:
        """Return the brick of a complete stream; its samples are a view of the stream."""
        ranges = stream[self.slot.sample_bytes : self.slot.sample_bytes + self.range_bytes]
        groups, shape = self.slot.groups_zyx, self._range_shape
        side = 8 * int(np.prod(shape))
        low, high = (ranges[begin : begin + side].copy().view(np.float64).reshape(shape) for begin in (0, side))
        bend = ranges[2 * side :].copy().view(np.float32).reshape(2, *groups) if self.slot.adaptive else None
        samples = self._samples(stream)
        parts = parts_of(samples, self.slot) if self.slot.mixed else [Part(samples)]
        return Stored(parts, low, high, voxels, bend, tuple(self._members(stream)))

    def _members(self, stream: Bytes) -> Iterator[Members | None]:
        """Yield what the brick has of each layer, copied from a stream; None where there is nothing."""
        begin = self.slot.sample_bytes + self.range_bytes
        for layer in self.layers:
            members, positions = (int(count[self.index_zyx]) for count in layer.in_bricks)
            arrays: dict[str, NDArray[Any]] = {}
            for name, (shape, dtype) in layer.forms(members, positions).items() if members else ():
                end = begin + int(np.prod(shape)) * dtype.itemsize
                arrays[name], begin = stream[begin:end].copy().view(dtype).reshape(shape), end
            yield layer.holds(**arrays) if members else None

    def _samples(self, stream: Bytes) -> NDArray[Any]:
        """Return the samples in a stream, (z, y, x), or for several volumes the words of the slot."""
        if self.slot.mixed:
            return stream[: self.slot.sample_bytes].view(np.uint32)
        return stream[: self.slot.sample_bytes].view(STORED_TYPE[self.slot.kind]).reshape(self.slot.samples_zyx)

    @property
    def _range_shape(self) -> tuple[int, ...]:
        """Shape of the lows, and of the highs."""
        if self.slot.group_box is None or self.index_zyx is None:
            return (1, *self.slot.groups_zyx)
        return (len(self.slot.parts), *self.slot.group_box.shape_of(self.index_zyx))

    @property
    def _pixel_bytes(self) -> int:
        return 4 * PIXEL[self.slot.kind].itemsize

    def _pixels(self, raw: Bytes) -> Pixels:
        return raw.view(PIXEL[self.slot.kind]).reshape(-1, 4)

    def _header(self, brick: Index, voxels: int, number: int, raw: Bytes) -> NDArray[np.void]:
        header = np.zeros(1, HEADER)
        header["stamp"], header["voxels"], header["brick"], header["number"] = self.stamp, voxels, brick, number
        header["checksum"] = zlib.crc32(raw.data, zlib.crc32(header.tobytes()))
        return header


def wire_format_of(plan: Plan) -> WireFormat:
    """Return the wire format of a plan's bricks."""
    return WireFormat(slot_of(plan), stamp_of(plan), PART_BYTES, plan.content.layers)


def _bytes(array: NDArray[Any]) -> Bytes:
    return np.ascontiguousarray(array).reshape(-1).view(np.uint8)
