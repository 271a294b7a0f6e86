"""Entries of the k-buffer against buffers that are run, and against lists of fragments of the reference."""

from __future__ import annotations

import numpy as np
import pytest
from data.cells import lattice, tetrahedra

from clusterviz.data.faces import find_neighbours
from clusterviz.data.unstructured import UnstructuredGrid
from clusterviz.errors import InputError
from clusterviz.pages.kbuffer.analysis import KBufferNeeds, analyse, comparisons
from clusterviz.pages.kbuffer.fragment_kernel import count_entries
from clusterviz.reference.cells import find_passages
from clusterviz.reference.rays import camera_rays
from clusterviz.scene.values import Camera


class Depth(float):
    """A depth that counts how often it is compared."""

    compared = 0

    def __lt__(self, other: float) -> bool:
        Depth.compared += 1
        return float(self) < float(other)


def segments(arriving: list[float], k: int, is_sorted: bool) -> tuple[list[tuple[float, float]], int]:
    """Run a k-buffer: the segments that it composites, and its comparisons."""
    held: list[Depth] = []
    found, Depth.compared = [], 0

    def insert(new: Depth) -> None:
        places = [new < other for other in held]  # all at once, as a network does
        held.insert(places.index(True) if True in places else len(held), new)

    def take() -> None:
        if is_sorted:
            nearest, second = held[0], held[1]
        else:
            nearest = min(held)
            rest = list(held)
            del rest[next(n for n, each in enumerate(held) if each is nearest)]
            second = min(rest)
        del held[next(n for n, each in enumerate(held) if each is nearest)]
        found.append((float(nearest), float(second)))

    for depth in arriving:
        if is_sorted:
            insert(Depth(depth))
        else:
            held.append(Depth(depth))
        if len(held) > k:
            take()
    while len(held) > 1:
        take()
    return found, Depth.compared


@pytest.mark.parametrize("is_sorted", [False, True])
def test_needs_and_comparisons_are_those_of_a_buffer_that_is_run(is_sorted: bool) -> None:
    rng = np.random.default_rng(7)
    some = [np.arange(count) + rng.normal(0, rng.choice([0.1, 1, 4]), count) for count in rng.integers(1, 20, 60)]
    for arriving in [[1.0, 2.0, 0.0], [3.0, 1.0, 2.0, 0.0, 4.0], *(each.tolist() for each in some)]:
        entries = np.zeros(1, np.int32)
        count_entries(np.array([0, len(arriving)]), np.array(arriving), entries)
        needed = int(entries[0])
        right = list(zip(sorted(arriving), sorted(arriving)[1:], strict=False))
        for k in range(2, 12):
            found, compared = segments(arriving, k, is_sorted)
            assert (found == right) == (k >= needed)
            assert compared == comparisons(np.array([len(arriving)]), k, is_sorted)[0]


def test_the_share_of_comparisons_that_sorting_saves() -> None:
    long = np.array([10**6])
    for k in (2, 6, 12):
        unsorted, in_order = (int(comparisons(long, k, each)[0]) for each in (False, True))
        assert unsorted - in_order == (k - 1) * (10**6 - k // 2 - 1)
        assert 1 - in_order / unsorted == pytest.approx((k - 1) / (2 * k - 1), abs=1e-4)


CAMERAS = {
    "perspective": Camera(position=(9.0, -7.0, 6.0), focal_point=(1.5, 1.5, 1.5), view_up=(0, 0, 1), view_angle=30),
    "along an axis": Camera(position=(1.5, 1.5, 9.0), focal_point=(1.5, 1.5, 1.5), view_up=(0, 1, 0), parallel_scale=2),
}


@pytest.mark.parametrize("name", CAMERAS)
def test_fragments_of_pixels_are_the_ends_of_passages(name: str) -> None:
    """Rays along the axis meet corners and edges of the grid exactly."""
    cells, camera, size = tetrahedra(lattice(3, 3, 3)), CAMERAS[name], (24, 16)
    faces = find_neighbours(cells.corners, len(cells.points)).faces().corners
    found = analyse(cells.points, faces, camera, size, threads=2)
    passages = find_passages(camera_rays(camera, size), cells)
    passed = np.bincount(passages.ray, minlength=24 * 16).reshape(16, 24)
    if name == "perspective":
        np.testing.assert_array_equal(found.fragments, np.where(passed > 0, passed + 1, 0))
    else:  # passages without a length are not listed
        assert (found.fragments >= np.where(passed > 0, passed + 1, 0)).all()
        assert ((found.fragments > 0) == (passed > 0)).all()
    assert found.fragments.max() > 9
    assert (found.needed[found.fragments > 0] >= 2).all()
    assert [found.wrong(k) for k in (2, 32)] == [int((found.needed > 2).sum()), 0]


def test_thin_cells_need_more_entries() -> None:
    """Long cells beside short ones: the order of centroids is not that of fragments."""
    whole = lattice(3, 3, 3)
    thin = UnstructuredGrid("a", whole.points * [1, 1, 20], whole.cells, whole.point_arrays)
    camera = Camera(position=(300.0, -200.0, 40.0), focal_point=(1.5, 1.5, 30), view_up=(0, 0, 1), view_angle=12)
    needs = []
    for grid in (whole, thin):
        cells = tetrahedra(grid)
        faces = find_neighbours(cells.corners, len(cells.points)).faces().corners
        needs.append(int(analyse(cells.points, faces, camera, (40, 60)).needed.max()))
    assert needs[1] > needs[0]


def test_a_grid_around_the_eye_is_refused() -> None:
    cells = tetrahedra(lattice(1, 1, 1))
    camera = Camera(position=(0.5, 0.5, 0.5), focal_point=(1.5, 1.5, 1.5), view_up=(0, 0, 1), view_angle=30)
    faces = find_neighbours(cells.corners, len(cells.points)).faces().corners
    with pytest.raises(InputError, match="beside or behind the eye"):
        analyse(cells.points, faces, camera, (4, 4))
    assert KBufferNeeds(np.zeros((1, 1), np.int64), np.zeros((1, 1), np.int64)).wrong(2) == 0
