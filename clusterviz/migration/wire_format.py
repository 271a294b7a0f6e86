"""Bricks as bytes on their way from rank to rank: as they are stored, in pieces, packed where that pays, and checked.

A brick's samples and the ranges of its groups of cells are one stream of bytes, cut into pieces so that no rank works
on one for long. A piece is a header and a message of `codec`. Whatever is damaged on the way is found: the header holds
a checksum of all that the piece stands for.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.codec.contract import Bytes, CodecError, Pixels, Rows
from clusterviz.codec.message import unpack
from clusterviz.data.source import Index
from clusterviz.plan.plan import Plan
from clusterviz.render.storage import STORED_TYPE, Slot, slot_of
from clusterviz.render.stored_brick import Stored, stamp_of

Pack = Callable[[Pixels, Rows], Bytes]
HEADER = np.dtype([("checksum", "<u4"), ("stamp", "<u4"), ("voxels", "<i8"), ("brick", "<i4", 3), ("number", "<i4")])
PIECE_BYTES = 1 << 18  # of a stream: four times what codecs ask for, and a fraction of a millisecond's work
# Pixels of as many bytes a component, so that codecs know what belongs together.
PIXEL: dict[str, np.dtype[Any]] = {
    "u8": np.dtype(np.uint8),
    "u16": np.dtype(np.float16),
    "f32": np.dtype(np.float32),
}


@dataclass(frozen=True)
class WireFormat:
    """What parcels of one frame have in common; sender and receiver have it alike.

    Attributes
    ----------
    slot : in which bricks lie
    dtype : of what is known of groups of cells: that of the volume's voxels, float64 of several volumes
    stamp : of how they are stored; another plan's may differ
    piece_bytes : of a stream, a multiple of 16
    """

    slot: Slot
    dtype: np.dtype[Any]
    stamp: int
    piece_bytes: int

    def of(self, brick: Index) -> WireFormat:
        """Those of one brick, where sizes differ."""
        return self if self.slot.layout is None else replace(self, slot=self.slot.at(brick))

    @property
    def range_bytes(self) -> int:
        """Of what is known of a brick's groups of cells: lows, highs, and bends where slabs are stretched."""
        bends = 8 * int(np.prod(self.slot.groups_zyx)) if self.slot.stretched else 0
        return 2 * int(np.prod(self._range_shape)) * self.dtype.itemsize + bends

    @property
    def stream_bytes(self) -> int:
        """Of a brick: its samples, its ranges, and what fills the last pixel."""
        return -(-(self.slot.sample_bytes + self.range_bytes) // self._pixel_bytes) * self._pixel_bytes

    @property
    def pieces(self) -> int:
        """Of a brick."""
        return -(-self.stream_bytes // self.piece_bytes)

    def piece(self, number: int) -> slice:
        """The bytes of a stream that a piece holds."""
        return slice(number * self.piece_bytes, min(self.stream_bytes, (number + 1) * self.piece_bytes))

    def most_bytes(self, number: int) -> int:
        """That a piece takes on its way."""
        held = self.piece(number)
        return int(HEADER.itemsize + held.stop - held.start)

    def stream(self, stored: Stored) -> Bytes:
        """A brick as bytes, uint8 (stream_bytes,)."""
        found = np.zeros(self.stream_bytes, np.uint8)
        samples = self._samples(found)
        if self.slot.parts:
            samples[:] = stored.samples
        else:
            z, y, x = stored.samples.shape
            samples[:z, :y, :x] = stored.samples
            # The last samples of a smaller brick are repeated.
            samples[z:, :y, :x] = samples[z - 1 : z, :y, :x]
            samples[:, y:, :x] = samples[:, y - 1 : y, :x]
            samples[:, :, x:] = samples[:, :, x - 1 : x]
        parts = [stored.low, stored.high] if stored.bend is None else [stored.low, stored.high, stored.bend]
        ranges = np.concatenate([_bytes(part) for part in parts])
        found[self.slot.sample_bytes : self.slot.sample_bytes + ranges.size] = ranges
        return found

    def wrap(self, brick: Index, voxels: int, stream: Bytes, number: int, pack: Pack) -> Bytes:
        """A piece of a brick's stream as it travels, uint8 (bytes,); `voxels` as of `Stored`."""
        raw = stream[self.piece(number)]
        message = pack(self._pixels(raw), Rows(0, raw.size // self._pixel_bytes))
        return np.concatenate([self._header(brick, voxels, number, raw).view(np.uint8), message])

    def unwrap(self, piece: Bytes, brick: Index, number: int, stream: Bytes) -> int:
        """Put a piece into its place in a stream; the voxels of its brick.

        Raises
        ------
        CodecError
            It is damaged, or of another brick, or of one that is stored in another way.
        """
        if piece.size <= HEADER.itemsize:
            raise CodecError(f"a piece of {piece.size} bytes holds nothing of a brick")
        header = piece[: HEADER.itemsize].copy().view(HEADER)
        room = stream[self.piece(number)]
        pixels = unpack(piece[HEADER.itemsize :], room.size // self._pixel_bytes, PIXEL[self.slot.kind])
        room[:] = _bytes(pixels)
        voxels = int(header["voxels"][0])
        if header != self._header(brick, voxels, number, room):
            raise CodecError(f"a piece that is not what was sent of brick {brick}")
        return voxels

    def brick(self, stream: Bytes, voxels: int) -> Stored:
        """The brick of a whole stream, in whose memory its samples stay."""
        ranges = stream[self.slot.sample_bytes : self.slot.sample_bytes + self.range_bytes]
        groups, shape = self.slot.groups_zyx, self._range_shape
        side = int(np.prod(shape)) * self.dtype.itemsize
        low, high = (ranges[begin : begin + side].copy().view(self.dtype).reshape(shape) for begin in (0, side))
        bend = ranges[2 * side :].copy().view(np.float32).reshape(2, *groups) if self.slot.stretched else None
        return Stored(self._samples(stream), low, high, voxels, bend)

    def _samples(self, stream: Bytes) -> NDArray[Any]:
        """The part of a stream that is samples, (z, y, x), or of several volumes the words of the slot."""
        if self.slot.parts:
            return stream[: self.slot.sample_bytes].view(np.uint32)
        return stream[: self.slot.sample_bytes].view(STORED_TYPE[self.slot.kind]).reshape(self.slot.samples_zyx)

    @property
    def _range_shape(self) -> tuple[int, ...]:
        """Of the lows, and of the highs."""
        volumes = (len(self.slot.parts),) if self.slot.parts else ()
        return (*volumes, *self.slot.groups_zyx)

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


def wire_format_of(plan: Plan, dtype: np.dtype[Any]) -> WireFormat:
    """The parcels of a plan's bricks."""
    return WireFormat(slot_of(plan), dtype, stamp_of(plan), PIECE_BYTES)


def _bytes(array: NDArray[Any]) -> Bytes:
    return np.ascontiguousarray(array).reshape(-1).view(np.uint8)
