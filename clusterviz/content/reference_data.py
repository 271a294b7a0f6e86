"""Content of a scene as the float64 reference draws it: all data of each entry, read whole."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import Any, NamedTuple

from clusterviz.comm import LoopbackChannel
from clusterviz.content.contract import Entry
from clusterviz.content.table import KINDS, drawn_entries, own_entries
from clusterviz.frame.run import Options, Run
from clusterviz.scene.values import Scene


class ReferenceData(NamedTuple):
    """Arguments of `render_reference`: grids and voxels of volumes, and the others by name."""

    grids: list[Any]
    voxels: list[Any]
    more: dict[str, Any]


def why_unchecked(scene: Scene) -> str:
    """Return what the reference does not draw of a scene, as "shows no …"; "" if it draws all."""
    return next(filter(None, (entry.kind.unchecked(entry.section) for entry in own_entries(scene))), "")


def become(scene: Scene) -> dict[str, list[Any]]:
    """Return the data of what entries of a scene are drawn as, by their keys."""
    run, found = Run(LoopbackChannel(), Options()), dict[str, list[Any]]()
    for kind in KINDS:
        keyed = [(entry.key, entry.section) for entry in own_entries(scene) if entry.kind is kind and kind.becomes]
        opened = kind.open(run, scene, keyed, [None] * len(keyed)) if keyed else ()
        found |= {key: one.drawn(run.channel) for (key, _), one in zip(keyed, opened, strict=True)}
    return found


def samples_of(scene: Scene, made: dict[str, list[Any]]) -> list[Any]:
    """Return the sources of all volumes of a scene and of `become`, of which nothing is read yet."""
    own = [entry for entry in own_entries(scene) if entry.section.drawn_as == "samples"]
    sources = [entry.kind.read(entry.section) for entry in own]
    return sources + [one for each in made.values() for one in each if hasattr(one, "read")]


def data_of(scene: Scene, made: dict[str, list[Any]]) -> list[tuple[Entry, Any]]:
    """Return the entries of a completed scene that are drawn, with their data.

    Parameters
    ----------
    made : as of `become`
    """
    rest = {key: iter(each) for key, each in made.items()}

    def data(entry: Entry) -> Any:
        section = entry.section
        return next(rest[section.path]) if section.of_flow else entry.kind.read(section)

    return [(entry, data(entry)) for entry in drawn_entries(scene)]


def reference_data(entries: Sequence[tuple[Entry, Any]]) -> ReferenceData:
    """Return entries with their data as the reference takes them."""
    found = defaultdict[str, list[Any]](list)
    for entry, data in entries:
        found[entry.kind.name].append(entry.kind.referenced(entry.section, data))
    sources = found["volumes"]
    voxels = [source.read((0, 0, 0), source.grid.shape_zyx) for source in sources]
    more = {"geometry": found["geometry"], "cells": found["grids"]}
    return ReferenceData([source.grid for source in sources], voxels, more)
