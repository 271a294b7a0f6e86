"""Vectors at seeds, which are drawn as arrows."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm import Channel, agree
from clusterviz.content.flow.expansion import VELOCITY
from clusterviz.content.flow.section import Seeds
from clusterviz.data.geometry import Points
from clusterviz.data.vectors import VectorSource, index_from_world
from clusterviz.flow.seeds import make_seeds

Floats = NDArray[np.float64]


def glyphs(vectors: VectorSource, seeds: Seeds, channel: Channel) -> Points:
    """Return seeds with their vectors, on every rank; collective.

    Seeds outside the data have NaN.
    """
    corners = vectors.grid.corners
    low, high = corners.min(axis=0), corners.max(axis=0)
    places = make_seeds(seeds, low, high, lambda at: np.linalg.norm(vectors_at(vectors, at, channel), axis=1))
    return Points(f"{vectors.name}: glyphs", places, {VELOCITY: vectors_at(vectors, places, channel)})


def vectors_at(vectors: VectorSource, places: Floats, channel: Channel) -> Floats:
    """Return the vectors at places in the world, float64 (n, 3), NaN outside the data; collective.

    Each rank reads the layers of samples around an equal share of the places, two layers at a time.
    """
    with agree(channel, 0, "vectors of arrows"):
        order = np.argsort(index_from_world(places, vectors.grid)[:, 2], kind="stable")
        mine = np.array_split(order, channel.size)[channel.rank]
        found = _interpolated(vectors, places[mine])
    each = channel.allgather((mine, found))
    whole = np.empty((len(places), 3))
    for rows, values in each:
        whole[rows] = values
    return whole


def _interpolated(vectors: VectorSource, places: Floats) -> Floats:
    samples = np.array(vectors.grid.shape_zyx[::-1])
    at = index_from_world(places, vectors.grid)
    inside: NDArray[np.bool_] = np.all((at >= 0) & (at <= samples - 1), axis=1)
    cells = np.clip(np.floor(np.where(inside[:, None], at, 0)), 0, np.maximum(samples - 2, 0)).astype(np.int64)
    found = np.full((len(places), 3), np.nan)
    for layer in np.unique(cells[inside, 2]).tolist():
        rows = np.flatnonzero(inside & (cells[:, 2] == layer))
        low = cells[rows].min(axis=0)
        end = np.minimum(cells[rows].max(axis=0) + 2, samples)
        box: NDArray[Any] = vectors.read(_zyx(low), _zyx(end)).astype(np.float64)
        first = cells[rows] - low
        share = at[rows] - cells[rows]
        found[rows] = interpolated(box, first, share)
    return found


def _zyx(numbers_xyz: NDArray[np.int64]) -> tuple[int, int, int]:
    x, y, z = numbers_xyz.tolist()
    return z, y, x


def interpolated(samples: NDArray[Any], cells: NDArray[np.int64], shares: Floats) -> Floats:
    """Return trilinear interpolation of samples (z, y, x, 3) in cells (n, 3), at shares of them along x, y, z."""
    found = np.zeros(shares.shape)
    last = np.array(samples.shape[2::-1]) - 1
    for corner in np.ndindex(2, 2, 2):
        weights = np.where(corner, shares, 1 - shares).prod(axis=1)[:, None]
        x, y, z = np.minimum(cells + corner, last).T
        # A sample without weight has no influence, though it may be NaN.
        found += weights * np.where(weights > 0, samples[z, y, x], 0.0)
    return found
