"""Content of a scene as the renderer needs it: a common domain, and a layer for each volume, mesh, grid and so on.

Content is mixed, each brick with a share of all that meets it, or it is one volume alone, whose own bricks are drawn,
and which may be shown in ways that are not mixed: projections, refraction, slabs of several lengths. `Content.mixed`
says which; all else is the same for both.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from clusterviz.content.grid.section import KBuffer
from clusterviz.content.transfer import transfer_function
from clusterviz.data.bricks import Boxes, BrickLayout
from clusterviz.data.levels import LevelMap, mixed_type
from clusterviz.data.source import Grid, Index, Source, levels_of
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
from clusterviz.plan.cells import CellLayer
from clusterviz.plan.detail import choose_levels, levels_in_bricks
from clusterviz.plan.domain import BrickGrid, Cut, Domain, domain_layout, make_cut, make_domain, samples_in_bricks
from clusterviz.plan.encoding import Encoding, make_encoding
from clusterviz.plan.geometry import GeometryLayer, Layer, Members
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
    """All that one brick of the domain needs of a scene's content.

    Attributes
    ----------
    index_zyx : index of the brick in the domain
    samples : samples (z, y, x) of each volume, in the box of `VolumeLayer.boxes`; None if the volume is invisible there
    around : margin and reach of each volume's cut, with which they were read
    members : those of each of `Content.layers` that come within half a slab; None where there are none, () for all
    levels : of the volumes' bricks around it, as `Content.levels_around`
    """

    index_zyx: Index
    samples: tuple[NDArray[Any] | None, ...]
    around: tuple[tuple[int, int], ...] = ()
    members: tuple[Members | None, ...] = ()
    levels: tuple[bytes, ...] = ()

    @property
    def size(self) -> int:
        """Number of samples of all volumes."""
        return sum(part.size for part in self.samples if part is not None)

    @property
    def nbytes(self) -> int:
        """Bytes of the samples of all volumes."""
        return sum(part.nbytes for part in self.samples if part is not None)


Bricks = dict[Index, ContentBrick]


def bricks_of_volume(layout: BrickLayout, samples: Iterable[tuple[Index, NDArray[Any]]]) -> Bricks:
    """Return the bricks of a volume alone, given the samples in each."""
    return {index: ContentBrick(index, (own,), ((layout.margin, 0),)) for index, own in samples}


@dataclass(frozen=True, eq=False)
class KnownVolume:
    """A volume as planning needs it; all but the source is the same on every rank.

    Attributes
    ----------
    source : of its voxels
    layout : bricks of the volume itself, which the summary describes; their margin is at least `margin_of`'s
    summary : extremes of its bricks, and its histogram
    """

    source: Source
    layout: BrickLayout
    summary: VolumeSummary

    @property
    def grid(self) -> Grid:
        """Grid of the voxels."""
        return self.source.grid


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
    own : bricks of the volume, if it is alone and these are drawn
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
    own: BrickLayout | None = None

    @property
    def boxes(self) -> Boxes:
        """Boxes of samples of the bricks."""
        return self.own or self.cut

    @cached_property
    def bricks_met(self) -> NDArray[np.bool_]:
        """Bricks of the domain that have samples, bool (bz, by, bx)."""
        return np.ones(self.own.counts_zyx, bool) if self.own else self.cut.bricks_met()

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
    layers : meshes, lines and points, then unstructured grids, in the order of the scene
    reach : cells beyond its own in which a brick has primitives and tetrahedra
    fill : how fragments are stored, see `render/abuffer/fills.py`
    resolve : how they come in order, see `render/abuffer/resolves.py`; not auto
    """

    domain: Domain
    layout: BrickLayout
    volume_layers: tuple[VolumeLayer, ...]
    mixed: bool = True
    layers: tuple[Layer, ...] = ()
    reach: int = 0
    fill: Fill = "fixed"
    resolve: Resolve = "static"

    @property
    def around(self) -> tuple[tuple[int, int], ...]:
        """Margin and reach of each volume's cut, and of all else; bricks that were read with others are read again."""
        volumes = tuple((part.cut.margin, part.cut.reach) for part in self.volume_layers)
        return (*volumes, (0, self.reach)) if self.layers else volumes

    def levels_around(self, index_zyx: Index) -> tuple[bytes, ...]:
        """Return for each volume with levels those around a brick; one that was read with others is read again."""
        return tuple(part.levels_around(index_zyx) for part in self.volume_layers if part.levels)

    def suiting(self, bricks: Bricks) -> Bricks:
        """Return those of some bricks that were read with the margins and levels that are needed now."""
        around = self.around
        return {
            index: brick
            for index, brick in bricks.items()
            if brick.around == around and brick.levels == self.levels_around(index)
        }

    @property
    def encodings(self) -> tuple[Encoding | None, ...]:
        """Encoding of each volume's stored samples; None of integers, which are stored unchanged with any of them."""
        each = (part.encoding for part in self.volume_layers)
        return tuple(encoding if encoding.kind == "f32" else None for encoding in each)

    @property
    def shown_by(self) -> tuple[object, ...]:
        """Objects by which groups of cells of the volumes are hidden or not, if their bricks are the same."""
        return tuple(one for part in self.volume_layers for one in (part.blend_mode, part.transfer))

    @cached_property
    def geometry(self) -> tuple[GeometryLayer, ...]:
        """The layers of meshes, lines and points."""
        return tuple(layer for layer in self.layers if isinstance(layer, GeometryLayer))

    @cached_property
    def cells(self) -> tuple[CellLayer, ...]:
        """The layers of unstructured grids."""
        return tuple(layer for layer in self.layers if isinstance(layer, CellLayer))

    @property
    def kbuffer(self) -> KBuffer | None:
        """K-buffer of the unstructured grid, which is then alone."""
        return self.cells[0].kbuffer if self.cells else None

    @property
    def brick_grid(self) -> BrickGrid:
        """Bricks as geometry and grids need them."""
        return BrickGrid(self.domain, self.layout, self.reach)


def is_mixed(scene: Scene) -> bool:
    """Return whether the content of a scene is mixed: it is unless there is one volume, without levels, and no more."""
    sampled = [*scene.drawn_as("samples").values()]
    return len(scene.entries) != 1 or not sampled or sampled[0].detail != "full"


def brick_cost(layout: BrickLayout, hidden: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the cost of each brick, float64 (bz, by, bx): its cells, or 0 if it is hidden."""
    cells = np.einsum("z,y,x->zyx", *(side.astype(np.float64) for side in layout.sides_zyx))
    return np.where(hidden, 0.0, cells)


def make_content(
    scene: Scene,
    volumes: Sequence[KnownVolume],
    bricks: BrickGrid,
    layers: Sequence[Layer],
    step_world: float,
    spectrum: Spectrum | None = None,
) -> tuple[Content, NDArray[np.float64]]:
    """Return the content of a completed scene, and the cost of drawing each brick of the domain.

    Parameters
    ----------
    volumes : metadata of the volumes, in the order of the scene
    bricks : of the domain
    layers : meshes, lines and points, then unstructured grids, in the order of the scene
    step_world : length of a slab in world units
    spectrum : wavelengths of a volume alone

    Returns
    -------
    content : all content in the domain
    cost : float64 (bz, by, bx), cells of all volumes, and `cost` of the layers; 0 where all is hidden

    Raises
    ------
    InputError
        The margin of a volume alone is too small, so that pictures would depend on the bricks; or as `choose_levels`.
    """
    mixed, cost, volume_layers = is_mixed(scene), np.zeros(bricks.layout.counts_zyx), list[VolumeLayer]()
    for (key, volume), known in zip(scene.drawn_as("samples").items(), volumes, strict=True):
        if mixed:
            part = _mixed_layer(scene, key, volume, known, bricks, step_world)
        else:
            part = _lone_layer(scene, volume, known, bricks, step_world, spectrum)
        hidden = part.blend_mode.hides(part.transfer, known.summary.minimum, known.summary.maximum)
        cost += samples_in_bricks(part.cut, known.layout, hidden) if mixed else brick_cost(bricks.layout, hidden)
        volume_layers.append(part)
    for layer in layers:
        cost += layer.cost
    content = Content(bricks.domain, bricks.layout, tuple(volume_layers), mixed, tuple(layers), bricks.reach)
    asked = scene.quality.abuffer
    # Of opaque layers alone, a pixel has one fragment at most.
    is_opaque = bool(content.geometry) and all(layer.opaque for layer in content.geometry)
    fill = "fixed" if asked.fill == "auto" and is_opaque else asked.fill
    resolve: Resolve = "peeling" if fill in ("lists", "pages") else "static"
    return replace(content, fill=fill, resolve=resolve if asked.resolve == "auto" else asked.resolve), cost


def _lone_layer(
    scene: Scene, volume: Volume, known: KnownVolume, bricks: BrickGrid, step_world: float, spectrum: Spectrum | None
) -> VolumeLayer:
    """Return the layer of a volume alone, whose own bricks are drawn."""
    quality, layout = scene.quality, bricks.layout
    how, around = (quality.classification, quality.borders), occlusion_reach(volume, known.grid)
    if layout.margin < (needed := margin_of(volume, *how, scene.needs_layers, around)):
        text = "bricks lack the margin that the blend mode needs"
        raise InputError(text, where="brick layout", found=layout.margin, allowed=needed)
    cut = make_cut(bricks.domain, layout, known.grid, layout.margin)
    return replace(
        _volume_layer(volume, known, scene, cut, step_world, spectrum),
        filter=_filter(volume, quality.filter),
        reach=reach_of(volume, *how) + around,
        spread=spread_of(volume, *how),
        own=layout,
    )


def _mixed_layer(
    scene: Scene, key: str, volume: Volume, known: KnownVolume, bricks: BrickGrid, step_world: float
) -> VolumeLayer:
    reach, around = reach_of(volume, scene.quality.classification), occlusion_reach(volume, known.grid)
    margin = margin_of(volume, has_layers=scene.needs_layers, around=around) - reach_of(volume)
    cut = make_cut(bricks.domain, bricks.layout, known.grid, margin, reach)
    levels = choose_levels(volume, levels_of(known.source), key)
    if levels is None:
        return _volume_layer(volume, known, scene, cut, step_world)
    if volume.interpolation == "nearest" and not levels.is_uniform:
        text, allowed = "no levels beside each other", "linear, or detail: {level: n}"
        raise SceneError(text, where=f"{key}.interpolation", found="nearest", allowed=allowed)
    part = _volume_layer(volume, known, scene, cut, step_world)
    encoding = make_encoding(mixed_type(known.source.dtype, levels), part.transfer.domain)
    return replace(part, encoding=encoding, levels=levels, brick_levels=levels_in_bricks(cut, levels))


def domain_of(volumes: Sequence[KnownVolume], placed: Sequence[tuple[Any, Any]]) -> Domain:
    """Return the domain of volumes, and of completed sections of geometry and grids with the facts on them."""
    boxes = [info.grown_box(section) for section, info in placed]
    return make_domain([known.grid for known in volumes], boxes)


def layout_of(
    scene: Scene, domain: Domain, volumes: Sequence[KnownVolume], placed: Sequence[tuple[Any, Any]]
) -> BrickLayout:
    """Return the bricks of the domain of a completed scene: of a volume alone its own."""
    if not is_mixed(scene):
        return volumes[0].layout
    # Bricks of volumes are as large as is asked for, since voxels are what takes memory.
    sides = [info.side for _, info in placed if info.side is not None]
    side = 0.0 if volumes else min(sides, default=0.0)
    return domain_layout(domain, scene.cluster.brick, bool(placed), side, [known.grid for known in volumes])


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
        make_encoding(known.source.dtype, transfer.domain),
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
