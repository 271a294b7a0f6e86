"""A completed scene in a few lines: how it looks, and which arrays were chosen."""

from __future__ import annotations

from clusterviz.content.contract import LegendEntry
from clusterviz.content.description import point_text
from clusterviz.content.table import own_entries
from clusterviz.scene.values import Scene


def scene_summary(scene: Scene) -> str:
    """Return a completed scene on one line: how its entries look, and the camera."""
    camera = scene.camera
    seen = f"parallel_scale {camera.parallel_scale:g}" if camera.parallel_scale else f"view_angle {camera.view_angle:g}"
    parts = [entry.kind.summary(entry.key, entry.section) for entry in own_entries(scene)]
    ends = " to ".join(point_text(point, digits=4) for point in (camera.position, camera.focal_point))
    return "; ".join([*parts, f"camera {ends}, {seen}"])


def chosen_arrays(scene: Scene, completed: Scene) -> list[str]:
    """Return a line on each array of geometry that automatic settings have taken, with how to take another."""
    now, found = completed.drawn_as("fragments"), []
    for key, section in scene.drawn_as("fragments").items():
        if section.scalars is None and now[key].scalars is not None:
            option = key.replace("[", ".").replace("]", "")
            another = f"another array: -D {option}.scalars=NAME, one colour: -D {option}.color=white"
            found.append(f"{key} has the colours of its array {now[key].scalars}; {another}")
    return found


def legends_of(scene: Scene) -> list[LegendEntry]:
    """Return how the entries of a completed scene are listed beside its picture; equal ones of flows once."""
    found: dict[object, LegendEntry] = {}
    for entry in own_entries(scene):
        legend = entry.kind.legend(entry.section)
        found[legend.shared or entry.key] = legend
    return list(found.values())
