"""Opening of the content of a scene, completion of the scene, and reading of bricks.

Each kind of content opens its entries (see `content.contract`). What they say completes the scene. Later frames read
the bricks that they miss.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.content.automatic import with_chosen_labels
from clusterviz.content.complete import complete_scene
from clusterviz.content.contract import Painter
from clusterviz.content.facts import Facts
from clusterviz.content.flow.expansion import without_flows
from clusterviz.content.table import KINDS, entries_of
from clusterviz.content.volume import opening as volumes_opening
from clusterviz.content.volume.opening import OpenedVolume, is_brick_same, read_layer, times_of, with_larger_bricks
from clusterviz.data.geometry import Geometry
from clusterviz.data.source import Index, Source
from clusterviz.data.unstructured import UnstructuredGrid
from clusterviz.data.vectors import VectorSource
from clusterviz.errors import InputError
from clusterviz.frame.run import Run
from clusterviz.partition import bricks_of, build_tree
from clusterviz.plan.content import Bricks, ContentBrick, bricks_of_volume, is_mixed
from clusterviz.plan.plan import Plan, domain_bricks, make_plan
from clusterviz.plan.refinement import with_detail
from clusterviz.report.machine import memory
from clusterviz.scene.values import Scene

PIXEL_BYTES = 32
"""Of a pixel on rank 0: its part, and the picture that it becomes."""
Given = Source | Sequence[Source | Geometry | UnstructuredGrid | VectorSource | None] | None
"""Data that replaces the files of a scene: one source, or one for each volume, mesh, entry of lines and of points,
unstructured grid and flow, in this order; None: the file is read."""


@dataclass(frozen=True)
class Opened:
    """Opened content of a scene, which may be none: entries by the name of their kind, what others become included."""

    entries: Mapping[str, tuple[Any, ...]]
    ranks: int = 1

    @property
    def infos(self) -> tuple[Facts, ...]:
        """Facts on each entry of a scene, which complete it."""
        return tuple(one.info for kind in KINDS for one in self.entries[kind.name])

    @property
    def volumes(self) -> tuple[OpenedVolume, ...]:
        """The volumes."""
        return self.entries["volumes"]

    @property
    def placed(self) -> list[Any]:
        """Entries whose members lie in bricks of the domain: meshes, lines and points, then unstructured grids."""
        return [one for kind in KINDS if kind.must_fit for one in self.entries[kind.name]]

    def with_volumes(self, volumes: Iterable[OpenedVolume]) -> Opened:
        """Return the content with its volumes at other time steps, or in other bricks."""
        return replace(self, entries={**self.entries, "volumes": tuple(volumes)})

    def painter(self, run: Run, scene: Scene) -> Painter | None:
        """Return what adds to the pictures of a scene; collective."""
        found = (kind.painter(run, scene, self.entries[kind.name]) for kind in KINDS)
        return next(filter(None, found), None)

    def suits(self, scene: Scene) -> bool:
        """Return whether the bricks suit a scene: those of mixed content are read with the margins of each plan."""
        return is_mixed(scene) or self.volumes[0].has_margin_for(scene)

    def plan(self, scene: Scene) -> Plan | None:
        """Plan a frame, None without content; collective where ranks look for what each brick holds."""
        if not self.infos:
            return None
        placed = list(zip(self.placed, scene.drawn_as("fragments", "segments").values(), strict=True))
        bricks = domain_bricks(scene, self.volumes, [(section, one.info) for one, section in placed])
        layers = [one.layer(section, scene.lights, bricks) for one, section in placed]
        return self.with_detail(make_plan(scene, self.volumes, bricks, layers), scene)

    def with_detail(self, plan: Plan, scene: Scene) -> Plan:
        """Return a plan with the levels of volumes that its view needs, and the bounds of their errors."""
        pairs = zip(self.volumes, plan.content.volume_layers, strict=True)
        levels = [volume.levels if part.levels else None for volume, part in pairs]
        if not any(levels):
            return plan
        return with_detail(plan, scene, levels, partial(_owners, ranks=self.ranks), self.volumes[0].bytes_per_second)

    def read(self, plan: Plan, wanted: Set[Index]) -> Iterator[tuple[Index, ContentBrick]]:
        """Read bricks of a plan from all sources, with one pass over each volume; collective, but for volumes alone."""
        content = plan.content
        # First, since the ranks exchange what their bricks hold.
        pairs = zip(self.placed, content.layers, strict=True)
        placed = [one.read(layer, content.brick_grid, wanted) for one, layer in pairs]
        volumes = list(zip(self.volumes, content.volume_layers, strict=True))
        streams = [read_layer(volume.source, part, wanted) for volume, part in volumes]
        for index in sorted(wanted):
            each = zip(streams, content.volume_layers, strict=True)
            samples = tuple(next(stream)[1] if part.bricks_met[index] else None for stream, part in each)
            members = tuple(bricks.pop(index, None) for bricks in placed)
            yield index, ContentBrick(index, samples, content.around, members, content.levels_around(index))

    def free(self) -> None:
        """Release what lies in the memory of all ranks; collective."""
        for kind in KINDS:
            for one in self.entries[kind.name]:
                kind.free(one)

    def shows_other_times(self, scene: Scene) -> bool:
        """Return whether a scene shows other time steps of the same volumes."""
        times = times_of(scene)
        return len(times) == len(self.volumes) and times != [volume.time for volume in self.volumes]

    def changed(self, plan: Plan, before: Opened, bricks: Set[Index]) -> set[Index]:
        """Return those of some bricks of a plan that may differ from those of other time steps."""
        found = set[Index]()
        for now, earlier, part in zip(self.volumes, before.volumes, plan.content.volume_layers, strict=True):
            if now.source is earlier.source:
                continue
            for index in (index for index in bricks - found if part.bricks_met[index]):
                if not is_brick_same(now.source, earlier.source, part, index):
                    found.add(index)
        return found

    def taken(self, scene: Scene) -> tuple[Opened, Bricks]:
        """Return the content without the bricks that were read as it was opened, and those that can be drawn."""
        bricks: Bricks = {}
        if not is_mixed(scene):
            (volume,) = self.volumes
            bricks = bricks_of_volume(volume.layout, volume.read_bricks.items())
        return self.with_volumes(replace(volume, read_bricks={}) for volume in self.volumes), bricks


def open_content(run: Run, scene: Scene, source: Given = None) -> tuple[Scene, Opened, Bricks]:
    """Open the entries of a scene, each rank its share of them, and complete the scene; collective.

    Returns
    -------
    scene : completed
    opened : its content
    bricks : that were read and can be drawn: those of a single volume with bricks of one size
    """
    with run.local("open", "load"):
        _check_picture(scene)
    asked, scene = scene, without_flows(scene)
    with run.local("open", "load"):
        given = _given_by_key(scene, source) if scene.has_content else {}
    scene, opened = _opened(run, scene, given)
    with run.local("plan", "plan"):
        scene = complete_scene(scene, opened.infos)
        labelled = with_chosen_labels(asked, scene)
        if labelled is None and not is_mixed(scene):
            opened = opened.with_volumes([with_larger_bricks(opened.volumes[0], scene, run.channel.size)])
    return open_content(run, labelled, source) if labelled else (scene, *opened.taken(scene))


def _opened(run: Run, scene: Scene, given: dict[str, Any]) -> tuple[Scene, Opened]:
    """Open all entries, those first that are drawn as entries of other kinds, which then are in the scene, too.

    `given` has by key what replaces the file of an entry. Collective.
    """
    found = dict[str, tuple[Any, ...]]()
    for kind in reversed(KINDS):
        keyed = [(entry.key, entry.section) for entry in entries_of(scene) if entry.kind is kind]
        found[kind.name] = tuple(kind.open(run, scene, keyed, [given.get(key) for key, _ in keyed])) if keyed else ()
        if kind.becomes and keyed:
            scene = kind.becomes(scene, [one.info for one in found[kind.name]])
            pairs = zip(keyed, found[kind.name], strict=True)
            drawn = {key: iter(one.drawn(run.channel)) for (key, _), one in pairs}
            made = [entry for entry in entries_of(scene) if entry.section.of_flow]
            given = given | {entry.key: next(drawn[entry.section.path]) for entry in made}
    return scene, Opened(found, run.channel.size)


def open_time_steps(run: Run, scene: Scene, opened: Opened) -> tuple[Opened, Bricks]:
    """Open those volumes of a scene whose time steps differ; return the content, and bricks as of `open_content`.

    Raises
    ------
    DataError
        There is no such step, or its shape, type or grid is another one.
    """
    volumes = volumes_opening.open_time_steps(run, scene, opened.volumes)
    return opened.with_volumes(volumes).taken(scene)


def _owners(cost: NDArray[np.float64], ranks: int) -> NDArray[np.int64]:
    tree, found = build_tree(cost, ranks), np.zeros(cost.shape, np.int64)
    for rank in range(ranks):
        found[tuple(bricks_of(tree, rank, cost).T)] = rank
    return found


def _check_picture(scene: Scene) -> None:
    width, height = scene.image.size
    needed, there = PIXEL_BYTES * width * height, memory().total_bytes
    if 0 < there < needed:
        found, allowed = f"{width} × {height}, which takes {needed >> 20} MiB", f"{there >> 20} MiB"
        raise InputError("too large a picture", where="image.size", found=found, allowed=allowed)


def _given_by_key(scene: Scene, given: Given) -> dict[str, Any]:
    """Return what is given for each entry by its key; those that are missing, or None, are read from files."""
    if given is None:
        return {}
    each = list(given) if isinstance(given, Sequence) else [given]
    entries = entries_of(scene)
    if len(each) not in (len(entries), len(scene.drawn_as("samples"))):
        raise InputError("not one for each volume", where="sources", found=len(each), allowed=len(entries))
    return {entry.key: one for entry, one in zip(entries, each, strict=False)}
