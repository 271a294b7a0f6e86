"""What a kernel is made for: the constants of its code, taken from a plan."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

from clusterviz.plan.blend_mode import BlendMode
from clusterviz.plan.encoding import VoxelKind
from clusterviz.plan.multi_volume import VolumeLayer
from clusterviz.plan.plan import Filter, Plan
from clusterviz.plan.shading import Table as TableHolds
from clusterviz.render.cpu.transfer.pieces import CAPACITIES, MOST, Pieces
from clusterviz.scene.blend_modes import Blending

if TYPE_CHECKING:
    from clusterviz.render.cpu.blending.light import Light

Held = Literal["many", "few", "fitted"]
Graded = Literal["", "faded", "opacities", "colours"]
"""It does nothing; extinction is multiplied; a table holds opacities, or colours, too."""


@dataclass(frozen=True)
class Kernel:
    """What a kernel is made for; its fields are constants of its code.

    Attributes
    ----------
    kind : how voxels are stored
    filter : how the field is reconstructed
    blending : what becomes of samples; sums are averages, too
    pieces : the transfer function's are many; or few, held in registers; or few, and fitted by polynomials
    capacity : as many as registers hold then; else 0
    lanes : pixels of a packet
    preintegrated : slabs are classified between their ends
    light : what shines on the volume
    graded : what the gradient's magnitude does to opacity
    smooth : gradients are those of cubic B-splines, whatever the field is
    jittered : every pixel has a lattice of slabs of its own
    adaptive : slabs are longer where groups of cells allow it
    split : slabs are cut where they leave a brick
    surfaces : isosurfaces are shown, alone or in the volume
    frame_coherence : rays start where the last frame says
    pitched : bricks are of several sizes
    wide : the numbers of voxels take 64 bits
    volumes : of several volumes what each needs; what the kernel says of one volume is then of no account
    """

    kind: VoxelKind
    filter: Filter
    blending: Blending
    pieces: Held
    capacity: int
    lanes: int
    preintegrated: bool = False
    light: Light = ""
    graded: Graded = ""
    smooth: bool = False
    jittered: bool = False
    adaptive: bool = False
    split: bool = False
    surfaces: bool = False
    frame_coherence: bool = False
    pitched: bool = False
    wide: bool = False
    volumes: tuple[Kernel, ...] = ()

    @property
    def name(self) -> str:
        """Of the function."""
        if self.volumes:
            # Names of several would make too long a one for a file.
            each = hashlib.sha256(" ".join(volume.name for volume in self.volumes).encode()).hexdigest()[:16]
            ways = "_jittered" * self.jittered + "_leaping" * self.frame_coherence + "_wide" * self.wide
            return f"cast_{len(self.volumes)}_volumes_{each}_{self.lanes}{ways}"
        parts = (
            self.kind,
            self.filter,
            self.blending,
            self.pieces + (str(self.capacity) if self.capacity else ""),
            str(self.lanes),
            *(["preintegrated"] if self.preintegrated else []),
            *([self.light] if self.light else []),
            *([self.graded] if self.graded else []),
            *(["smooth"] if self.smooth else []),
            *(["jittered"] if self.jittered else []),
            *(["adaptive"] if self.adaptive else []),
            *(["split"] if self.split else []),
            *(["surfaces"] if self.surfaces and self.blending == "composite" else []),
            *(["frame_coherence"] if self.frame_coherence else []),
            *(["pitched"] if self.pitched else []),
            *(["wide"] if self.wide else []),
        )
        return f"cast_{'_'.join(parts)}"


def kernel_of(plan: Plan, lanes: int, pieces: Pieces | None) -> Kernel:
    """The kernel that a plan needs.

    Parameters
    ----------
    pieces : the transfer function's, where they are few
    """
    blending = plan.blend_mode.blending
    preintegrated = plan.march.preintegrated
    apart = preintegrated or plan.blend_mode.grading is not None
    few = pieces if lanes == MOST and blending == "composite" and not apart else None
    held: Held = "many" if few is None else "fitted" if few.fitted else "few"
    blending = "average" if blending == "additive" else blending
    light, smooth = _light_of(plan.blend_mode), plan.blend_mode.smooth
    kind, graded, jittered = plan.encoding.kind, _graded_of(plan.blend_mode), plan.march.jittered
    surfaces = bool(plan.blend_mode.surfaces) or blending == "isosurface"
    return Kernel(
        kind,
        plan.march.filter,
        blending,
        held,
        few.capacity if few else 0,
        lanes,
        preintegrated,
        light,
        graded,
        smooth,
        jittered,
        adaptive=plan.march.adaptive_step is not None,
        split=plan.march.split,
        surfaces=surfaces,
        frame_coherence=plan.march.frame_coherence is not None,
        pitched=plan.layout.edges_zyx is not None,
    )


def mixed_kernel_of(plan: Plan, lanes: int, pieces: Sequence[Pieces | None]) -> Kernel:
    """The kernel that a plan of several volumes needs.

    Parameters
    ----------
    pieces : of the transfer function of each, where they are few
    """
    assert plan.multi_volume is not None, "the plan is one of several volumes"
    each = zip(plan.multi_volume.volume_layers, pieces, strict=True)
    volumes = tuple(_volume_kernel(part, lanes, own) for part, own in each)
    jittered, frame_coherence = plan.march.jittered, plan.march.frame_coherence is not None
    return Kernel(
        "u8",
        "linear",
        "composite",
        "many",
        0,
        lanes,
        jittered=jittered,
        frame_coherence=frame_coherence,
        volumes=volumes,
    )


def _volume_kernel(part: VolumeLayer, lanes: int, pieces: Pieces | None) -> Kernel:
    """What one of several volumes needs."""
    blend_mode = part.blend_mode
    apart = part.preintegrated or (blend_mode.grading is not None and blend_mode.grading.table is not None)
    few = pieces is not None and pieces.fitted and lanes == MOST and not apart
    held: Held = "fitted" if few else "many"
    light, graded = _light_of(blend_mode), _graded_of(blend_mode)
    kind, capacity = part.encoding.kind, pieces.capacity if few and pieces else 0
    ramped = part.preintegrated
    return Kernel(
        kind, part.interpolation, "composite", held, capacity, lanes, ramped, light, graded, blend_mode.smooth
    )


def _light_of(blend_mode: BlendMode) -> Light:
    """What shines on a volume."""
    return ("near" if blend_mode.shading.has_places else "far") if blend_mode.shading else ""


def _graded_of(blend_mode: BlendMode) -> Graded:
    """What the gradient's magnitude does to a volume's opacity."""
    grading = blend_mode.grading
    if grading is None:
        return ""
    holds: dict[TableHolds, Graded] = {"": "faded", "opacity": "opacities", "colour and opacity": "colours"}
    return holds[grading.table_holds]


def can_draw(plan: Plan) -> bool:
    """Whether there is a kernel for a plan."""
    march = plan.march
    coherent_in_parts = march.split and march.frame_coherence is not None
    parts = plan.multi_volume.volume_layers if plan.multi_volume else ()
    modes = [part.blend_mode for part in parts] or [plan.blend_mode]
    occluded = any(mode.shading and len(mode.shading.occlusion) for mode in modes)
    # Of several volumes none may have surfaces, or nothing but surfaces.
    has_surfaces = any(part.blend_mode.surfaces or part.blend_mode.blending != "composite" for part in parts)
    has_look = any(mode.grading and mode.grading.look for mode in modes)
    refused = has_surfaces or coherent_in_parts or bool(plan.layers) or has_look or occluded
    return not refused and march.filter in (
        "linear",
        "nearest",
        "cubic",
    )


def common_kernels(lanes: int) -> list[Kernel]:
    """Return kernels for one volume with linear interpolation: composite, shaded or not, maximum, and isosurface."""
    found: list[Kernel] = []
    for kind in ("u8", "u16", "f32"):
        for light in ("", "far"):
            found += [Kernel(kind, "linear", "composite", "many", 0, lanes, light=light)]
            if lanes == MOST:
                found += [Kernel(kind, "linear", "composite", "fitted", n, lanes, light=light) for n in CAPACITIES]
        found.append(Kernel(kind, "linear", "maximum", "many", 0, lanes))
        found.append(Kernel(kind, "linear", "isosurface", "many", 0, lanes, light="far", surfaces=True))
    return found


def first_kernels(lanes: int) -> list[Kernel]:
    """Return the kernels of `launch/demo`, and of an 8-bit data file without a scene."""
    names = [Kernel("u8", "linear", "composite", "many", 0, lanes, light=light) for light in ("", "far")]
    return [replace(each, pieces="fitted", capacity=CAPACITIES[1]) for each in names] if lanes == MOST else names
