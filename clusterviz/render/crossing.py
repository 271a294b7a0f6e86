"""Where the opacity of pixels passes one half: the depth, the normal and the object there.

The opacity in front of a piece is known only when all ranks have drawn, so rays are drawn a second time, with that
opacity (crossing.glsl). Only one piece answers in a pixel, or the nearest of several that rounding lets answer, so
answers are composited like opaque pixels, by any algorithm.

    partial images -> opacity in front of each -> what each finds -> compositing -> layers
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.image.partial import PartialImage, Rect
from clusterviz.plan.plan import Plan

Planes = NDArray[np.float32]
PLANES = 8
NO_OBJECT = -1.0
SURFACE_OBJECTS = 1024
"""As in march.glsl."""


@dataclass(frozen=True)
class Crossing:
    """Rays of a piece, or of some rows of its pixels.

    Attributes
    ----------
    front : float32 (rows, columns), opacity in front of the piece
    found : float32 (8, rows, columns), written: view depth, object as the shader names it or `NO_OBJECT`, the
        gradient in index space, turned to the eye, and the light that a surface there adds to the pixel
    """

    front: Planes
    found: Planes

    @classmethod
    def behind(cls, front: Planes) -> Crossing:
        """Return rays that have found nothing yet."""
        found = np.zeros((PLANES, *front.shape), np.float32)
        found[1] = NO_OBJECT
        return cls(front, found)

    def rows(self, begin: int, end: int) -> Crossing:
        """Return a view of some rows of pixels."""
        return replace(self, front=self.front[begin:end], found=self.found[:, begin:end])

    @property
    def planes(self) -> Planes:
        """Planes with which the shader begins, as `found`."""
        return self.found

    @property
    def pixels(self) -> Planes:
        """Pixels with which rays begin, and their rounding errors: float32 (2, rows, columns, 4)."""
        pixels = np.zeros((2, *self.front.shape, 4), np.float32)
        pixels[0, ..., 3] = self.front
        return pixels

    def keep(self, planes: Planes) -> bool:
        """Store the planes that the shader has written; False, as no ray has to be drawn again."""
        self.found[:] = planes
        return False


FoundLayers = tuple[PartialImage, PartialImage, PartialImage]
"""What a piece has found as pixels, see `as_partials`."""


def as_partials(plan: Plan, rect: Rect, found: Planes) -> FoundLayers:
    """Return what a piece has found: (depth, object, 0, 1), (x, y, z, 1), (r, g, b, 1); zeros where it found nothing.

    Parameters
    ----------
    rect : the piece's footprint
    found : float32 (8, rows, columns), see `Crossing.found`

    Returns
    -------
    partials : the first with view depths in world units and numbers of objects, the second with unit normals in the
        world, or zeros where there is no gradient, the third with the light of surfaces
    """
    named, there = found[1].astype(np.int64), found[1] > NO_OBJECT
    where, normals, light = np.zeros((3, *there.shape, 4), np.float32)
    for number, volume in enumerate(plan.layers):
        mine = there & (named % SURFACE_OBJECTS == number)
        where[mine, 0] = found[0, mine]
        where[mine, 1] = np.array(volume.objects)[named[mine] // SURFACE_OBJECTS]
        normals[mine, :3] = _unit(found[2:5, mine].T @ volume.normal_from_gradient.T)
    light[there, :3] = found[5:, there].T
    where[there, 3] = normals[there, 3] = light[there, 3] = 1.0
    return PartialImage(rect, where), PartialImage(rect, normals), PartialImage(rect, light)


def named_layers(
    names: Sequence[str], rgba: Planes, where: Planes | None, normals: Planes | None
) -> dict[str, NDArray[Any]]:
    """Return the layers of a picture by name.

    Parameters
    ----------
    rgba : float32 (h, w, 4), the picture
    where, normals : float32 (h, w, 4), composited from `as_partials`; None if nothing was drawn

    Returns
    -------
    layers : of those that are asked for, depth, float32 (h, w), infinite where the opacity does not pass one half;
        normal, float32 (h, w, 3), zeros there; opacity, float32 (h, w); object, int32 (h, w), −1 there
    """
    where = np.zeros_like(rgba) if where is None else where
    normals = np.zeros_like(rgba) if normals is None else normals
    there = where[..., 3] > 0
    every = {
        "depth": np.where(there, where[..., 0], np.float32(np.inf)),
        "normal": normals[..., :3].copy(),
        "opacity": rgba[..., 3].copy(),
        "object": np.where(there, where[..., 1], -1).astype(np.int32),
    }
    return {name: every[name] for name in every if name in names}


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return unit vectors (n, 3); the zero vector stays."""
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    unit: NDArray[np.float64] = vectors / np.where(lengths > 0, lengths, 1.0)
    return unit
