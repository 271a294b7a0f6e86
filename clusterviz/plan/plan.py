"""The plan of a frame: a frozen value, computed from the scene alone and equal on every rank.

`changed_settings` lists what a scene asks for and the plan replaces. Settings that raise an error have no entry, nor
those that are chosen automatically (`auto`, `quality.max_error`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.bricks import BrickLayout
from clusterviz.data.source import Grid, Index
from clusterviz.image.partial import Rect
from clusterviz.plan.adaptive_step import AdaptiveStep, make_adaptive_step
from clusterviz.plan.blend_mode import (
    LONGEST_SLAB,
    BlendMode,
    Lattice,
    has_surfaces,
    is_lit,
    is_preintegrated,
    lattice_of,
    step_of,
)
from clusterviz.plan.content import (
    Content,
    Filter,
    KnownVolume,
    VolumeLayer,
    domain_of,
    is_mixed,
    layout_of,
    make_content,
)
from clusterviz.plan.domain import BrickGrid
from clusterviz.plan.geometry import Layer
from clusterviz.plan.layers import LayeredContent, make_layers
from clusterviz.plan.lens import Lens, make_lens
from clusterviz.plan.ray_sampling import clip_planes, clipped_bricks, make_frame_coherence, slab_length
from clusterviz.plan.refraction import Refraction, make_refraction
from clusterviz.plan.slices.planes import SlicePlanes, slice_planes
from clusterviz.plan.spectrum import Spectrum, make_spectrum
from clusterviz.plan.view import Vector, View, make_view
from clusterviz.report.decisions import Change, Detail
from clusterviz.scene.blend_modes import BLEND_MODES
from clusterviz.scene.values import Quality, Scene, Volume

CROSSED = 0.5 - 1e-4
"""Transparency at which a ray has surely passed one half, whatever the rounding."""
MIXED = BlendMode()
"""Blend mode of mixed content, whose samples are composited."""


@dataclass(frozen=True)
class March:
    """How rays are sampled.

    Attributes
    ----------
    lattice : where slabs begin: where the ray enters the volume (rays), by a hash of the pixel (jittered), or on planes
        perpendicular to the view direction (slices)
    frame_coherence : slabs between a ray's start and the last frame's hit; None: rays start where they enter the volume
    discard_margin : world units behind the end of a ray of the last frame, beyond which fragments are not stored;
        None: all are stored
    """

    step_world: float  # length of a slab in world units
    residual: float  # a ray ends when its transparency falls to this value
    lattice: Lattice = "rays"
    adaptive_step: AdaptiveStep | None = None  # the adaptive step; None: all slabs are equally long
    split: bool = False  # slabs are cut where they leave a brick
    frame_coherence: int | None = None
    discard_margin: float | None = None
    crossing: bool = False  # only where the opacity of a pixel passes one half is found, see `Plan.crossing`


@dataclass(frozen=True)
class Plan:
    """All decisions of one frame.

    Attributes
    ----------
    spectrum : wavelengths of a volume with optics, whose first one is that of its segments; else None
    lens : sub-images of a thin lens, whose planes are the last two of `clip`, and whose margin is in `view`; else None
    layers : its volumes, if other layers are wanted beside the colours; then what `crossing` plans is drawn, too
    """

    view: View  # the camera in index space
    march: March  # the sampling of rays
    content: Content  # what is drawn, in whose domain are index space and bricks
    clip: NDArray[np.float64]  # float64 (n, 4), planes in index space, see `clip_planes`
    cost: NDArray[np.float64]  # float64 (bz, by, bx): cost of drawing each brick in cells; 0 for hidden bricks
    layers: tuple[LayeredContent, ...] = ()
    times: tuple[int | str | None, ...] = ()  # time steps of the volumes
    detail: tuple[Detail, ...] = ()  # levels of the volumes that are drawn by those of a store
    spectrum: Spectrum | None = None
    lens: Lens | None = None
    refraction: Refraction | None = None  # how rays bend; None: they are straight

    @property
    def layout(self) -> BrickLayout:
        """The bricks."""
        return self.content.layout

    @property
    def volume(self) -> VolumeLayer:
        """The volume that is drawn alone."""
        assert not self.content.mixed, "there is one volume alone"
        return self.content.volume_layers[0]

    @property
    def blend_mode(self) -> BlendMode:
        """How samples become a pixel."""
        return MIXED if self.content.mixed else self.volume.blend_mode

    @property
    def filter(self) -> Filter:
        """Filter of the volume that is drawn alone; of mixed content linear interpolation, which most volumes have."""
        return "linear" if self.content.mixed else self.volume.filter

    @property
    def has_passes(self) -> bool:
        """Whether its bricks may be drawn in passes: those of volumes only, and each ray once."""
        march = self.march
        return not self.content.layers and march.frame_coherence is None and march.discard_margin is None

    @property
    def pictures(self) -> int:
        """Number of pictures that are drawn: one, or one for each wavelength, or for each sub-image of a lens."""
        several = self.spectrum or self.lens
        return several.count if several else 1

    @property
    def canvas_size(self) -> tuple[int, int]:
        """Width and height of what is composited: the picture, or the tall picture of several."""
        width, height = self.view.size
        return width, height * self.pictures

    def on_screen(self, rect: Rect) -> Rect:
        """Return the rectangle of the picture that a rectangle of the canvas belongs to."""
        count = self.pictures
        return replace(rect, y_begin=rect.y_begin // count, y_end=rect.y_end // count)

    def tall(self, rect: Rect) -> Rect:
        """Return the rows of the canvas that hold a rectangle in all pictures.

        Row y of picture n is row y · pictures + n, so that partial images of all pictures are composited together.
        """
        return replace(rect, y_begin=rect.y_begin * self.pictures, y_end=rect.y_end * self.pictures)

    def pictures_of(self, begin_zyx: Index, end_zyx: Index) -> dict[int, Plan]:
        """Return the plans of the pictures in which a box of bricks may be seen, by their numbers."""
        if self.spectrum:
            return {number: self.at_wavelength(number) for number in range(self.pictures)}
        assert self.lens, "there are several pictures"
        begin, end = self.layout.cells_of(begin_zyx, end_zyx)
        # Geometry of a brick may lie beyond it, by a slab of overlap.
        reach = np.full(3, self.content.reach)
        ends = np.array([begin[::-1] - reach, end[::-1] + reach])
        corners = np.stack(np.meshgrid(*ends.T), axis=-1).reshape(-1, 3)
        numbers = self.lens.numbers(self.view.depths(corners))
        whole = replace(self, lens=None)
        kept = self.clip[:-2]
        return {n: replace(whole, clip=np.vstack([kept, self.lens.planes(self.view, n)])) for n in numbers}

    def at_wavelength(self, number: int) -> Plan:
        """Return the plan of one wavelength of a spectral volume."""
        assert self.spectrum, "there are wavelengths"
        only = self.spectrum.only(number)
        volume = replace(self.volume, segments=only.segments[0])
        return replace(self, spectrum=only, content=replace(self.content, volume_layers=(volume,)))

    @property
    def crossing(self) -> Plan:
        """Plan by which rays find where their opacity passes one half, with the same bricks."""
        march = replace(self.march, crossing=True, residual=CROSSED, frame_coherence=None, discard_margin=None)
        return replace(self, march=march)

    @property
    def extent(self) -> tuple[float, float, float]:
        """Lengths (x, y, z) of the box through which rays are sampled, in index space, where it begins at 0."""
        return self.content.domain.extent

    @property
    def slice_planes(self) -> SlicePlanes:
        """The planes between the slabs of `quality.renderer: slices`."""
        return slice_planes(self.view, self.extent, self.march.step_world)

    def eye_in_bricks(self, first_zyx: Index = (0, 0, 0)) -> Vector | None:
        """The eye (x, y, z) in units of bricks, relative to brick `first_zyx`; None for parallel projection."""
        eye, layout = self.view.eye_point, self.layout
        if eye is None:
            return None
        if layout.edges_zyx is None:
            places = [place / layout.brick for place in eye]
        else:
            # np.interp clamps at the volume's faces; the distance beyond them is added.
            places = [
                float(np.interp(at, borders, np.arange(len(borders)))) + at - min(max(at, 0.0), float(borders[-1]))
                for at, borders in zip(eye, layout.borders_zyx[::-1], strict=True)
            ]
        x, y, z = (place - first for place, first in zip(places, first_zyx[::-1], strict=True))
        return x, y, z


def shows_more(plan: Plan, assigned_cost: NDArray[np.float64] | None) -> bool:
    """Return True if a plan shows a brick that was hidden when bricks were assigned to ranks.

    `assigned_cost`: the cost of bricks by which they were assigned; 0 for a hidden one; None: all were hidden.
    """
    return assigned_cost is None or bool(np.any((plan.cost > 0) & (assigned_cost == 0)))


def domain_bricks(scene: Scene, volumes: Sequence[KnownVolume], placed: Sequence[tuple[Any, Any]] = ()) -> BrickGrid:
    """Return the bricks of a completed scene, in which the primitives of its geometry and grids are then looked for.

    `volumes`: their metadata, in the order of the scene. `placed`: sections and facts of meshes, lines, points and
    unstructured grids. Raises InputError: the domain would have too many bricks, or a ray too many slabs.
    """
    domain = domain_of(volumes, placed)
    layout = layout_of(scene, domain, volumes, placed)
    # Fragments lie up to half a slab from the midpoint that a brick holds.
    half = _rays_of(scene, domain.grid)[1] / domain.spacing / 2
    return BrickGrid(domain, layout, max(1, math.ceil(half)) if is_mixed(scene) else 0)


def make_plan(
    scene: Scene,
    volumes: Sequence[KnownVolume],
    bricks: BrickGrid | None = None,
    layers: Sequence[Layer] = (),
) -> Plan:
    """Make the plan of a frame.

    Parameters
    ----------
    scene : a completed scene
    volumes : their metadata, in the order of the scene
    bricks : of the scene; None: it shows volumes only
    layers : meshes, lines and points, then unstructured grids, in these bricks

    Raises
    ------
    InputError
        The domain would have too many bricks, or a ray too many slabs; or the bricks of a volume alone lack the margin
        that it needs.
    """
    quality, mixed, bricks = scene.quality, is_mixed(scene), bricks or domain_bricks(scene, volumes)
    domain = bricks.domain.grid
    view, step_world, shortest = _rays_of(scene, domain)
    sampled = [*scene.drawn_as("samples").values()]
    spectrum = None if mixed else make_spectrum(sampled[0], scene.image.background)
    content, cost = make_content(scene, volumes, bricks, layers, step_world, spectrum)
    planes, surfaces = clip_planes(scene.clip, domain), bool(content.layers)
    # A slab's midpoint may be clipped where a fragment in the slab is not.
    beyond = planes.copy()
    beyond[:, 3] += content.reach * surfaces * np.linalg.norm(planes[:, :3], axis=1)
    all_grids, parts = [known.grid for known in volumes], content.volume_layers
    plan = Plan(
        view,
        March(
            step_world,
            quality.early_termination,
            lattice_of(sampled, quality),
            frame_coherence=None if surfaces else make_frame_coherence(scene, all_grids, shortest * step_world),
            discard_margin=quality.early_discarding if content.geometry and not content.cells else None,
        ),
        content,
        planes,
        np.where(clipped_bricks(beyond, content.layout), 0.0, cost),
        make_layers(scene, all_grids, [part.blend_mode for part in parts]),
        tuple(volume.time for volume in sampled),
        spectrum=spectrum,
    )
    return _behind_lens(plan if mixed else _of_lone_volume(plan, sampled[0], quality), scene)


def _rays_of(scene: Scene, domain: Grid) -> tuple[View, float, float]:
    """Return the view, the length of a slab in world units, and that of the shortest slab of all rays in these."""
    quality, view = scene.quality, make_view(scene.camera, scene.image.size, domain)
    sampled = [*scene.drawn_as("samples").values()]
    steps = [step_of(volume, quality.step, quality.classification) for volume in sampled]
    shortest = view.corner_cosine if lattice_of(sampled, quality) == "slices" else 1.0
    return view, slab_length(min(steps, default=quality.step), domain, shortest), shortest


def _of_lone_volume(plan: Plan, volume: Volume, quality: Quality) -> Plan:
    """Return the plan of a volume alone with what no mixed content has: slabs of other lengths, and rays that bend."""
    grid = plan.content.domain.grid
    adaptive = make_adaptive_step(volume, quality, grid, plan.volume.transfer)
    split = plan.volume.preintegrated and quality.borders == "split"
    refraction = make_refraction(volume, grid, plan.layout, plan.cost > 0, plan.march.step_world)
    return replace(plan, march=replace(plan.march, adaptive_step=adaptive, split=split), refraction=refraction)


def _behind_lens(plan: Plan, scene: Scene) -> Plan:
    """Return the plan of the sub-images of a scene's lens; with a pinhole, the plan itself."""
    lens = make_lens(scene, plan.view, plan.extent)
    if lens is None:
        return plan
    view = lens.view(plan.view)
    return replace(plan, view=view, clip=np.vstack([plan.clip, lens.planes(view)]), lens=lens)


def changed_settings(scene: Scene, ranks: int, on_cpu: bool = False) -> tuple[Change, ...]:
    """Return all settings of a scene that are not used as given.

    `scene`: completed, all settings chosen. `ranks`: that draw. `on_cpu`: the CPU ray caster draws.
    """
    found: list[Change] = []
    sampled, quality = scene.drawn_as("samples"), scene.quality
    surfaces, cells = scene.drawn_as("fragments"), scene.drawn_as("segments")
    if sampled:
        found += [*_of_quality([*sampled.values()], quality), *_of_light(sampled)]
    if quality.frame_coherence and (surfaces or cells):
        text = "rays start where they enter the box around all content"
        found.append(Change("quality.frame_coherence", True, False, text))
    margin, ends = quality.early_discarding, quality.early_termination > 0
    if margin is not None and cells:
        found.append(Change("quality.early_discarding", margin, "null", "rays through grids need all entries"))
    elif margin is not None and not any(ends or one.may_be_opaque for one in surfaces.values()):
        found.append(Change("quality.early_discarding", margin, "null", "nothing ends rays in front of geometry"))
    if scene.has_content:
        found += _of_cluster(scene, ranks)
    if on_cpu and quality.filter == "hardware":
        found.append(Change("quality.filter", "hardware", "exact", "CPUs have no texture unit"))
    return tuple(found)


def _of_quality(volumes: Sequence[Volume], quality: Quality) -> Iterator[Change]:
    step = min(step_of(volume, quality.step, quality.classification) for volume in volumes)
    if step < quality.step:
        text = f"slabs with geometry, pre-integration or refraction are at most {LONGEST_SLAB:g} voxels long"
        yield Change("quality.step", quality.step, step, text)
    ramps = [is_preintegrated(volume, quality.classification) for volume in volumes]
    if quality.classification == "pre-integrated" and not all(ramps):
        text = "not with isosurfaces, transfer_2d, a shader, nearest interpolation or a projection"
        which = "" if not any(ramps) else f" in volumes[{ramps.index(False)}]"
        yield Change("quality.classification", "pre-integrated", f"post{which}", text)
    if quality.borders == "split" and not any(ramps):
        yield Change("quality.borders", "split", "overlap", "only pre-integrated slabs are cut")
    if quality.jitter and any(has_surfaces(volume) for volume in volumes):
        yield Change("quality.jitter", True, False, "isosurfaces are found, not sampled")
    if quality.renderer == "slices" and any(has_surfaces(volume) for volume in volumes):
        yield Change("quality.renderer", "slices", "raycast", "isosurfaces are found, not sampled")
    if quality.filter == "hardware" and volumes[0].interpolation == "nearest":
        yield Change("quality.filter", "hardware", "exact", "nearest voxels are not weighted")
    if quality.early_termination > 0 and not any(BLEND_MODES[one.blending].composited for one in volumes):
        yield Change("quality.early_termination", quality.early_termination, 0.0, "there is no opacity that ends a ray")


def _of_light(volumes: Mapping[str, Volume]) -> Iterator[Change]:
    for key, volume in volumes.items():
        if volume.shade and not is_lit(volume):
            yield Change(f"{key}.shade", True, False, f"not with blending: {volume.blending}")


def _of_cluster(scene: Scene, ranks: int) -> Iterator[Change]:
    cluster = scene.cluster
    if cluster.distribution == "replicated" and cluster.copies > ranks:
        yield Change("cluster.copies", cluster.copies, ranks, "there are no more ranks")
    if cluster.mode == "hybrid" and cluster.groups is None and ranks < 3:
        yield Change("cluster.mode", "hybrid", "sort-last", "fewer than three ranks make no groups")
