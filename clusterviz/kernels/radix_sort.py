"""Radix sort of 32-bit keys: the order of primitives by depth.

The least significant digit of 8 bits comes first. One pass over the keys counts all four digits; a digit that all keys
share needs no pass. With several threads, each moves a part of the items, and counts the later digits of its part
again.

Reference: S. P. Callahan, M. Ikits, J. L. D. Comba, C. T. Silva: Hardware-assisted visibility sorting for unstructured
volume rendering, IEEE TVCG 11(3), 2005, section 5.1. (The signs of its formula for negative numbers are lost in print.)
"""

from __future__ import annotations

from concurrent.futures import Executor, ThreadPoolExecutor
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.kernels.compiled import CompiledKernel

LEAST = 1 << 15  # keys of a task
_SOURCES = [Path(__file__).with_name("radix_kernel.py")]


def _kernel(name: str, arguments: str) -> CompiledKernel:
    return CompiledKernel("clusterviz.kernels.radix_kernel", name, arguments, _SOURCES)


_COUNT_ALL = _kernel("count_digits", "uint32[::1]; int64; int64[:,::1]")
_COUNT = _kernel("count_digit", "uint64[::1]; int64; int64[::1]")
_KEYS = _kernel("scatter_keys", "uint32[::1]; int64; int64; int64; uint64[::1]; uint64[::1]")
_ITEMS = _kernel("scatter_items", "uint64[::1]; int64; uint64[::1]; uint64[::1]")
_NUMBERS = _kernel("scatter_numbers", "uint64[::1]; int64; uint64[::1]; uint32[::1]")


def sorted_order(keys: NDArray[Any], threads: int = 1) -> NDArray[np.uint32]:
    """Return the order that sorts keys, uint32 (n,); equal keys keep their order.

    `keys`: float32 or uint32 (n,), n < 2³²; −0 is less than 0, and NaN is beyond all numbers, on the side of its sign.
    `threads`: of the work; the order does not depend on them.
    """
    count = max(1, min(threads, len(keys) // LEAST))
    with ThreadPoolExecutor(count) as pool:
        return _sort(np.ascontiguousarray(keys).view(np.uint32), int(keys.dtype.kind == "f"), count, pool)


def _sort(bits: NDArray[np.uint32], signed: int, count: int, pool: Executor) -> NDArray[np.uint32]:
    edges = [len(bits) * n // count for n in range(count + 1)]
    parts = [slice(a, b) for a, b in pairwise(edges)]
    counts = np.zeros((count, 4, 256), np.int64)
    list(pool.map(lambda part, own: _COUNT_ALL(bits[part], signed, own), parts, counts))
    digits = [n for n in range(4) if counts[:, n].sum(axis=0).max() < len(bits)] or [3]
    if len(digits) == 1:  # items are made in one pass, and their numbers written in another one
        digits = [digits[0], digits[0]]
    items, target = np.empty(0, np.uint64), np.empty(len(bits), np.uint64)
    order = np.empty(len(bits), np.uint32)
    for step, digit in enumerate(digits):
        own, shift = counts[:, digit].copy(), 32 + 8 * digit
        if step and count > 1:
            own[:] = 0
            list(pool.map(lambda part, to: _COUNT(items[part], shift, to), parts, own))  # noqa: B023 - used at once
        # Of each digit, the items of the first thread come first.
        ends = np.cumsum(own.T).reshape(256, count).T
        places = np.ascontiguousarray(ends - own).view(np.uint64)
        if not step:
            list(pool.map(lambda p, a, to: _KEYS(bits[p], signed, a, shift, to, target), parts, edges, places))  # noqa: B023
        elif step < len(digits) - 1:
            list(pool.map(lambda p, to: _ITEMS(items[p], shift, to, target), parts, places))  # noqa: B023
        else:
            list(pool.map(lambda p, to: _NUMBERS(items[p], shift, to, order), parts, places))  # noqa: B023
        items, target = target, (items if len(items) else np.empty(len(bits), np.uint64))
    return order
