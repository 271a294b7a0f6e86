"""Kinds of content, and the entries of a scene with their kinds; see `content.contract`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from clusterviz.content.contract import Entry, Kind
from clusterviz.content.facts import Facts
from clusterviz.content.flow.kind import FLOW
from clusterviz.content.geometry.kind import GEOMETRY
from clusterviz.content.grid.kind import GRID
from clusterviz.content.volume.kind import VOLUME
from clusterviz.scene.values import Scene

KINDS: tuple[Kind, ...] = (VOLUME, GEOMETRY, GRID, FLOW)
"""In the order of facts, legends and descriptions; opened last to first."""


def entries_of(scene: Scene, infos: Sequence[Facts] | None = None) -> list[Entry]:
    """Return the entries of a scene, in the order of the kinds, with the facts on them, which have this order."""
    found = [
        Entry(kind, f"{name}[{number}]", section)
        for kind in KINDS
        for name in kind.sections
        for number, section in enumerate(getattr(scene, name))
    ]
    if infos is None:
        return found
    return [Entry(one.kind, one.key, one.section, info) for one, info in zip(found, infos, strict=True)]


def drawn_entries(scene: Scene, infos: Sequence[Facts]) -> list[Entry]:
    """Return the opened entries of a scene that are drawn themselves, not as entries of other kinds."""
    return [entry for entry in entries_of(scene, infos) if entry.kind.becomes is None]


def own_entries(scene: Scene, infos: Sequence[Facts] | None = None) -> list[Entry]:
    """Return the entries that a scene names: not those that flows are drawn as."""
    return [entry for entry in entries_of(scene, infos) if not entry.section.of_flow]


def check_drawable(scene: Scene) -> None:
    """Refuse what can be said in a scene, but no renderer draws.

    Raises
    ------
    SceneError
        The error names the key.
    """
    for kind in KINDS:
        kind.check(scene)


def infos_of(kind: Kind, infos: Iterable[Facts]) -> list[Any]:
    """Return the facts on entries of one kind, of its class."""
    return [info for info in infos if isinstance(info, kind.facts)]


def with_sections(scene: Scene, entries: Iterable[Entry]) -> Scene:
    """Return a scene with the sections of all its entries, which keep their order."""
    lists = {name: list[object]() for kind in KINDS for name in kind.sections}
    for entry in entries:
        lists[entry.key.partition("[")[0]].append(entry.section)
    return scene.model_copy(update={name: tuple(each) for name, each in lists.items()})
