"""What draws: OpenGL on a GPU or where it is asked for, else the processor."""

from __future__ import annotations

from typing import Any

import pytest

from clusterviz.cli.arguments import parse_device
from clusterviz.errors import DeviceError, InputError
from clusterviz.gl import devices
from clusterviz.gl.devices import prefers_cpu

ASKED = {"CLUSTERVIZ_EGL_DEVICE": "0"}


@pytest.mark.parametrize(
    ("gpu", "device", "environment", "processor"),
    [
        (False, None, {}, True),
        (False, None, ASKED, False),
        (False, 0, {}, False),
        (False, "cpu", ASKED, True),
        (True, None, {}, False),
        (True, "cpu", {}, True),
    ],
)
def test_the_processor_draws_where_there_is_no_gpu_or_it_is_asked_for(
    gpu: bool, device: Any, environment: dict[str, str], processor: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(devices, "has_gpu", lambda: gpu)
    assert prefers_cpu(device, environment) is processor


def test_no_egl_is_no_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> None:
        raise DeviceError("there is no EGL library")

    monkeypatch.setattr(devices, "egl_devices", fail)
    assert not devices.has_gpu()


def test_devices_are_named_by_index_or_cpu() -> None:
    assert [parse_device(text) for text in (None, "cpu", "0", "12")] == [None, "cpu", 0, 12]
    for wrong in ("gpu", "-1", "", "1.5"):
        with pytest.raises(InputError, match="not a device"):
            parse_device(wrong)
