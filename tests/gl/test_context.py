from __future__ import annotations

from types import SimpleNamespace

import moderngl
import pytest

from clusterviz.errors import DeviceError, InputError
from clusterviz.gl import context as context_module
from clusterviz.gl.context import open_context
from clusterviz.gl.devices import EglDevice


@pytest.fixture
def two_devices(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Two EGL devices whose contexts nobody makes; the list receives the device indices that were asked for."""
    asked: list[int] = []

    def create(*, device_index: int, **_: object) -> SimpleNamespace:
        asked.append(device_index)
        return SimpleNamespace()

    monkeypatch.delenv("CLUSTERVIZ_EGL_DEVICE", raising=False)
    monkeypatch.setattr(context_module, "egl_devices", lambda: (EglDevice(0, False), EglDevice(1, False)))
    monkeypatch.setattr(moderngl, "create_context", create)
    return asked


def test_ranks_are_dealt_to_devices_in_turn(two_devices: list[int]) -> None:
    for local_rank in range(3):
        open_context(local_rank)
    assert two_devices == [0, 1, 0]


def test_device_that_is_asked_for_is_taken(two_devices: list[int]) -> None:
    open_context(0, 1)
    assert two_devices == [1]


def test_device_that_does_not_exist_is_bad_input(two_devices: list[int]) -> None:
    with pytest.raises(InputError, match="no such EGL device"):
        open_context(0, 5)


def test_no_egl_library_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("clusterviz.gl.devices.find_library", lambda name: None)
    with pytest.raises(DeviceError, match=r"no EGL library.*apt-get install libegl1"):
        open_context()


def test_driver_that_gives_no_context_says_why_and_what_to_install(
    two_devices: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(**_: object) -> None:
        raise Exception("eglInitialize failed (0x3001)")

    monkeypatch.setattr(moderngl, "create_context", refuse)
    with pytest.raises(DeviceError, match=r"eglInitialize failed.*apt-get install libegl1"):
        open_context()


def test_driver_that_is_too_old_is_named(two_devices: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    info = {"GL_RENDERER": "pretended", "GL_VERSION": "3.3 (Core Profile)"}

    def create(*, require: int, **_: object) -> SimpleNamespace:
        if require > 330:
            raise Exception("eglCreateContext failed (0x3009)")
        return SimpleNamespace(info=info, release=lambda: None)

    monkeypatch.setattr(moderngl, "create_context", create)
    with pytest.raises(DeviceError, match=r"pretended has 3.3 \(Core Profile\); allowed 4.3 and later"):
        open_context()


@pytest.mark.gl
def test_real_context_has_compute_shaders(context: moderngl.Context) -> None:
    assert context.version_code >= 430
