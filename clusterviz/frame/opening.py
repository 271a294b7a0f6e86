"""Opening of the content of a scene, completion of the scene, and reading of bricks.

A store keeps the summary of its volume. Of other volumes each rank reads an equal share of the bricks, from which all
ranks make the summary. What the summaries say completes the scene. Later frames read the bricks that they miss.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterator, Sequence, Set
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm import Channel
from clusterviz.content.flow.expansion import with_flows, without_flows
from clusterviz.content.geometry.bricks import KnownGeometry
from clusterviz.content.geometry.section import GeometrySection
from clusterviz.content.grid.bricks import KnownCells
from clusterviz.content.grid.section import GridSection
from clusterviz.data import format_of, open_first_parts, open_time_step, override_grid, read_geometry, read_piece
from clusterviz.data.axes import warn_of_choices
from clusterviz.data.bricks import Box, BrickLayout, Edges, read_bricks
from clusterviz.data.geometry import Geometry
from clusterviz.data.grid_files import GridFile, grid_files
from clusterviz.data.levels import MixedSource, halved
from clusterviz.data.source import Grid, Index, Source, levels_of
from clusterviz.data.summary import VolumeSummary, block_sides, kept_summary, summarise, summary_over_time
from clusterviz.data.unstructured import UnstructuredGrid
from clusterviz.data.vectors import VectorSource
from clusterviz.errors import DataError, InputError
from clusterviz.flow.content import OpenedFlow, geometry_with_flows, open_flows
from clusterviz.flow.lic_lines import LicOverRanks
from clusterviz.frame.run import Run
from clusterviz.jobs.device import devices_of, on_device
from clusterviz.partition import bricks_of, build_tree, refined_edges
from clusterviz.plan.blend_mode import LARGEST_MARGIN, classification_of, margin_of
from clusterviz.plan.content import ContentBrick, KnownVolume, VolumeLayer, brick_cost, is_mixed
from clusterviz.plan.plan import Plan, domain_bricks, make_plan
from clusterviz.plan.refinement import VolumeLevels, field_error, with_detail
from clusterviz.plan.shading import occlusion_reach
from clusterviz.report.machine import HELD_SHARE_OF_MEMORY, memory
from clusterviz.scene.complete import Info, VolumeInfo, complete_scene
from clusterviz.scene.values import Scene, Volume

Bricks = dict[Index, Any]
"""By index the samples (z, y, x) of one volume, or the `ContentBrick` of several."""


@dataclass(frozen=True)
class OpenedVolume:
    """Opened volume, with what plans need; all but the source is the same on every rank.

    Attributes
    ----------
    source : of its voxels
    layout : of its bricks
    summary : of its values
    infos : information on it, which completes a scene
    time : step of the scene's volume
    """

    source: Source
    layout: BrickLayout
    summary: VolumeSummary
    infos: tuple[VolumeInfo, ...]
    time: int | None = None

    @cached_property
    def levels(self) -> VolumeLevels | None:
        """What is known of the levels of a store; None without one."""
        source = levels_of(self.source)
        return VolumeLevels(self.grid, source.dtype, field_error(source)) if source else None

    @property
    def grid(self) -> Grid:
        """Grid of the voxels."""
        return self.source.grid

    @property
    def range_type(self) -> np.dtype[Any]:
        """Type of the value ranges of groups of cells: that of the voxels."""
        return self.source.dtype

    def suits(self, scene: Scene) -> bool:
        """Return whether the bricks have the margins that a scene needs."""
        return self.layout.margin >= _layout(scene, scene.volumes[0], self.source).margin

    def plan(self, scene: Scene) -> Plan:
        """Plan a frame."""
        return make_plan(scene, [KnownVolume(self.grid, self.source.dtype, self.layout, self.summary)])

    def with_detail(self, plan: Plan, scene: Scene) -> Plan:
        """Return a plan with the levels that its view needs: as it is."""
        return plan

    def grid_of(self, plan: Plan) -> Grid:
        """Return the grid in whose index space a plan is."""
        return self.grid

    def read(self, plan: Plan, wanted: Set[Index]) -> Iterator[tuple[Index, Any]]:
        """Read bricks of a plan from the source."""
        return read_bricks(self.source, self.layout, wanted)

    def suiting(self, plan: Plan, held: Bricks) -> Bricks:
        """Return those of the bricks in memory that suit a plan: all of them."""
        return held

    def free(self) -> None:
        """Release what the ranks share, as of `OpenedContent`: nothing."""

    @property
    def volumes(self) -> tuple[OpenedVolume, ...]:
        """The volume alone, as of `OpenedContent`."""
        return (self,)

    def with_volumes(self, volumes: Sequence[OpenedVolume]) -> OpenedVolume:
        """Return the volume at another time step."""
        return volumes[0]

    def changed(self, plan: Plan, before: Opened, bricks: Set[Index]) -> set[Index]:
        """Return those of some bricks that may differ from those of another time step."""
        return {
            index
            for index in bricks
            if not _is_same(self.source, before.volumes[0].source, self.layout.sample_box(index))
        }


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
    bytes_per_second : of samples that a rank reads, where a picture may take some time only
    """

    volumes: tuple[OpenedVolume, ...]
    geometry: tuple[KnownGeometry, ...] = ()
    grids: tuple[KnownCells, ...] = ()
    flows: tuple[OpenedFlow, ...] = ()
    ranks: int = 1
    bytes_per_second: float = 0.0

    @property
    def infos(self) -> tuple[Info, ...]:
        """Information on each volume, each entry of geometry and each grid, which completes a scene."""
        volumes: tuple[Info, ...] = tuple(info for volume in self.volumes for info in volume.infos)
        return (*volumes, *(one.info for each in (self.geometry, self.grids, self.flows) for one in each))

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
        return with_detail(plan, scene, levels, partial(_owners, ranks=self.ranks), self.bytes_per_second)

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
            each.append(_read_volume(volume.source, part, [index for index in wanted if met[index]]))
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
                if not _is_brick_same(now.source, earlier.source, part, index):
                    found.add(index)
        return found


def _is_brick_same(now: Source, earlier: Source, part: VolumeLayer, index: Index) -> bool:
    """Return whether a volume's samples in a brick of the domain are known to be the same at another time step."""
    several = [source for source in (levels_of(now), levels_of(earlier)) if source]
    if part.levels is None or part.brick_levels is None or len(several) < 2:
        return _is_same(now, earlier, part.cut.sample_box(index))
    level = int(part.brick_levels[index])
    box = part.cut.at(level).sample_box(index)
    # Samples of a brick may be those of all coarser levels around it.
    for number in range(level, int(part.levels.levels.max()) + 1):
        first, other = (source.level(number) for source in several)
        low, high = ((min(i, n - 1) for i, n in zip(corner, first.grid.shape_zyx, strict=True)) for corner in box)
        (z, y, x), (z_last, y_last, x_last) = low, high
        if not _is_same(first, other, ((z, y, x), (z_last + 1, y_last + 1, x_last + 1))):
            return False
        box = halved(box)
    return True


def _read_volume(source: Source, layer: VolumeLayer, wanted: Sequence[Index]) -> Bricks:
    """Read the samples of one of several volumes in bricks of the domain."""
    levels = levels_of(source)
    if layer.levels is None or layer.brick_levels is None or levels is None:
        return dict(read_bricks(source, layer.cut, wanted))
    found: Bricks = {}
    for level in sorted({int(layer.brick_levels[index]) for index in wanted}):
        here = [index for index in wanted if layer.brick_levels[index] == level]
        found |= read_bricks(MixedSource(levels, layer.levels, level), layer.cut.at(level), here)
    return found


Opened = OpenedVolume | OpenedContent


MOST_BRICKS = 1 << 17
"""Bricks a rank, at most: each takes some time in Python, even a small one."""
PIXEL_BYTES = 32
"""Of a pixel on rank 0: its part, and the picture that it becomes."""
LARGEST_BRICK = 512
"""Side of the largest brick that is advised; each is held as a whole."""
Given = Source | Sequence[Source | Geometry | UnstructuredGrid | VectorSource | None] | None
"""Data that replaces the files of a scene: one source, or one for each volume, mesh, entry of lines and of points,
unstructured grid and flow, in this order; None: the file is read."""


def complete(opened: Opened | None, scene: Scene) -> Scene:
    """Complete a scene by what is known of its content; None: the scene has none."""
    return complete_scene(scene, opened.infos if opened else ())


def open_volumes(run: Run, scene: Scene, source: Given = None) -> tuple[Scene, Opened | None, Bricks]:
    """Read geometry and an equal share of each volume's bricks, summarise the volumes, complete the scene; collective.

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
            return complete(None, scene), None, {}
    with run.local("open", "load"):
        given, geometries, unstructured, vectors = _divided(scene, source)
        device = run.options.device
        with nullcontext() if device is None or not scene.flows else on_device(devices_of([device])[0]):
            flows = open_flows(scene, vectors, run.channel)
        scene = with_flows(scene, [each.info for each in flows])
        given = [*given, *(volume for flow in flows for volume in flow.sources())]
        geometries = geometry_with_flows(scene, geometries, flows, run.channel)
        sources, parts = _sources(scene, given, run.channel.rank == 0)
        layouts = [_layout(scene, *pair) for pair in zip(scene.volumes, sources, strict=True)]
        _check_bricks([each.grid.shape_zyx for each in sources], scene.cluster.brick, run.channel.size)
        triples = zip(scene.geometry, scene.geometry_keys, geometries, strict=True)
        geometry = tuple(_known(*each, run.channel) for each in triples)
        grids = tuple(_known_cells(*pair, run.channel) for pair in zip(scene.grids, unstructured, strict=True))
        timed = [n for n, each in enumerate(scene.volumes) if each.detail != "full" and each.detail.seconds]
        speed = _reading_speed(sources[timed[0]]) if timed and run.channel.rank == 0 else 0.0
    _check_same_on_ranks(run, sources)
    if timed:
        with run.collective("open", "load"):
            speed = run.channel.allgather(speed)[0]
    summaries, held = _summarised(run, sources, layouts, scene.cluster.memory_limit)
    with run.local("plan", "plan"):
        opened = tuple(
            OpenedVolume(
                each,
                layout,
                summary,
                (replace(_info(each, _over_time(volume, each, layout, summary), volume.path), parts=part),),
                part.get("time", _first_step(volume)),
            )
            for volume, each, layout, summary, part in zip(
                scene.volumes, sources, layouts, summaries, parts, strict=True
            )
        )
        if is_mixed(scene):
            several = OpenedContent(opened, geometry, grids, tuple(flows), run.channel.size, speed)
            completed = complete(several, scene)
            if labelled := _with_labels(asked, completed):
                return open_volumes(run, labelled, source)
            return completed, several, {}
        scene = complete(opened[0], scene)
        if labelled := _with_labels(asked, scene):
            return open_volumes(run, labelled, source)
        if scene.cluster.largest_brick in (None, scene.cluster.brick):
            return scene, opened[0], held[0]
        return scene, _with_larger_bricks(opened[0], scene, run.channel.size), {}


def _with_labels(asked: Scene, completed: Scene) -> Scene | None:
    """Return a scene with the labels that presets chose; None if they chose none."""
    volumes = [
        own.model_copy(update={"labels": found.labels})
        for own, found in zip(asked.volumes, completed.volumes, strict=False)  # flows add volumes
    ]
    same = all(own.labels == found.labels for own, found in zip(asked.volumes, volumes, strict=True))
    return None if same else asked.model_copy(update={"volumes": tuple(volumes)})


def _check_same_on_ranks(run: Run, sources: Sequence[Source]) -> None:
    """Check that each volume is the same on all ranks, as far as its description says; collective."""
    with run.collective("open", "load"):
        ranks = run.channel.allgather([(each.grid, each.dtype, getattr(each, "version", "")) for each in sources])
    with run.local("open", "load"):
        for source, *known in zip(sources, *ranks, strict=True):
            if any(each != known[0] for each in known):
                raise DataError("ranks read different data", where=source.name, allowed="the same file on all ranks")


def open_time_steps(run: Run, scene: Scene, opened: Opened) -> tuple[Opened, Bricks]:
    """Open those volumes of a scene whose time steps differ from the opened ones; collective.

    Returns
    -------
    opened : the same content if no time step differs
    bricks : that were read and can be drawn, as of `open_volumes`

    Raises
    ------
    DataError
        There is no such step, or its shape, type or grid is another one.
    """
    volumes = list(opened.volumes)
    moved = [n for n, each in enumerate(volumes) if scene.volumes[n].time != each.time]
    if not moved:
        return opened, {}
    with run.local("open", "load"):
        sources = [open_time_step(volumes[n].source, scene.volumes[n]) for n in moved]
        layouts = [replace(volumes[n].layout, edges_zyx=None) for n in moved]
    summaries, held = _summarised(run, sources, layouts, scene.cluster.memory_limit)
    for n, source, summary in zip(moved, sources, summaries, strict=True):
        edges, time = volumes[n].layout.edges_zyx, _first_step(scene.volumes[n])
        summary = _with_joined_bricks(summary, edges) if edges else summary
        volumes[n] = replace(volumes[n], source=source, summary=summary, time=time)
    can_be_drawn = isinstance(opened, OpenedVolume) and not opened.layout.edges_zyx
    return opened.with_volumes(volumes), held[0] if can_be_drawn else {}


def _reading_speed(source: Source) -> float:
    """Return the bytes of samples a second that are read of a brick in the middle of a volume; 0 without levels."""
    levels = levels_of(source)
    if levels is None:
        return 0.0
    sides, started = source.grid.shape_zyx, perf_counter()
    z, y, x = (side // 2 // levels.brick * levels.brick for side in sides)
    end_z, end_y, end_x = (min(b + levels.brick, n) for b, n in zip((z, y, x), sides, strict=True))
    return source.read((z, y, x), (end_z, end_y, end_x)).nbytes / max(perf_counter() - started, 1e-6)


def _owners(cost: NDArray[np.float64], ranks: int) -> NDArray[np.int64]:
    """Return the rank of each brick in a coherent distribution, int64 (bz, by, bx)."""
    tree, found = build_tree(cost, ranks), np.zeros(cost.shape, np.int64)
    for rank in range(ranks):
        found[tuple(bricks_of(tree, rank, cost).T)] = rank
    return found


def _is_same(source: Source, other: Source, box: Box) -> bool:
    known = getattr(source, "is_same", None)
    return bool(known and known(other, *box))


def _layout(scene: Scene, volume: Volume, source: Source) -> BrickLayout:
    """Return the bricks of a volume, with the margins that its blend mode needs."""
    known = not scene.automatic and volume.preset is None
    quality, has_layers = scene.quality, scene.needs_layers
    around = occlusion_reach(volume, source.grid)
    how = classification_of(quality), quality.borders, has_layers, around
    margin = margin_of(volume, *how) if known else LARGEST_MARGIN + around
    return BrickLayout(source.grid.shape_zyx, scene.cluster.brick, margin)


def _summarised(
    run: Run, sources: Sequence[Source], layouts: Sequence[BrickLayout], limit_bytes: int | None
) -> tuple[list[VolumeSummary], list[Bricks]]:
    """Summarise the volumes; of those whose source keeps no summary, an equal share is read.

    Returns
    -------
    summaries : of the volumes
    bricks : those read, of each volume, if they fit into memory
    """
    with run.collective("read", "load"):
        most_bytes = HELD_SHARE_OF_MEMORY * memory().available_bytes / run.channel.placement().local_size
        most_bytes = min(most_bytes, limit_bytes or most_bytes)
    with run.local("read", "load"):
        pairs = list(zip(sources, layouts, strict=True))
        kept = [kept_summary(*pair) for pair in pairs]
        parts = [(*pair, [] if known else _equal_share(pair[1], run)) for pair, known in zip(pairs, kept, strict=True)]
        share_bytes = sum(
            len(share) * (layout.brick + 1 + 2 * layout.margin) ** 3 * source.dtype.itemsize
            for source, layout, share in parts
        )
        fits = share_bytes <= most_bytes
        held = [dict(read_bricks(*part)) if fits else {} for part in parts]
    with run.collective("summarise", "load"):
        each = zip(kept, parts, held, strict=True)
        return [known or _summary(run, *part, bricks if fits else None) for known, part, bricks in each], held


def _with_larger_bricks(opened: OpenedVolume, scene: Scene, ranks: int) -> OpenedVolume:
    """Divide the volume into small bricks near the expected planes between ranks, and larger ones elsewhere.

    Parameters
    ----------
    scene : completed

    References
    ----------
    M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 5.3.6.
    """
    largest, brick = scene.cluster.largest_brick, scene.cluster.brick
    assert largest is not None, "only bricks of several sizes are divided again"
    tree = build_tree(opened.plan(scene).cost, ranks)
    edges, summary = refined_edges(tree, largest // brick), opened.summary

    return replace(opened, layout=replace(opened.layout, edges_zyx=edges), summary=_with_joined_bricks(summary, edges))


def _with_joined_bricks(summary: VolumeSummary, edges: Edges) -> VolumeSummary:
    """Return the summary of a volume with the extremes of larger bricks."""

    def joined(pick: np.ufunc, values: NDArray[Any]) -> NDArray[Any]:
        for axis, inner in enumerate(edges):
            values = pick.reduceat(values, [0, *inner], axis)
        return values

    found = joined(np.minimum, summary.minimum), joined(np.maximum, summary.maximum)
    return replace(summary, minimum=found[0], maximum=found[1])


def _check_picture(scene: Scene) -> None:
    """Refuse a picture that no rank could hold."""
    width, height = scene.image.size
    needed, there = PIXEL_BYTES * width * height, memory().total_bytes
    if 0 < there < needed:
        found, allowed = f"{width} × {height}, which takes {needed >> 20} MiB", f"{there >> 20} MiB"
        raise InputError("too large a picture", where="image.size", found=found, allowed=allowed)


def _check_bricks(shapes: Sequence[Index], brick: int, ranks: int) -> None:
    """Refuse so small bricks that preparing all of them would take minutes."""

    def bricks(side: int) -> int:
        return sum(math.prod(BrickLayout(shape, side).counts_zyx) for shape in shapes)

    if (found := bricks(brick)) > MOST_BRICKS * ranks:
        sides = range(brick, max(map(max, shapes)) + 1)
        fitting = sides[bisect_left(sides, -MOST_BRICKS * ranks, key=lambda side: -bricks(side))]
        if fitting > LARGEST_BRICK:
            size = " × ".join(map(str, max(shapes, key=math.prod)[::-1]))
            most = f"{MOST_BRICKS * ranks} bricks of {LARGEST_BRICK}³; more ranks, or a coarser level"
            raise InputError("too large a volume", where="volumes", found=f"{size} samples", allowed=most)
        text, allowed = "too many bricks", f"{fitting} or more, which makes {bricks(fitting)} bricks"
        raise InputError(
            text,
            where="cluster.brick",
            found=f"{brick}, which makes {found} bricks on {ranks} rank{'s' * (ranks > 1)}",
            allowed=allowed,
        )


def _divided(scene: Scene, given: Given) -> tuple[list[Any], list[Any], list[Any], list[Any]]:
    """Return what is given for each volume, entry of geometry, grid and flow; None: the file is read."""
    volumes, grids = len(scene.volumes), len(scene.volumes) + len(scene.geometry)
    flows = grids + len(scene.grids)
    count = flows + len(scene.flows)
    each: list[Any] = [None] * count
    if given is not None:
        each = list(given) if isinstance(given, Sequence) else [given]
        each += [None] * (count - volumes if len(each) == volumes else 0)
    if len(each) != count:
        raise InputError("not one for each volume", where="sources", found=len(each), allowed=count)
    return each[:volumes], each[volumes:grids], each[grids:flows], each[flows:]


def _sources(scene: Scene, given: Sequence[Source | None], warns: bool) -> tuple[list[Source], list[dict[str, Any]]]:
    """Open the source of each volume; return them, and the keys of the parts of their files that were chosen."""
    sources, parts = list[Source](), list[dict[str, Any]]()
    for number, (each, volume) in enumerate(zip(given, scene.volumes, strict=True)):
        at_first = volume.model_copy(update={"time": _first_step(volume)})
        source, choices = open_first_parts(at_first) if each is None else (override_grid(each, volume), [])
        sources.append(source)
        parts.append({choice.key: choice.parts[0] for choice in choices})
        if warns:
            warn_of_choices(volume.path, choices, f"volumes.{number}." if number else "")
    return sources, parts


def _first_step(volume: Volume) -> int | None:
    """Return the time step of a volume with which a row of frames begins."""
    return 0 if volume.time == "all" else volume.time


def _over_time(volume: Volume, source: Source, layout: BrickLayout, summary: VolumeSummary) -> VolumeSummary:
    """Return the summary of all time steps if all are to be shown and the source keeps them, else that of the first."""
    slab = getattr(source, "slab", None)
    if volume.time != "all" or slab is None:
        return summary
    steps = [source.at_time(n) if hasattr(source, "at_time") else None for n in range(slab.time_steps)]
    kept = [each and kept_summary(each, layout) for each in steps]
    return summary_over_time([each for each in kept if each]) if all(kept) else summary


def _known(section: GeometrySection, key: str, given: Geometry | None, channel: Channel) -> KnownGeometry:
    return KnownGeometry(section, key, (lambda: given) if given else partial(read_geometry, section.path), channel)


def _known_cells(section: GridSection, given: UnstructuredGrid | None, channel: Channel) -> KnownCells:
    if given:
        return KnownCells(section, lambda: [GridFile(Path(section.path))], lambda _: given, channel)
    return KnownCells(section, partial(grid_files, Path(section.path), section.time), read_piece, channel)


def _equal_share(layout: BrickLayout, run: Run) -> list[Index]:
    """Return the bricks that this rank reads first: its leaf of a tree in which all bricks are visible."""
    cells = brick_cost(layout, np.zeros(layout.counts_zyx, bool))
    mine = bricks_of(build_tree(cells, run.channel.size), run.channel.rank, cells)
    return [(z, y, x) for z, y, x in mine.tolist()]


def _summary(run: Run, source: Source, layout: BrickLayout, share: list[Index], held: Bricks | None) -> VolumeSummary:
    """Summarise a volume; a share that exceeds the memory is read again for each pass."""
    bricks = (lambda: read_bricks(source, layout, share)) if held is None else (lambda: iter(held.items()))
    return summarise(source.dtype, layout, bricks, run.channel.allgather)


def _info(source: Source, summary: VolumeSummary, path: str) -> VolumeInfo:
    """Return the information on a volume of a path that completes a scene."""
    array = source.name.removesuffix(getattr(getattr(source, "slab", None), "label", ""))
    array = array.removeprefix(f"{path}:").lstrip("/") if array.startswith(f"{path}:") else ""
    grid, known, known_format = source.grid, summary.categories, format_of(Path(path))
    low, high = summary.value_range
    percentile_1, percentile_99 = summary.percentile(1.0), summary.percentile(99.0)
    more: dict[str, Any] = {}
    if known is not None and len(known.values):
        commonest, equal = int(known.equal[known.counts.argmax()]), int(known.equal.sum())
        more = {"values": known.values, "counts": known.counts}
        more["equal_share"] = (equal - commonest) / max(1, known.pairs - commonest)
        more["jump_share"] = known.jumps / max(1, known.pairs - equal)
    return VolumeInfo(
        grid.shape_zyx,
        grid.spacing,
        grid.corners,
        *(low, high, percentile_1, percentile_99),
        finite=int(summary.histogram.sum()),
        orientation=grid.orientation,
        modality=grid.modality,
        is_integer=source.dtype.kind != "f",
        histogram=summary.histogram,
        percentiles=summary.percentiles,
        blocks=summary.blocks,
        block_sides=block_sides(grid.shape_zyx),
        rows_down=known_format is not None and known_format.name in ("picture", "tiff"),
        array=array,
        **more,
    )
