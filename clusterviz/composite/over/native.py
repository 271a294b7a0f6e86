"""Compiled kernels as object files: numba compiles them once, later runs load them without numba.

numba's own cache would need numba to be imported, and keep code whose imported parts have changed.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from clusterviz.kernels.objects import function_address, machine

Kernel = Callable[[int], int]

# What kernels are made from.
_PARTS = ("job_layout", "vector_code", "merge_code", "instructions", "places", "merging_pixels", "sums")
USUAL = (("layer_kernels", "blend_layers"), ("pair_kernels", "put"))
"""Module and name of the kernels that every composition needs."""
SOURCES = (*_PARTS, "layer_kernels", "pair_kernels", "depth_kernels")


@cache
def kernel(module: str, name: str) -> Kernel:
    """A function of a module of this room, compiled: it takes the address of a job and writes its answer there.

    Made by the first process that needs it, where a file can be kept, and loaded from then on. It needs no lock of
    Python's, so threads run it at once.
    """
    address = function_address(name, sources(), lambda: _compile(module, name))
    function = ctypes.CFUNCTYPE(ctypes.c_int, *[ctypes.c_int64] * 3)(address)
    # numba's way to call: where the result goes, where an exception would go (there is none), and the job.
    return lambda job: function(job, job + 8, job)


def sources() -> list[bytes]:
    """What the files hold that kernels are made from."""
    return [Path(__file__).with_name(f"{source}.py").read_bytes() for source in SOURCES]


def _compile(module: str, name: str) -> bytes:
    """An object file with one function of this name."""
    import llvmlite.binding as llvm  # type: ignore[import-untyped]
    from numba import int64, njit

    function = getattr(import_module(f"clusterviz.composite.over.{module}"), name)
    # Nothing in the file may call Python, so numba shall not write the functions by which Python would call it.
    options: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    compiled = njit(error_model="numpy", **options)(function)
    compiled.compile((int64,))
    text = compiled.inspect_llvm((int64,))
    unit = llvm.parse_assembly(text)
    mangled = compiled.overloads[int64,].fndesc.llvm_func_name
    unit.get_function(mangled).name = name
    code: bytes = machine().emit_object(unit)
    return code
