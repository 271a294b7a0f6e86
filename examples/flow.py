"""A vortex ring with swirl, of vectors in memory: its vorticity as a volume, streamlines as tubes, arrows in a plane.

mpirun -n 4 python examples/flow.py flow.png
"""

import sys

import numpy as np

import clusterviz
from clusterviz.data.vectors import VectorArray

CORE = 0.22  # radius of the vortex
ANGLE = np.linspace(0, 2 * np.pi, 64, endpoint=False)
RING = np.stack([np.cos(ANGLE), np.sin(ANGLE), 0 * ANGLE], axis=1)
ALONG = np.stack([-np.sin(ANGLE), np.cos(ANGLE), 0 * ANGLE], axis=1) * ANGLE[1] / 2

axis = np.linspace(-1.8, 1.8, 61)
z, y, x = np.meshgrid(axis[14:-14], axis, axis, indexing="ij")
places = np.stack([x, y, z], axis=-1)
swirl = 0.25 / (x**2 + y**2 + CORE)
velocity = swirl[..., None] * np.stack([-y, x, 0 * x], axis=-1)
for point, along in zip(RING, ALONG, strict=True):  # the law of Biot and Savart
    away = places - point
    velocity += np.cross(along, away) / ((away**2).sum(axis=-1, keepdims=True) + CORE**2) ** 1.5
vorticity = np.exp(-((np.hypot(x, y) - 1) ** 2 + z**2) / CORE**2).astype(np.float32)
grid = clusterviz.Grid(x.shape, (axis[1] - axis[0],) * 3, (axis[0], axis[0], axis[14]))
flow = VectorArray(velocity, grid)

turn = np.repeat(np.arange(8) * np.pi / 4, 2)
reach = 1 - np.tile([0.22, 0.33], 8)  # of the seeds from the axis, inside the ring
seeds = np.stack([reach * np.cos(turn), reach * np.sin(turn), 0 * turn], axis=1)
u, v = (part.ravel() for part in np.meshgrid(np.linspace(-1.7, 1.7, 15), np.linspace(-0.9, 0.9, 8)))
plane = np.stack([u, 0 * u, v], axis=1)
tubes = {
    "path": flow,
    "show": "streamlines",
    "seeds": {"kind": "list", "points": seeds},
    "trace": {"direction": "forward", "max_length": 8.4},
}
arrows = {"path": flow, "show": "glyphs", "seeds": {"kind": "list", "points": plane}}

picture = clusterviz.render(
    vorticity,
    grid=grid,
    cmap="ice",
    clim=(0, 1.4),
    opacity=[[0.05, 0], [0.3, 0.08], [1, 0.4]],
    opacity_unit_distance=0.1,
    shade=True,
    flows=[
        tubes | {"radius": 0.018, "cmap": "turbo", "ambient": 0.2, "specular": 0.4},
        arrows | {"color_by": "color", "length": 0.3},
    ],
    camera={"position": (2.6, -4.6, 3.4), "focal_point": (0, 0, 0), "view_up": (0, 0, 1)},
    size=(640, 480),
    background="#0b1020",
    step=0.5,
)
if picture is not None:
    picture.save(sys.argv[1] if len(sys.argv) > 1 else "flow.png")
