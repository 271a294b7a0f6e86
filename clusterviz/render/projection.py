"""Last step of projections: from merged scalars or sums to colours."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clusterviz.image.merge import EXISTS
from clusterviz.plan.plan import Plan

Pixels = NDArray[np.float32]


def finish_projection(plan: Plan, merged: Pixels) -> Pixels:
    """Return the picture of merged pixels, by the `resolve` step of the blend mode.

    Scalars get their colour and opacity, not corrected for any length. An average is the mean of opacity × scalar along
    the ray through valid voxels, a sum is that times the length of the ray in opacity unit distances; both are grey and
    opaque, and scalars are clamped to clim, as in VTK.

    Parameters
    ----------
    merged : float32 (h, w, 4), see `image/merge.py`

    Returns
    -------
    rgba : float32 (h, w, 4), premultiplied; composited pixels are returned as they are
    """
    resolve = plan.blend_mode.traits.resolve
    if resolve == "none":
        return merged
    rgba = np.zeros(merged.shape, np.float32)
    hit = merged[..., 3] > 0
    pixels = merged[hit].astype(np.float64)
    if resolve in ("mean", "integral"):
        grey = pixels[:, 0] * plan.march.slab_units if resolve == "integral" else pixels[:, 0] / pixels[:, 3]
        rgba[hit] = np.append(np.repeat(np.clip(grey, 0, 1)[:, None], 3, axis=1), np.ones((len(grey), 1)), axis=1)
        return rgba
    units = pixels[:, 0]
    if resolve == "colour of run":
        units = np.where(pixels[:, 2].astype(int) & EXISTS, units, pixels[:, 1])
    low, high = plan.transfer.domain
    scalars = low * (1 - units) + high * units
    alpha = plan.transfer.opacity(scalars)[:, None]
    rgba[hit] = np.append(plan.transfer.colour(scalars) * alpha, alpha, axis=1)
    return rgba
