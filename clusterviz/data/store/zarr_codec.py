"""Bricks of wavelets as a codec of Zarr 3, for zarr-python and what reads through it; found by an entry point.

zarr-python is imported here only: clusterviz reads and writes the stores that it made without it.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from zarr.abc.codec import ArrayBytesCodec
from zarr.core.common import parse_named_configuration

from clusterviz.data.source import Index, as_index
from clusterviz.data.store.wavelet import EFFORT, decode_brick, encode_brick
from clusterviz.errors import DataError

if TYPE_CHECKING:
    from zarr.core.array_spec import ArraySpec
    from zarr.core.buffer import Buffer, NDBuffer

NAME = "clusterviz.wavelet"


@dataclass(frozen=True)
class WaveletCodec(ArrayBytesCodec):
    """Codec of chunks with up to three axes longer than 1; parameters as of `encode_brick`."""

    is_fixed_size = False
    error: float = 0.0
    effort: int = EFFORT

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Self:
        _, found = parse_named_configuration(data, NAME, require_configuration=False)
        configuration: Any = found or {}
        return cls(**configuration)

    def to_dict(self) -> dict[str, Any]:
        return {"name": NAME, "configuration": {"error": self.error, "effort": self.effort}}

    async def _decode_single(self, chunk_bytes: Buffer, chunk_spec: ArraySpec) -> NDBuffer:
        data = chunk_bytes.as_numpy_array().data
        dtype: np.dtype[Any] = chunk_spec.dtype.to_native_dtype().newbyteorder("=")
        samples: Any = await asyncio.to_thread(decode_brick, data, _three_axes(chunk_spec.shape), dtype, NAME)
        return chunk_spec.prototype.nd_buffer.from_ndarray_like(samples.reshape(chunk_spec.shape))

    async def _encode_single(self, chunk_array: NDBuffer, chunk_spec: ArraySpec) -> Buffer:
        samples = chunk_array.as_numpy_array()
        samples = samples.astype(samples.dtype.newbyteorder("="), copy=False).reshape(_three_axes(samples.shape))
        data = await asyncio.to_thread(encode_brick, samples, self.error, self.effort)
        return chunk_spec.prototype.buffer.from_bytes(data)

    def compute_encoded_size(self, input_byte_length: int, _chunk_spec: ArraySpec) -> int:
        raise NotImplementedError


def _three_axes(shape: tuple[int, ...]) -> Index:
    if any(side != 1 for side in shape[:-3]):
        raise DataError("not a brick", where=NAME, found=shape, allowed="chunks of 1 along all but the last three axes")
    return as_index((1, 1, 1, *shape)[-3:])
