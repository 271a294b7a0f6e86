"""What flows of a scene become when they are opened: volumes of line integral convolution, lines, and arrows.

`content.flow.expansion` says how they are shown. The volumes are computed box by box when bricks are read; lines
are traced once, by all ranks together, which then all hold them.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm import Channel, agree
from clusterviz.content.flow.section import LINES, FlowInfo, FlowSection, Lic, Seeds
from clusterviz.data.axes import Subset, first_parts, warn_of_choices
from clusterviz.data.bricks import BrickLayout
from clusterviz.data.formats import grid_format_of
from clusterviz.data.geometry import Geometry
from clusterviz.data.source import Index, Source
from clusterviz.data.summary import HISTOGRAM_BINS, VolumeSummary
from clusterviz.data.vectors import VectorSource, open_vectors
from clusterviz.errors import DataError
from clusterviz.flow.cells import Cells, open_cells, regular_vectors
from clusterviz.flow.glyphs import glyphs
from clusterviz.flow.lic import LicSource
from clusterviz.flow.lic_lines import LicOverRanks
from clusterviz.frame.run import Run
from clusterviz.jobs.device import devices_of, on_device
from clusterviz.scene.values import Scene

if TYPE_CHECKING:
    from clusterviz.flow.tracing import LineKind

LATTICE = 64
"""Vectors a side of the lattice whose speeds are taken as those of all vectors."""
SAMPLES = 128
"""Samples along the longest side of a grid on which vectors of an unstructured one are sampled."""
FASTEST = 99.0
"""Percentile of these speeds that has the last colour."""


@dataclass(frozen=True, eq=False)
class OpenedFlow:
    """Vectors of a flow, facts on them that all ranks know, and the convolution if it is shown."""

    section: FlowSection
    vectors: VectorSource | Cells
    info: FlowInfo
    lic: Source | None = None

    def drawn(self, channel: Channel) -> list[Any]:
        """Return what the flow becomes on every rank: components and convolution, lines, or arrows; collective."""
        section, vectors = self.section, self.vectors
        seeds = section.seeds or Seeds()
        if section.show in LINES:
            # Importing numba takes longer than many a render without lines.
            from clusterviz.flow.tracing import trace

            kind = cast("LineKind", section.show)
            traced = trace(vectors, seeds, section.trace, kind, channel=channel, first_step=section.time)
            return [Geometry(lines=traced.lines)]
        if isinstance(vectors, Cells):
            return []
        if section.show == "glyphs":
            return [Geometry(points=glyphs(vectors, seeds, channel))]
        return [*(ComponentSource(vectors, axis) for axis in range(3)), self.lic] if self.lic else []

    def free(self) -> None:
        """Release a convolution that lies in the memory of all ranks; collective."""
        if isinstance(self.lic, LicOverRanks):
            self.lic.free()


class ComponentSource:
    """Component of vectors along x, y or z (0, 1, 2) as a volume."""

    dtype = np.dtype(np.float32)

    def __init__(self, vectors: VectorSource, axis: int) -> None:
        self.name, self.grid, self._vectors, self._axis = f"{vectors.name} {'xyz'[axis]}", vectors.grid, vectors, axis

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[np.float32]:
        """Read a box; see `Source`."""
        return np.ascontiguousarray(self._vectors.read(begin_zyx, end_zyx)[..., self._axis], np.float32)

    def summary(self, layout: BrickLayout) -> VolumeSummary:
        """Return a summary with which nothing is skipped, since it is not drawn: no sample has to be read for it."""
        wide = np.full(layout.counts_zyx, np.inf)
        histogram = np.zeros(HISTOGRAM_BINS, np.int64)
        histogram[0] = 1
        return VolumeSummary(-wide, wide, histogram, (0.0, 1.0), tuple((q, q / 100) for q in (0.0, 1.0, 99.0, 100.0)))


def open_flow(section: FlowSection, given: Any, key: str, channel: Channel) -> OpenedFlow:
    """Open a flow, of vectors in memory if they are given; collective. Errors name the key.

    Raises
    ------
    DataError
        The file cannot be read, or holds no vectors.
    """
    with agree(channel, 0, "open"):
        vectors, _, choices = first_parts(
            lambda part: open_flow_vectors(section.model_copy(update={"array": part.array}), given, key),
            Subset(section.array),
            ("array",),
        )
        if channel.rank == 0:
            warn_of_choices(section.path, choices, f"{key}.")
        mine = _speeds(vectors, channel.rank, channel.size)
    speeds = np.concatenate(channel.allgather(mine))
    fastest = float(np.percentile(speeds, FASTEST)) if speeds.size else 0.0
    if section.show != "lic" or isinstance(vectors, Cells):
        return OpenedFlow(section, vectors, FlowInfo(fastest))
    if channel.size == 1:
        return OpenedFlow(section, vectors, FlowInfo(fastest), LicSource(vectors, section.lic))
    lic = LicOverRanks(channel, vectors, section.lic or Lic())
    return OpenedFlow(section, vectors, FlowInfo(fastest, f"{key}.lic: {lic.note}"), lic)


def open_all(
    run: Run, scene: Scene, keyed: Sequence[tuple[str, FlowSection]], given: Sequence[Any]
) -> list[OpenedFlow]:
    """Open the flows of a scene on the device of a run; collective. Raises as `open_flow`."""
    device = run.options.device
    with run.local("open", "load"), nullcontext() if device is None else on_device(devices_of([device])[0]):
        return [open_flow(flow, each, key, run.channel) for (key, flow), each in zip(keyed, given, strict=True)]


def open_flow_vectors(section: FlowSection, given: Any = None, key: str = "flows[0]") -> VectorSource | Cells:
    """Open the vectors of a flow as its kind needs them: those of unstructured grids in their cells, or resampled.

    Raises
    ------
    DataError
        As `open_vectors`, or there is one time step, and lines that need several.
    """
    vectors: VectorSource | Cells
    if given is not None:
        vectors = given if section.time is None else given.at_time(section.time)
    elif section.path.startswith("field:") or grid_format_of(Path(section.path)) is None:
        vectors = open_vectors(section.path, section.array, section.time, section.order, section.scale)
    else:
        vectors = open_cells(section.path, section.array, section.time, section.order, section.scale)
    if section.show in ("pathlines", "streaklines") and len(getattr(vectors, "times", ())) < 2:
        found, allowed = "vectors at one time", "vectors at several times, or show: streamlines"
        raise DataError(
            f"nothing changes with time in {section.path}", where=f"{key}.show", found=found, allowed=allowed
        )
    if isinstance(vectors, Cells) and section.show not in LINES:
        return regular_vectors(vectors, section.samples or SAMPLES)
    return vectors


def _speeds(vectors: VectorSource | Cells, rank: int, ranks: int) -> NDArray[np.float64]:
    """Return this rank's share of the speeds of a lattice of at most `LATTICE`³ vectors; those that are finite."""
    if isinstance(vectors, Cells):
        return _finite_speeds(vectors.vectors.reshape(-1, 4)[rank::ranks, :3])
    z, y, x = vectors.grid.shape_zyx
    step_z, step_y, step_x = (max(1, -(-side // LATTICE)) for side in (z, y, x))
    found = [np.empty(0)]
    for layer in range(0, z, step_z)[rank::ranks]:
        read = vectors.read((layer, 0, 0), (layer + 1, y, x))[0, ::step_y, ::step_x]
        found.append(_finite_speeds(read.reshape(-1, 3)))
    return np.concatenate(found)


def _finite_speeds(vectors: NDArray[Any]) -> NDArray[np.float64]:
    speeds: NDArray[np.float64] = np.linalg.norm(vectors.astype(np.float64), axis=1)
    return speeds[np.isfinite(speeds)]
