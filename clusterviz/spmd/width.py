"""How wide the CPU's vectors are."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

from clusterviz.kernels.objects import has_features


@dataclass(frozen=True)
class Width:
    lanes: int  # floats in one
    name: str  # of the instruction set, for people


WIDTHS = (Width(16, "AVX-512"), Width(8, "AVX2"), Width(4, "vectors of 4"))
_FEATURES = {16: ("avx512f", "avx512dq", "avx512bw", "avx512vl"), 8: ("avx2", "fma"), 4: ()}


@cache
def host_width() -> Width:
    """The widest vectors of this CPU."""
    return next(width for width in WIDTHS if has_features(*_FEATURES[width.lanes]))


def cpu_name(threads: int, width: Width | None = None) -> str:
    """What draws, in words: "CPU, AVX-512, 2 threads"."""
    return f"CPU, {(width or host_width()).name}, {threads} thread{'s' * (threads > 1)}"
