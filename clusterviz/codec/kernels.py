"""Compiled loops of the codecs, which need numba only where no object file holds them."""

from __future__ import annotations

from pathlib import Path

from clusterviz.kernels.compiled import CompiledKernel

TILE = 256  # pixels that `split_planes` and `join_planes` keep in the first-level cache
_SOURCES = [
    Path(__file__).with_name(f"{name}.py") for name in ("active_kernels", "filter_kernels", "intrinsics", "kernels")
]


def _kernel(module: str, name: str, arguments: str, results: int = 0) -> CompiledKernel:
    return CompiledKernel(f"clusterviz.codec.{module}", name, arguments, _SOURCES, results)


make_mask = _kernel("active_kernels", "make_mask", "uint8[::1]; int64; uint64[::1]")
find_runs = _kernel("active_kernels", "find_runs", "uint64[::1]; int64; int32[:,::1]", 2)
check_runs = _kernel("active_kernels", "check_runs", "int32[:,::1]; int64", 1)
gather = _kernel("active_kernels", "gather", "uint8[::1]; int32[:,::1]; int64; uint8[::1]")
scatter = _kernel("active_kernels", "scatter", "uint8[::1]; int32[:,::1]; int64; uint8[::1]")
find_box = _kernel("active_kernels", "find_box", "uint64[::1]; int64; int64; int64", 4)
add = _kernel("filter_kernels", "add", "uint8[::1]; int64; uint8[::1]")
split_planes = _kernel("filter_kernels", "split_planes", "uint8[::1]; int64; uint8[::1]; uint8[::1]")
join_planes = _kernel("filter_kernels", "join_planes", "uint8[::1]; int64; uint8[::1]; uint8[::1]")
subtract = {  # by the bytes of a number
    size: _kernel("filter_kernels", f"subtract-int{8 * size}", f"int{8 * size}[::1]; int{8 * size}[::1]")
    for size in (1, 2, 4)
}
KERNELS = (
    *(make_mask, find_runs, check_runs, gather, scatter, find_box, add, split_planes, join_planes),
    *subtract.values(),
)
