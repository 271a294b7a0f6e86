"""Many layers in one pass: equal to plain NumPy bit for bit, and as exact as is claimed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from composite.patches import DTYPES, WIDTHS, line, patches, random_pixels, random_runs
from hypothesis import given, settings
from hypothesis import strategies as st

from clusterviz.composite.fragment import Patch
from clusterviz.composite.over import job
from clusterviz.composite.over.layers import Layer, blend_layers, plain_layers
from clusterviz.errors import InputError
from clusterviz.image.region import Rect
from clusterviz.reference.over import over as exact_over


def blended(layers: list[Layer], patch: Patch, dtype: Any, split: int = 0, threads: int = 1) -> np.ndarray:
    out = np.full((patch.count, 4), 77, dtype)
    blend_layers(layers, patch, out, split=split, threads=threads)
    return out


def random_layer(data: st.DataObject, rng: np.random.Generator, width: int, height: int) -> Layer:
    patch, dtype = data.draw(patches(width, height)), data.draw(st.sampled_from(DTYPES))
    pixels = random_pixels(rng, patch.count, dtype)
    if data.draw(st.booleans()):
        active, runs = random_runs(rng, patch.count)
        layer = Layer(patch, pixels[active], runs)
    else:
        layer = Layer(patch, pixels)
    layer.pixels.setflags(write=data.draw(st.booleans()))
    return layer


def draw_case(data: st.DataObject) -> tuple[list[Layer], Patch, np.dtype[Any], int]:
    width = data.draw(st.sampled_from(WIDTHS))
    height = data.draw(st.integers(1, 20 if width < 100 else 3))
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32)))
    layers = [random_layer(data, rng, width, height) for _ in range(data.draw(st.integers(0, 6)))]
    split = data.draw(st.integers(0, len(layers)))
    return layers, data.draw(patches(width, height)), data.draw(st.sampled_from(DTYPES)), split


@settings(max_examples=300, deadline=None)
@given(st.data())
def test_any_layers_of_any_patch_equal_plain_numpy(data: st.DataObject) -> None:
    layers, patch, dtype, split = draw_case(data)
    wanted = plain_layers(layers, patch, dtype, split)
    assert np.array_equal(blended(layers, patch, dtype, split), wanted)


@settings(max_examples=100, deadline=None)
@given(st.data())
def test_batches_through_floats_change_no_bit(data: st.DataObject) -> None:
    layers, patch, dtype, _ = draw_case(data)
    cut = data.draw(st.integers(0, len(layers)))
    front = Layer(patch, blended(layers[:cut], patch, np.float32))
    assert np.array_equal(blended([front, *layers[cut:]], patch, dtype), blended(layers, patch, dtype))


@settings(max_examples=50, deadline=None)
@given(st.data())
def test_threads_change_no_bit(data: st.DataObject) -> None:
    layers, patch, dtype, split = draw_case(data)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(job, "PIXELS_A_THREAD", 1)
        threaded = blended(layers, patch, dtype, split, threads=3)
    assert np.array_equal(threaded, blended(layers, patch, dtype, split))


def stack(count: int, pixels: int, dtype: np.dtype[Any], alpha: str) -> list[np.ndarray]:
    rng = np.random.default_rng(count)
    opacity = {
        "faint": lambda: rng.choice([0, 1, 2, 3], (pixels, 1)) / 255,
        "dense": lambda: rng.choice([0, 1, 128, 254, 255], (pixels, 1)) / 255,
        "any": lambda: rng.random((pixels, 1)) ** 4,
    }[alpha]
    layers = []
    for _ in range(count):
        a = opacity()
        layer = np.concatenate([rng.choice([0, 0.5, 1], (pixels, 3)) * a, a], axis=1)
        layers.append(np.rint(layer * 255).astype(dtype) if dtype == np.uint8 else layer.astype(dtype))
    return layers


@pytest.mark.parametrize("alpha", ["faint", "dense", "any"])
@pytest.mark.parametrize("count", [1, 2, 3, 8, 64])
@pytest.mark.parametrize("dtype", DTYPES, ids=str)
def test_bytes_are_exact_to_half_a_level_however_many_layers(dtype: np.dtype[Any], count: int, alpha: str) -> None:
    images, patch = stack(count, 5000, dtype, alpha), line(5000)
    scale = 255 if dtype == np.uint8 else 1
    exact = exact_over([image[None].astype(np.float64) / scale for image in images])[0]
    for split in (0, count // 2):
        made = blended([Layer(patch, image) for image in images], patch, np.uint8, split)
        assert np.abs(made - 255 * exact).max() <= 0.51
        assert np.all(made[exact[:, 3] == 1, 3] == 255)


@pytest.mark.parametrize("alpha", ["faint", "dense", "any"])
@pytest.mark.parametrize("count", [1, 2, 8, 64])
def test_floats_stay_within_their_bound(count: int, alpha: str) -> None:
    images, patch = stack(count, 5000, np.dtype(np.float32), alpha), line(5000)
    exact = exact_over([image[None] for image in images])[0]
    for split in (0, count // 2):
        made = blended([Layer(patch, image) for image in images], patch, np.float32, split)
        assert np.abs(made - exact).max() <= count * 2**-23


def test_one_layer_of_bytes_comes_out_as_it_went_in() -> None:
    levels = np.arange(256, dtype=np.uint8)[:, None].repeat(4, axis=1)
    for dtype in DTYPES:
        through = blended([Layer(line(256), levels)], line(256), dtype)
        assert np.array_equal(blended([Layer(line(256), through)], line(256), np.uint8), levels)


def test_every_half_is_read_and_written_as_numpy_does() -> None:
    halves = np.arange(1 << 16, dtype=np.uint16).view(np.float16)
    pixels = np.concatenate([halves[np.isfinite(halves)].reshape(-1, 1)] * 4, axis=1)
    patch = line(len(pixels))
    with np.errstate(invalid="ignore"):
        assert np.array_equal(blended([Layer(patch, pixels)], patch, np.float32), pixels.astype(np.float32))
    # Between neighbours: a float below, on and above the middle, where ties go to the even one.
    small = np.arange(0x7C00 - 1, dtype=np.uint16).view(np.float16).astype(np.float32)
    middle = small + np.diff(np.arange(0x7C00, dtype=np.uint16).view(np.float16).astype(np.float32)) / 2
    near = np.concatenate([np.nextafter(middle, np.float32(side), dtype=np.float32) for side in (0, 1e9)] + [middle])
    floats = np.stack([near] * 3 + [np.zeros_like(near)], axis=1)
    patch = line(len(floats))
    assert np.array_equal(blended([Layer(patch, floats)], patch, np.float16), floats.astype(np.float16))


def test_nothing_behind_an_opaque_block_is_added() -> None:
    patch = line(3000)
    solid, behind = np.full((3000, 4), 255, np.uint8), np.full((3000, 4), 9, np.uint8)
    assert np.array_equal(blended([Layer(patch, solid), Layer(patch, behind)], patch, np.uint8), solid)


def test_no_layers_leave_every_pixel_blank() -> None:
    for dtype in DTYPES:
        assert not blended([], line(700), dtype).any()
        assert blended([Layer(line(5), np.ones((5, 4), dtype))], Patch(5, 3, 3, Rect(0, 0, 5, 1)), dtype).size == 0


def test_bytes_that_are_not_premultiplied_are_cut_at_255() -> None:
    patch, bright = line(40), np.full((40, 4), (255, 255, 255, 10), np.uint8)
    assert np.all(blended([Layer(patch, bright)] * 3, patch, np.uint8)[:, :3] == 255)


def test_pixels_may_begin_at_any_address() -> None:
    store = np.zeros(16 * 100 + 3, np.uint8)
    for dtype in DTYPES:
        pixels = store[3 : 3 + 100 * 4 * dtype.itemsize].view(dtype).reshape(100, 4)
        pixels[:] = random_pixels(np.random.default_rng(0), 100, dtype)
        layers = [Layer(line(100), pixels)]
        assert np.array_equal(blended(layers, line(100), dtype), plain_layers(layers, line(100), dtype))


@pytest.mark.parametrize(
    "runs",
    [[[0, 50]], [[0, 5], [2, 900]], [[90, 20]], [[-5, 7]], [[5, -3], [0, 9]], [[2**31 - 1, 2**31 - 1]]],
    ids=["more than stored", "overlapping", "past the end", "before the start", "negative", "huge"],
)
def test_impossible_runs_read_and_write_nothing_else(runs: list[list[int]]) -> None:
    stored = np.full((12, 4), 1, np.float32)
    around = np.full((120, 4), 7, np.float32)
    layer = Layer(line(100), stored[1:11], np.array(runs, np.int32))
    stored[[0, 11]] = np.nan
    blend_layers([layer], line(100), around[10:110])
    assert np.all((around[10:110] == 0) | (around[10:110] == 1))
    assert np.all(around[:10] == 7)
    assert np.all(around[110:] == 7)


GOOD = np.zeros((10, 4), np.uint8)


@pytest.mark.parametrize(
    ("pixels", "runs", "text"),
    [
        (np.zeros((9, 4), np.uint8), None, "layer 1: the pixels do not fit their patch; allowed 10 pixels"),
        (np.zeros((10, 3), np.uint8), None, "not an array of pixels"),
        (np.zeros((10, 4), np.float64), None, "not an array of pixels"),
        (np.zeros((20, 4), np.uint8)[::2], None, "not in C order"),
        (GOOD, np.zeros((1, 2), np.int64), "not an array of runs"),
        (GOOD, np.zeros(2, np.int32), "not an array of runs"),
    ],
)
def test_a_layer_that_does_not_fit_is_refused(pixels: np.ndarray, runs: np.ndarray | None, text: str) -> None:
    layers = [Layer(line(10), GOOD), Layer(line(10), pixels, runs)]
    with pytest.raises(InputError, match=text):
        blend_layers(layers, line(10), np.zeros((10, 4), np.uint8))


def test_a_target_that_cannot_be_written_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    fixed = np.zeros((10, 4), np.uint8)
    fixed.setflags(write=False)
    with pytest.raises(InputError, match="read-only"):
        blend_layers([], line(10), fixed)
    with pytest.raises(InputError, match="target: the pixels do not fit their patch; allowed 10 pixels"):
        blend_layers([], line(10), np.zeros((11, 4), np.uint8))
    monkeypatch.setattr(job, "PIXELS_A_THREAD", 1)
    with pytest.raises(InputError, match="target: the pixels do not fit their patch"):
        blend_layers([], line(10), np.zeros((11, 4), np.uint8), threads=2)
