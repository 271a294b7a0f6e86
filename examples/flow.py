"""A vortex ring with swirl: its vorticity as a volume, streamlines as tubes, and arrows in a plane.

mpirun -n 4 python examples/flow.py flow.png
"""

import sys

import numpy as np

import clusterviz
from clusterviz.data.geometry import Lines, Points

CORE = 0.22  # radius of the vortex
ANGLE = np.linspace(0, 2 * np.pi, 64, endpoint=False)
RING = np.stack([np.cos(ANGLE), np.sin(ANGLE), 0 * ANGLE], axis=1)
ALONG = np.stack([-np.sin(ANGLE), np.cos(ANGLE), 0 * ANGLE], axis=1) * (ANGLE[1] / 2)


def velocity(points):
    """Biot–Savart's law for the ring, and a swirl around the axis."""
    away = points[:, None] - RING
    found = (np.cross(ALONG, away) / ((away**2).sum(axis=2, keepdims=True) + CORE**2) ** 1.5).sum(axis=1)
    swirl = 0.25 / (points[:, :1] ** 2 + points[:, 1:2] ** 2 + CORE)
    return found + swirl * np.stack([-points[:, 1], points[:, 0], 0 * points[:, 0]], axis=1)


def streamlines(points, steps=280, length=0.03):
    """Midpoint rule with steps of equal length."""
    path = [points]
    for _ in range(steps):
        for share in (0.5, 1.0):
            way = velocity(points)
            points = path[-1] + share * length * way / np.linalg.norm(way, axis=1, keepdims=True)
        path.append(points)
    return np.stack(path, axis=1)


axis = np.linspace(-1.8, 1.8, 97)
z, y, x = np.meshgrid(axis[24:-24], axis, axis, indexing="ij")
vorticity = np.exp(-((np.hypot(x, y) - 1) ** 2 + z**2) / CORE**2).astype(np.float32)
turn = np.repeat(np.arange(8) * np.pi / 4, 2)
reach = 1 - np.tile([0.22, 0.33], 8)  # of the seeds from the axis, inside the ring
seeds = np.stack([reach * np.cos(turn), reach * np.sin(turn), 0 * turn], axis=1)
paths = streamlines(seeds)
speed = np.linalg.norm(velocity(paths.reshape(-1, 3)), axis=1)
offsets = np.arange(len(paths) + 1) * paths.shape[1]
tubes = Lines("streamlines", paths.reshape(-1, 3), offsets, {"speed": speed})
u, v = (part.ravel() for part in np.meshgrid(np.linspace(-1.7, 1.7, 15), np.linspace(-0.9, 0.9, 8)))
plane = np.stack([u, 0 * u, v], axis=1)
arrows = Points("plane", plane, {"velocity": velocity(plane)})

picture = clusterviz.render(
    vorticity,
    grid=clusterviz.Grid(vorticity.shape, (axis[1] - axis[0],) * 3, (axis[0], axis[0], axis[24])),
    cmap="ice",
    clim=(0, 1.4),
    opacity=[[0.05, 0], [0.3, 0.08], [1, 0.4]],
    opacity_unit_distance=0.1,
    shade=True,
    lines=[{"path": tubes, "radius": 0.018, "scalars": "speed", "cmap": "turbo", "ambient": 0.2, "specular": 0.4}],
    points=[{"path": arrows, "style": "arrows", "direction": "velocity", "color": "white", "length": 0.17}],
    camera={"position": (2.6, -4.6, 3.4), "focal_point": (0, 0, 0), "view_up": (0, 0, 1)},
    size=(640, 480),
    background="#0b1020",
    step=0.5,
)
if picture is not None:
    picture.save(sys.argv[1] if len(sys.argv) > 1 else "flow.png")
