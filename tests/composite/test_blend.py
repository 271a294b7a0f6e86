"""The kernels equal plain NumPy bit for bit, and bytes are rounded exactly."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clusterviz.composite.blend import copy, over, put_before, put_behind
from clusterviz.composite.patch import Patch
from clusterviz.image.region import Rect


def _line(count: int) -> Patch:
    return Patch(count, 0, count, Rect(0, 0, count, 1))


def _all_bytes() -> tuple[np.ndarray, np.ndarray]:
    """Every pair of a front alpha and a back value, with the largest colours that the alpha allows."""
    alpha, value = (axis.ravel().astype(np.uint8) for axis in np.meshgrid(np.arange(256), np.arange(256)))
    front = np.stack([alpha, alpha // 2, alpha - alpha // 3, alpha], axis=1)
    back = np.stack([value, value // 2, 255 - value, value], axis=1)
    return front, back


def test_plain_over_rounds_all_byte_pairs_to_nearest() -> None:
    front, back = _all_bytes()
    exact = front + back * (255 - front[:, 3:].astype(np.float64)) / 255
    assert np.array_equal(over(front, back), np.minimum(np.floor(exact + 0.5), 255))


def test_kernels_equal_plain_over_at_all_byte_pairs() -> None:
    front, back = _all_bytes()
    patch, wanted = _line(len(front)), over(front, back)
    before, behind = back.copy(), front.copy()
    put_before(before, patch, front, patch)
    put_behind(behind, patch, back, patch)
    assert np.array_equal(before, wanted)
    assert np.array_equal(behind, wanted)


def test_bytes_that_are_not_premultiplied_do_not_spill_into_other_channels() -> None:
    rng = np.random.default_rng(0)
    front, back = rng.integers(0, 256, (2, 10_000, 4), np.uint8)
    made, patch = back.copy(), _line(len(front))
    put_before(made, patch, front, patch)
    assert np.array_equal(made, over(front, back))
    assert made.max() == 255


@pytest.mark.parametrize("count", [1, 3, 1000])
def test_float_kernels_equal_plain_over(count: int) -> None:
    rng = np.random.default_rng(count)
    front, back = rng.random((2, count, 4), np.float32)
    patch, wanted = _line(count), over(front, back)
    before, behind = back.copy(), front.copy()
    put_before(before, patch, front, patch)
    put_behind(behind, patch, back, patch)
    assert np.array_equal(before, wanted)
    assert np.array_equal(behind, wanted)


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_patches_in_patches_meet_the_right_pixels(data: st.DataObject) -> None:
    """Against whole canvases: a patch is what is left of a canvas where nothing else is."""
    width, height = data.draw(st.integers(1, 7)), data.draw(st.integers(1, 7))
    xs, ys = st.integers(0, width), st.integers(0, height)
    outer = _rect(data, xs, ys)
    begin, end = sorted(data.draw(st.tuples(st.integers(0, width * height), st.integers(0, width * height))))
    target_patch = Patch(width, 0, width * height, outer).cut(begin, end)
    inner = _rect(data, xs, ys).intersect(target_patch.rect)
    low, high = sorted(data.draw(st.tuples(st.integers(begin, end), st.integers(begin, end))))
    source_patch = Patch(width, begin, end, inner).cut(low, high)
    if source_patch.count == 0:
        return
    assert target_patch.contains(source_patch)
    rng = np.random.default_rng(0)
    for dtype in (np.float32, np.uint8):
        target, source = (_pixels(rng, patch.count, dtype) for patch in (target_patch, source_patch))
        on_canvas = [_unfold(p, v, width, height) for p, v in ((target_patch, target), (source_patch, source))]
        before, behind, copied = target.copy(), target.copy(), target.copy()
        put_before(before, target_patch, source, source_patch)
        put_behind(behind, target_patch, source, source_patch)
        copy(copied, target_patch, source, source_patch)
        assert np.array_equal(_unfold(target_patch, before, width, height), over(on_canvas[1], on_canvas[0]))
        assert np.array_equal(_unfold(target_patch, behind, width, height), over(on_canvas[0], on_canvas[1]))
        there = _mask(source_patch, width, height)[..., None]
        assert np.array_equal(_unfold(target_patch, copied, width, height), np.where(there, on_canvas[1], on_canvas[0]))


def _rect(data: st.DataObject, xs: st.SearchStrategy[int], ys: st.SearchStrategy[int]) -> Rect:
    x, y = sorted(data.draw(st.tuples(xs, xs))), sorted(data.draw(st.tuples(ys, ys)))
    return Rect(x[0], y[0], x[1], y[1])


def _pixels(rng: np.random.Generator, count: int, dtype: type) -> np.ndarray:
    return rng.random((count, 4), np.float32) if dtype is np.float32 else rng.integers(0, 256, (count, 4), np.uint8)


def _mask(patch: Patch, width: int, height: int) -> np.ndarray:
    mask = np.zeros((height, width), bool)
    rect = patch.rect
    mask[rect.y_begin : rect.y_end, rect.x_begin : rect.x_end] = True
    number = np.arange(width * height).reshape(height, width)
    return mask & (number >= patch.begin) & (number < patch.end)


def _unfold(patch: Patch, pixels: np.ndarray, width: int, height: int) -> np.ndarray:
    canvas = np.zeros((height, width, 4), pixels.dtype)
    canvas[_mask(patch, width, height)] = pixels
    return canvas
