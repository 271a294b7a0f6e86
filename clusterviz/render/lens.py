"""Picture of a thin lens, from the sub-images of ranges of depth (`plan/lens.py`), by pyramid filters.

Sub-images are composited towards the plane in focus, those behind it from the farthest on, those in front of it from the
nearest on. After each, all that has been composited is blurred by what is missing to the radius of the next one, so
that a sub-image is blurred by its own radius in the end: variances add up. So neighbours, whose radii differ little, are
blurred nearly together, as they are by a lens, and only what is in front of the focus and what is behind it are blurred
independently of each other. (The thesis blurs each sub-image independently; seams of surfaces become transparent.)

What a foreground hides is drawn, and becomes visible at its blurred edge. Only a surface that goes on from one
sub-image to the next ends at the border of both, so the one behind is continued under the opaque part of the one in front,
by pull-push interpolation, and no seam opens. (The thesis continues all that is hidden, which its one picture lacks.)

Errors: radii are those of sub-images; the disc of a lens is replaced by a filter of the same variance; the two sides of
the focus are independent; at a large margin of the picture something is missing. `docs/how-to/show-depth-of-field.md`
has measured errors. Cost: linear in pixels and in sub-images, whatever the radii.

References
----------
M. Kraus, M. Strengert: Depth-of-field rendering by pyramidal image processing, Computer Graphics Forum 26(3), 2007.
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, 4.2.4.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from clusterviz.image.merge import over
from clusterviz.image.pyramid import blur, fill
from clusterviz.plan.lens import Lens

Pixels = NDArray[np.float32]
OPAQUE_POWER = 8
"""A sub-image is continued under what is in front of it by this power of the opacity there, so that only what is nearly
opaque counts as hiding."""
LEAST_HIDDEN = 1e-3
"""Weight of a continuation below which there is none."""


def depth_of_field(tall: Pixels, lens: Lens) -> Pixels:
    """Return the picture of a lens.

    Parameters
    ----------
    tall : float32 (n h, w, 4), premultiplied, the composited sub-images with their margin; row y of sub-image k is row
        y n + k

    Returns
    -------
    rgba : float32 (height, width, 4), premultiplied, without the margin
    """
    height, width = len(tall) // lens.count, tall.shape[1]
    sub_images = np.moveaxis(tall.reshape(height, lens.count, width, 4), 1, 0)
    sharp, near, far = (np.zeros((height, width, 4), np.float32) for _ in range(3))
    radii = lens.radii.tolist()
    for number in range(lens.count - 1, -1, -1):
        if radii[number] > 0:
            behind = _continued(sub_images, number)
            far = _blurred(over(behind, far), radii[number], max(0.0, radii[number - 1]) if number else 0.0)
    for number in range(lens.count):
        if radii[number] < 0:
            next_radius = -radii[number + 1] if number + 1 < lens.count else 0.0
            near = _blurred(over(near, _continued(sub_images, number)), -radii[number], max(0.0, next_radius))
        elif radii[number] == 0:
            sharp = _continued(sub_images, number)
    picture = over(over(near, sharp), far)
    rows, columns = (slice(lens.margin, lens.margin + side) for side in lens.size[::-1])
    return np.ascontiguousarray(picture[rows, columns])


def _blurred(picture: Pixels, radius: float, next_radius: float) -> Pixels:
    """Return a picture with the blur of one radius that that of the next one leaves; the same if it is empty.

    The disc of a lens has a quarter of its squared radius as variance along each axis.
    """
    if not picture[..., 3].any():
        return picture
    return blur(picture, math.sqrt(radius**2 - next_radius**2) / 2)


def _continued(sub_images: Pixels, number: int) -> Pixels:
    """Return a sub-image that goes on under the opaque part of the one in front of it, where it is empty."""
    own = sub_images[number]
    if number == 0:
        return own
    hidden = sub_images[number - 1, ..., 3] ** OPAQUE_POWER * (1 - own[..., 3])
    hidden = np.where(hidden > LEAST_HIDDEN, hidden, np.float32(0))[..., None]
    if not hidden.any() or not own[..., 3].any():
        return own
    continued: Pixels = own * (1 - hidden) + hidden * fill(own, 1 - hidden[..., 0])
    return continued
