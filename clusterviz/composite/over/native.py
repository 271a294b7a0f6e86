"""Compiled kernels of compositing: functions of the address of a job, see `job.py`."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from clusterviz.codec import kernels
from clusterviz.kernels.compiled import CompiledKernel

COMMON_KERNELS = (("layer_kernels", "blend_layers"), ("pair_kernels", "put"))
"""Module and name of all kernels."""
SOURCES = ("job", "vector_code", "intrinsics", "geometry", "merging_pixels", "layer_kernels", "pair_kernels")


@cache
def kernel(module: str, name: str) -> CompiledKernel:
    """Return a kernel of a module of this package; several threads can call it at once."""
    paths = [Path(__file__).with_name(f"{source}.py") for source in SOURCES]
    paths.append(Path(str(kernels.__file__)).with_name("intrinsics.py"))
    return CompiledKernel(f"clusterviz.composite.over.{module}", name, "int64", paths, results=1)
