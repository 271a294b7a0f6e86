from __future__ import annotations

import pytest

from clusterviz.errors import DeviceError, InputError
from clusterviz.gl.devices import ENVIRONMENT, EglDevice, choose_device, egl_devices

SOFTWARE = EglDevice(0, software=True)
MIXED = (SOFTWARE, EglDevice(1, software=False), EglDevice(2, software=False))


def test_hardware_is_dealt_in_turn_and_software_is_left_out() -> None:
    assert [choose_device(MIXED, rank, environment={}) for rank in range(5)] == [1, 2, 1, 2, 1]


def test_software_alone_serves_every_rank() -> None:
    assert [choose_device((SOFTWARE,), rank, environment={}) for rank in range(3)] == [0, 0, 0]


def test_option_goes_before_environment_and_environment_before_the_deal() -> None:
    assert choose_device(MIXED, 0, 2, {ENVIRONMENT: "0"}) == 2
    assert choose_device(MIXED, 0, None, {ENVIRONMENT: " 0 "}) == 0
    assert choose_device(MIXED, 0, None, {ENVIRONMENT: ""}) == 1


def test_no_device_names_the_packages() -> None:
    with pytest.raises(DeviceError, match="libegl1"):
        choose_device((), 0, environment={})


@pytest.mark.parametrize("text", ["3", "-1", "first", "1.5"])
def test_override_that_names_no_device_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=ENVIRONMENT):
        choose_device(MIXED, 0, environment={ENVIRONMENT: text})


def test_override_by_option_that_names_no_device_says_which_exist() -> None:
    with pytest.raises(InputError, match="allowed 0 to 2"):
        choose_device(MIXED, 0, 3, {})


def test_label_tells_devices_apart() -> None:
    gpu = EglDevice(1, False, "/dev/dri/renderD128", 3, "Some GPU", "Some Vendor")
    assert gpu.label == "hardware, Some GPU, /dev/dri/renderD128, CUDA 3"
    assert SOFTWARE.label == "software"


@pytest.mark.gl
def test_devices_are_listed_in_the_order_of_their_indices() -> None:
    devices = egl_devices()
    assert devices
    assert [device.index for device in devices] == list(range(len(devices)))


@pytest.mark.gl
def test_software_flag_agrees_with_the_renderer_of_a_context() -> None:
    moderngl = pytest.importorskip("moderngl")
    for device in egl_devices():
        if device.software:
            context = moderngl.create_context(standalone=True, backend="egl", device_index=device.index)
            renderer = context.info["GL_RENDERER"]
            context.release()
            assert "llvmpipe" in renderer or "softpipe" in renderer


def test_no_egl_library_is_one_clear_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("clusterviz.gl.devices.find_library", lambda name: None)
    with pytest.raises(DeviceError, match="libegl1"):
        egl_devices()
