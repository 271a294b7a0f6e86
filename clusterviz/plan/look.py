"""How the samples along a ray become a pixel: the look of a volume, as the renderer needs it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clusterviz.image.merge import Operator
from clusterviz.plan.encoding import in_units_of_clim
from clusterviz.plan.shading import Shading
from clusterviz.scene.transfer import TransferFunction
from clusterviz.scene.values import Volume

Blending = Literal["composite", "maximum", "minimum", "average", "additive", "local-maximum"]
OPERATORS: dict[Blending, Operator] = {
    "composite": "over",
    "maximum": "maximum",
    "minimum": "minimum",
    "average": "sum",
    "additive": "sum",
    "local-maximum": "stretch",
}


@dataclass(frozen=True)
class Look:
    """What is made of the samples of a ray.

    Attributes
    ----------
    blending : as in the scene
    threshold : in units of clim; what a stretch of a local maximum is not below
    shading : how the volume is lit; None where it is not
    """

    blending: Blending
    threshold: float = 0.0
    shading: Shading | None = None

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
        if self.blending == "composite":
            return transfer.is_transparent(low, high)
        if self.blending == "maximum":
            return np.asarray((low > high) | transfer.is_transparent(-np.inf, high))
        if self.blending == "minimum":
            return np.asarray((low > high) | transfer.is_transparent(low, np.inf))
        return np.asarray(low > high)


def is_lit(volume: Volume) -> bool:
    """Whether light makes a difference to a volume."""
    return volume.shade and volume.blending == "composite"


def margin_of(volume: Volume) -> int:
    """Samples beyond its cells' corners that a brick of the volume needs on every side: one for gradients."""
    return 1 if is_lit(volume) else 0


def make_look(volume: Volume, clim: tuple[float, float], shading: Shading | None) -> Look:
    """The look of a completed volume."""
    threshold = 0.0 if volume.threshold is None else float(in_units_of_clim(volume.threshold, *clim))
    return Look(volume.blending, threshold, shading)
