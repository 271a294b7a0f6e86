"""Machine code of a shader for this CPU."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.gl.shader import ShaderSource
from clusterviz.kernels.objects import load_function, optimized_object
from clusterviz.spmd.codegen import Generator
from clusterviz.spmd.intrinsics import INTRINSICS
from clusterviz.spmd.memory import BUFFERS, SYSTEM_BLOCK
from clusterviz.spmd.parser import parse

Blocks = Mapping[int, NDArray[Any]]


def object_code(source: ShaderSource, name: str, lanes: int, intrinsics: bool = True) -> bytes:
    """Return an object file with a shader's `main` under another name.

    Parameters
    ----------
    lanes : of a vector: 4, 8 or 16; more than this CPU's registers hold are divided
    intrinsics : use the CPU's own ways (`intrinsics.py`), as far as this CPU has them

    Raises
    ------
    InputError
        The shader has a mistake.
    """
    import llvmlite.binding as llvm  # type: ignore[import-untyped]

    used = dict(INTRINSICS) if intrinsics else {}
    if lanes != 16 or not llvm.get_host_cpu_features().get("avx512f"):
        used.pop("piece_row", None)
    return optimized_object(Generator(parse(source), lanes, used).text(name))


def function_of(code: bytes, name: str) -> Callable[[int], None]:
    """Return a function of an object file; it takes the address of the table that `addresses` returns."""
    return ctypes.CFUNCTYPE(None, ctypes.c_void_p)(load_function(code, name))


def addresses(uniforms: Blocks, buffers: Blocks, system: NDArray[np.uint32]) -> NDArray[np.uint64]:
    """Return the table of the blocks' addresses, by their bindings; the arrays must outlive its use.

    Parameters
    ----------
    system : uint32 (7,), see `memory.SYSTEM_BLOCK`

    Returns
    -------
    table : uint64 (64,)
    """
    table = np.zeros(64, np.uint64)
    for first, blocks in ((0, uniforms), (BUFFERS, buffers)):
        for binding, block in blocks.items():
            table[first + binding] = block.__array_interface__["data"][0]
    table[SYSTEM_BLOCK] = system.__array_interface__["data"][0]
    return table
