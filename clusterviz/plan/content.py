"""Content of a scene as the renderer needs it: a common domain, and a layer for each volume, mesh, grid and so on.

Content is mixed, each brick with a share of all that meets it, or it is one volume alone, whose own bricks are drawn,
and which may be shown in ways that are not mixed: projections, refraction, slabs of several lengths. `Content.mixed`
says which; all else is the same for both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from clusterviz.content.geometry.section import GeometryInfo
from clusterviz.content.grid.section import GridInfo, KBuffer
from clusterviz.content.transfer import transfer_function
from clusterviz.data.bricks import BrickLayout
from clusterviz.data.levels import LevelMap, mixed_type
from clusterviz.data.source import Grid, Index, MultilevelSource
from clusterviz.data.summary import VolumeSummary
from clusterviz.errors import InputError, SceneError
from clusterviz.plan.blend_mode import (
    BlendMode,
    is_graded,
    is_lit,
    is_preintegrated,
    make_blend_mode,
    margin_of,
    reach_of,
    spread_of,
)
from clusterviz.plan.cells import CellBrick, CellLayer
from clusterviz.plan.detail import choose_levels, levels_in_bricks
from clusterviz.plan.domain import BrickGrid, Cut, Domain, domain_layout, make_cut, make_domain, samples_in_bricks
from clusterviz.plan.encoding import Encoding, make_encoding
from clusterviz.plan.geometry import GeometryLayer, Primitives
from clusterviz.plan.preintegration import make_preintegrated
from clusterviz.plan.ray_sampling import clip_planes, slab_units
from clusterviz.plan.segments import Segments, make_segments
from clusterviz.plan.shading import make_grading, make_shading, occlusion_reach
from clusterviz.plan.spectrum import Spectrum
from clusterviz.scene.transfer import TransferFunction
from clusterviz.scene.values import Fill, Resolve, Scene, Volume

Filter = Literal["linear", "nearest", "cubic", "hardware", "cubic-hardware"]
"""Filter of a volume: with float32 weights, or the texture unit's "hardware" (linear) and "cubic-hardware"."""


@dataclass(frozen=True, eq=False)
class ContentBrick:
    """Samples of all volumes in one brick of the domain.

    Attributes
    ----------
    index_zyx : index of the brick in the domain
    samples : samples (z, y, x) of each volume, in the box of its `Cut`; None if the volume is invisible there
    around : margin and reach of each volume's cut, with which they were read
    levels : of the volumes' bricks around it, as `Content.levels_around`
    primitives : those of each layer of geometry that come within half a slab; None where there are none, () for all
    cells : those of each unstructured grid, as `primitives`
    """

    index_zyx: Index
    samples: tuple[NDArray[Any] | None, ...]
    around: tuple[tuple[int, int], ...] = ()
    primitives: tuple[Primitives | None, ...] = ()
    cells: tuple[CellBrick | None, ...] = ()
    levels: tuple[bytes, ...] = ()

    @property
    def size(self) -> int:
        """Number of samples of all volumes."""
        return sum(part.size for part in self.samples if part is not None)


@dataclass(frozen=True, eq=False)
class KnownVolume:
    """Metadata of a volume that planning needs.

    Attributes
    ----------
    grid, dtype : grid and dtype of its voxels
    layout : bricks of the volume itself, which the summary describes; their margin is at least `margin_of`'s
    summary : extremes of its bricks, and its histogram
    source : its data if they have levels
    """

    grid: Grid
    dtype: np.dtype[Any]
    layout: BrickLayout
    summary: VolumeSummary
    source: MultilevelSource | None = None


@dataclass(frozen=True, eq=False)
class VolumeLayer:
    """A volume.

    Attributes
    ----------
    cut : its voxels that each brick of the domain needs
    blend_mode : how its samples become a pixel, its lighting and isosurfaces; in mixed content one that can be mixed
    encoding : how its voxels are stored
    transfer : its transfer function
    segments : the transfer function as the shader reads it; of a spectral volume that of the first wavelength
    filter : interpolation between its voxels
    reach : cells beyond its own in which a brick samples the field
    spread : samples beyond a cell's corners on which the field in it, and of a volume alone its pixels, depend
    slab_units : length of a slab in its opacity unit distances
    preintegrated : its slabs are classified between their ends, not at their midpoints
    levels : levels of its own bricks; None: the finest everywhere, as it is
    brick_levels : uint8 (bz, by, bx), the level whose samples each brick of the domain holds; None as `levels`
    """

    cut: Cut
    blend_mode: BlendMode
    encoding: Encoding
    transfer: TransferFunction
    segments: Segments
    filter: Filter
    reach: int
    spread: int
    slab_units: float
    preintegrated: bool = False
    levels: LevelMap | None = None
    brick_levels: NDArray[np.uint8] | None = None

    @property
    def finest(self) -> int:
        """Level for which slots of one size must suffice: of several, the finest, as they may change."""
        return int(self.levels.levels.flat[0]) if self.levels and self.levels.is_uniform else 0

    def cut_of(self, index_zyx: Index) -> Cut:
        """Return the cut of the level that a brick holds."""
        return self.cut if self.brick_levels is None else self._cuts[int(self.brick_levels[index_zyx])]

    def levels_around(self, index_zyx: Index) -> bytes:
        """Return the levels on which the samples of a brick depend; b"" without levels."""
        if self.levels is None or self.brick_levels is None:
            return b""
        level = int(self.brick_levels[index_zyx])
        if self.levels.is_uniform:
            return bytes([level])
        if index_zyx not in self._around:
            levels = self.levels.around(self._cuts[level].sample_box(index_zyx), level)
            self._around[index_zyx] = bytes([level]) + levels.tobytes()
        return self._around[index_zyx]

    @cached_property
    def _cuts(self) -> list[Cut]:
        """Cuts of the levels."""
        coarsest = 0 if self.brick_levels is None else int(self.brick_levels.max())
        return [self.cut.at(level) for level in range(coarsest + 1)]

    @cached_property
    def _around(self) -> dict[Index, bytes]:
        """Results of `levels_around`, which take longer than to compare them in each frame."""
        return {}


@dataclass(frozen=True, eq=False)
class Content:
    """Volumes, geometry and unstructured grids in one domain.

    Attributes
    ----------
    domain : the box around them
    layout : the domain's bricks, which may be larger than the scene asks for
    volume_layers : the volumes, in the order of the scene
    mixed : bricks hold a share of all content; False: they are those of one volume, which is alone
    geometry : meshes, lines and points, in the order of the scene
    reach : cells beyond its own in which a brick has primitives and tetrahedra
    fill : how fragments are stored, see `render/abuffer/fills.py`
    resolve : how they come in order, see `render/abuffer/resolves.py`; not auto
    cells : unstructured grids, in the order of the scene
    """

    domain: Domain
    layout: BrickLayout
    volume_layers: tuple[VolumeLayer, ...]
    mixed: bool = True
    geometry: tuple[GeometryLayer, ...] = ()
    reach: int = 0
    fill: Fill = "fixed"
    resolve: Resolve = "static"
    cells: tuple[CellLayer, ...] = ()

    @property
    def around(self) -> tuple[tuple[int, int], ...]:
        """Margin and reach of each volume's cut, and of all else; bricks that were read with others are read again."""
        volumes = tuple((part.cut.margin, part.cut.reach) for part in self.volume_layers)
        return (*volumes, (0, self.reach)) if self.geometry or self.cells else volumes

    def levels_around(self, index_zyx: Index) -> tuple[bytes, ...]:
        """Return for each volume with levels those around a brick; one that was read with others is read again."""
        return tuple(part.levels_around(index_zyx) for part in self.volume_layers if part.levels)

    @property
    def encodings(self) -> tuple[Encoding | None, ...]:
        """Encoding of each volume's stored samples; None of integers, which are stored unchanged with any of them."""
        each = (part.encoding for part in self.volume_layers)
        return tuple(encoding if encoding.kind == "f32" else None for encoding in each)

    @property
    def shown_by(self) -> tuple[object, ...]:
        """Objects by which groups of cells of the volumes are hidden or not, if their bricks are the same."""
        return tuple(one for part in self.volume_layers for one in (part.blend_mode, part.transfer))

    @property
    def layers(self) -> tuple[GeometryLayer | CellLayer, ...]:
        """Geometry, and then the unstructured grids."""
        return (*self.geometry, *self.cells)

    @property
    def kbuffer(self) -> KBuffer | None:
        """K-buffer of the unstructured grid, which is then alone."""
        return self.cells[0].kbuffer if self.cells else None

    @property
    def brick_grid(self) -> BrickGrid:
        """Bricks as geometry and grids need them."""
        return BrickGrid(self.domain, self.layout, self.reach)


PRIMITIVE_COST = 8.0
"""Cost of a primitive in a brick, in cells of a volume: a triangle of a third of a pixel takes 90 ns, a cell 11 ns."""
SEGMENT_COST = 2.0
"""Cost of a ray's segment in a tetrahedron, in cells of a volume: 40 ns beside 20 ns in alternated frames of both.

Nearly all of it is the walk: a segment without opacity costs 0.93 times as much.
"""


def is_mixed(scene: Scene) -> bool:
    """Return whether the content of a scene is mixed: it is unless there is one volume, without levels, and no more."""
    return (
        len(scene.volumes) != 1
        or bool(scene.geometry or scene.grids or scene.flows)
        or scene.volumes[0].detail != "full"
    )


def brick_cost(layout: BrickLayout, hidden: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the cost of each brick, float64 (bz, by, bx): its cells, or 0 if it is hidden."""
    cells = np.einsum("z,y,x->zyx", *(side.astype(np.float64) for side in layout.sides_zyx))
    return np.where(hidden, 0.0, cells)


def make_lone_content(
    scene: Scene, known: KnownVolume, bricks: BrickGrid, step_world: float, spectrum: Spectrum | None
) -> tuple[Content, NDArray[np.float64]]:
    """Return the content of a completed scene with one volume alone, and the cost of its bricks, as `make_content`.

    Raises
    ------
    InputError
        The layout's margin is too small, so that pictures would depend on the bricks.
    """
    (volume,), quality, layout = scene.volumes, scene.quality, bricks.layout
    how, around = (quality.classification, quality.borders), occlusion_reach(volume, known.grid)
    if layout.margin < (needed := margin_of(volume, *how, scene.needs_layers, around)):
        raise InputError(
            "bricks lack the margin that the blend mode needs",
            where="brick layout",
            found=layout.margin,
            allowed=needed,
        )
    cut = make_cut(bricks.domain, layout, known.grid, layout.margin)
    layer = replace(
        _volume_layer(volume, known, scene, cut, step_world, spectrum),
        filter=_filter(volume, quality.filter),
        reach=reach_of(volume, *how) + around,
        spread=spread_of(volume, *how),
    )
    hidden = layer.blend_mode.hides(layer.transfer, known.summary.minimum, known.summary.maximum)
    return Content(bricks.domain, layout, (layer,), mixed=False), brick_cost(layout, hidden)


def make_content(
    scene: Scene,
    volumes: Sequence[KnownVolume],
    bricks: BrickGrid,
    geometry: Sequence[GeometryLayer],
    grids: Sequence[tuple[CellLayer, NDArray[np.float64]]],
    step_world: float,
) -> tuple[Content, NDArray[np.float64]]:
    """Return the mixed content of a completed scene, and the cost of drawing each brick of the domain.

    Parameters
    ----------
    volumes : metadata of the volumes, in the order of the scene
    bricks : of the domain
    geometry : meshes, lines and points, in the order of the scene
    grids : unstructured grids, in the order of the scene, each with the segments of a ray expected in each brick
    step_world : length of a slab in world units

    Returns
    -------
    content : all content in the domain
    cost : float64 (bz, by, bx), cells of all volumes, `PRIMITIVE_COST` a primitive and `SEGMENT_COST` a segment in a
        tetrahedron; 0 where all is hidden
    """
    domain, layout = bricks.domain, bricks.layout
    cost = np.zeros(layout.counts_zyx)
    volume_layers = []
    for number, (volume, known) in enumerate(zip(scene.volumes, volumes, strict=True)):
        reach = reach_of(volume, scene.quality.classification)
        around = occlusion_reach(volume, known.grid)
        margin = margin_of(volume, has_layers=scene.needs_layers, around=around) - reach_of(volume)
        cut = make_cut(domain, layout, known.grid, margin, reach)
        levels, dtype = choose_levels(volume, known.source, f"volumes[{number}]"), known.dtype
        if levels is not None:
            dtype = mixed_type(dtype, levels)
            if volume.interpolation == "nearest" and not levels.is_uniform:
                text, where = "no levels beside each other", f"volumes[{number}].interpolation"
                raise SceneError(text, where=where, found="nearest", allowed="linear, or detail: {level: n}")
        part = _volume_layer(volume, replace(known, dtype=dtype), scene, cut, step_world)
        if levels is not None:
            part = replace(part, levels=levels, brick_levels=levels_in_bricks(cut, levels))
        hidden = part.blend_mode.hides(part.transfer, known.summary.minimum, known.summary.maximum)
        cost += samples_in_bricks(part.cut, known.layout, hidden)
        volume_layers.append(part)
    for section, layer in zip(scene.geometry, geometry, strict=True):
        cost += PRIMITIVE_COST * layer.in_bricks[0] * (section.opacity != 0 or layer.edges is not None)
    for number, (grid, (cells, segments)) in enumerate(zip(scene.grids, grids, strict=True)):
        if grid.shade and cells.on_cells:
            text, where = "values of cells have no gradient to light", f"grids[{number}].shade"
            raise SceneError(text, where=where, found="true, and values of cells", allowed="false, or values of points")
        cost += SEGMENT_COST * segments
    asked = scene.quality.abuffer
    # Of opaque layers alone, a pixel has one fragment at most.
    fill = "fixed" if asked.fill == "auto" and geometry and all(layer.opaque for layer in geometry) else asked.fill
    resolve: Resolve = "peeling" if fill in ("lists", "pages") else "static"
    schemes = fill, resolve if asked.resolve == "auto" else asked.resolve
    layers, grids_alone = tuple(geometry), tuple(cells for cells, _ in grids)
    return Content(domain, layout, tuple(volume_layers), True, layers, bricks.reach, *schemes, grids_alone), cost


def domain_of(
    scene: Scene, volumes: Sequence[KnownVolume], geometry: Sequence[GeometryInfo], grids: Sequence[GridInfo]
) -> Domain:
    """Return the domain of a completed scene."""
    pairs = zip(scene.geometry, geometry, strict=True)
    boxes = [*(info.grown_box(section) for section, info in pairs), *(info.box for info in grids)]
    return make_domain([known.grid for known in volumes], boxes)


def layout_of(
    scene: Scene, domain: Domain, volumes: Sequence[KnownVolume], has_geometry: bool, grids: Sequence[GridInfo]
) -> BrickLayout:
    """Return the bricks of the domain of a completed scene: of a volume alone its own."""
    if not is_mixed(scene):
        return volumes[0].layout
    # Bricks of volumes are as large as is asked for, since voxels are what takes memory.
    side = 0.0 if volumes else min((info.side for info in grids), default=0.0)
    each = [known.grid for known in volumes]
    return domain_layout(domain, scene.cluster.brick, has_geometry or bool(grids), side, each)


def _volume_layer(
    volume: Volume, known: KnownVolume, scene: Scene, cut: Cut, step_world: float, spectrum: Spectrum | None = None
) -> VolumeLayer:
    """Return the layer of a volume of mixed content; that of a volume alone has another filter, reach and spread."""
    transfer, planes = transfer_function(volume), clip_planes(scene.clip, known.grid)
    preintegrated = is_preintegrated(volume, scene.quality.classification)
    unit = transfer.unit_distance
    units = slab_units(step_world, unit)
    shading = make_shading(volume, scene.lights, known.grid, unit, planes, scene.clip.cap) if is_lit(volume) else None
    grading = make_grading(volume, transfer.domain, known.grid) if is_graded(volume) else None
    if spectrum:
        segments = spectrum.segments[0]
    elif preintegrated:
        segments = make_preintegrated(transfer)
    else:
        # Of several volumes extinctions are added, so the shader needs the opacity of a unit length, which is linear.
        segments = make_segments(transfer, 1.0 if is_mixed(scene) else units)
    return VolumeLayer(
        cut,
        make_blend_mode(volume, transfer, shading, grading),
        make_encoding(known.dtype, transfer.domain),
        transfer,
        segments,
        volume.interpolation,
        cut.reach,
        spread_of(volume) - reach_of(volume),
        units,
        preintegrated,
    )


def _filter(volume: Volume, quality: str) -> Filter:
    """Return the filter of a volume alone; nearest voxels have no weights, so they do not use the texture unit."""
    if quality != "hardware" or volume.interpolation == "nearest":
        return volume.interpolation
    return "cubic-hardware" if volume.interpolation == "cubic" else "hardware"
