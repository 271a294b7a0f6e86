"""Edges of the box around the data and lines on its faces: in front of the data, or behind, and cut to the picture.

All content lies in the box, which is convex. So a point of a face that is turned to the eye lies in front of all
content on its ray, and a point of a face that is turned away lies behind it. Edges of front faces are blended over the
finished picture, and all other lines under it: this is exact whatever the content is, and no depth is needed. An edge
of a front and a back face is met by rays that only touch the box there, so that either order is right. From inside of
the box all faces are turned away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clusterviz.scene.camera import camera_axes, camera_coordinates, camera_vectors, half_height, project_points
from clusterviz.scene.values import Camera

Floats = NDArray[np.float64]
NEAREST = 1e-6
"""Smallest depth at which lines are drawn, as a share of the largest distance of their ends."""
BEYOND = 0.02
"""How far lines go beyond the picture's border, as a share of its half sides, so that their ends are not seen."""


@dataclass(frozen=True, eq=False)
class Box:
    """Parallelepiped."""

    origin: Floats  # float64 (3,), world
    edges: Floats  # float64 (3, 3), the three edges from the origin, row by row, world

    @property
    def is_aligned(self) -> bool:
        """Whether each edge is along an axis of the world."""
        return bool((np.abs(self.edges) > 1e-6 * np.abs(self.edges).max()).sum(axis=1).max() <= 1)

    def point(self, shares: object) -> Floats:
        """Return points, float64 (…, 3), at shares (…, 3) of the edges, world."""
        return self.origin + np.asarray(shares, np.float64) @ self.edges

    def front_faces(self, camera: Camera) -> NDArray[np.bool_]:
        """Return whether the face at the beginning and at the end of each edge is turned to the eye, bool (3, 2)."""
        position, focal_point, view_up = camera_vectors(camera)
        scale = float(np.abs(self.edges).max()) or 1.0
        edges = self.edges / scale
        turn = 1.0 if np.linalg.det(edges) >= 0 else -1.0
        normals = turn * np.stack([np.cross(edges[(axis + 1) % 3], edges[(axis + 2) % 3]) for axis in range(3)])
        if camera.parallel_scale is not None:
            toward_eye = normals @ -camera_axes(position, focal_point, view_up)[2]
            return np.stack([toward_eye < 0, toward_eye > 0], axis=1)
        begin, end = (((np.array(position) - corner) / scale * normals).sum(axis=1) for corner in self._face_points())
        return np.stack([begin < 0, end > 0], axis=1)

    def _face_points(self) -> tuple[Floats, Floats]:
        """Return a point of the face at the beginning, and at the end of each edge, float64 (3, 3)."""
        return np.broadcast_to(self.origin, (3, 3)), self.origin + self.edges


def box_of(corners: Floats) -> Box:
    """Return the box with these corners (8, 3), x fastest."""
    return Box(corners[0], corners[[1, 2, 4]] - corners[0])


def edge_shares(axis: int) -> Floats:
    """Return the ends of the four edges along an axis as shares, float64 (4, 2, 3)."""
    others = [other for other in range(3) if other != axis]
    shares = np.zeros((4, 2, 3))
    shares[:, 1, axis] = 1
    for number, ends in enumerate(np.ndindex(2, 2)):
        shares[number][:, others] = ends
    return shares


def adjacent_front_faces(shares: Floats, front: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return how many of the two faces of each edge (n, 2, 3) are turned to the eye, int64 (n,)."""
    on_face = shares[:, 0] == shares[:, 1]
    ends = shares[:, 0].astype(int)
    return np.asarray((on_face & front[np.arange(3), ends]).sum(axis=1))


def grid_lines(ticks: Sequence[Floats], front: NDArray[np.bool_]) -> Floats:
    """Return lines across all faces that are turned away, as shares, float64 (n, 2, 3).

    `ticks`: shares of each edge at which lines begin.
    """
    lines = []
    for axis, end in np.argwhere(~front):
        for across in (other for other in range(3) if other != axis):
            for share in ticks[across]:
                line = np.zeros((2, 3))
                line[1] = 1
                line[:, axis], line[:, across] = end, share
                lines.append(line)
    return np.array(lines).reshape(-1, 2, 3)


def projected(camera: Camera, segments: Floats, size: tuple[int, int]) -> tuple[Floats, NDArray[np.bool_]]:
    """Cut segments at the eye and at the picture's border, and project them.

    Parameters
    ----------
    segments : float64 (n, 2, 3), world

    Returns
    -------
    pixels : float64 (m, 2, 2), x and y from the top left corner
    is_seen : bool (n,), of the segments of which m parts are seen
    """
    points = segments.reshape(-1, 3)
    ahead, aside = camera_coordinates(camera, points)
    half = half_height(camera, ahead)
    reach = np.stack([half * size[0] / size[1], half], axis=1)
    aside, reach = aside - reach * camera.window_center, reach * (1 + BEYOND)
    near = NEAREST * float(np.abs(np.concatenate([ahead[:, None], aside], axis=1)).max(initial=0.0))
    # A point is in the picture where none of these five, which are linear along a segment, is negative.
    inside = np.concatenate([(ahead - near)[:, None], reach - aside, reach + aside], axis=1).reshape(-1, 2, 5)
    first, last = inside[:, 0], inside[:, 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = first / (first - last)
    begin = np.where(first < 0, crossing, 0.0)
    end = np.where(last < 0, crossing, 1.0)
    begin[(first < 0) & (last < 0)] = np.inf
    enter, leave = begin.max(axis=1, initial=0.0), end.min(axis=1, initial=1.0)
    is_seen = enter < leave
    shares = np.stack([enter, leave], axis=1)[is_seen][..., None]
    cut = segments[is_seen]
    pixels, _ = project_points(camera, (cut[:, :1] * (1 - shares) + cut[:, 1:] * shares).reshape(-1, 3), size)
    return pixels.reshape(-1, 2, 2), is_seen
