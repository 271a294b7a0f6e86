"""Object files of the kernels: compiled once by numba, loaded by later runs without numba.

numba's own cache needs numba to be imported, and does not notice when imported parts of a kernel change.
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

# Modules from which kernels are made.
_PARTS = ("job", "vector_code", "intrinsics", "geometry", "merging_pixels")
COMMON_KERNELS = (("layer_kernels", "blend_layers"), ("pair_kernels", "put"))
"""Module and name of the kernels that all compositing needs."""
SOURCES = (*_PARTS, "layer_kernels", "pair_kernels", "depth_kernels")


@cache
def kernel(module: str, name: str) -> Kernel:
    """Return a compiled kernel of a module of this package: a function of the address of a job.

    The kernel writes its result into the job. It is compiled by the first process that needs it and saved if possible.
    It runs without Python's lock, so several threads can call it at once.
    """
    address = function_address(name, sources(), lambda: _compile(module, name))
    function = ctypes.CFUNCTYPE(ctypes.c_int, *[ctypes.c_int64] * 3)(address)
    # numba's calling convention: address of the result, address of an exception (there is none), and the job.
    return lambda job: function(job, job + 8, job)


def sources() -> list[bytes]:
    """Return the contents of the modules from which kernels are made."""
    return [Path(__file__).with_name(f"{source}.py").read_bytes() for source in SOURCES]


def _compile(module: str, name: str) -> bytes:
    """Return an object file with one function of this name."""
    import llvmlite.binding as llvm  # type: ignore[import-untyped]
    from numba import int64, njit

    function = getattr(import_module(f"clusterviz.composite.over.{module}"), name)
    # The file may not call Python, so numba does not write the wrappers for calls from Python.
    options: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    compiled = njit(error_model="numpy", **options)(function)
    compiled.compile((int64,))
    text = compiled.inspect_llvm((int64,))
    unit = llvm.parse_assembly(text)
    mangled = compiled.overloads[int64,].fndesc.llvm_func_name
    unit.get_function(mangled).name = name
    code: bytes = machine().emit_object(unit)
    return code
