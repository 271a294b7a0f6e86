"""Pictures read back from OpenGL: the same in every format, whole or packed, for the bytes of what they show."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import moderngl
import numpy as np
import pytest
from render.scenes import FAINT, SHAPE, camera_at, noise, pieces_of, prepare, scene_of

from clusterviz.cli.instrumentation import summary
from clusterviz.comm import LoopbackChannel
from clusterviz.composite.rounding import rounded
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid
from clusterviz.frame import render_frame
from clusterviz.frame.run import Options
from clusterviz.gl.device import Counts, Device
from clusterviz.image.partial import PartialImage, Rect
from clusterviz.render import opengl
from clusterviz.render.opengl import opengl_caster
from clusterviz.render.packed_picture import HEAD_BYTES, LEAST_SQUARES, MARGIN, PictureReader, square_dtype

pytestmark = pytest.mark.gl

WAYS = pytest.mark.parametrize("is_mapped", [True, False], ids=["mapped", "read"])
TIES = np.array([0.5, 1.5, 127.5, 254.5], np.float32) / 255
EDGES = [0.0, -0.0, -1.0, 1e-45, 2.0**-25, 2.0**-24, 3 * 2.0**-25, 2.0**-14, 1.0, 65519.0, 65520.0, np.inf]
SHOWN = np.uint32([1, 2, 3, 4]).view(np.float32)
"""Bits of denormal numbers, which arithmetic may flush to zero."""


@pytest.fixture
def made(context: moderngl.Context) -> Iterator[Any]:
    """`made(is_mapped, packs)`: a reader, released after the test."""
    readers = []

    def make(is_mapped: bool, packs: bool = True) -> PictureReader:
        readers.append(PictureReader(Device(context, is_mapped), packs))
        return readers[-1]

    yield make
    for reader in readers:
        reader.release()


def read(reader: PictureReader, rgba: np.ndarray, pixel: str = "float32") -> tuple[np.ndarray, Counts]:
    """A picture that went to the device and came back as the only one of a frame, and the calls that it took."""
    buffer = reader.device.context.buffer(rgba.tobytes())
    before = replace(reader.device.counts)
    reader.next_frame(pixel)
    found, _ = reader.begin(buffer, Rect(0, 0, rgba.shape[1], rgba.shape[0])).finish()
    buffer.release()
    return found, reader.device.counts.since(before)


def values() -> np.ndarray:
    """Numbers where rounding is decided, and many others: float32 (h, w, 4), its sides no multiples of a square's."""
    near = [np.nextafter(TIES, np.float32(to)) for to in (0, 1)]
    drawn = np.random.default_rng(1).integers(0, 0x3F800001, 4 * 61 * 43, np.uint32).view(np.float32)
    drawn[: drawn.size // 2] = np.random.default_rng(2).random(drawn.size // 2, np.float32)
    edges = np.concatenate([TIES, *near, np.float32(EDGES)])
    drawn[: edges.size] = edges
    return drawn.reshape(61, 43, 4)


@WAYS
@pytest.mark.parametrize("pixel", ["float32", "float16", "uint8"])
def test_a_packed_picture_has_the_bits_that_the_host_rounds_to(made: Any, is_mapped: bool, pixel: str) -> None:
    rgba, reader = values(), made(is_mapped)
    expected = rounded(PartialImage(Rect(0, 0, 43, 61), rgba), pixel).rgba
    for _ in range(3):
        found, counts = read(reader, rgba, pixel)
        assert found.dtype == pixel
        assert not found.flags.writeable
        assert found.tobytes() == expected.tobytes()
    assert (counts.waits, counts.made, counts.dispatches) == (1, 0, 1)


@pytest.mark.cover
@WAYS
@pytest.mark.parametrize(("pixel", "size"), [("float32", 16), ("float16", 8), ("uint8", 4)])
def test_only_covered_squares_are_read(made: Any, is_mapped: bool, pixel: str, size: int) -> None:
    rgba, reader = np.zeros((480, 640, 4), np.float32), made(is_mapped)
    rgba[100:204, 200:352] = 0.5  # 13 or 14 × 19 squares: 5.5 %
    covered = 14 * 19
    for frame in range(3):
        found, counts = read(reader, rgba, pixel)
        assert np.array_equal(found, rounded(PartialImage(Rect(0, 0, 640, 480), rgba), pixel).rgba)
        read_squares = (counts.read - HEAD_BYTES) / square_dtype(pixel).itemsize
        assert counts.waits == (2 if frame == 0 else 1)
        assert read_squares <= (covered if frame == 0 else LEAST_SQUARES + (1 + MARGIN) * covered)
    assert square_dtype(pixel).itemsize == 64 * size + 4


@WAYS
def test_any_change_of_what_is_shown_is_read(made: Any, is_mapped: bool) -> None:
    """Growing takes a second wait; full pictures are read whole; pixels are shown if any of their bits is set."""
    reader = made(is_mapped)
    waits = []
    for share in (0.1, 1.0, 1.0, 0.1, 0.0, 0.9):
        rgba = np.zeros((200, 240, 4), np.float32)
        rgba[: int(share * 200)] = SHOWN
        found, counts = read(reader, rgba)
        assert found.tobytes() == rgba.tobytes()
        waits.append(counts.waits)
    assert waits == [2, 2, 1, 1, 1, 2]


@WAYS
@pytest.mark.parametrize("packs", [True, False], ids=["packed", "whole"])
def test_pictures_stay_while_others_are_read(made: Any, is_mapped: bool, packs: bool) -> None:
    """Two pictures are on their way together, and none of three changes when the next are read."""
    reader = made(is_mapped, packs)
    pictures = [np.full((24, 24, 4), number, np.float32) for number in range(1, 5)]
    buffers = [reader.device.context.buffer(one.tobytes()) for one in pictures]
    ways, found = [reader.begin(one, Rect(0, 0, 24, 24)) for one in buffers[:2]], []
    for one in buffers[2:]:
        found.append(ways.pop(0).finish()[0])
        ways.append(reader.begin(one, Rect(0, 0, 24, 24)))
    found += [way.finish()[0] for way in ways]
    for one, expected in zip(found, pictures, strict=True):
        assert np.array_equal(one, expected)
    for buffer in buffers:
        buffer.release()


@pytest.mark.parametrize("pixel", ["float32", "float16", "uint8"])
def test_a_caster_draws_the_same_packed_or_whole(context: moderngl.Context, pixel: str) -> None:
    voxels = noise(dtype="uint8")
    prepared = prepare(scene_of(voxels, camera_at("outside", Grid(SHAPE)), opacity=FAINT), voxels, brick=7)
    drawn = []
    for packs in (False, True):
        caster = opengl_caster(context, prepared.plan, packs=packs)
        caster.load(prepared.plan, dict(prepared.shown))
        drawn.append([one for _ in range(3) for one in caster.draw(prepared.plan, pieces_of(prepared, 2), pixel=pixel)])
        caster.release()
    for whole, packed in zip(*drawn, strict=True):
        assert whole.partial.rgba.any()
        assert (whole.partial.rgba.dtype, packed.partial.rgba.dtype) == ("float32", pixel)
        assert rounded(whole.partial, pixel).rgba.tobytes() == packed.partial.rgba.tobytes()
        assert np.array_equal(whole.work, packed.work)
        assert packed.bytes_read > packed.work.nbytes


@pytest.mark.cover("coherent")
@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ({"pixel": "uint8"}, "uint8"),
        ({"pixel": "float16", "frame_coherence": True}, "float32"),  # whose opacities are looked at
        ({"blending": "maximum"}, "float32"),
    ],
    ids=["uint8", "coherent", "maximum"],
)
def test_a_frame_is_the_same_and_says_what_was_read(
    context: moderngl.Context, monkeypatch: pytest.MonkeyPatch, keys: dict[str, Any], expected: str
) -> None:
    source = ArraySource(noise(dtype="uint8"))
    scene = scene_of(noise(dtype="uint8"), camera_at("outside", source.grid), opacity=FAINT, **keys)
    images, counts = [], []
    for software in (True, False):
        monkeypatch.setattr(opengl, "is_software", lambda _, answer=software: answer)
        rendered = render_frame(scene, LoopbackChannel(), source, options=Options(device=0))
        images.append(rendered.image)
        counts.append(rendered.statistics.per_rank[0])
    assert images[0] is not None
    assert images[0].any()
    assert np.array_equal(*images)
    assert [one.readback_pixel for one in counts] == ["float32", expected]
    assert all(one.readback_bytes for one in counts)
    assert [one.choices["pictures"].split(",")[0] for one in counts] == ["whole", "packed"]
    assert counts[1].calls["dispatches"] > counts[0].calls["dispatches"] >= 1
    assert all(one.calls["waits"] and one.calls["read"] >= one.readback_bytes for one in counts)
    assert f"from GPUs, {expected}" in summary(rendered.statistics)
