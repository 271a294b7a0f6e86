"""Bricks as bytes on their way from rank to rank: encoded as they are stored, packed where that pays, and checked.

A header, the ranges of the brick's groups of cells, and its samples as a message of `codec`. Whatever is damaged on the
way is found: the header holds a checksum of all that the message stands for.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.codec.contract import Bytes, CodecError, Pixels, Rows
from clusterviz.codec.message import unpack
from clusterviz.data.source import Index
from clusterviz.plan.plan import Plan
from clusterviz.render.storage import STORED_TYPE, Slot, slot_of
from clusterviz.render.stored import Stored

Pack = Callable[[Pixels, Rows], Bytes]
HEADER = np.dtype([("checksum", "<u4"), ("stamp", "<u4"), ("voxels", "<i8"), ("brick", "<i4", 3), ("unused", "<i4")])
# Pixels of as many bytes a component, so that codecs know what belongs together.
PIXEL: dict[str, np.dtype[Any]] = {
    "u8": np.dtype(np.uint8),
    "u16": np.dtype(np.float16),
    "f32": np.dtype(np.float32),
}


@dataclass(frozen=True)
class Parcels:
    """What parcels of one frame have in common; sender and receiver have it alike.

    Attributes
    ----------
    slot : in which bricks lie
    dtype : of the volume's voxels
    stamp : of how they are stored; another plan's may differ
    """

    slot: Slot
    dtype: np.dtype[Any]
    stamp: int

    @property
    def pixels(self) -> int:
        """Of four components, that hold a brick's samples."""
        return -(-self._sample_bytes // (4 * PIXEL[self.slot.kind].itemsize))

    @property
    def range_bytes(self) -> int:
        """Of what is known of a brick's groups of cells: lows, highs, and bends where slabs are stretched."""
        groups = int(np.prod(self.slot.groups_zyx))
        return 2 * groups * self.dtype.itemsize + (8 * groups if self.slot.stretched else 0)

    @property
    def most_bytes(self) -> int:
        """That a parcel takes."""
        return HEADER.itemsize + self.range_bytes + self.pixels * 4 * PIXEL[self.slot.kind].itemsize

    def wrap(self, brick: Index, stored: Stored, pack: Pack) -> Bytes:
        """A brick as a parcel, uint8 (bytes,)."""
        kind = PIXEL[self.slot.kind]
        missing = [(0, n - have) for n, have in zip(self.slot.samples_zyx, stored.samples.shape, strict=True)]
        samples = _bytes(np.pad(stored.samples, missing, mode="edge"))
        words = np.zeros(self.pixels * 4 * kind.itemsize, np.uint8)
        words[: samples.size] = samples
        bends = [] if stored.bend is None else [_bytes(stored.bend)]
        ranges = np.concatenate([_bytes(stored.low), _bytes(stored.high), *bends])
        header = self._header(brick, stored.voxels, ranges, words)
        message = pack(words.view(kind).reshape(-1, 4), Rows(0, self.pixels))
        return np.concatenate([header.view(np.uint8), ranges, message])

    def unwrap(self, parcel: Bytes, brick: Index) -> Stored:
        """The brick of a parcel.

        Raises
        ------
        CodecError
            It is damaged, or holds another brick, or one that is stored in another way.
        """
        body = HEADER.itemsize + self.range_bytes
        if parcel.size <= body:
            raise CodecError(f"a parcel of {parcel.size} bytes cannot hold a brick")
        header = parcel[: HEADER.itemsize].copy().view(HEADER)
        ranges = parcel[HEADER.itemsize : body]
        words = unpack(parcel[body:], self.pixels, PIXEL[self.slot.kind])
        whole = np.ascontiguousarray(words).reshape(-1).view(np.uint8)
        if header != self._header(brick, int(header["voxels"][0]), ranges, whole):
            raise CodecError(f"a parcel that is not what was sent as brick {brick}")
        samples = whole[: self._sample_bytes].view(STORED_TYPE[self.slot.kind]).reshape(self.slot.samples_zyx)
        return Stored(samples, *self._groups(ranges), int(header["voxels"][0]), self._bends(ranges))

    def _groups(self, ranges: Bytes) -> tuple[NDArray[Any], NDArray[Any]]:
        side = int(np.prod(self.slot.groups_zyx)) * self.dtype.itemsize
        low, high = (ranges[begin : begin + side].copy().view(self.dtype) for begin in (0, side))
        return low.reshape(self.slot.groups_zyx), high.reshape(self.slot.groups_zyx)

    def _bends(self, ranges: Bytes) -> NDArray[np.float32] | None:
        if not self.slot.stretched:
            return None
        bends = ranges[2 * int(np.prod(self.slot.groups_zyx)) * self.dtype.itemsize :]
        return bends.copy().view(np.float32).reshape(2, *self.slot.groups_zyx)

    @property
    def _sample_bytes(self) -> int:
        return int(np.prod(self.slot.samples_zyx)) * PIXEL[self.slot.kind].itemsize

    def _header(self, brick: Index, voxels: int, ranges: Bytes, words: Bytes) -> NDArray[np.void]:
        header = np.zeros(1, HEADER)
        header["stamp"], header["voxels"], header["brick"] = self.stamp, voxels, brick
        header["checksum"] = zlib.crc32(words.data, zlib.crc32(ranges.data, zlib.crc32(header.tobytes())))
        return header


def parcels_of(plan: Plan, dtype: np.dtype[Any]) -> Parcels:
    """The parcels of a plan's bricks."""
    return Parcels(slot_of(plan), dtype, stamp_of(plan))


def stamp_of(plan: Plan) -> int:
    """A number for how a plan's bricks are stored: bricks of another one are of no use to it."""
    # Integers are stored as they are, whatever the encoding makes of them later.
    stored = slot_of(plan), plan.encoding if plan.encoding.kind == "f32" else None
    return zlib.crc32(repr(stored).encode())


def _bytes(array: NDArray[Any]) -> Bytes:
    return np.ascontiguousarray(array).reshape(-1).view(np.uint8)
