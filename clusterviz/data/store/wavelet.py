"""Codec of bricks: linear spline wavelets by lifting, byte planes, and zstd.

What: samples become unsigned numbers in the same order. Every second one along each axis is kept, the others are
replaced by what linear interpolation between their neighbours lacks; this is repeated until one sample is left. zstd
packs the residuals, or the numbers themselves where these get shorter, as labels do.
When: measured or simulated fields, exact or with a stated error. When not: random numbers, which nothing makes shorter.
Cost: 2 to 6 GB/s to transform one way or the other, so zstd decides.

Maximum error. Both sides predict from *decoded* samples, in integers, so they predict the same. The encoder rounds the
distance from the prediction to the nearest multiple of the odd step 2e + 1, which leaves at most e. Clamping to the
range of the type, in which the sample lies, brings the result no farther from it. So every sample is at most e away,
whatever happened to its neighbours: errors do not add up. The second lifting step, which updates the kept samples, is
left out, since it would add the errors of several residuals. For integers e is the whole part of the error asked for;
those whose range in the brick takes more than 32 bits are kept exactly.
Floats are first rounded to multiples of h, which leaves h/2; with e = 127 of these multiples the sum is 127.5 h, the
error asked for. Rounding of the conversion itself is not bounded this way; so the encoder decodes what it wrote, and
keeps a brick exactly if a sample of it is too far away or not finite.

Bytes of a brick, little-endian: "cvw1"; method, 0 for plain numbers and 1 for residuals, and bytes of a number, a byte
each; two zeros; step, uint32; offset, uint64; low and spacing, float64; entries of the table and its bytes, uint32; as
in `_Numbers`. Then the differences of the table's keys, and the byte planes of the numbers, each as a frame of zstd.
Numbers of two bytes are split in pairs, into four planes.
A brick whose samples are those of an earlier time step is "cvr1" and the number of the step, uint32, alone.

References
----------
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 5.3.5.
W. Sweldens: The lifting scheme, SIAM J. Math. Anal. 29(2), 1998.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, field
from pathlib import Path
from threading import local
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.codec import kernels
from clusterviz.data.order_statistics import keys_of, samples_of
from clusterviz.data.source import Index
from clusterviz.errors import DataError
from clusterviz.kernels.compiled import CompiledKernel

MOST_EFFORT, EFFORT = 22, 1
"""Levels of zstd: the highest, and the default."""
LARGEST_ERROR = 1 << 30
"""Of whole numbers; more are kept closer."""
SAMPLED = 4096
"""Samples of a brick among which few different values mean that it may have few."""
_HEADER = struct.Struct("<4sBB2xIQddII")
_MAGIC = b"cvw1"
_REFERENCE = struct.Struct("<4sI")
_REFERS = b"cvr1"
_PLAIN, _LIFTED = 0, 1
_MULTIPLES = 127
"""Largest error of a brick of floats, in the multiples to which they are rounded first."""
_SOURCES = [Path(__file__).with_name("wavelet_kernels.py"), Path(str(kernels.__file__)).with_name("intrinsics.py")]


def _kernel(dtype: str) -> CompiledKernel:
    array = f"{dtype}[::1]"
    arguments = f"int64; {array}; int64; int64; int64; int64; {array}; {array}; {array}"
    return CompiledKernel("clusterviz.data.store.wavelet_kernels", f"transform-{dtype}", arguments, _SOURCES)


TRANSFORMS = {size: _kernel(f"uint{8 * size}") for size in (1, 2, 4, 8)}
"""Compiled lifting by the bytes of a number."""
_scratch = local()


@dataclass(frozen=True)
class _Numbers:
    """What the unsigned numbers of a brick stand for.

    Attributes
    ----------
    step : of residuals; odd
    offset : added to numbers, which gives keys
    low, spacing : samples are low + spacing · number, if `spacing` is not 0
    table : keys by number, ascending; empty: numbers are keys less the offset
    """

    step: int = 1
    offset: int = 0
    low: float = 0.0
    spacing: float = 0.0
    table: NDArray[Any] = field(default_factory=lambda: np.empty(0, np.uint8))


def encode_brick(samples: NDArray[Any], error: float = 0.0, effort: int = EFFORT) -> bytes:
    """Return a brick as bytes.

    Parameters
    ----------
    samples : any integer or float type of up to 64 bits, three axes, each at least 1
    error : largest difference between a sample and the decoded one; 0: bit for bit
    """
    samples = np.ascontiguousarray(samples)
    if error > 0 and samples.dtype.kind == "f":
        data = _encode_rounded(samples, error, effort)
        if data is not None:
            return data
        error = 0.0
    keys = keys_of(samples.ravel())
    low, high = int(keys.min()), int(keys.max())
    width = _width(high - low)
    # No number of this width may be beyond the keys, since decoded ones may be larger than all that were encoded.
    offset = min(low, (1 << 8 * keys.itemsize) - (1 << 8 * width))
    step = 2 * int(min(error, LARGEST_ERROR)) + 1 if width < 8 else 1
    numbers = (keys - keys.dtype.type(offset)).astype(f"u{width}", copy=False) if offset else keys
    data = _pack(numbers.astype(f"u{width}", copy=False), samples.shape, _Numbers(step, offset), effort)
    table = _few_values(keys) if error < 1 else None
    if table is None:
        return data
    numbers = np.searchsorted(table, keys).astype(f"u{_width(len(table) - 1)}")
    return min(data, _pack(numbers, samples.shape, _Numbers(table=table), effort), key=len)


def encode_reference(step: int) -> bytes:
    """Return the bytes of a brick whose samples are those of an earlier time step."""
    return _REFERENCE.pack(_REFERS, step)


def referred_step(data: bytes) -> int | None:
    """Return the time step whose samples a brick has; None if it has samples of its own."""
    if len(data) != _REFERENCE.size or data[:4] != _REFERS:
        return None
    step: int = _REFERENCE.unpack(data)[1]
    return step


def _width(largest: float) -> int:
    return next(size for size in (1, 2, 4, 8) if largest < 1 << (8 * size))


def _few_values(keys: NDArray[Any]) -> NDArray[Any] | None:
    """Return the different keys if these are few for their range; None if not, or if they need all bits anyway."""
    some = keys[:: max(1, keys.size // SAMPLED)]
    found = np.unique(some)
    if keys.itemsize == 1 or 2 * len(found) > min(len(some), int(found[-1]) - int(found[0])):
        return None
    table = np.unique(keys)
    return table if len(table) <= 1 << 16 and 2 * len(table) <= int(table[-1]) - int(table[0]) else None


def _encode_rounded(samples: NDArray[Any], error: float, effort: int) -> bytes | None:
    values = samples.ravel().astype(np.float64)
    low, high = float(values.min()), float(values.max())
    # Decoded samples are rounded to their type.
    rounding = float(np.finfo(samples.dtype).eps) * max(abs(low), abs(high))
    spacing = (error - rounding) / (_MULTIPLES + 0.5)
    if not (math.isfinite(high - low) and spacing > 0 and high - low < spacing * ((1 << 32) - 1)):
        return None
    numbers = np.rint((values - low) / spacing)
    meaning = _Numbers(2 * _MULTIPLES + 1, low=low, spacing=spacing)
    data = _pack(numbers.astype(f"u{_width(numbers.max())}"), samples.shape, meaning, effort)
    decoded = decode_brick(data, samples.shape, samples.dtype).ravel()
    return data if np.abs(decoded.astype(np.float64) - values).max() <= error else None


def _pack(numbers: NDArray[Any], shape: Index, meaning: _Numbers, effort: int) -> bytes:
    count, width, step, table = numbers.size, numbers.itemsize, meaning.step, meaning.table
    as_they_are, residuals = np.zeros((2, _padded(count, width)), numbers.dtype)
    restored = np.empty(count, numbers.dtype)
    TRANSFORMS[width](1, residuals[:count], *shape, step, numbers, restored, _space(shape, numbers.dtype))
    as_they_are[:count] = restored
    planes = _split(as_they_are), _split(residuals)
    packed = [compress(each, 1, not method) for method, each in enumerate(planes)]
    method = _LIFTED if len(packed[_LIFTED]) <= len(packed[_PLAIN]) else _PLAIN
    best = packed[method] if effort == 1 else compress(planes[method], effort)
    packed_table = compress(np.diff(table, prepend=table[:1] * 0), effort) if len(table) else b""
    values = method, width, step, meaning.offset, meaning.low, meaning.spacing, len(table), len(packed_table)
    return _HEADER.pack(_MAGIC, *values) + packed_table + best


def compress(numbers: NDArray[Any], effort: int, repeats: bool = True) -> bytes:
    """Return numbers packed by zstd.

    Parameters
    ----------
    repeats : whether they may repeat in other ways than as runs; residuals do not, and level 1 then looks for runs only
    """
    import zstandard  # which may be missing

    if effort == 1 and not repeats:
        runs = {"strategy": zstandard.STRATEGY_FAST, "min_match": 7, "hash_log": 10, "window_log": 18}
        packer = zstandard.ZstdCompressor(compression_params=zstandard.ZstdCompressionParameters(**runs))
    else:
        packer = zstandard.ZstdCompressor(level=effort)
    return packer.compress(numbers.data)


def decompress(frame: memoryview, size: int, where: str) -> bytes:
    import zstandard  # which may be missing

    try:
        found = zstandard.frame_content_size(frame)
        if found == size:
            return zstandard.ZstdDecompressor().decompress(frame)
    except zstandard.ZstdError as error:
        raise DataError(f"a damaged brick: {error}", where=where) from error
    raise DataError("a damaged brick", where=where, found=f"{found} bytes", allowed=size)


def decode_brick(data: bytes | memoryview, shape: Index, dtype: np.dtype[Any], where: str = "") -> NDArray[Any]:
    view, count = memoryview(data), math.prod(shape)
    if (before := referred_step(bytes(view[: _REFERENCE.size + 1]))) is not None:
        allowed = "clusterviz, or a store of `clusterviz store --codec zstd`, which every program reads"
        raise DataError(f"a brick has the samples of time step {before}", where=where, allowed=allowed)
    if len(view) < _HEADER.size:
        raise DataError("a brick ends early", where=where, found=f"{len(view)} bytes")
    magic, method, width, step, offset, low, spacing, entries, table_bytes = _HEADER.unpack(view[: _HEADER.size])
    largest = 4 if spacing > 0 else 2 if entries else dtype.itemsize
    if magic != _MAGIC or method not in (_PLAIN, _LIFTED) or width not in (1, 2, 4, 8) or width > largest:
        raise DataError("not a brick of wavelets", where=where, found=bytes(view[:6]).hex(" "))
    if step % 2 == 0 or (step > 1 and width == 8) or entries > 1 << 16:
        raise DataError("a damaged brick", where=where, found=f"step {step}, {entries} values")
    kind, begin = np.dtype(f"u{width}"), _HEADER.size + table_bytes
    planes = decompress(view[begin:], _padded(count, width) * width, where)
    residuals = _joined(np.frombuffer(planes, kind))[:count]
    numbers = residuals.copy() if method == _PLAIN else np.empty(count, kind)
    if method == _LIFTED:
        TRANSFORMS[width](0, residuals, *shape, step, numbers, numbers, _space(shape, kind))
    if spacing > 0:
        with np.errstate(over="ignore"):
            values: NDArray[Any] = (numbers * np.float64(spacing) + low).astype(dtype)
        return values.reshape(shape)
    if entries:
        steps = decompress(view[_HEADER.size : begin], entries * dtype.itemsize, where)
        table = np.cumsum(np.frombuffer(steps, f"u{dtype.itemsize}"), dtype=f"u{dtype.itemsize}")
        keys = table.take(numbers, mode="clip")
    else:
        keys = numbers.astype(f"u{dtype.itemsize}", copy=False)
        if offset:
            keys += keys.dtype.type(offset & (1 << 8 * keys.itemsize) - 1)
    return samples_of(keys, dtype).reshape(shape)


def _padded(count: int, width: int) -> int:
    """Return the numbers that are packed: pairs of 16 bits, since byte planes are of pixels of four bytes or more."""
    return count + (count & 1 if width == 2 else 0)


def _split(numbers: NDArray[Any]) -> NDArray[np.uint8]:
    if numbers.itemsize == 1:
        return numbers.view(np.uint8)
    size, planes = max(4, numbers.itemsize), np.empty(numbers.nbytes, np.uint8)
    kernels.split_planes(numbers.view(np.uint8), size, planes, _reused("tile", size * kernels.TILE, np.uint8))
    return planes


def _joined(planes: NDArray[Any]) -> NDArray[Any]:
    """Return the numbers of byte planes, which is memory that is used again."""
    if planes.itemsize == 1:
        return planes
    size, numbers = max(4, planes.itemsize), _reused("numbers", len(planes), planes.dtype)
    tile = _reused("tile", size * kernels.TILE, np.uint8)
    kernels.join_planes(planes.view(np.uint8), size, numbers.view(np.uint8), tile)
    return numbers


def _space(shape: tuple[int, ...], dtype: np.dtype[Any]) -> NDArray[Any]:
    _, y, x = shape
    coarse = sum(math.prod(-(-side // apart) for side in shape) for apart in (2, 4))
    return _reused("space", coarse + 3 * y * (x + 1), dtype)


def _reused(name: str, count: int, dtype: Any) -> NDArray[Any]:
    """Return memory of this thread: the system takes longer to find new pages than a brick to be decoded."""
    wanted = count * np.dtype(dtype).itemsize
    memory = getattr(_scratch, name, None)
    if memory is None or memory.nbytes < wanted:
        memory = np.empty(wanted, np.uint8)
        setattr(_scratch, name, memory)
    part: NDArray[Any] = memory[:wanted].view(dtype)
    return part
