"""Picture of a thin lens, from the sub-images of ranges of depth (`plan/lens.py`), by pyramid filters.

Sub-images are composited towards the plane in focus, those behind it from the farthest on, those in front of it from
the nearest on. After each, all that has been composited is blurred by what is missing to the radius of the next one, so
that a sub-image is blurred by its own radius in the end: variances add up. So neighbours, whose radii differ little,
are blurred nearly together, as they are by a lens, and only what is in front of the focus and what is behind it are
blurred independently of each other. (The thesis blurs each sub-image independently; seams of surfaces become
transparent.)

What a foreground hides is drawn, and becomes visible at its blurred edge. Only a surface that goes on from one
sub-image to the next ends at the border of both. So a sub-image is continued under what is opaque in front of it, where
it is empty, by pull-push interpolation, and no seam opens.

Errors: radii are those of sub-images; the disc of a lens is replaced by a filter of the same variance; the two sides of
the focus are independent; radii beyond the picture's margin have too little to gather.
`docs/how-to/show-depth-of-field.md` has measured errors. Cost: linear in pixels and in sub-images, whatever the radii.

References
----------
M. Kraus, M. Strengert: Depth-of-field rendering by pyramidal image processing, Computer Graphics Forum 26(3), 2007.
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, 4.2.4.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm.placement import kernel_threads
from clusterviz.image.merge import over
from clusterviz.image.pyramid.blur import blur
from clusterviz.image.pyramid.interpolation import interpolate
from clusterviz.jobs.device import Device, on_device
from clusterviz.plan.lens import Lens

Pixels = NDArray[np.float32]
OPAQUE_POWER = 8
"""A sub-image is continued under what is in front of it by this power of the opacity there, so that only what is nearly
opaque counts as hiding."""
MOST_KNOWN = 0.5
"""Weight of a continuation up to which a pixel's own value is known."""


def depth_of_field(tall: Pixels, lens: Lens) -> Pixels:
    """Return the picture of a lens; its filters run on the CPU, as they do less than pixels on the bus cost.

    Parameters
    ----------
    tall : float32 (n h, w, 4), premultiplied, the composited sub-images with their margin; row y of sub-image k is row
        y n + k

    Returns
    -------
    rgba : float32 (height, width, 4), premultiplied, without the margin
    """
    with on_device(Device(threads=kernel_threads())):
        picture = _blended(tall, lens)
    rows, columns = (slice(lens.margin, lens.margin + side) for side in lens.size[::-1])
    return np.ascontiguousarray(picture[rows, columns])


def _blended(tall: Pixels, lens: Lens) -> Pixels:
    """Return the picture with its margin."""
    height, width = len(tall) // lens.count, tall.shape[1]
    sub_images = np.moveaxis(tall.reshape(height, lens.count, width, 4), 1, 0)
    sharp, near, far, hiding = (np.zeros((height, width, 4), np.float32) for _ in range(4))
    continued, radii = [], lens.radii.tolist()
    for own in sub_images:
        continued.append(_continued(own, hiding[..., 3]))
        hiding = over(hiding, own)
    for number in range(lens.count - 1, -1, -1):
        if radii[number] > 0:
            following = max(0.0, radii[number - 1]) if number else 0.0
            far = _blurred(over(continued[number], far), radii[number], following)
    for number in range(lens.count):
        if radii[number] < 0:
            following = max(0.0, -radii[number + 1]) if number + 1 < lens.count else 0.0
            near = _blurred(over(near, continued[number]), -radii[number], following)
        elif radii[number] == 0:
            sharp = continued[number]
    return over(over(near, sharp), far)


def _blurred(picture: Pixels, radius: float, next_radius: float) -> Pixels:
    """Return a picture with the blur of one radius that that of the next one leaves; the same if it is empty.

    The disc of a lens has a quarter of its squared radius as variance along each axis.
    """
    if not picture[..., 3].any():
        return picture
    return blur(picture, math.sqrt(radius**2 - next_radius**2) / 2)


def _continued(own: Pixels, hiding: NDArray[np.float32]) -> Pixels:
    """Return a sub-image that goes on under what hides it, where it is empty.

    Parameters
    ----------
    own : float32 (h, w, 4)
    hiding : float32 (h, w), opacity in front of it
    """
    hidden = (hiding.clip(0, 1) ** OPAQUE_POWER * (1 - own[..., 3])).astype(np.float32)
    if hidden.max() <= MOST_KNOWN or not own[..., 3].any():
        return own
    filled = interpolate(np.ascontiguousarray(own), np.where(hidden > MOST_KNOWN, np.float32(0), 1 - hidden))
    continued: Pixels = own + hidden[..., None] * (filled - own)
    return continued
