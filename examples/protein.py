"""Ball-and-stick trace of a protein's electron density, in the density and its envelope.

mpirun -n 4 python examples/protein.py protein.png
"""

import sys
from itertools import product

import numpy as np

import clusterviz
from clusterviz.data import open_source
from clusterviz.data.geometry import Lines, Points
from clusterviz.data.samples import fetch_sample

source = open_source(str(fetch_sample("1jzv")))
density, grid = source.read((0, 0, 0), source.grid.shape_zyx), source.grid
NEIGHBOURS = [way for way in product((-1, 0, 1), repeat=3) if any(way)]

envelope = np.maximum(density, 0)
for axis in (0, 1, 2) * 8:
    envelope = (np.roll(envelope, 1, axis) + envelope + np.roll(envelope, -1, axis)) / 3

# Balls: peaks of the density, between samples where parabolas have them. Sticks: near ones with a high density between.
higher = np.max([np.roll(density, way, (0, 1, 2)) for way in NEIGHBOURS], axis=0)
peaks = np.argwhere((density > higher) & (density > 2.2 * density.std()))
peaks = peaks[((peaks > 0) & (peaks < np.array(density.shape) - 1)).all(axis=1)]
height, places = density[tuple(peaks.T)], peaks.astype(np.float64)
for axis, way in enumerate(np.eye(3, dtype=int)):
    before, after = density[tuple((peaks - way).T)], density[tuple((peaks + way).T)]
    places[:, axis] += 0.5 * (before - after) / (before - 2 * height + after)
atoms = places[:, ::-1] * grid.spacing + grid.origin
apart = np.linalg.norm(atoms[:, None] - atoms, axis=2)
begin, end = np.nonzero(np.triu((apart > 0) & (apart < 2.9)))
middle = np.rint((places[begin] + places[end]) / 2).astype(int)
joined = density[tuple(middle.T)] > 1.8 * density.std()
begin, end = begin[joined], end[joined]
bonds = np.stack([atoms[begin], atoms[end]], axis=1).reshape(-1, 3)
held = np.unique([begin, end])  # others are noise, or water
heights = np.stack([height[begin], height[end]], axis=1).ravel()

light = {"shade": True, "opacity_unit_distance": 0.9}
blue = {"cmap": [[0.2, 0.5, 1.0]] * 2, "clim": (0, 4), "opacity": [[0.5, 0], [1.0, 0.3], [4, 0.4]]}
grey = {"cmap": [[0.8, 0.8, 0.85]] * 2, "clim": (0, 1), "opacity": [[0.2, 0], [0.24, 0.12], [0.28, 0]]}
look = {"cmap": "turbo", "scalars": "density", "clim": (0.7, 2.2), "ambient": 0.2, "specular": 0.4}
centre = atoms.mean(axis=0)
sticks = Lines("sticks", bonds, np.arange(0, len(bonds) + 1, 2), {"density": heights})
picture = clusterviz.render(
    [density, envelope],
    grid=[grid, grid],
    volumes=[{"path": "array", **colours, **light} for colours in (blue, grey)],
    points=[{"path": Points("balls", atoms[held], {"density": height[held]}), "radius": 0.42, **look}],
    lines=[{"path": sticks, "radius": 0.16, **look}],
    camera={"focal_point": centre, "position": np.add(centre, (66, -54, 26)), "view_up": (0, 0, 1)},
    size=(640, 480),
    background="white",
    step=0.5,
)
if picture is not None:
    picture.save(sys.argv[1] if len(sys.argv) > 1 else "protein.png")
