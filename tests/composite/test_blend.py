"""Two images at a time: equal to plain NumPy bit for bit, and bytes are rounded exactly."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from composite.patches import DTYPES, WIDTHS, line, patches, random_pixels, random_runs, runs_of
from hypothesis import given, settings
from hypothesis import strategies as st

from clusterviz.composite.fragment import Patch
from clusterviz.composite.over import job
from clusterviz.composite.over.blend import merge_runs, over, over_into, put_before, put_behind
from clusterviz.composite.over.layers import Layer, plain_layers
from clusterviz.errors import InputError
from clusterviz.image.region import Rect


def all_bytes() -> tuple[np.ndarray, np.ndarray]:
    """Every pair of a front alpha and a back value, with the largest colours that the alpha allows."""
    alpha, value = (axis.ravel().astype(np.uint8) for axis in np.meshgrid(np.arange(256), np.arange(256)))
    front = np.stack([alpha, alpha // 2, alpha - alpha // 3, alpha], axis=1)
    back = np.stack([value, value // 2, 255 - value, value], axis=1)
    return front, back


def over_by(way: str, front: np.ndarray, back: np.ndarray, threads: int = 1) -> np.ndarray:
    """Front over back in one of the compiled ways."""
    patch, made = line(len(front)), (front if way == "behind" else back).copy()
    if way == "before":
        put_before(made, patch, front, patch, threads=threads)
    elif way == "behind":
        put_behind(made, patch, back, patch, threads=threads)
    else:
        over_into(made := np.empty_like(front), front, back, threads=threads)
    return made


WAYS = ("before", "behind", "into")


def test_plain_over_rounds_all_byte_pairs_to_nearest() -> None:
    front, back = all_bytes()
    exact = front + back * (255 - front[:, 3:].astype(np.float64)) / 255
    assert np.array_equal(over(front, back), np.minimum(np.floor(exact + 0.5), 255))


@pytest.mark.parametrize("way", WAYS)
def test_kernels_equal_plain_over_at_all_byte_pairs(way: str) -> None:
    front, back = all_bytes()
    assert np.array_equal(over_by(way, front, back), over(front, back))


@pytest.mark.parametrize("way", WAYS)
def test_bytes_that_are_not_premultiplied_do_not_spill_into_other_channels(way: str) -> None:
    front, back = np.random.default_rng(0).integers(0, 256, (2, 10_000, 4), np.uint8)
    made = over_by(way, front, back)
    assert np.array_equal(made, over(front, back))
    assert made.max() == 255


@pytest.mark.parametrize("count", [0, 1, 3, 1000])
@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("dtype", DTYPES, ids=str)
def test_any_number_of_pixels_of_any_type(dtype: np.dtype[Any], way: str, count: int) -> None:
    rng = np.random.default_rng(count)
    front, back = (random_pixels(rng, count, dtype) for _ in range(2))
    assert np.array_equal(over_by(way, front, back), over(front, back))


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("dtype", DTYPES, ids=str)
def test_threads_change_no_bit(monkeypatch: pytest.MonkeyPatch, dtype: np.dtype[Any], way: str) -> None:
    monkeypatch.setattr(job, "PIXELS_A_THREAD", 1)
    rng = np.random.default_rng(0)
    front, back = (random_pixels(rng, 5001, dtype) for _ in range(2))
    assert np.array_equal(over_by(way, front, back, threads=3), over(front, back))


@settings(max_examples=200, deadline=None)
@given(st.data())
def test_patches_meet_where_both_have_pixels(data: st.DataObject) -> None:
    width = data.draw(st.sampled_from(WIDTHS))
    height = data.draw(st.integers(1, 20 if width < 100 else 3))
    rng, dtype = np.random.default_rng(data.draw(st.integers(0, 2**32))), data.draw(st.sampled_from(DTYPES))
    target_patch, source_patch = data.draw(patches(width, height)), data.draw(patches(width, height))
    target, source = (random_pixels(rng, patch.count, dtype) for patch in (target_patch, source_patch))
    source.setflags(write=False)
    canvas = Patch(width, 0, width * height, Rect(0, 0, width, height))
    on_canvas = [
        plain_layers([Layer(p, v)], canvas, np.dtype(np.float32))
        for p, v in ((target_patch, target), (source_patch, source))
    ]
    if dtype == np.uint8:
        on_canvas = [np.rint(pixels * 255) for pixels in on_canvas]
    below, above = (pixels.astype(dtype) for pixels in on_canvas)
    for put, wanted in ((put_before, over(above, below)), (put_behind, over(below, above))):
        made = target.copy()
        put(made, target_patch, source, source_patch)
        # Cutting the canvas down to the target's patch changes no value.
        cut = plain_layers([Layer(canvas, wanted)], target_patch, dtype)
        assert np.array_equal(made, cut)


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 300), st.sampled_from(DTYPES), st.integers(0, 2**32))
def test_runs_over_runs_are_the_runs_of_both(count: int, dtype: np.dtype[Any], seed: int) -> None:
    rng = np.random.default_rng(seed)
    front, back = (random_pixels(rng, count, dtype) for _ in range(2))
    (near, near_runs), (far, far_runs) = (random_runs(rng, count) for _ in range(2))
    pixels, runs = merge_runs((front[near], near_runs), (back[far], far_runs))
    front[~near], back[~far] = 0, 0
    assert np.array_equal(pixels, over(front, back)[near | far])
    assert np.array_equal(runs, runs_of(near | far))


def test_runs_that_claim_more_than_is_stored_are_cut() -> None:
    few = np.ones((3, 4), np.float32)
    pixels, runs = merge_runs((few, np.array([[0, 2], [5, 9]], np.int32)), (few, np.array([[2, 4]], np.int32)))
    assert np.array_equal(pixels, np.ones((6, 4), np.float32))
    assert runs.tolist() == [[0, 6]]


def test_images_of_different_types_are_refused() -> None:
    floats, bytes_ = np.zeros((4, 4), np.float32), np.zeros((4, 4), np.uint8)
    runs = np.zeros((0, 2), np.int32)
    for call in (
        lambda: put_before(floats, line(4), bytes_, line(4)),
        lambda: over_into(floats, floats, bytes_),
        lambda: merge_runs((floats, runs), (bytes_, runs)),
    ):
        with pytest.raises(InputError, match="images differ in pixel type; found float32, uint8"):
            call()


def test_images_that_do_not_fit_are_refused() -> None:
    few, more = np.zeros((4, 4), np.uint8), np.zeros((5, 4), np.uint8)
    with pytest.raises(InputError, match="layer 0: the pixels do not fit their patch; allowed 4 pixels"):
        put_behind(few, line(4), more, line(4))
    with pytest.raises(InputError, match="layer 1: the pixels do not fit"):
        over_into(few, few.copy(), more)
    few.setflags(write=False)
    with pytest.raises(InputError, match="read-only"):
        put_before(few, line(4), few, line(4))
