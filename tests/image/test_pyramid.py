"""Pyramid filters: the masks of the thesis in float64, its counts of fetches, any size, constants and ramps."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray

from clusterviz import jobs
from clusterviz.errors import InputError
from clusterviz.image.pyramid.blur import blur, levels_of
from clusterviz.image.pyramid.contract import Filter, Pass
from clusterviz.image.pyramid.executor import Fetches, apply_filter, build_levels
from clusterviz.image.pyramid.filters import ANALYSIS, BASIC, SYNTHESIS, gauss
from clusterviz.image.pyramid.interpolation import interpolate
from clusterviz.image.pyramid.zoom import FARTHEST, NOISE, STRENGTH, zoom
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


def footprints(sigma: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Weights of all pixels of a row around each of 32 in its middle, and how far they are from it."""
    count = int(14 * sigma) // 32 * 32 + 96
    middle = count // 64 * 32 + np.arange(32)
    weights = blur(np.eye(count, dtype=np.float32)[None], sigma)[0, middle]
    return weights.astype(np.float64), np.arange(count) - middle[:, None]


@pytest.mark.parametrize("sigma", [0.3, 0.7, 1.0, 1.4, 1.87, 1.88, 2.7, 4.02, 4.5, 8.1, 13.0, 17.5])
def test_blur_is_near_a_gaussian_of_that_width(sigma: float) -> None:
    weights, apart = footprints(sigma)
    gaussian = np.exp(-0.5 * (apart / sigma) ** 2)
    gaussian /= gaussian.sum(axis=1, keepdims=True)
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-6)
    np.testing.assert_allclose((weights * apart).sum(axis=1), 0, atol=1e-5 * sigma)
    np.testing.assert_allclose(np.sqrt((weights * apart**2).sum(axis=1)), sigma, rtol=1e-5)
    of_largest, of_sum = (0.09, 0.07) if sigma >= 1 else (0.11, 0.17)
    assert np.abs(weights - gaussian).max() < of_largest * gaussian.max()
    assert np.abs(weights - gaussian).sum(axis=1).max() < of_sum
    if sigma >= 1:  # in the plane
        apart = [np.outer(weights[n], weights[n]) - np.outer(gaussian[n], gaussian[n]) for n in range(32)]
        assert np.max(np.abs(apart)) < 0.15 * gaussian.max() ** 2
        assert np.abs(apart).sum(axis=(1, 2)).max() < 0.1


def test_blur_costs_the_same_for_all_widths() -> None:
    image, pixels = np.zeros((512, 512, 1), np.float32), 512 * 512
    for sigma in (1.88, 3.9, 7.9, 20, 100, 1e4):
        counted = Fetches()
        blur(image, sigma, counted)
        bound = 1 + (4 + 1) / 3 + 14 / 4 ** levels_of(sigma)[0]
        assert counted.count / pixels < bound * 1.02, sigma


def test_blur_of_odd_images(device: str) -> None:
    for shape in ((1, 1, 4), (1, 9, 1), (7, 1, 3), (5, 6, 4), (33, 18, 4)):
        np.testing.assert_array_equal(blur(np.full(shape, 0.3, np.float32), 2.3), np.float32(0.3))
        np.testing.assert_array_equal(blur(noise(shape), 0), noise(shape))
        found = blur(noise(shape), 3.7)
        assert found.shape == shape
        assert np.abs(found).max() <= np.abs(noise(shape)).max()
    image = np.repeat(noise((1, 64, 1)).astype(np.float32), 64, axis=0)
    difference = blur(image, 2)[16:-16, 16:-16] - reference.gaussian(image, 2)[16:-16, 16:-16]
    assert np.abs(difference).max() < 0.05 * np.abs(image).max()
    assert blur(np.full((9, 9, 1), 4e37, np.float32), 1e6).max() == np.float32(4e37)
    for sigma in (-1, float("nan"), 2e6):
        with pytest.raises(InputError, match="impossible standard deviation"):
            blur(image, sigma)


def test_invalid_pixels_do_not_blur_into_others() -> None:
    image = np.full((40, 30, 4), 0.7, np.float32)
    image[3, 4, 1], image[20:26, 10:20], image[39, 29] = np.nan, np.inf, -5e37
    wrong = ~(np.abs(image) <= 4e37).all(axis=-1)
    for sigma in (1, 5, 60):
        found = blur(image, sigma)
        np.testing.assert_array_equal(found[wrong], image[wrong])
        np.testing.assert_allclose(found[~wrong], 0.7, rtol=1e-6)
    assert np.isnan(blur(np.full((3, 3, 1), np.nan, np.float32), 2)).all()


def sparse(shape: tuple[int, ...], count: int) -> tuple[Floats, Floats]:
    """Values, and weights that are not 0 at some pixels."""
    draw = np.random.default_rng(count)
    weights = np.zeros(shape[:-1], np.float32)
    weights.flat[draw.choice(weights.size, count, replace=False)] = draw.uniform(0.2, 1, count)
    return noise(shape), weights


@pytest.mark.parametrize(
    ("shape", "count"), [((1, 1, 1), 1), ((1, 9, 2), 2), ((30, 41, 4), 25), ((64, 64, 1), 1), ((9, 12, 17, 1), 30)]
)
def test_interpolation_is_that_in_float64(shape: tuple[int, ...], count: int, device: str) -> None:
    values, weights = sparse(shape, count)
    counted = Fetches()
    found = interpolate(values, weights, counted)
    np.testing.assert_array_equal(found[weights > 0], values[weights > 0])
    expected = reference.pull_push(values.astype(np.float64), weights.astype(np.float64))
    np.testing.assert_allclose(found, expected, atol=2e-5)
    given = values[weights > 0]
    assert (found >= given.min(axis=0) - 1e-5).all()
    assert (found <= given.max(axis=0) + 1e-5).all()


def test_fetches_of_the_push() -> None:
    values, weights = sparse((256, 256, 1), 40)
    counted, pull = Fetches(), Fetches()
    interpolate(values, weights, counted)
    build_levels(ANALYSIS["box 4 x 4"], values, 8, pull)
    assert counted.count - pull.count == sum(2 * 4**i for i in range(1, 9)) < 8 / 3 * 256**2


def test_interpolation_of_little() -> None:
    values, weights = noise((6, 7, 2)), np.zeros((6, 7), np.float32)
    np.testing.assert_array_equal(interpolate(values, weights), 0)
    weights[2, 3], weights[1, 1] = 1e-3, 1
    values[1, 1, 0] = np.nan
    np.testing.assert_allclose(interpolate(values, weights), np.broadcast_to(values[2, 3], values.shape), rtol=1e-6)
    tiny = np.full((5, 64, 1), 1e-38, np.float32)
    np.testing.assert_allclose(interpolate(tiny, np.eye(5, 64) > 0), tiny, rtol=1e-6)
    for wrong in (weights[:5], -weights, weights * np.nan):
        with pytest.raises(InputError, match="wrong weights"):
            interpolate(values, wrong)


def test_zoom_is_that_in_float64(device: str) -> None:
    for shape in ((1, 1, 3), (1, 6, 1), (13, 9, 4), (16, 20, 2)):
        image = blur(noise(shape), 1.0)
        found = zoom(image, (2 * shape[0], 2 * shape[1]))
        expected = reference.edge_directed(image.astype(np.float64), STRENGTH, FARTHEST, NOISE)
        # The direction of the move jumps where the second derivative is 0 up to rounding, by little in the image.
        np.testing.assert_allclose(found, expected, atol=2e-4)
        plain = zoom(image, (2 * shape[0], 2 * shape[1]), edges=False)
        np.testing.assert_allclose(plain, apply_filter(SYNTHESIS["doo-sabin"], image), atol=2e-6)


def test_zoom_sharpens_edges_and_keeps_the_rest() -> None:
    constant = np.full((5, 7, 4), 0.1, np.float32)
    np.testing.assert_array_equal(zoom(constant, (33, 41)), np.float32(0.1))
    ramp = np.repeat(np.linspace(0, 1, 33, dtype=np.float32)[None, :, None], 9, axis=0)
    inside = np.s_[:, 8:-8]
    np.testing.assert_allclose(zoom(ramp, (18, 66))[inside], zoom(ramp, (18, 66), edges=False)[inside], atol=1e-6)
    rows, columns = np.indices((128, 128)) + 0.5
    disc = (np.hypot(rows - 64, columns - 64) < 45).astype(np.float32)[..., None]
    for level in (2, 4):
        small = build_levels(ANALYSIS["box 2 x 2"], disc, level // 2)[-1]
        errors = [np.square(zoom(small, (128, 128), edges=edges) - disc).mean() for edges in (True, False)]
        assert errors[0] < 0.8 * errors[1]
    assert zoom(disc[:50, :50], (77, 100)).shape == (77, 100, 1)
    spoilt = disc.copy()
    spoilt[3, 4] = np.nan
    assert np.isnan(zoom(spoilt, (256, 256))).sum() == 16
    for size in ((127, 128), (128, 0)):
        with pytest.raises(InputError, match="no magnification"):
            zoom(disc, size)


def test_zoom_takes_less_than_eleven_lookups() -> None:
    image = np.zeros((16, 16, 4), np.float32)
    for factor in (2, 4, 64):
        counted = Fetches()
        zoom(image, (16 * factor, 16 * factor), fetches=counted)
        assert counted.count / (16 * factor) ** 2 == pytest.approx(8 * (4 - 4 / factor**2) / 3)
        assert counted.count / (16 * factor) ** 2 < 11
