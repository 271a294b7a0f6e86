"""How wide the CPU's vectors are; see `clusterviz.spmd.width`."""

from __future__ import annotations

from clusterviz.spmd.width import WIDTHS, Width, cpu_name, host_width

__all__ = ["WIDTHS", "Width", "cpu_name", "host_width"]
