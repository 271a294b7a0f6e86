"""Shader files that sample a volume: fetches of its voxels, interpolation between them, and the gradient."""

from __future__ import annotations

from clusterviz.plan.plan import Filter
from clusterviz.render.storage import Slot


def voxel_file(slot: Slot) -> str:
    """Return the file that fetches voxels."""
    return "atlas.glsl" if slot.textured else f"voxel_{slot.kind}.glsl"


def field_file(filter: Filter, slot: Slot) -> str:
    """Return the file that interpolates between them."""
    return "linear_u8.glsl" if (filter, slot.kind) == ("linear", "u8") else f"{filter.replace('-', '_')}.glsl"


def cell_file(filter: Filter) -> str:
    """Return the file of the cells in which the field is one polynomial."""
    kernel = {"hardware": "linear", "cubic-hardware": "cubic"}.get(filter, filter)
    return f"cell_{kernel}.glsl"


def gradient_file(filter: Filter, smooth: bool) -> str:
    """Return the file of the gradient; a smooth one is that of cubic B-splines, with any interpolation."""
    if smooth:
        return "gradient_cubic.glsl"
    files = {"linear": "gradient.glsl", "nearest": "gradient_nearest.glsl", "hardware": "gradient_differences.glsl"}
    return files.get(filter, "gradient_cubic.glsl")


def spline_file(filter: Filter, gradient: str) -> str:
    """Return the file of cubic B-splines, or a comment if neither the field nor its gradient needs it."""
    return "spline.glsl" if "cubic" in filter + gradient else "// nothing\n"
