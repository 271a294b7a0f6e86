"""Kernels: one text on CPU vectors and on OpenGL, arguments of all types, and every mistake as one message."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jobs.kernels import smooth

from clusterviz import jobs
from clusterviz.gl import devices
from clusterviz.gl.context import open_context
from clusterviz.gl.devices import EglDevice
from clusterviz.jobs import device
from clusterviz.jobs.device import devices_of, on_device

DEVICES = ["cpu", pytest.param(0, marks=pytest.mark.gl)]


def smoothed(src: np.ndarray, weight: float) -> np.ndarray:
    """float64 (z, y, x): what `smooth` finds."""
    p = np.pad(src.astype(np.float64), 1, mode="edge")
    pairs = [np.roll(p, 1, axis) + np.roll(p, -1, axis) for axis in range(3)]
    mean: np.ndarray = sum(pairs)[1:-1, 1:-1, 1:-1] / 6
    return src * (1 - weight) + mean * weight


def kernel_of(folder: Path, text: str, function: Any, **options: Any) -> jobs.Kernel:
    """Return a kernel of a text."""
    (folder / "own.glsl").write_text(text)
    return jobs.kernel(folder / "own.glsl", **options)(function)


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("shape", [(1, 1, 1), (3, 5, 7), (1, 1, 300), (19, 1, 33)])
def test_a_kernel_is_run_once_for_each_point(device: Any, shape: tuple[int, int, int]) -> None:
    src = np.random.default_rng(1).random(shape, np.float32)
    dst = np.full(shape, np.nan, np.float32)
    with on_device(devices_of([device])[0]):
        smooth[shape](src, dst, 1)
    np.testing.assert_allclose(dst, smoothed(src, 1.0), atol=2e-7)


TYPES = """void kernel(ivec3 at) {
    doubles_set(at, doubles_at(at) + double(number) + 0.5LF);
    words_set(at, words_at(at) + uint(whole.y));
    vectors_set(at, vectors_flat(vectors_index(at)).wzyx * number + offset.xyzx);
    ints_set(at, ints_at(at) - ints_size().x);
}"""


@pytest.mark.parametrize("device", DEVICES)
def test_arguments_are_of_these_types(device: Any, tmp_path: Path) -> None:
    def types(doubles: Any, words: Any, vectors: Any, ints: Any, number: float, whole: Any, offset: Any) -> None: ...

    kernel = kernel_of(tmp_path, TYPES, types, writes=("doubles", "words", "vectors", "ints"), vectors=("vectors",))
    doubles, words = np.arange(10.0), np.arange(10, dtype=np.uint32)
    vectors, ints = np.ones((1, 10, 4), np.float32) * [1, 2, 3, 4], np.zeros((10, 20), np.int32)[:, ::2][0]
    vectors = vectors.astype(np.float32)
    with on_device(devices_of([device])[0]):
        kernel[10](doubles, words, vectors, ints, 2, (7, 8), (0.5, 0.25, 0.125))
    assert doubles.tolist() == [n + 2.5 for n in range(10)]
    assert words.tolist() == [n + 8 for n in range(10)]
    assert vectors[0, 9].tolist() == [8.5, 6.25, 4.125, 2.5]
    assert ints.tolist() == [-10] * 10


@pytest.mark.parametrize("device", DEVICES)
def test_a_write_outside_of_an_array_is_an_error(device: Any) -> None:
    src, dst = np.zeros((2, 3, 4), np.float32), np.zeros((2, 3, 4), np.float32)
    found = r"found 1 writes outside, one at \(z, y, x\) = \(0, 0, 4\); allowed below \(2, 3, 4\)"
    text = f"kernel smooth: wrote outside of the array dst; {found}"
    with on_device(devices_of([device])[0]), pytest.raises(jobs.KernelError, match=text):
        smooth[5](src, dst, 0.5)


@pytest.mark.gl
def test_another_context_of_the_thread_stays_current() -> None:
    other = open_context()
    before = other.buffer(b"1234")
    with on_device(devices_of([0])[0]):
        smooth[1](np.zeros(1, np.float32), np.zeros(1, np.float32), 0.5)
    assert before.read() == b"1234"


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("void kernel(ivec3 at) {\n    dst_set(at, 1.0)\n}", r"own.glsl:[23]"),
        ("void kernel(ivec3 at) {\n    dst_set(at, nothing);\n}", r"own.glsl:2.*nothing"),
        ("void kern(ivec3 at) {}", "no main function"),
    ],
)
def test_a_mistake_in_a_kernel_is_named_with_its_line(device: Any, text: str, said: str, tmp_path: Path) -> None:
    def wrong(dst: Any) -> None: ...

    kernel = kernel_of(tmp_path, text, wrong, writes=("dst",))
    with on_device(devices_of([device])[0]), pytest.raises(jobs.KernelError, match=rf"(?s)kernel wrong.*{said}"):
        kernel[3](np.zeros(3, np.float32))


ARRAY = np.zeros((2, 3, 4), np.float32)


@pytest.mark.parametrize(
    ("arguments", "grid", "said"),
    [
        ((ARRAY, ARRAY.copy()), 1, "wrong number of arguments; found 2; allowed 3"),
        ((ARRAY, ARRAY[:1], 1.0), 1, "dst is written, and shares memory with src"),
        ((ARRAY.astype(np.int8), ARRAY, 1.0), 1, "src has elements of a wrong type; found int8"),
        ((ARRAY, 3.0, 1.0), 1, "dst is no array"),
        ((ARRAY[None], ARRAY, 1.0), 1, "src has a wrong number of axes"),
        ((ARRAY, ARRAY.copy(), "much"), 1, "weight is of a wrong type"),
        ((ARRAY, ARRAY.copy(), 1.0), (1, -1), "wrong grid"),
    ],
)
def test_wrong_arguments_are_refused(arguments: Any, grid: Any, said: str) -> None:
    with pytest.raises(jobs.KernelError, match=said):
        smooth[grid](*arguments)


def test_wrong_declarations_are_refused() -> None:
    def nothing(dst: Any) -> None: ...

    for file, options, said in (
        ("missing.glsl", {"writes": ("dst",)}, "the file is missing; found missing.glsl"),
        ("smooth.glsl", {"writes": ("out",)}, "no such parameter; found out"),
        ("smooth.glsl", {}, "writes no array"),
    ):
        with pytest.raises(jobs.KernelError, match=said):
            jobs.kernel(file, **options)(nothing)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("asked", "ranks", "chosen"), [(None, 1, [0, 2]), (None, 2, [2]), (["cpu", 1, "cpu"], 1, [None, 1, None])]
)
def test_a_single_rank_has_all_gpus(asked: Any, ranks: int, chosen: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CLUSTERVIZ_EGL_DEVICE", raising=False)
    listed = tuple(EglDevice(n, software=n == 1) for n in range(3))
    for module in (device, devices):
        monkeypatch.setattr(module, "egl_devices", lambda: listed)
    assert [each.egl for each in devices_of(asked, 1 if ranks > 1 else 0, ranks)] == chosen
