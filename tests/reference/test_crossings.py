"""The reference's crossings against the roots of polynomials that NumPy finds, cell by cell."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from clusterviz.reference.rays import Floats, Rays, inside
from clusterviz.reference.sample import trilinear
from clusterviz.reference.surfaces import RayField, extrema

VALUES = np.array([0.2, 0.5, 0.93])
SHAPE = (9, 11, 10)


def some_rays(count: int) -> Rays:
    """Rays through a box of noise, from all around."""
    rng = np.random.default_rng(4)
    middle = (np.array(SHAPE[::-1]) - 1) / 2
    start = middle + 30 * (way := rng.normal(size=(count, 3))) / np.linalg.norm(way, axis=1)[:, None]
    way = middle + rng.uniform(-3, 3, (count, 3)) - start
    return Rays(start, way / np.linalg.norm(way, axis=1)[:, None])


def found_in_slabs(rays: Rays, voxels: np.ndarray, slabs: int) -> list[tuple[int, float, int]]:
    """Which ray crosses which surface where, of the course through so many slabs."""
    course, every = RayField(rays, voxels, "linear", VALUES), np.arange(len(rays.direction))
    enter, leave = inside(rays, np.array(SHAPE[::-1]) - 1.0)
    ends: Floats = np.linspace(enter, leave, slabs + 1)
    met = [one for begin, end in pairwise(ends) for one in course.crossings(every, begin, end)]
    parts = [(one.slabs, one.place, one.surface) for one in met]
    return sorted(zip(*(np.concatenate(part).tolist() for part in zip(*parts, strict=True)), strict=True))


def roots_in_cells(rays: Rays, voxels: np.ndarray) -> list[tuple[int, float, int]]:
    """The same by the companion matrices of each cell's polynomials."""
    last, found = np.array(SHAPE[::-1]) - 1.0, []
    for n, (start, way) in enumerate(zip(rays.start, rays.direction, strict=True)):
        (enter,), (leave,) = inside(Rays(start[None], way[None]), last)
        faces = ((np.arange(1, max(SHAPE))[:, None] - start) / way).ravel()
        cuts = np.concatenate([[enter], np.sort(faces[(faces > enter) & (faces < leave)]), [leave]])
        for begin, end in pairwise(cuts):
            t = np.linspace(0.001, 0.999, 4)
            at = start + (begin + t * (end - begin))[:, None] * way
            cubic = np.polynomial.polynomial.polyfit(t, trilinear(voxels, *at.T)[0], 3)
            for surface, value in enumerate(VALUES):
                roots = np.polynomial.polynomial.polyroots(cubic - [value, 0, 0, 0])
                real = roots[np.abs(roots.imag) < 1e-9].real
                inside_cell = real[(real >= 0) & (real < 1)]
                found += [(n, float(begin + t * (end - begin)), surface) for t in inside_cell]
    return sorted(found)


@pytest.mark.cover("20")
@pytest.mark.parametrize("slabs", [20, 7])
def test_every_root_is_a_crossing(slabs: int) -> None:
    """Slabs of 0.5 to 2 voxels; of hundreds of crossings none is missed, and none made up."""
    voxels, rays = np.random.default_rng(1).random(SHAPE), some_rays(80)
    found, expected = found_in_slabs(rays, voxels, slabs), roots_in_cells(rays, voxels)
    assert len(expected) > 400
    assert [(ray, surface) for ray, _, surface in found] == [(ray, surface) for ray, _, surface in expected]
    assert np.allclose([place for _, place, _ in found], [place for _, place, _ in expected], atol=1e-6)


def test_polynomials_turn_where_their_derivatives_are_nought() -> None:
    cubics = np.random.default_rng(2).normal(size=(4, 200))
    cubics[3, :20] = cubics[2, :10] = 0.0  # parabolas, straight lines
    found = extrema(np.polynomial.polynomial.polyval(np.array([0, 1 / 3, 2 / 3, 1]), cubics).T)
    for cubic, turns in zip(cubics.T, found.T, strict=True):
        roots = np.polynomial.polynomial.polyroots(np.trim_zeros([cubic[1], 2 * cubic[2], 3 * cubic[3]], "b"))
        real = np.sort(roots[np.abs(roots.imag) < 1e-9].real)
        expected = real[(real > 1e-6) & (real < 1 - 1e-6)]
        assert np.allclose(np.sort(turns[turns < 1 - 1e-6])[-len(expected) or 2 :], expected, atol=1e-6)
