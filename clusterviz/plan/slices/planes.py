"""Planes of view-aligned slices: perpendicular to the view direction, at equal distances.

They are counted from the nearest corner of the box around the whole scene, so they do not depend on bricks. A slab lies
between two planes; its sample is where a ray meets the plane in the middle between them. Along a ray, slabs are as much
longer than the distance of planes as the ray is oblique. The distance is chosen such that slabs are `quality.step` long
on the ray through the picture's corner, and shorter on all others, so that bounds on the length of slabs hold.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from clusterviz.plan.view import Vector, View


@dataclass(frozen=True)
class SlicePlanes:
    """Equidistant planes perpendicular to the view direction.

    Attributes
    ----------
    first : view depth of the first plane, in distances
    distance : of neighbouring planes, in world units
    """

    first: float
    distance: float


def slice_planes(view: View, extent: Vector, step_world: float) -> SlicePlanes:
    """Return the planes of a view.

    Parameters
    ----------
    extent : lengths (x, y, z) of the box through which rays are sampled, in index space, where it begins at 0
    step_world : length of the longest slab, in world units
    """
    distance = step_world * view.corner_cosine
    corners = np.array(list(product(*((0.0, length) for length in extent))))
    return SlicePlanes(float(view.depths(corners).min()) / distance, distance)
