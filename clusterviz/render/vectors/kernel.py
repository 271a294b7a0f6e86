"""What a kernel is made for: the constants of its code, taken from a plan."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from clusterviz.plan.encoding import VoxelKind
from clusterviz.plan.grading import Table as TableHolds
from clusterviz.plan.look import Blending, Look
from clusterviz.plan.mixture import Ingredient
from clusterviz.plan.plan import Filter, Plan
from clusterviz.render.vectors.transfer.pieces import MOST, Pieces

if TYPE_CHECKING:
    from clusterviz.render.vectors.looks.light import Light

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
    stretched : slabs are longer where groups of cells allow it
    split : slabs are cut where they leave a brick
    surfaces : isosurfaces are shown, alone or in the volume
    leaping : rays start where the last frame says
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
    stretched: bool = False
    split: bool = False
    surfaces: bool = False
    leaping: bool = False
    pitched: bool = False
    wide: bool = False
    volumes: tuple[Kernel, ...] = ()

    @property
    def name(self) -> str:
        """Of the function."""
        if self.volumes:
            # Names of several would make too long a one for a file.
            each = hashlib.sha256(" ".join(volume.name for volume in self.volumes).encode()).hexdigest()[:16]
            ways = "_jittered" * self.jittered + "_leaping" * self.leaping + "_wide" * self.wide
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
            *(["stretched"] if self.stretched else []),
            *(["split"] if self.split else []),
            *(["surfaces"] if self.surfaces and self.blending == "composite" else []),
            *(["leaping"] if self.leaping else []),
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
    blending = plan.look.blending
    preintegrated = plan.march.preintegrated
    apart = preintegrated or plan.look.grading is not None
    few = pieces if lanes == MOST and blending == "composite" and not apart else None
    held: Held = "many" if few is None else "fitted" if few.fitted else "few"
    blending = "average" if blending == "additive" else blending
    light, smooth = _light_of(plan.look), plan.look.smooth
    kind, graded, jittered = plan.encoding.kind, _graded_of(plan.look), plan.march.jittered
    surfaces = bool(plan.look.surfaces) or blending == "isosurface"
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
        stretched=plan.march.stretching is not None,
        split=plan.march.split,
        surfaces=surfaces,
        leaping=plan.march.leaping is not None,
        pitched=plan.layout.edges_zyx is not None,
    )


def mixed_kernel_of(plan: Plan, lanes: int, pieces: Sequence[Pieces | None]) -> Kernel:
    """The kernel that a plan of several volumes needs.

    Parameters
    ----------
    pieces : of the transfer function of each, where they are few
    """
    assert plan.mixture is not None, "the plan is one of several volumes"
    each = zip(plan.mixture.ingredients, pieces, strict=True)
    volumes = tuple(_volume_kernel(part, lanes, own) for part, own in each)
    jittered, leaping = plan.march.jittered, plan.march.leaping is not None
    return Kernel("u8", "linear", "composite", "many", 0, lanes, jittered=jittered, leaping=leaping, volumes=volumes)


def _volume_kernel(part: Ingredient, lanes: int, pieces: Pieces | None) -> Kernel:
    """What one of several volumes needs."""
    look = part.look
    apart = part.preintegrated or (look.grading is not None and look.grading.table is not None)
    few = pieces is not None and pieces.fitted and lanes == MOST and not apart
    held: Held = "fitted" if few else "many"
    light, graded = _light_of(look), _graded_of(look)
    kind, capacity = part.encoding.kind, pieces.capacity if few and pieces else 0
    ramped = part.preintegrated
    return Kernel(kind, part.interpolation, "composite", held, capacity, lanes, ramped, light, graded, look.smooth)


def _light_of(look: Look) -> Light:
    """What shines on a volume."""
    return ("near" if look.shading.has_places else "far") if look.shading else ""


def _graded_of(look: Look) -> Graded:
    """What the gradient's magnitude does to a volume's opacity."""
    grading = look.grading
    if grading is None:
        return ""
    holds: dict[TableHolds, Graded] = {"": "faded", "opacity": "opacities", "colour and opacity": "colours"}
    return holds[grading.table_holds]


def can_draw(plan: Plan) -> bool:
    """Whether there is a kernel for a plan."""
    march = plan.march
    leaps_in_parts = march.split and march.leaping is not None
    parts = plan.mixture.ingredients if plan.mixture else ()
    # Of several volumes none may have surfaces, or nothing but surfaces.
    has_surfaces = any(part.look.surfaces or part.look.blending != "composite" for part in parts)
    return not (has_surfaces or leaps_in_parts) and march.filter in ("linear", "nearest", "cubic")
