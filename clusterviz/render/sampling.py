"""Which shader files sample a volume: fetches of its voxels, the field between them, and the field's gradient."""

from __future__ import annotations

from clusterviz.plan.plan import Filter
from clusterviz.render.storage import Slot


def voxel_file(slot: Slot) -> str:
    """The file that fetches voxels."""
    return "atlas.glsl" if slot.textured else f"voxel_{slot.kind}.glsl"


def field_file(filter: Filter, slot: Slot) -> str:
    """The file that interpolates between them."""
    return "linear_u8.glsl" if (filter, slot.kind) == ("linear", "u8") else f"{filter.replace('-', '_')}.glsl"


def cell_file(filter: Filter) -> str:
    """The file of the cells in which the field is one polynomial."""
    kernel = {"hardware": "linear", "cubic-hardware": "cubic"}.get(filter, filter)
    return f"cell_{kernel}.glsl"


def gradient_file(filter: Filter, smooth: bool) -> str:
    """The file of the field's gradient; a smooth one is a cubic B-spline's, whatever the field is."""
    if smooth:
        return "gradient_cubic.glsl"
    files = {"linear": "gradient.glsl", "nearest": "gradient_nearest.glsl", "hardware": "gradient_differences.glsl"}
    return files.get(filter, "gradient_cubic.glsl")


def spline_file(filter: Filter, gradient: str) -> str:
    """The file of cubic B-splines, or a comment where neither the field nor its gradient is one."""
    return "spline.glsl" if "cubic" in filter + gradient else "// nothing\n"
