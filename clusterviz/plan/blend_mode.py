"""Blend mode of a volume as the renderer needs it: how the samples along a ray become a pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clusterviz.image.merge import Operator
from clusterviz.plan.encoding import FAR, in_units_of_clim
from clusterviz.plan.shading import Grading, Shading
from clusterviz.scene.blend_modes import BLEND_MODES, DEFAULT_BLENDING, Blending, BlendModeTraits
from clusterviz.scene.transfer import TransferFunction
from clusterviz.scene.values import Quality, Volume

Classification = Literal["post", "pre-integrated"]
Borders = Literal["overlap", "split"]
Lattice = Literal["rays", "jittered", "slices"]

LONGEST_SLAB = 2.0
"""Voxels, if the field is sampled at the ends of slabs, so that these lie in their brick's margin."""


@dataclass(frozen=True)
class Surface:
    """An isosurface."""

    value: float  # isovalue in data values
    units: float  # isovalue in units of clim
    colour: tuple[float, float, float]  # straight (r, g, b)
    opacity: float  # opacity of the surface, whatever the step
    number: int = 1  # its number in the volume's list, from 1


@dataclass(frozen=True)
class BlendMode:
    """Blend mode of a volume, with its lighting and isosurfaces."""

    blending: Blending = DEFAULT_BLENDING  # as in the scene
    threshold: float = 0.0  # least scalar of the run of a local maximum, in units of clim
    shading: Shading | None = None  # lighting; None if the volume is not lit
    surfaces: tuple[Surface, ...] = ()  # isosurfaces that are not wholly transparent, by ascending value
    grading: Grading | None = None  # dependence of opacity on the gradient's magnitude; None if there is none
    smooth: bool = False  # gradients are those of cubic B-splines, with any interpolation
    of_lines: bool = False  # opacity and light depend on vectors, whose components are the three volumes before

    @property
    def traits(self) -> BlendModeTraits:
        """Record of the mode."""
        return BLEND_MODES[self.blending]

    @property
    def operator(self) -> Operator:
        """Operator that merges the pixels of two boxes; `image/merge.py` defines their four floats."""
        return self.traits.operator

    def hides(self, transfer: TransferFunction, low: ArrayLike, high: ArrayLike) -> NDArray[np.bool_]:
        """Return True where samples in a closed interval do not affect the picture.

        `low`, `high`: (…) data values; an interval with low > high holds no sample. Returns bool (…), by the mode's
        `skip`.
        """
        low, high = np.asarray(low, np.float64), np.asarray(high, np.float64)
        hidden = low > high
        match self.traits.skip:
            case "all":
                hidden = np.ones(low.shape, bool)
            case "transparent":
                hidden = transfer.is_transparent(low, high)
            case "transparent below":
                hidden = hidden | transfer.is_transparent(-np.inf, high)
            case "transparent above":
                hidden = hidden | transfer.is_transparent(low, np.inf)
            case "below threshold":
                # The threshold is rounded to float32, and so are samples, in data values and in units of clim.
                most = in_units_of_clim(np.maximum(high * (1 - 2.0**-20), high * (1 + 2.0**-20)), *transfer.domain)
                hidden = hidden | (most < self.threshold - 2.0**-20 * max(1.0, abs(self.threshold)))
        for surface in self.surfaces:
            hidden = hidden & ~((low <= surface.value) & (surface.value <= high))
        return np.asarray(hidden)

    def surface_block(self) -> NDArray[np.float32]:
        """Return the block of surfaces.glsl, (2 · surfaces, 4)."""
        rows = [row for s in self.surfaces for row in ((s.units, 0.0, 0.0, 0.0), (*s.colour, s.opacity))]
        return np.array(rows, np.float32)


def is_lit(volume: Volume) -> bool:
    """Return True if a volume is lit."""
    return volume.shade and BLEND_MODES[volume.blending].lit


def is_graded(volume: Volume) -> bool:
    """Return True if a volume's opacity or colour may depend on the gradient."""
    return BLEND_MODES[volume.blending].absorbs and bool(volume.gradient_opacity or volume.transfer_2d or volume.shader)


def has_surfaces(volume: Volume) -> bool:
    """Return True if isosurfaces are shown, alone or in the volume."""
    return bool(volume.isosurfaces) and BLEND_MODES[volume.blending].surfaces != "refused"


def classification_of(quality: Quality) -> Classification:
    """Return the classification that bricks are read for; it suits both if the choice is open."""
    return quality.classification if quality.max_error is None else "pre-integrated"


def is_preintegrated(volume: Volume, classification: Classification) -> bool:
    """Return True if slabs of the volume are classified between their ends.

    They are not in projections, with nearest-voxel interpolation, with isosurfaces, which cut slabs, with a 2-D
    transfer function, nor with a user's look.
    """
    if volume.interpolation == "nearest" or volume.isosurfaces or volume.transfer_2d or volume.shader:
        return False
    return classification == "pre-integrated" and BLEND_MODES[volume.blending].absorbs


def lattice_of(volumes: Sequence[Volume], quality: Quality) -> Lattice:
    """Return where slabs begin; isosurfaces need rays alone, as they are not sampled."""
    if not volumes or any(has_surfaces(volume) for volume in volumes):
        return "rays"
    if quality.renderer == "slices":
        return "slices"
    return "jittered" if quality.jitter else "rays"


def reach_of(volume: Volume, classification: Classification = "post", borders: Borders = "overlap") -> int:
    """Return the cells beyond its own in which a brick samples the field, at the ends of slabs."""
    at_ends = is_preintegrated(volume, classification) and borders == "overlap"
    return int(has_surfaces(volume) or at_ends or volume.refracts)


LARGEST_MARGIN = 2
"""Largest result of `margin_of`, for bricks that are read before the blend mode is known."""


def margin_of(
    volume: Volume,
    classification: Classification = "post",
    borders: Borders = "overlap",
    has_layers: bool = False,
    around: int = 0,
) -> int:
    """Return the samples that a brick needs beyond its cells on every side: one for its reach, one for a kernel.

    `has_layers`: the picture has other layers than the colours. `around`: see `occlusion_reach`.
    """
    kernel = has_layers or is_lit(volume) or is_graded(volume) or volume.refracts or volume.interpolation == "cubic"
    return reach_of(volume, classification, borders) + kernel + around


def spread_of(volume: Volume, classification: Classification = "post", borders: Borders = "overlap") -> int:
    """Return the samples beyond a cell's corners on which the field in it, or at the ends of its slabs, depends."""
    return reach_of(volume, classification, borders) + (volume.interpolation == "cubic")


def step_of(volume: Volume, step: float, classification: Classification = "post") -> float:
    """Return the length of a slab in voxels; it is bounded if the field is sampled at its ends."""
    return min(step, LONGEST_SLAB) if reach_of(volume, classification) else step


def make_blend_mode(
    volume: Volume, transfer: TransferFunction, shading: Shading | None, grading: Grading | None = None
) -> BlendMode:
    """Return the blend mode of a completed volume."""
    threshold = 0.0 if volume.threshold is None else _in_float32(in_units_of_clim(volume.threshold, *transfer.domain))
    surfaces = []
    for number, entry in enumerate(volume.isosurfaces if has_surfaces(volume) else (), start=1):
        value, opacity = entry if isinstance(entry, tuple) else (entry, float(transfer.opacity(entry)))
        red, green, blue = transfer.colour(value).tolist()
        units = _in_float32(in_units_of_clim(value, *transfer.domain))
        surfaces.append(Surface(value, units, (red, green, blue), opacity, number))
    visible = tuple(sorted((s for s in surfaces if s.opacity > 0), key=lambda surface: surface.value))
    smooth = volume.gradient == "smooth" and bool(shading or grading or volume.refracts)
    of_lines = volume.vector_unit is not None
    return BlendMode(volume.blending, threshold, shading, visible, grading, smooth, of_lines)


def _in_float32(units: NDArray[np.float64]) -> float:
    """Return a value in units of clim clamped to `FAR`, which no voxel exceeds."""
    return float(np.clip(units, -2 * FAR, 2 * FAR))
