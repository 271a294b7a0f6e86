"""The nearest fragment wins: equal to plain NumPy, whoever is put where first."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from composite.patches import DTYPES, WIDTHS, line, patches
from hypothesis import given, settings
from hypothesis import strategies as st

from clusterviz.composite.fragment import Patch
from clusterviz.composite.over import job
from clusterviz.composite.over.depth import DepthLayer, nearest, nearest_layers, put_nearest
from clusterviz.composite.over.layers import Layer, plain_layers
from clusterviz.errors import InputError
from clusterviz.image.region import Rect

FLOAT = np.dtype(np.float32)


def random_layer(rng: np.random.Generator, patch: Patch, dtype: np.dtype[Any]) -> DepthLayer:
    """Colours of one's own, few depths that often agree, and pixels with nothing in them."""
    depths = rng.choice([1, 2, 3, np.inf], patch.count).astype(np.float32)
    colours = rng.integers(1, 255, (patch.count, 4)).astype(dtype)
    colours[np.isinf(depths)] = 0
    return DepthLayer(patch, colours, depths)


def plainly(layers: list[DepthLayer], canvas: Patch, dtype: np.dtype[Any]) -> tuple[np.ndarray, np.ndarray]:
    """All layers on the canvas, one by one."""
    result = np.zeros((canvas.count, 4), dtype), np.full(canvas.count, np.inf, np.float32)
    for layer in layers:
        result = nearest(result, on_canvas(layer, canvas))
    return result


def on_canvas(layer: DepthLayer, canvas: Patch) -> tuple[np.ndarray, np.ndarray]:
    near = np.repeat(1 / layer.depths[:, None], 4, axis=1)
    # Reciprocals of depths, so that blank pixels are infinitely far.
    with np.errstate(divide="ignore"):
        depths = 1 / plain_layers([Layer(layer.patch, near)], canvas, FLOAT)[:, 0]
    colours = plain_layers([Layer(layer.patch, layer.pixels.astype(FLOAT))], canvas, FLOAT)
    return colours.astype(layer.pixels.dtype), np.rint(depths)


def cut(image: tuple[np.ndarray, np.ndarray], canvas: Patch, patch: Patch) -> tuple[np.ndarray, np.ndarray]:
    return on_canvas(DepthLayer(canvas, *image), patch)


def draw_canvas(data: st.DataObject) -> tuple[Patch, np.random.Generator, np.dtype[Any]]:
    width = data.draw(st.sampled_from(WIDTHS))
    height = data.draw(st.integers(1, 20 if width < 100 else 3))
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32)))
    return Patch(width, 0, width * height, Rect(0, 0, width, height)), rng, data.draw(st.sampled_from(DTYPES))


@settings(max_examples=150, deadline=None)
@given(st.data(), st.sampled_from([1, 3]))
def test_many_layers_equal_plain_numpy(data: st.DataObject, threads: int) -> None:
    canvas, rng, dtype = draw_canvas(data)
    here = patches(canvas.rect.width, canvas.rect.height)
    layers = [random_layer(rng, data.draw(here), dtype) for _ in range(data.draw(st.integers(0, 5)))]
    patch = data.draw(here)
    out, depths = np.full((patch.count, 4), 7, dtype), np.full(patch.count, 7, np.float32)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(job, "PIXELS_A_THREAD", 1)
        nearest_layers(layers, patch, out, depths, threads=threads)
    colours, wanted = cut(plainly(layers, canvas, dtype), canvas, patch)
    assert np.array_equal(out, colours)
    assert np.array_equal(depths, wanted)


@settings(max_examples=150, deadline=None)
@given(st.data(), st.booleans())
def test_two_images_equal_plain_numpy(data: st.DataObject, before: bool) -> None:
    canvas, rng, dtype = draw_canvas(data)
    here = patches(canvas.rect.width, canvas.rect.height)
    target, source = (random_layer(rng, data.draw(here), dtype) for _ in range(2))
    source.pixels.setflags(write=False)
    both = [source, target] if before else [target, source]
    colours, depths = cut(plainly(both, canvas, dtype), canvas, target.patch)
    put_nearest(target, source, before=before)
    assert np.array_equal(target.pixels, colours)
    assert np.array_equal(target.depths, depths)


def test_of_equal_depths_the_first_wins() -> None:
    layers = [DepthLayer(line(40), np.full((40, 4), k, np.uint8), np.ones(40, np.float32)) for k in (1, 2, 3)]
    out, depths = np.zeros((40, 4), np.uint8), np.zeros(40, np.float32)
    nearest_layers(layers, line(40), out, depths)
    assert np.all(out == 1)
    put_nearest(layers[1], layers[2], before=False)
    assert np.all(layers[1].pixels == 2)
    put_nearest(layers[1], layers[0], before=True)
    assert np.all(layers[1].pixels == 1)


@pytest.mark.parametrize(
    ("depths", "text"),
    [
        (np.zeros(9, np.float32), "not the depths of these pixels"),
        (np.zeros(10, np.float64), "not the depths of these pixels"),
        (np.zeros(20, np.float32)[::2], "not the depths of these pixels"),
    ],
)
def test_depths_that_do_not_fit_are_refused(depths: np.ndarray, text: str) -> None:
    good = DepthLayer(line(10), np.zeros((10, 4), np.uint8), np.zeros(10, np.float32))
    with pytest.raises(InputError, match=text):
        put_nearest(good, DepthLayer(line(10), good.pixels, depths), before=True)


def test_targets_that_cannot_be_written_and_other_types_are_refused() -> None:
    good = DepthLayer(line(10), np.zeros((10, 4), np.uint8), np.zeros(10, np.float32))
    halves = DepthLayer(line(10), np.zeros((10, 4), np.float16), np.zeros(10, np.float32))
    with pytest.raises(InputError, match="images differ in pixel type"):
        put_nearest(good, halves, before=True)
    good.depths.setflags(write=False)
    with pytest.raises(InputError, match="read-only"):
        put_nearest(good, halves, before=True)
