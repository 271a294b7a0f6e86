"""Opening of volumes, and reading of their bricks.

A store keeps the summary of its volume. Of other volumes each rank reads an equal share of the bricks, from which all
ranks make the summary. Later frames read the bricks that they miss.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.content.volume.info import VolumeInfo
from clusterviz.content.volume.section import Volume
from clusterviz.data import ALL_STEPS, ONE_STEP, open_first_parts, open_time_step, override_grid
from clusterviz.data.axes import warn_of_choices
from clusterviz.data.bricks import Box, BrickLayout, Edges, read_bricks
from clusterviz.data.formats import format_of
from clusterviz.data.levels import MixedSource, halved
from clusterviz.data.source import Index, Source, levels_of
from clusterviz.data.summary import VolumeSummary, block_sides, kept_summary, summarise, summary_over_time
from clusterviz.errors import DataError, InputError, SceneError
from clusterviz.frame.run import Run
from clusterviz.partition import bricks_of, build_tree, refined_edges
from clusterviz.plan.blend_mode import LARGEST_MARGIN, classification_of, margin_of
from clusterviz.plan.content import KnownVolume, VolumeLayer, brick_cost
from clusterviz.plan.plan import make_plan
from clusterviz.plan.refinement import VolumeLevels, field_error
from clusterviz.plan.shading import occlusion_reach
from clusterviz.report.machine import HELD_SHARE_OF_MEMORY, memory
from clusterviz.scene.values import Scene

MOST_BRICKS = 1 << 17
"""Bricks a rank, at most: each takes some time in Python, even a small one."""
LARGEST_BRICK = 512
"""Side of the largest brick that is advised; each is held as a whole."""
Samples = dict[Index, NDArray[Any]]
"""Samples of bricks of a volume."""


@dataclass(frozen=True, eq=False)
class OpenedVolume(KnownVolume):
    """Opened volume.

    Attributes
    ----------
    info : facts on it
    time : step of the scene's volume
    read_bricks : that were read for the summary and can be drawn, until they are taken over
    bytes_per_second : of samples that a rank reads, where a picture may take some time only
    """

    info: VolumeInfo
    time: int | None = None
    read_bricks: Samples = field(default_factory=dict)
    bytes_per_second: float = 0.0

    @cached_property
    def levels(self) -> VolumeLevels | None:
        """What is known of the levels of a store; None without one."""
        source = levels_of(self.source)
        return VolumeLevels(self.grid, source.dtype, field_error(source)) if source else None

    def has_margin_for(self, scene: Scene) -> bool:
        """Return whether its own bricks have the margins that a scene needs, which shows it alone."""
        return self.layout.margin >= _layout(scene, scene.volumes[0], self.source).margin


def open_volumes(
    run: Run, scene: Scene, keyed: Sequence[tuple[str, Volume]], given: Sequence[Source | None]
) -> list[OpenedVolume]:
    """Open volumes and summarise them; collective."""
    volumes = [volume for _, volume in keyed]
    with run.local("open", "load"):
        sources, parts = _sources(volumes, given, run.channel.rank == 0)
        layouts = [_layout(scene, *pair) for pair in zip(volumes, sources, strict=True)]
        _check_bricks([each.grid.shape_zyx for each in sources], scene.cluster.brick, run.channel.size)
        timed = [n for n, each in enumerate(volumes) if each.detail != "full" and each.detail.seconds]
        speed = _reading_speed(sources[timed[0]]) if timed and run.channel.rank == 0 else 0.0
    _check_same_on_ranks(run, sources)
    if timed:
        with run.collective("open", "load"):
            speed = run.channel.allgather(speed)[0]
    summaries, held = _summarised(run, sources, layouts, scene.cluster.memory_limit)
    with run.local("plan", "plan"):
        found = list[OpenedVolume]()
        for each in zip(volumes, sources, layouts, summaries, parts, held, strict=True):
            volume, source, layout, summary, part, bricks = each
            info = _info(source, _over_time(volume, source, layout, summary), volume.path, part)
            time = part.get("time", _first_step(volume))
            found.append(OpenedVolume(source, layout, summary, info, time, bricks, speed))
        return found


def times_of(scene: Scene) -> list[int | str | None]:
    """Return the time step of each volume of a scene."""
    return [volume.time for volume in scene.volumes]


def several_steps(scene: Scene) -> SceneError | None:
    """Return the error of a picture of all time steps at once; None of other scenes."""
    if "all" not in times_of(scene):
        return None
    where = f"volumes[{times_of(scene).index('all')}].time"
    return SceneError(ONE_STEP, where=where, found="all", allowed=ALL_STEPS)


def open_time_steps(run: Run, scene: Scene, opened: Sequence[OpenedVolume]) -> list[OpenedVolume]:
    """Open those volumes of a scene whose time steps differ from the opened ones; collective.

    Raises
    ------
    DataError
        There is no such step, or its shape, type or grid is another one.
    """
    volumes = list(opened)
    moved = [n for n, each in enumerate(volumes) if scene.volumes[n].time != each.time]
    if not moved:
        return volumes
    with run.local("open", "load"):
        sources = [open_time_step(volumes[n].source, scene.volumes[n]) for n in moved]
        layouts = [replace(volumes[n].layout, edges_zyx=None) for n in moved]
    summaries, held = _summarised(run, sources, layouts, scene.cluster.memory_limit)
    for n, source, summary, bricks in zip(moved, sources, summaries, held, strict=True):
        edges, time = volumes[n].layout.edges_zyx, _first_step(scene.volumes[n])
        summary = _with_joined_bricks(summary, edges) if edges else summary
        bricks = {} if edges else bricks
        volumes[n] = replace(volumes[n], source=source, summary=summary, time=time, read_bricks=bricks)
    return volumes


def is_brick_same(now: Source, earlier: Source, part: VolumeLayer, index: Index) -> bool:
    """Return whether a volume's samples in a brick are known to be the same at another time step."""
    several = [source for source in (levels_of(now), levels_of(earlier)) if source]
    if part.levels is None or part.brick_levels is None or len(several) < 2:
        return _is_same(now, earlier, part.boxes.sample_box(index))
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


def read_layer(source: Source, layer: VolumeLayer, wanted: Iterable[Index]) -> Iterator[tuple[Index, NDArray[Any]]]:
    """Read the samples of a volume in those of some bricks that it meets, in one pass, by ascending indices."""
    levels, met = levels_of(source), [index for index in wanted if layer.bricks_met[index]]
    if layer.levels is None or layer.brick_levels is None or levels is None:
        yield from read_bricks(source, layer.boxes, met)
        return
    found: Samples = {}
    for level in sorted({int(layer.brick_levels[index]) for index in met}):
        here = [index for index in met if layer.brick_levels[index] == level]
        found |= read_bricks(MixedSource(levels, layer.levels, level), layer.cut.at(level), here)
    yield from sorted(found.items(), key=lambda each: each[0])


def _check_same_on_ranks(run: Run, sources: Sequence[Source]) -> None:
    """Check that each volume is the same on all ranks, as far as its description says; collective."""
    with run.collective("open", "load"):
        ranks = run.channel.allgather([(each.grid, each.dtype, getattr(each, "version", "")) for each in sources])
    with run.local("open", "load"):
        for source, *known in zip(sources, *ranks, strict=True):
            if any(each != known[0] for each in known):
                raise DataError("ranks read different data", where=source.name, allowed="the same file on all ranks")


def _reading_speed(source: Source) -> float:
    """Return the bytes of samples a second that are read of a brick in the middle of a volume; 0 without levels."""
    levels = levels_of(source)
    if levels is None:
        return 0.0
    sides, started = source.grid.shape_zyx, perf_counter()
    z, y, x = (side // 2 // levels.brick * levels.brick for side in sides)
    end_z, end_y, end_x = (min(b + levels.brick, n) for b, n in zip((z, y, x), sides, strict=True))
    return source.read((z, y, x), (end_z, end_y, end_x)).nbytes / max(perf_counter() - started, 1e-6)


def _is_same(source: Source, other: Source, box: Box) -> bool:
    known = getattr(source, "is_same", None)
    return bool(known and known(other, *box))


def _layout(scene: Scene, volume: Volume, source: Source) -> BrickLayout:
    known = not scene.automatic and volume.preset is None
    quality, has_layers = scene.quality, scene.needs_layers
    around = occlusion_reach(volume, source.grid)
    how = classification_of(quality), quality.borders, has_layers, around
    margin = margin_of(volume, *how) if known else LARGEST_MARGIN + around
    return BrickLayout(source.grid.shape_zyx, scene.cluster.brick, margin)


def _summarised(
    run: Run, sources: Sequence[Source], layouts: Sequence[BrickLayout], limit_bytes: int | None
) -> tuple[list[VolumeSummary], list[Samples]]:
    """Summarise the volumes; of sources without summaries an equal share is read, and returned if it fits."""
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


def with_larger_bricks(opened: OpenedVolume, scene: Scene, ranks: int) -> OpenedVolume:
    """Divide a volume alone into small bricks near the expected planes between ranks, and larger ones elsewhere.

    It stays as it is if bricks have one size. Bricks that were read are forgotten.

    References
    ----------
    M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 5.3.6.
    """
    largest, brick = scene.cluster.largest_brick, scene.cluster.brick
    if largest is None or largest == brick:
        return opened
    tree = build_tree(make_plan(scene, [opened]).cost, ranks)
    edges = refined_edges(tree, largest // brick)
    layout, summary = replace(opened.layout, edges_zyx=edges), _with_joined_bricks(opened.summary, edges)
    return replace(opened, layout=layout, summary=summary, read_bricks={})


def _with_joined_bricks(summary: VolumeSummary, edges: Edges) -> VolumeSummary:

    def joined(pick: np.ufunc, values: NDArray[Any]) -> NDArray[Any]:
        for axis, inner in enumerate(edges):
            values = pick.reduceat(values, [0, *inner], axis)
        return values

    found = joined(np.minimum, summary.minimum), joined(np.maximum, summary.maximum)
    return replace(summary, minimum=found[0], maximum=found[1])


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


def _sources(
    volumes: Sequence[Volume], given: Sequence[Source | None], warns: bool
) -> tuple[list[Source], list[dict[str, Any]]]:
    sources, parts = list[Source](), list[dict[str, Any]]()
    for number, (each, volume) in enumerate(zip(given, volumes, strict=True)):
        at_first = volume.model_copy(update={"time": _first_step(volume)})
        source, choices = open_first_parts(at_first) if each is None else (override_grid(each, volume), [])
        sources.append(source)
        parts.append({choice.key: choice.parts[0] for choice in choices})
        if warns:
            warn_of_choices(volume.path, choices, f"volumes.{number}." if number else "")
    return sources, parts


def _first_step(volume: Volume) -> int | None:
    return 0 if volume.time == "all" else volume.time


def _over_time(volume: Volume, source: Source, layout: BrickLayout, summary: VolumeSummary) -> VolumeSummary:
    """Return the summary of all time steps if all are to be shown and the source keeps them, else that of the first."""
    slab = getattr(source, "slab", None)
    if volume.time != "all" or slab is None:
        return summary
    steps = [source.at_time(n) if hasattr(source, "at_time") else None for n in range(slab.time_steps)]
    kept = [each and kept_summary(each, layout) for each in steps]
    return summary_over_time([each for each in kept if each]) if all(kept) else summary


def _equal_share(layout: BrickLayout, run: Run) -> list[Index]:
    """Return the bricks that this rank reads first: its leaf of a tree in which all bricks are visible."""
    cells = brick_cost(layout, np.zeros(layout.counts_zyx, bool))
    mine = bricks_of(build_tree(cells, run.channel.size), run.channel.rank, cells)
    return [(z, y, x) for z, y, x in mine.tolist()]


def _summary(run: Run, source: Source, layout: BrickLayout, share: list[Index], held: Samples | None) -> VolumeSummary:
    """Summarise a volume; a share that exceeds the memory is read again for each pass."""
    bricks = (lambda: read_bricks(source, layout, share)) if held is None else (lambda: iter(held.items()))
    return summarise(source.dtype, layout, bricks, run.channel.allgather)


def _info(source: Source, summary: VolumeSummary, path: str, parts: Mapping[str, Any]) -> VolumeInfo:
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
        parts=parts,
        **more,
    )
