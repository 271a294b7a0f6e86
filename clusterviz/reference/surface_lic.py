"""Reference of surface LIC: noise convolved along vectors on the visible surface of a picture, float64.

Pixels are pixels of one layer of depths and normals. A vector's direction on the screen is the way that its point moves
there, as a difference of two projections.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.source import Grid
from clusterviz.reference.rays import Floats
from clusterviz.scene.camera import camera_axes, camera_vectors, half_height, project_points
from clusterviz.scene.values import Camera

Pixels = NDArray[np.int64]
NEAR = 4.0
"""Pixels from the plane through a neighbour, up to which a point is on the same surface."""
MOVED = 1e-6
"""Pixels by which points move along their vectors, about."""


@dataclass(frozen=True)
class LicLine:
    """Lines and noise; keys as of the scene's `lic`, lengths in pixels."""

    weights: Floats  # float64 (2n + 1,), of samples from the begin of a line to its end
    step: float = 0.5
    integrator: str = "rk4"
    grain: float = 1.5
    seed: int = 1
    phase: float = 0.0


class SurfacePicture:
    """Surface in a picture.

    `camera`: completed. `depth`: (h, w), along the view; infinite where there is no surface. `normals`: (h, w, 3), in
    the world.
    """

    def __init__(self, camera: Camera, depth: Floats, normals: Floats) -> None:
        self.camera, self.normals = camera, normals.astype(np.float64)
        self.shape = depth.shape
        height, width = depth.shape
        self.there: NDArray[np.bool_] = np.asarray(np.isfinite(depth))
        self.depth = np.where(self.there, depth, 1.0).astype(np.float64)
        self.side = 2 * half_height(camera, self.depth) / height
        position, focal_point, view_up = camera_vectors(camera)
        right, up, forward = camera_axes(position, focal_point, view_up)
        rows, columns = np.indices(depth.shape)
        column, row = width / 2 * (1 - camera.window_center[0]), height / 2 * (1 + camera.window_center[1])
        across, above = (columns + 0.5 - column) * self.side, (row - rows - 0.5) * self.side
        parts = across[..., None] * right + above[..., None] * up + self.depth[..., None] * forward
        self.points: Floats = parts + np.array(position)

    def directions(self, vectors: Floats) -> Floats:
        """Return unit vectors on the screen, (h, w, 2), to the right and down; zeros where there is none.

        `vectors`: (h, w, 3), in the world; NaN where there is none.
        """
        n = self.normals
        with np.errstate(invalid="ignore", divide="ignore"):
            scaled = vectors / np.abs(vectors).max(axis=-1, keepdims=True)
            tangential = scaled - n * ((n * scaled).sum(axis=-1) / (n * n).sum(axis=-1))[..., None]
            step = tangential * (MOVED * self.side)[..., None]
            size = self.shape[1], self.shape[0]
            ends = [project_points(self.camera, (self.points + s * step).reshape(-1, 3), size)[0] for s in (1, -1)]
            moved = (ends[0] - ends[1]).reshape(*self.shape, 2) / (2 * MOVED)
            length = np.linalg.norm(moved, axis=-1)
            is_valid = np.asarray(self.there & np.isfinite(length) & (length > 1e-4))
            return np.where(is_valid[..., None], moved / length[..., None], 0.0)

    def links(self, directions: Floats) -> NDArray[np.bool_]:
        """Return whether pixels have a link to their neighbours, (3, 3, h, w), by rows and columns from −1 on."""
        valid: NDArray[np.bool_] = np.asarray(directions.any(axis=-1))
        found = np.zeros((3, 3, *self.shape), bool)
        found[1, 1] = valid
        height, width = self.shape
        for dy, dx in [(y, x) for y in (-1, 0, 1) for x in (-1, 0, 1) if (y, x) != (0, 0)]:
            here = slice(max(0, -dy), height - max(0, dy)), slice(max(0, -dx), width - max(0, dx))
            there = slice(max(0, dy), height - max(0, -dy)), slice(max(0, dx), width - max(0, -dx))
            offset = self.points[there] - self.points[here]
            bound = NEAR * np.minimum(self.side[here], self.side[there])
            near = [np.abs((self.normals[part] * offset).sum(axis=-1)) <= bound for part in (here, there)]
            found[(dy + 1, dx + 1, *here)] = valid[here] & valid[there] & near[0] & near[1]
        return found

    def noise(self, grid: Grid, line: LicLine) -> Floats:
        """Return noise, (h, w), of lattices with cells around the size of a grain."""
        places = self.points - np.array(grid.corners).mean(axis=0)
        octaves = np.log2(line.grain * self.side)
        share = octaves - np.floor(octaves)
        mixed = np.zeros(self.shape)
        for above, weight in ((0, 1 - share), (1, share)):
            level = np.floor(octaves).astype(np.int64) + above
            mixed += weight * (_lattice_noise(places / 2.0 ** level[..., None], level, line) - 0.5)
        return np.asarray(0.5 + mixed / np.hypot(1 - share, share))


def reference_surface_lic(picture: SurfacePicture, vectors: Floats, grid: Grid, line: LicLine) -> Floats:
    """Return noise convolved along the lines of all pixels, (h, w); NaN where there is no line.

    `vectors`: (h, w, 3), at the picture's points; `grid`: of the vectors, at whose middle the noise begins.
    """
    directions = picture.directions(vectors)
    links, noise = picture.links(directions), picture.noise(grid, line)
    reach = len(line.weights) // 2
    rows, columns = np.nonzero(directions.any(axis=-1))
    begin = np.stack([columns, rows], axis=1).astype(np.float64)
    total = np.full(len(begin), float(line.weights[reach]))
    sums = total * noise[rows, columns]

    def sampled(places: Floats, values: Floats) -> Floats:
        """Interpolate between the pixels around places, of those that are linked to the nearest."""
        nearest, found, weight = _nearest(places), np.zeros((len(places), values.shape[-1])), np.zeros((len(places), 1))
        for corner in ((0, 0), (1, 0), (0, 1), (1, 1)):
            pixel = np.floor(places).astype(np.int64) + corner
            share = (1 - np.abs(places - pixel)).prod(axis=1)[:, None] * is_linked(nearest, pixel)[:, None]
            x, y = np.clip(pixel, 0, np.array(picture.shape[::-1]) - 1).T
            found, weight = found + share * values[y, x], weight + share
        return np.asarray(found / weight)

    def is_linked(pixel: Pixels, other: Pixels) -> NDArray[np.bool_]:
        dx, dy = (other - pixel).T + 1
        return np.asarray(links[np.clip(dy, 0, 2), np.clip(dx, 0, 2), pixel[:, 1], pixel[:, 0]])

    def direction(places: Floats) -> Floats:
        found = sampled(places, directions)
        length = np.linalg.norm(found, axis=1, keepdims=True)
        return np.where(length > 1e-3, found / np.where(length > 0, length, 1), 0.0)

    for way in (-1, 1):
        places, going = begin.copy(), np.arange(len(begin))
        for n in range(1, reach + 1):
            now = places[going]
            slopes = [direction(now)]
            good = slopes[0].any(axis=1)
            for share in (0.5, 0.5, 1.0) if line.integrator == "rk4" else ():
                middle = now + share * way * line.step * slopes[-1]
                good &= is_linked(_nearest(now), _nearest(middle))
                slopes.append(direction(np.where(good[:, None], middle, now)))
            by = slopes[0] if len(slopes) == 1 else (slopes[0] + 2 * slopes[1] + 2 * slopes[2] + slopes[3]) / 6
            end = now + way * line.step * by
            good &= is_linked(_nearest(now), _nearest(end))
            going = going[good]
            places[going] = end[good]
            weight = float(line.weights[reach + way * n])
            sums[going] += weight * sampled(places[going], noise[..., None])[:, 0]
            total[going] += weight
    found = np.full(picture.shape, np.nan)
    found[rows, columns] = np.where(total > 0, sums / np.where(total > 0, total, 1), noise[rows, columns])
    return found


def _nearest(places: Floats) -> Pixels:
    return np.floor(places + 0.5).astype(np.int64)


def _lattice_noise(places: Floats, level: Pixels, line: LicLine) -> Floats:
    """Return noise of lattices with unit cells, linear between their corners."""
    lattice = _mixed_bits(level * 0x9E3779B9 + line.seed)
    corner = np.floor(places)
    found = np.zeros(places.shape[:-1])
    for step in np.ndindex(2, 2, 2):
        x, y, z = np.moveaxis(corner.astype(np.int64) + step, -1, 0)
        bits = _mixed_bits(x + lattice)
        bits = _mixed_bits(bits ^ (y * 0x9E3779B9 & 0xFFFFFFFF))
        bits = _mixed_bits(bits ^ (z * 0x7FEB352D & 0xFFFFFFFF))
        value = (bits >> 8) / 2.0**24 + line.phase
        wave = np.abs(2 * (value - np.floor(value)) - 1)
        found += (1 - np.abs(places - corner - step)).prod(axis=-1) * wave
    return found


def _mixed_bits(bits: Pixels) -> Pixels:
    bits = bits & 0xFFFFFFFF
    for shift, factor in ((16, 0x85EBCA6B), (13, 0xC2B2AE35)):
        product = (bits ^ (bits >> shift)).astype(np.uint64) * np.uint64(factor)
        bits = (product & np.uint64(0xFFFFFFFF)).astype(np.int64)
    return np.asarray(bits ^ (bits >> 16))
