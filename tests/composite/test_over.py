"""Kernels that merge pixels: equal to plain NumPy bit for bit, and as exact as is claimed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from composite.cases import DTYPES, OPERATORS, random_pixels
from composite.patches import CANVASES, line, patches, random_runs
from hypothesis import given, settings
from hypothesis import strategies as st

from clusterviz.codec import open_message, pack, unpack
from clusterviz.composite.fragment import Patch
from clusterviz.composite.over.blend import over, put_before, put_behind
from clusterviz.composite.over.layers import Layer, blend_layers, plain_layers
from clusterviz.errors import InputError
from clusterviz.image.merge import MERGES, Operator
from clusterviz.image.partial import Rect
from clusterviz.reference.over import over as exact_over

FLOAT = np.dtype(np.float32)
SEEDS = st.integers(0, 2**32 - 1)


def merged(way: str, front: np.ndarray, back: np.ndarray, operator: Operator = "over") -> np.ndarray:
    """Front and back, merged in one of the compiled ways."""
    patch, made = line(len(front)), (front if way == "behind" else back).copy()
    put, source = (put_behind, back) if way == "behind" else (put_before, front)
    put(made, patch, source, patch, operator=operator)
    return made


def blended(layers: list[Layer], patch: Patch, dtype: Any, **options: Any) -> np.ndarray:
    out = np.full((patch.count, 4), 77, dtype)
    blend_layers(layers, patch, out, **options)
    return out


def all_bytes() -> tuple[np.ndarray, np.ndarray]:
    """Every pair of a front alpha and a back value, with the largest colours that the alpha allows."""
    alpha, value = (axis.ravel().astype(np.uint8) for axis in np.meshgrid(np.arange(256), np.arange(256)))
    front = np.stack([alpha, alpha // 2, alpha - alpha // 3, alpha], axis=1)
    return front, np.stack([value, value // 2, 255 - value, value], axis=1)


def test_plain_over_rounds_all_byte_pairs_to_nearest() -> None:
    front, back = all_bytes()
    exact = front + back * (255 - front[:, 3:].astype(np.float64)) / 255
    assert np.array_equal(over(front, back), np.minimum(np.floor(exact + 0.5), 255))


@pytest.mark.parametrize("way", ["before", "behind"])
def test_kernels_equal_plain_over_at_all_byte_pairs(way: str) -> None:
    """Bytes that are not premultiplied do not spill into other channels."""
    for front, back in (all_bytes(), np.random.default_rng(0).integers(0, 256, (2, 10_000, 4), np.uint8)):
        made = merged(way, front, back)
        assert np.array_equal(made, over(front, back))
    assert made.max() == 255


@pytest.mark.parametrize("kind", [*DTYPES, *OPERATORS], ids=str)
def test_any_number_of_pixels_of_any_kind(kind: Any) -> None:
    rng, operator = np.random.default_rng(5), kind if kind in OPERATORS else "over"
    for count in (0, 1, 3, 4, 5, 700, 1000):
        front, back = (random_pixels(rng, count, kind) for _ in range(2))
        wanted = over(front, back) if operator == "over" else MERGES[kind](front, back)
        for way in ("before", "behind"):
            assert np.array_equal(merged(way, front, back, operator), wanted), (way, count)


@settings(max_examples=100, deadline=None)
@given(st.data(), CANVASES, SEEDS, st.sampled_from(DTYPES))
def test_patches_meet_where_both_have_pixels(data: st.DataObject, canvas: Patch, seed: int, dtype: Any) -> None:
    rng = np.random.default_rng(seed)
    target_patch, source_patch = data.draw(patches(canvas)), data.draw(patches(canvas))
    target, source = (random_pixels(rng, patch.count, dtype) for patch in (target_patch, source_patch))
    source.setflags(write=False)
    on_canvas = [
        plain_layers([Layer(p, v)], canvas, FLOAT) for p, v in ((target_patch, target), (source_patch, source))
    ]
    if dtype == np.uint8:
        on_canvas = [np.rint(pixels * 255) for pixels in on_canvas]
    below, above = (pixels.astype(dtype) for pixels in on_canvas)
    for put, wanted in ((put_before, over(above, below)), (put_behind, over(below, above))):
        made = target.copy()
        put(made, target_patch, source, source_patch)
        # Cutting the canvas down to the target's patch changes no value.
        assert np.array_equal(made, plain_layers([Layer(canvas, wanted)], target_patch, dtype))


def draw_layers(data: st.DataObject, seed: int, canvas: Patch, operator: Operator = "over") -> list[Layer]:
    """Pixels, or those of runs, of any types."""
    rng, layers = np.random.default_rng(seed), []
    for _ in range(data.draw(st.integers(0, 6))):
        patch = data.draw(patches(canvas))
        pixels = random_pixels(rng, patch.count, data.draw(st.sampled_from(DTYPES)) if operator == "over" else operator)
        active, runs = random_runs(rng, patch.count)
        layers.append(Layer(patch, pixels[active], runs) if data.draw(st.booleans()) else Layer(patch, pixels))
        layers[-1].pixels.setflags(write=data.draw(st.booleans()))
    return layers


@pytest.mark.cover
@pytest.mark.parametrize("operator", ["over", *OPERATORS])
@settings(max_examples=60, deadline=None)
@given(st.data(), CANVASES, SEEDS, st.sampled_from(DTYPES))
def test_any_layers_of_any_patch_equal_plain_numpy(
    operator: Operator, data: st.DataObject, canvas: Patch, seed: int, dtype: np.dtype[Any]
) -> None:
    layers, patch = draw_layers(data, seed, canvas, operator), data.draw(patches(canvas))
    split, dtype = data.draw(st.integers(0, len(layers))), dtype if operator == "over" else FLOAT
    made = blended(layers, patch, dtype, split=split, operator=operator)
    assert np.array_equal(made, plain_layers(layers, patch, dtype, split, operator))


@settings(max_examples=50, deadline=None)
@given(st.data(), CANVASES, SEEDS, st.sampled_from(DTYPES))
def test_batches_through_floats_change_no_bit(data: st.DataObject, canvas: Patch, seed: int, dtype: Any) -> None:
    layers, patch = draw_layers(data, seed, canvas), data.draw(patches(canvas))
    cut = data.draw(st.integers(0, len(layers)))
    front = Layer(patch, blended(layers[:cut], patch, np.float32))
    assert np.array_equal(blended([front, *layers[cut:]], patch, dtype), blended(layers, patch, dtype))


@pytest.mark.parametrize(
    ("dtype", "count", "alpha"),
    [
        *((np.dtype(np.uint8), count, alpha) for count, alpha in ((1, "any"), (3, "faint"), (64, "dense"))),
        *((np.dtype(np.float16), count, alpha) for count, alpha in ((2, "dense"), (8, "any"))),
        *((np.dtype(np.float32), count, alpha) for count, alpha in ((1, "faint"), (3, "dense"), (64, "any"))),
    ],
)
def test_bytes_are_exact_to_half_a_level_and_floats_to_rounding(dtype: np.dtype[Any], count: int, alpha: str) -> None:
    """However many layers there are."""
    rng, patch, layers, scale = np.random.default_rng(count), line(5000), [], 255 if dtype == np.uint8 else 1
    levels = {"faint": [0, 1, 2, 3], "dense": [0, 1, 128, 254, 255]}.get(alpha)
    for _ in range(count):
        a = rng.choice(levels, (5000, 1)) / 255 if levels else rng.random((5000, 1)) ** 4
        pixels = np.concatenate([rng.choice([0, 0.5, 1], (5000, 3)) * a, a], axis=1) * scale
        layers.append(Layer(patch, np.rint(pixels).astype(dtype) if scale > 1 else pixels.astype(dtype)))
    exact = exact_over([layer.pixels[None].astype(np.float64) / scale for layer in layers])[0]
    for split in (0, count // 2):
        made = blended(layers, patch, np.uint8, split=split)
        assert np.abs(made - 255 * exact).max() <= 0.51
        assert np.all(made[exact[:, 3] == 1, 3] == 255)
        if dtype == np.float32:
            assert np.abs(blended(layers, patch, np.float32, split=split) - exact).max() <= count * 2**-23


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
    small = np.arange(0x7C00, dtype=np.uint16).view(np.float16).astype(np.float32)
    middle = small[:-1] + np.diff(small) / 2
    near = np.concatenate([np.nextafter(middle, np.float32(side), dtype=np.float32) for side in (0, 1e9)] + [middle])
    floats = np.stack([near] * 3 + [np.zeros_like(near)], axis=1)
    assert np.array_equal(
        blended([Layer(line(len(floats)), floats)], line(len(floats)), np.float16), floats.astype(np.float16)
    )


def test_opaque_bright_and_missing_layers() -> None:
    patch, solid, behind = line(3000), np.full((3000, 4), 255, np.uint8), np.full((3000, 4), 9, np.uint8)
    assert np.array_equal(blended([Layer(patch, solid), Layer(patch, behind)], patch, np.uint8), solid)
    bright = np.full((40, 4), (255, 255, 255, 10), np.uint8)
    assert np.all(blended([Layer(line(40), bright)] * 3, line(40), np.uint8)[:, :3] == 255)
    for dtype in DTYPES:
        assert not blended([], line(700), dtype).any()
        assert blended([Layer(line(5), np.ones((5, 4), dtype))], Patch(5, 3, 3, Rect(0, 0, 5, 1)), dtype).size == 0


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
    stored, around = np.full((12, 4), 1, np.float32), np.full((120, 4), 7, np.float32)
    layer = Layer(line(100), stored[1:11], np.array(runs, np.int32))
    stored[[0, 11]] = np.nan
    blend_layers([layer], line(100), around[10:110])
    assert np.isin(around[10:110], (0, 1)).all()
    assert np.all(np.delete(around, slice(10, 110), axis=0) == 7)


@pytest.mark.parametrize("operator", OPERATORS)
def test_what_a_codec_leaves_out_is_neutral(operator: Operator) -> None:
    pixels = random_pixels(np.random.default_rng(6), 4000, operator)
    pixels[:1000] = 0
    for codec in ("active", "rectangle", "active+shuffle+lz4"):
        message = pack(pixels, codec)
        kept, _ = open_message(message, len(pixels), pixels.dtype)
        assert len(kept) < len(pixels)
        assert np.array_equal(unpack(message, len(pixels), pixels.dtype), pixels)
    blank = np.zeros_like(pixels)
    assert np.array_equal(MERGES[operator](pixels, blank), pixels)
    assert np.array_equal(MERGES[operator](blank, pixels), pixels)


FEW, MORE, FLOATS = np.zeros((4, 4), np.uint8), np.zeros((5, 4), np.uint8), np.zeros((4, 4), np.float32)
FIXED = np.zeros((4, 4), np.uint8)
FIXED.setflags(write=False)


def second(pixels: np.ndarray, runs: np.ndarray | None = None) -> None:
    blend_layers([Layer(line(4), FEW), Layer(line(4), pixels, runs)], line(4), np.zeros((4, 4), np.uint8))


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: put_before(FLOATS, line(4), FEW, line(4)), "images differ in pixel type; found float32, uint8"),
        (lambda: put_behind(FEW, line(4), MORE, line(4)), "layer 0: the pixels do not fit their patch; allowed 4"),
        (lambda: put_before(FIXED, line(4), FEW, line(4)), "read-only"),
        (lambda: second(MORE), "layer 1: the pixels do not fit their patch; allowed 4 pixels"),
        (lambda: second(np.zeros((4, 3), np.uint8)), "not an array of pixels"),
        (lambda: second(FLOATS.astype(np.float64)), "not an array of pixels"),
        (lambda: second(np.zeros((8, 4), np.uint8)[::2]), "not in C order"),
        (lambda: second(FEW, np.zeros((1, 2), np.int64)), "not an array of runs"),
        (lambda: second(FEW, np.zeros(2, np.int32)), "not an array of runs"),
        (lambda: blend_layers([], line(4), FIXED), "read-only"),
        (lambda: blend_layers([], line(4), MORE), "target: the pixels do not fit their patch; allowed 4 pixels"),
        (lambda: blend_layers([Layer(line(4), FEW)], line(4), FLOATS, operator="sum"), "the operator sum cannot merge"),
    ],
)
def test_images_that_do_not_fit_are_refused(call: Callable[[], None], text: str) -> None:
    with pytest.raises(InputError, match=text):
        call()
