"""Seeds of lines: points of the world by a rule, the same on any ranks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.content.flow.section import Seeds

Points = NDArray[np.float64]
DEFAULT_COUNT = 200
_CANDIDATES, _ROUNDS = 8192, 64


def make_seeds(seeds: Seeds, low: Points, high: Points, speed_at: Callable[[Points], NDArray[np.float64]]) -> Points:
    """Return the positions of seeds, float64 (n, 3), world.

    A place is a function of the number of the seed. By speed, places are kept with a probability that rises linearly
    from 0 to 1 at the largest speed of 8192 places.

    Parameters
    ----------
    low, high : (3,), the box around the data
    speed_at : function of places (n, 3), NaN where there is nothing
    """
    count, number = seeds.count or DEFAULT_COUNT, 1 if seeds.seed is None else seeds.seed
    if seeds.kind == "list":
        return np.array(seeds.points, np.float64)
    if seeds.kind == "line":
        begin, end = np.array(seeds.begin, np.float64), np.array(seeds.end, np.float64)
        line: Points = begin + np.linspace(0, 1, count)[:, None] * (end - begin)
        return line
    if seeds.kind == "plane":
        # Even on a disc: radii by the square root of a uniform number.
        normal = np.array(seeds.normal, np.float64) / np.linalg.norm(seeds.normal or 1)
        across = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
        across /= np.linalg.norm(across)
        radius = seeds.radius or float(np.linalg.norm(high - low)) / 2
        u, v = uniform(number, np.arange(count), 2).T
        r, angle = radius * np.sqrt(u), 2 * np.pi * v
        along = (r * np.cos(angle))[:, None] * across + (r * np.sin(angle))[:, None] * np.cross(normal, across)
        disc: Points = np.array(seeds.center, np.float64) + along
        return disc
    if seeds.kind == "sphere":
        # Even in a ball: even heights on the sphere, and radii by the cube root.
        u, v, w = uniform(number, np.arange(count), 3).T
        height, angle = 2 * v - 1, 2 * np.pi * w
        flat = np.sqrt(1 - height * height)
        sphere = np.stack([flat * np.cos(angle), flat * np.sin(angle), height], axis=1)
        ball: Points = np.array(seeds.center, np.float64) + (seeds.radius or 0.0) * np.cbrt(u)[:, None] * sphere
        return ball
    begin = low if seeds.begin is None else np.array(seeds.begin, np.float64)
    end = high if seeds.end is None else np.array(seeds.end, np.float64)
    if seeds.kind == "random":
        anywhere: Points = begin + uniform(number, np.arange(count), 3) * (end - begin)
        return anywhere
    return _by_speed(number, count, begin, end, speed_at)


def _by_speed(
    number: int, count: int, begin: Points, end: Points, speed_at: Callable[[Points], NDArray[np.float64]]
) -> Points:
    found, largest = np.empty((0, 3)), 0.0
    for turn in range(_ROUNDS):
        drawn = uniform(number, np.arange(turn * _CANDIDATES, (turn + 1) * _CANDIDATES), 4)
        places = begin + drawn[:, :3] * (end - begin)
        speeds = np.nan_to_num(speed_at(places), nan=0.0)
        largest = largest or float(speeds.max())
        found = np.concatenate([found, places[drawn[:, 3] * largest < speeds]])
        if len(found) >= count or not largest:
            break
    return found[:count]


def uniform(seed: int, numbers: NDArray[np.int64], columns: int) -> NDArray[np.float64]:
    """Return numbers in [0, 1), float64 (n, columns): a hash of the seed, each number and the column.

    References
    ----------
    G. L. Steele, D. Lea, C. H. Flood: Fast splittable pseudorandom number generators, OOPSLA 2014. (SplitMix64.)
    """
    with np.errstate(over="ignore"):
        place = numbers.astype(np.uint64)[:, None] * np.uint64(columns) + np.arange(columns, dtype=np.uint64)
        bits = _mixed(_mixed(np.full(1, seed, np.uint64)) + place)
    found: NDArray[np.float64] = (bits >> np.uint64(11)).astype(np.float64) * 2.0**-53
    return found


def _mixed(bits: Any) -> Any:
    bits = (bits + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return bits ^ (bits >> np.uint64(31))
