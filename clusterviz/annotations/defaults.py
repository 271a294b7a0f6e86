"""Annotations of `--annotate`."""

from __future__ import annotations

from clusterviz.content.table import own_entries
from clusterviz.scene.values import Scene

NAMES = ("scalar_bar", "outline", "axes", "orientation", "time")


def with_annotations(scene: Scene) -> Scene:
    """Return a scene with scalar bars, outline, axes grid, orientation marker and time stamp; keys that are set stay.

    A legend joins them if some of several contents have no scalars, which a scalar bar would name.
    """
    given, entries = scene.annotations, own_entries(scene)
    several, has_plain = len(entries) > 1, any(entry.section.has_one_colour for entry in entries)
    names = [*NAMES, "legend"] if several and has_plain else NAMES
    found = {name: True for name in names if name not in given.model_fields_set}
    return scene.model_copy(update={"annotations": given.model_copy(update=found)})
