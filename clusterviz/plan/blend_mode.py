"""How the samples along a ray become a pixel: the look of a volume, as the renderer needs it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clusterviz.image.merge import Operator
from clusterviz.plan.encoding import FAR, in_units_of_clim
from clusterviz.plan.grading import Grading
from clusterviz.plan.shading import Shading
from clusterviz.scene.transfer import TransferFunction
from clusterviz.scene.values import Quality, Volume

Blending = Literal["composite", "maximum", "minimum", "average", "additive", "local-maximum", "isosurface"]
OPERATORS: dict[Blending, Operator] = {
    "composite": "over",
    "maximum": "maximum",
    "minimum": "minimum",
    "average": "sum",
    "additive": "sum",
    "local-maximum": "stretch",
    "isosurface": "over",
}


Classification = Literal["post", "pre-integrated"]
Borders = Literal["overlap", "split"]

LONGEST_SLAB = 2.0
"""Voxels; where the field is sampled at the ends of slabs, they lie in their brick's margin."""


@dataclass(frozen=True)
class Surface:
    """An isosurface.

    Attributes
    ----------
    value : in data values
    units : the same in units of clim
    colour : straight (r, g, b)
    opacity : for no length
    """

    value: float
    units: float
    colour: tuple[float, float, float]
    opacity: float


@dataclass(frozen=True)
class BlendMode:
    """What is made of the samples of a ray.

    Attributes
    ----------
    blending : as in the scene
    threshold : in units of clim; what a stretch of a local maximum is not below
    shading : how the volume is lit; None where it is not
    surfaces : those that are not wholly transparent, by ascending value
    grading : how opacity depends on the gradient's magnitude; None where it does not
    smooth : gradients are those of cubic B-splines, whatever the field is
    """

    blending: Blending
    threshold: float = 0.0
    shading: Shading | None = None
    surfaces: tuple[Surface, ...] = ()
    grading: Grading | None = None
    smooth: bool = False

    @property
    def operator(self) -> Operator:
        """How the pixels of two boxes become one; what their four floats mean is said in `image/merge.py`."""
        return OPERATORS[self.blending]

    def hides(self, transfer: TransferFunction, low: ArrayLike, high: ArrayLike) -> NDArray[np.bool_]:
        """Whether samples in a closed interval can be left out without any change of the picture.

        Parameters
        ----------
        low, high : (…) data values; an interval with low > high holds no sample

        Returns
        -------
        hidden : bool (…). A maximum needs no scalar below which all is transparent, a minimum none above which all is.
            Averages count transparent samples as well, sums show black where the volume is, and stretches end there.
        """
        low, high = np.asarray(low, np.float64), np.asarray(high, np.float64)
        if self.blending in ("composite", "isosurface"):
            nothing = np.ones(low.shape, bool) if self.blending == "isosurface" else transfer.is_transparent(low, high)
            for surface in self.surfaces:
                nothing = nothing & ~((low <= surface.value) & (surface.value <= high))
            return np.asarray(nothing)
        if self.blending == "maximum":
            return np.asarray((low > high) | transfer.is_transparent(-np.inf, high))
        if self.blending == "minimum":
            return np.asarray((low > high) | transfer.is_transparent(low, np.inf))
        return np.asarray(low > high)

    def surface_block(self) -> NDArray[np.float32]:
        """The block of surfaces.glsl, (2 · surfaces, 4)."""
        rows = [row for s in self.surfaces for row in ((s.units, 0.0, 0.0, 0.0), (*s.colour, s.opacity))]
        return np.array(rows, np.float32)


def is_lit(volume: Volume) -> bool:
    """Whether light makes a difference to a volume."""
    return volume.shade and volume.blending in ("composite", "isosurface")


def is_graded(volume: Volume) -> bool:
    """Whether the magnitude of the gradient makes a difference to a volume's opacity."""
    return volume.blending == "composite" and bool(volume.gradient_opacity or volume.transfer_2d)


def has_surfaces(volume: Volume) -> bool:
    """Whether isosurfaces are shown, alone or in the volume."""
    return bool(volume.isosurfaces) and volume.blending in ("composite", "isosurface")


def classification_of(quality: Quality) -> Classification:
    """What bricks must be read for: both ways, where the choice is open."""
    return quality.classification if quality.max_error is None else "pre-integrated"


def is_preintegrated(volume: Volume, classification: Classification) -> bool:
    """Whether slabs of the volume are classified between their ends.

    Not where no light is blended, nor between nearest voxels, where a slab has one scalar and not a ramp, nor where
    surfaces cut the slabs, nor by a table of two dimensions.
    """
    if volume.interpolation == "nearest" or volume.isosurfaces or volume.transfer_2d:
        return False
    return classification == "pre-integrated" and volume.blending == "composite"


def is_jittered(volume: Volume, jitter: bool) -> bool:
    """Whether each pixel has a lattice of slabs of its own; surfaces are found, not sampled, and need none."""
    return jitter and not has_surfaces(volume)


def reach_of(volume: Volume, classification: Classification = "post", borders: Borders = "overlap") -> int:
    """Cells beyond its own in which a brick of the volume samples the field: where slabs end, if that is asked."""
    return int(has_surfaces(volume) or (is_preintegrated(volume, classification) and borders == "overlap"))


LARGEST_MARGIN = 2
"""What `margin_of` gives at most; of bricks that are read before it is known how they are shown."""


def margin_of(volume: Volume, classification: Classification = "post", borders: Borders = "overlap") -> int:
    """Samples beyond its cells' corners that a brick needs on every side: one for its reach, one for a kernel."""
    kernel = is_lit(volume) or is_graded(volume) or volume.interpolation == "cubic"
    return reach_of(volume, classification, borders) + kernel


def spread_of(volume: Volume, classification: Classification = "post", borders: Borders = "overlap") -> int:
    """Samples beyond a cell's corners on which the field in it, or where its slabs end, may depend."""
    return reach_of(volume, classification, borders) + (volume.interpolation == "cubic")


def step_of(volume: Volume, step: float, classification: Classification = "post") -> float:
    """The length of a slab in voxels; bounded where the field is sampled at its ends."""
    return min(step, LONGEST_SLAB) if reach_of(volume, classification) else step


def make_blend_mode(
    volume: Volume, transfer: TransferFunction, shading: Shading | None, grading: Grading | None = None
) -> BlendMode:
    """The look of a completed volume."""
    threshold = 0.0 if volume.threshold is None else _in_float32(in_units_of_clim(volume.threshold, *transfer.domain))
    surfaces = []
    for entry in volume.isosurfaces if has_surfaces(volume) else ():
        value, opacity = entry if isinstance(entry, tuple) else (entry, float(transfer.opacity(entry)))
        red, green, blue = transfer.colour(value).tolist()
        units = _in_float32(in_units_of_clim(value, *transfer.domain))
        surfaces.append(Surface(value, units, (red, green, blue), opacity))
    visible = tuple(sorted((s for s in surfaces if s.opacity > 0), key=lambda surface: surface.value))
    smooth = volume.gradient == "smooth" and bool(shading or grading)
    return BlendMode(volume.blending, threshold, shading, visible, grading, smooth)


def _in_float32(units: NDArray[np.float64]) -> float:
    """A value in units of clim that float32 holds; no voxel comes to what lies beyond `FAR`."""
    return float(np.clip(units, -2 * FAR, 2 * FAR))
