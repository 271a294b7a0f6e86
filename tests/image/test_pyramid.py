"""Pyramid filters: the masks of the thesis in float64, its counts of fetches, any size, constants and ramps."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray

from clusterviz import jobs
from clusterviz.errors import InputError
from clusterviz.image.pyramid.basic.gauss import gauss
from clusterviz.image.pyramid.contract import Filter, Pass
from clusterviz.image.pyramid.executor import Fetches, apply_filter, build_levels
from clusterviz.image.pyramid.filters import ANALYSIS, BASIC, SYNTHESIS
from clusterviz.reference import pyramid as reference

Floats = NDArray[np.float32]
FILTERS = {**BASIC, **ANALYSIS, **SYNTHESIS}
SHAPES = ((1, 1, 1), (1, 7, 2), (8, 1, 4), (2, 3, 3), (9, 6, 4), (16, 17, 5), (3, 5, 4, 1), (4, 1, 7, 2), (1, 1, 1, 1))
THESIS = {"box": 1, "bartlett": 2, "gauss 5 x 5": 4, "box 2 x 2": 1, "box 4 x 4": 2} | {
    "nearest": 1,
    "midpoint": 1,
    "doo-sabin": 1,
    "cubic": 2,
}
"""Fetches for a pixel of the result, as sections 4.1 and 4.2.1 count them."""
AS_WRITTEN = {
    "box 4 x 4": Filter("one pass", (Pass("reduce", 0.5, spread=1.0),)),
    "bartlett 3 x 3": Filter("two boxes", (Pass("keep", 0.5, more=1), Pass("reduce", 0.5))),
    "quadratic 4 x 4": Filter(
        "three boxes", (Pass("keep", -0.5, more=2), Pass("keep", 0.5, more=1), Pass("reduce", 0.5))
    ),
}
"""Other constructions in the thesis of the same filters."""


@pytest.fixture(params=["cpu", pytest.param("gl", marks=pytest.mark.gl)])
def device(request: pytest.FixtureRequest) -> Iterator[str]:
    known = {"cpu" if each.egl is None else "gl": each for each in reversed(jobs.devices())}
    with jobs.on_device(known[request.param]):
        yield request.param


def noise(shape: tuple[int, ...]) -> Floats:
    return np.random.default_rng(len(shape) + sum(shape)).normal(0, 3, shape).astype(np.float32)


@pytest.mark.parametrize("name", FILTERS)
def test_filters_are_the_masks_of_the_thesis(name: str, device: str) -> None:
    for shape in SHAPES:
        image = noise(shape)
        found = apply_filter(FILTERS[name], image)
        np.testing.assert_allclose(found, reference.convolve(name, image.astype(np.float64)), rtol=0, atol=4e-6)
        constant = np.full(shape, 0.1, np.float32)
        np.testing.assert_array_equal(apply_filter(FILTERS[name], constant), np.float32(0.1))


@pytest.mark.parametrize("name", AS_WRITTEN)
def test_other_constructions_find_the_same(name: str) -> None:
    for shape in SHAPES:
        image = noise(shape)
        np.testing.assert_allclose(
            apply_filter(AS_WRITTEN[name], image), apply_filter(FILTERS[name], image), rtol=0, atol=4e-6
        )


def test_masks_are_those_that_the_thesis_prints() -> None:
    impulse = np.zeros((5, 5, 1), np.float32)
    impulse[2, 2] = 1
    rows = [[1, 4, 6, 4, 1], [4, 16, 24, 16, 4], [6, 24, 36, 24, 6], [4, 16, 24, 16, 4], [1, 4, 6, 4, 1]]
    np.testing.assert_array_equal(apply_filter(gauss(5), impulse)[..., 0] * 256, rows)
    np.testing.assert_array_equal(apply_filter(gauss(3), impulse), apply_filter(BASIC["bartlett"], impulse))
    # Row and column 0 of a block belong to h^(1,1), whose mask is turned by the convolution.
    found = apply_filter(SYNTHESIS["doo-sabin"], impulse)[..., 0] * 16
    block = [[1, 3, 3, 1], [3, 9, 9, 3], [3, 9, 9, 3], [1, 3, 3, 1]]
    np.testing.assert_array_equal(found[3:7, 3:7], block)
    assert found.sum() == 64


def test_fetches_are_those_of_the_thesis() -> None:
    for name, count in THESIS.items():
        assert FILTERS[name].fetches() == count
    assert gauss(9).fetches() == 9 - 1
    # Of these the thesis counts 6 and 3; see the manuals of the filters.
    assert [ANALYSIS[name].fetches() for name in ("bartlett 3 x 3", "quadratic 4 x 4")] == [4, 4]
    assert [AS_WRITTEN[name].fetches() for name in AS_WRITTEN] == [4, 5, 9]
    assert ANALYSIS["quadratic 4 x 4"].fetches(3) == 8
    image, counted = np.zeros((130, 64, 1), np.float32), Fetches()
    for name, filter in FILTERS.items():
        before = counted.count
        pixels = np.prod(apply_filter(filter, image, fetches=counted).shape[:2])
        borders = max(each.more for each in filter.passes) * len(filter.passes)
        assert filter.fetches() <= (counted.count - before) / pixels <= filter.fetches() * (1 + borders / 16), name


def test_fetches_of_a_pyramid_are_bounded() -> None:
    image, counted = np.zeros((256, 256, 1), np.float32), Fetches()
    up, down = SYNTHESIS["doo-sabin"], ANALYSIS["box 2 x 2"]
    for level in build_levels(down, image, 8, counted)[:-1]:
        apply_filter(up, np.zeros((*((side + 1) // 2 for side in level.shape[:2]), 1), np.float32), fetches=counted)
    theta, pixels = 1, 256**2
    exact = theta * pixels + sum((theta + theta) * pixels / 4**i for i in range(1, 8)) + theta * pixels / 4**8
    assert counted.count == exact
    assert counted.count / pixels < theta + (theta + theta) / 3


@pytest.mark.parametrize(
    ("down", "up"), [(d, u) for d, u in product(ANALYSIS, SYNTHESIS) if ANALYSIS[d].alignment == SYNTHESIS[u].alignment]
)
def test_ramps_are_not_shifted(down: str, up: str) -> None:
    for size in ((20, 24), (21, 23)):
        ramp = np.empty((*size, 2), np.float32)
        ramp[..., 1], ramp[..., 0] = np.indices(size)
        image = ramp
        if up == "nearest":  # means of blocks
            image = apply_filter(SYNTHESIS["nearest"], apply_filter(ANALYSIS["box 2 x 2"], ramp), size)
        found = apply_filter(SYNTHESIS[up], apply_filter(ANALYSIS[down], ramp), size)
        np.testing.assert_allclose(found[6:-6, 6:-6], image[6:-6, 6:-6], atol=2e-6)


def test_wrong_images_and_sizes() -> None:
    wrong = (np.zeros((3, 3)), np.zeros((3, 3), np.float32), np.zeros((0, 3, 1), np.float32), np.zeros((2, 2, 4)))
    for image in wrong:
        with pytest.raises(InputError, match=r"no image.*float32 \(h, w, c\)"):
            apply_filter(BASIC["box"], image)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"wrong size of a synthesis.*5 or 6 × 3 or 4"):
        apply_filter(SYNTHESIS["nearest"], noise((3, 2, 1)), (4, 4))
    with pytest.raises(InputError, match="no such Gaussian"):
        gauss(4)
