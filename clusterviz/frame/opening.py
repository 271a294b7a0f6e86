"""Opening of the content of a scene, completion of the scene, and reading of bricks.

Each kind of content opens its entries (see `content.contract`). What they say completes the scene. Later frames read
the bricks that they miss.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence, Set
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.content.automatic import with_chosen_labels
from clusterviz.content.complete import complete_scene
from clusterviz.content.facts import Facts
from clusterviz.content.flow.expansion import without_flows
from clusterviz.content.flow.opening import OpenedFlow
from clusterviz.content.geometry.bricks import KnownGeometry
from clusterviz.content.grid.bricks import KnownCells
from clusterviz.content.table import KINDS, entries_of
from clusterviz.content.volume import opening as volumes_opening
from clusterviz.content.volume.opening import Bricks, OpenedVolume, is_brick_same, read_layer, with_larger_bricks
from clusterviz.data.geometry import Geometry
from clusterviz.data.source import Grid, Index, Source, levels_of
from clusterviz.data.unstructured import UnstructuredGrid
from clusterviz.data.vectors import VectorSource
from clusterviz.errors import InputError
from clusterviz.flow.lic_lines import LicOverRanks
from clusterviz.frame.run import Run
from clusterviz.partition import bricks_of, build_tree
from clusterviz.plan.content import ContentBrick, KnownVolume, is_mixed
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
class OpenedContent:
    """Several opened volumes, or any number with geometry or grids, with the interface of `OpenedVolume`.

    Attributes
    ----------
    volumes : in the order of the scene
    geometry : meshes, lines and points, in the order of the scene
    grids : unstructured grids, in the order of the scene
    flows : in the order of the scene; their volumes, lines and points are among the others
    ranks : that draw
    """

    volumes: tuple[OpenedVolume, ...]
    geometry: tuple[KnownGeometry, ...] = ()
    grids: tuple[KnownCells, ...] = ()
    flows: tuple[OpenedFlow, ...] = ()
    ranks: int = 1

    @property
    def infos(self) -> tuple[Facts, ...]:
        """Facts on each entry of a scene, which complete it."""
        return tuple(one.info for kind in KINDS for one in getattr(self, kind.name))

    @property
    def range_type(self) -> np.dtype[Any]:
        """Type of the value ranges of groups of cells."""
        return np.dtype(np.float64)

    def suits(self, scene: Scene) -> bool:
        """Return whether the bricks suit a scene: they are read with the margins of each plan."""
        return True

    def plan(self, scene: Scene) -> Plan:
        """Plan a frame; collective with geometry or grids, of which the ranks look for what each brick holds."""
        known = [KnownVolume(v.grid, v.source.dtype, v.layout, v.summary, levels_of(v.source)) for v in self.volumes]
        infos = [one.info for one in self.geometry], [one.info for one in self.grids]
        bricks, lights = domain_bricks(scene, known, *infos), scene.lights
        geometry = [one.layer(own, lights, bricks) for own, one in zip(scene.geometry, self.geometry, strict=True)]
        grids = [one.layer(own, lights, bricks) for own, one in zip(scene.grids, self.grids, strict=True)]
        return self.with_detail(make_plan(scene, known, bricks, geometry, grids), scene)

    def with_detail(self, plan: Plan, scene: Scene) -> Plan:
        """Return a plan with the levels of volumes that its view needs, and the bounds of their errors."""
        if all(volume.detail == "full" for volume in scene.volumes):
            return plan
        pairs = zip(self.volumes, scene.volumes, strict=True)
        levels = [volume.levels if section.detail != "full" else None for volume, section in pairs]
        return with_detail(plan, scene, levels, partial(_owners, ranks=self.ranks), self.volumes[0].bytes_per_second)

    def grid_of(self, plan: Plan) -> Grid:
        """Return the grid of a plan's domain, in whose index space it is."""
        return plan.content.domain.grid

    def read(self, plan: Plan, wanted: Set[Index]) -> Iterator[tuple[Index, ContentBrick]]:
        """Read bricks of a plan from all sources, with one pass over each volume; collective, but for volumes alone."""
        content = plan.content
        # First, since the ranks exchange what their bricks hold.
        pairs = zip(self.geometry, content.geometry, strict=True)
        geometry = [one.read(layer, content.brick_grid, wanted) for one, layer in pairs]
        grids = zip(self.grids, content.cells, strict=True)
        cells = [one.read(layer, content.brick_grid, wanted) for one, layer in grids]
        each = []
        for volume, part in zip(self.volumes, content.volume_layers, strict=True):
            met = part.cut.bricks_met()
            each.append(read_layer(volume.source, part, [index for index in wanted if met[index]]))
        for index in wanted:
            samples = tuple(bricks.pop(index, None) for bricks in each)
            primitives = tuple(bricks.pop(index, None) for bricks in geometry)
            tetrahedra = tuple(bricks.pop(index, None) for bricks in cells)
            levels = content.levels_around(index)
            yield index, ContentBrick(index, samples, content.around, primitives, tetrahedra, levels)

    def suiting(self, plan: Plan, held: Bricks) -> Bricks:
        """Return those of the bricks in memory that were read with the margins and levels of a plan."""
        content = plan.content
        return {
            index: brick
            for index, brick in held.items()
            if brick.around == content.around and brick.levels == content.levels_around(index)
        }

    def free(self) -> None:
        """Release volumes that lie in the memory of all ranks; collective."""
        for volume in self.volumes:
            source = getattr(volume.source, "source", volume.source)  # of one layer with a thickness
            if isinstance(source, LicOverRanks):
                source.free()

    def with_volumes(self, volumes: Sequence[OpenedVolume]) -> OpenedContent:
        """Return the content with its volumes at other time steps."""
        return replace(self, volumes=tuple(volumes))

    def changed(self, plan: Plan, before: Opened, bricks: Set[Index]) -> set[Index]:
        """Return those of some bricks of a plan that may differ from those of other time steps."""
        found = set[Index]()
        for now, earlier, part in zip(self.volumes, before.volumes, plan.content.volume_layers, strict=True):
            if now.source is earlier.source:
                continue
            met = part.cut.bricks_met()
            for index in (index for index in bricks - found if met[index]):
                if not is_brick_same(now.source, earlier.source, part, index):
                    found.add(index)
        return found


Opened = OpenedVolume | OpenedContent


def open_content(run: Run, scene: Scene, source: Given = None) -> tuple[Scene, Opened | None, Bricks]:
    """Open the entries of a scene, each rank its share of them, and complete the scene; collective.

    Parameters
    ----------
    source : replaces the files of the scene

    Returns
    -------
    scene : completed
    opened : its content; None if the scene has none
    bricks : that were read and can be drawn: those of a single volume with bricks of one size
    """
    with run.local("open", "load"):
        _check_picture(scene)
    asked, scene = scene, without_flows(scene)
    if not scene.has_content:
        with run.local("plan", "plan"):
            return complete_scene(scene, ()), None, {}
    with run.local("open", "load"):
        given = _given_by_key(scene, source)
    scene, found = _opened(run, scene, given)
    with run.local("plan", "plan"):
        bricks = [dict(volume.read_bricks) for volume in found["volumes"]]
        volumes = tuple(replace(volume, read_bricks={}) for volume in found["volumes"])
        # A single volume keeps the bricks that were read; mixed content reads its own boxes.
        several = OpenedContent(**{**found, "volumes": volumes}, ranks=run.channel.size)
        opened = several if is_mixed(scene) else volumes[0]
        scene = complete_scene(scene, opened.infos)
        if labelled := with_chosen_labels(asked, scene):
            return open_content(run, labelled, source)
        if not isinstance(opened, OpenedVolume):
            return scene, opened, {}
        if scene.cluster.largest_brick in (None, scene.cluster.brick):
            return scene, opened, bricks[0]
        return scene, with_larger_bricks(opened, scene, run.channel.size), {}


def _opened(run: Run, scene: Scene, given: dict[str, Any]) -> tuple[Scene, dict[str, tuple[Any, ...]]]:
    """Open all entries, those first that are drawn as entries of other kinds; collective.

    Parameters
    ----------
    given : by key, what replaces the file of an entry

    Returns
    -------
    scene : with the entries that others are drawn as
    opened : by the name of a kind, its opened entries
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
    return scene, found


def open_time_steps(run: Run, scene: Scene, opened: Opened) -> tuple[Opened, Bricks]:
    """Open those volumes of a scene whose time steps differ from the opened ones; collective.

    Returns
    -------
    opened : the same content if no time step differs
    bricks : that were read and can be drawn, as of `open_content`

    Raises
    ------
    DataError
        There is no such step, or its shape, type or grid is another one.
    """
    volumes = volumes_opening.open_time_steps(run, scene, opened.volumes)
    bricks = dict(volumes[0].read_bricks) if isinstance(opened, OpenedVolume) else {}
    return opened.with_volumes([replace(volume, read_bricks={}) for volume in volumes]), bricks


def _owners(cost: NDArray[np.float64], ranks: int) -> NDArray[np.int64]:
    """Return the rank of each brick in a coherent distribution, int64 (bz, by, bx)."""
    tree, found = build_tree(cost, ranks), np.zeros(cost.shape, np.int64)
    for rank in range(ranks):
        found[tuple(bricks_of(tree, rank, cost).T)] = rank
    return found


def _check_picture(scene: Scene) -> None:
    """Refuse a picture that no rank could hold."""
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
    if len(each) not in (len(entries), len(scene.volumes)):
        raise InputError("not one for each volume", where="sources", found=len(each), allowed=len(entries))
    return {entry.key: one for entry, one in zip(entries, each, strict=False)}
