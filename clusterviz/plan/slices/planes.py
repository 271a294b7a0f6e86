"""Planes of view-aligned slices: perpendicular to the view direction, at equal distances.

They are counted from the nearest corner of the box around the whole scene, so they do not depend on bricks. A slab lies
between two planes; its sample is where a ray meets the plane in the middle between them. Along a ray, slabs are as much
longer than the distance of planes as the ray is oblique. The distance is chosen such that slabs are `quality.step` long
on the ray through the picture's corner, and shorter on all others, so that bounds on the length of slabs hold.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from clusterviz.plan.view import Vector, View

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class SlicePlanes:
    """Equidistant planes perpendicular to the view direction."""

    first: float  # view depth of the first plane, in distances
    distance: float  # of neighbouring planes, in world units


def slice_planes(view: View, extent: Vector, step_world: float) -> SlicePlanes:
    """Return the planes of a view.

    `extent`: lengths (x, y, z) of the box through which rays are sampled, in index space, where it begins at 0.
    `step_world`: length of the longest slab, in world units.
    """
    distance = step_world * view.corner_cosine
    corners = np.array(list(product(*((0.0, length) for length in extent))))
    return SlicePlanes(float(view.depths(corners).min()) / distance, distance)


@dataclass(frozen=True)
class PlaneLevels:
    """The planes in the middle of slabs, in index space: points p with normal · p = first + k, for k = 0, 1, …"""

    normal: Floats  # float64 (3,)
    first: float  # level of the first plane
    eye: float  # level of the eye's own plane; what lies behind is not seen

    def between(self, low: Floats, high: Floats) -> Floats:
        """Return the levels of the planes that meet a box [low, high], float64 (n,)."""
        corners = np.where(self.normal < 0, [high, low], [low, high]) @ self.normal
        begin = math.ceil(max(float(corners[0]), self.eye) - self.first)
        end = math.ceil(float(corners[1]) - self.first)
        return self.first + np.arange(float(begin), float(max(begin, end)))


def plane_levels(view: View, planes: SlicePlanes) -> PlaneLevels:
    """Return the levels of the planes of a view in its index space."""
    normal: Floats = view.depth_gradient / planes.distance
    eye = float(normal @ np.array(view.eye))
    return PlaneLevels(normal, eye + planes.first + 0.5, eye)
