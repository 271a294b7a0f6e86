"""Bricks packed by zfp, as `numcodecs.zfpy` of Zarr 3 has them: floats and signed integers of 32 and 64 bits.

References
----------
P. Lindstrom: Fixed-rate compressed floating-point arrays, IEEE Trans. Visualization and Computer Graphics 20(12), 2014.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.source import Index
from clusterviz.errors import DataError

NAME = "numcodecs.zfpy"
DTYPES = ("float32", "float64", "int32", "int64")
_FIXED_ACCURACY, _REVERSIBLE = 4, 5


def metadata(error: float) -> dict[str, Any]:
    mode = {"mode": _FIXED_ACCURACY, "tolerance": error} if error > 0 else {"mode": _REVERSIBLE}
    return {"name": NAME, "configuration": mode}


def encode_brick(samples: NDArray[Any], error: float = 0.0) -> bytes:
    """Return a brick as bytes.

    Parameters
    ----------
    error : largest difference between a sample and the decoded one, for floats; 0: bit for bit, as with samples that
        zfp does not keep within it
    """
    import zfpy  # which may be missing

    samples = np.ascontiguousarray(samples)
    if error > 0 and np.isfinite(samples).all():
        data: bytes = zfpy.compress_numpy(samples, tolerance=error)
        if np.abs(zfpy.decompress_numpy(data) - samples).max() <= error:
            return data
    exact: bytes = zfpy.compress_numpy(samples)
    return exact


def decode_brick(data: bytes, shape: Index, dtype: np.dtype[Any], where: str) -> NDArray[Any]:
    import zfpy  # which may be missing

    try:
        header = zfpy.header(data)
        found = tuple(header[name] for name in ("nz", "ny", "nx")), np.dtype(header["type"])
        known = found == (tuple(shape), dtype) and header["config"]["mode"] in (_FIXED_ACCURACY, _REVERSIBLE)
    except (ValueError, IndexError, KeyError, TypeError):
        known = False
    if not known:
        raise DataError("a damaged brick of zfp", where=where, allowed=f"{shape}, {dtype.name}")
    # zfp reads on behind bytes that end early.
    samples: NDArray[Any] = zfpy.decompress_numpy(bytes(data) + bytes(2 * math.prod(shape) * dtype.itemsize))
    return samples
