"""Kernels that tests run."""

from __future__ import annotations

from typing import Any

from clusterviz import jobs


@jobs.kernel("smooth.glsl", writes=("dst",))
def smooth(src: Any, dst: Any, weight: float) -> None:
    """Weighted mean of a voxel and its six neighbours."""
