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
    kinds = {name: kind for kind in KINDS for name in kind.sections}
    found = [Entry(kinds[key.partition("[")[0]], key, section) for key, section in scene.entries.items()]
    if infos is None:
        return found
    return [Entry(one.kind, one.key, one.section, info) for one, info in zip(found, infos, strict=True)]


def drawn_entries(scene: Scene, infos: Sequence[Facts] | None = None) -> list[Entry]:
    """Return the entries of a scene that are drawn themselves, not as entries of other kinds."""
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


def first_of(kind: Kind, scene: Scene) -> Any:
    """Return the section of the first entry of a kind; None without one."""
    return next((entry.section for entry in entries_of(scene) if entry.kind is kind), None)
