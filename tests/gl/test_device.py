"""Buffers that stay on the device from draw to draw."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from clusterviz.errors import DeviceError
from clusterviz.gl import staging
from clusterviz.gl.device import COMPARED_BYTES, Device
from clusterviz.spmd.source import ShaderSource

pytestmark = pytest.mark.gl
SMALL, LARGE = np.arange(8, dtype=np.uint32), np.arange(COMPARED_BYTES, dtype=np.uint32)


@pytest.fixture(params=[True, False], ids=["mapped", "read"])
def device(context, request):
    made = Device(context, is_mapped=request.param)
    yield made
    made.release()


def _counted(device, call):
    before = replace(device.counts)
    call()
    return device.counts.since(before)


@pytest.mark.parametrize("data", [SMALL, LARGE], ids=["small", "large"])
def test_unchanged_data_are_uploaded_once(device, data):
    data = data.copy()
    data.setflags(write=False)
    first = _counted(device, lambda: device.give("d", data))
    again = _counted(device, lambda: device.give("d", data))
    assert (first.made, first.uploaded) == (1, data.nbytes)
    assert (again.made, again.uploaded) == (0, 0)


@pytest.mark.parametrize("data", [SMALL, LARGE], ids=["small", "large"])
def test_changed_data_are_uploaded_into_the_same_buffer(device, data):
    data = data.copy()
    device.give("d", data)
    data[5] = 77
    counts = _counted(device, lambda: device.give("d", data))
    assert (counts.made, counts.uploaded) == (0, data.nbytes)
    assert np.array_equal(np.frombuffer(device.read(device.give("d", data), data.nbytes), np.uint32), data)


def test_buffers_grow_and_shrunken_data_keep_them(device):
    device.give("d", SMALL)
    assert _counted(device, lambda: device.give("d", LARGE)).made == 1
    assert _counted(device, lambda: device.give("d", SMALL)).made == 0
    assert np.frombuffer(device.read(device.give("d", SMALL), SMALL.nbytes), np.uint32).tolist() == SMALL.tolist()


def test_what_a_shader_may_have_written_is_given_again(device):
    device.give("d", SMALL)
    device.reserve("d", SMALL.nbytes)
    assert _counted(device, lambda: device.give("d", SMALL)).uploaded == SMALL.nbytes


def test_a_table_is_uploaded_when_it_changes(device):
    texels = np.ones((2, 3, 4), np.float32)
    assert _counted(device, lambda: device.table("t", texels)).uploaded == texels.nbytes
    assert _counted(device, lambda: device.table("t", texels.copy())).uploaded == 0
    assert _counted(device, lambda: device.table("t", 2 * texels)).uploaded == texels.nbytes
    assert _counted(device, lambda: device.table("t", texels[:1])).made == 1


def test_only_reads_wait(device, context):
    program = device.compile(ShaderSource(Path(__file__).with_name("add_ten.glsl").read_text(), ("add_ten.glsl",)))
    buffer = device.begin("numbers", SMALL)

    def draw():
        device.clear(buffer, 8, 4)
        device.dispatch(program, (4,))
        device.dispatch(program, (2,))
        assert np.frombuffer(device.read(buffer, SMALL.nbytes), np.uint32).tolist() == [20, 20, 10, 13, 4, 5, 6, 7]

    counts = _counted(device, draw)
    assert (counts.waits, counts.dispatches, counts.read) == (1, 2, SMALL.nbytes)
    program.release()


def test_a_buffer_that_grows_keeps_its_contents_if_asked_to(device):
    device.write(device.reserve("c", SMALL.nbytes), SMALL)
    grown = device.reserve("c", 4 * SMALL.nbytes, keeps=True)
    assert np.frombuffer(device.read(grown, SMALL.nbytes), np.uint32).tolist() == SMALL.tolist()


def test_parts_of_buffers_arrive_together_with_one_wait(device):
    small, large = device.give("d", SMALL), device.give("e", LARGE)
    parts = [(small, 4, 12), (large, 8, LARGE.nbytes - 8), (small, 28, 4)]
    counts = _counted(device, lambda: [device.arrived(device.copy(parts)) for _ in range(2)])
    again = _counted(device, lambda: device.arrived(device.copy(parts)))
    found = [each.view(np.uint32).tolist() for each in device.arrived(device.copy(parts))]
    assert found == [[1, 2, 3], LARGE[2:].tolist(), [7]]
    assert (again.waits, again.made, again.read) == (1, 0, 12 + LARGE.nbytes - 8 + 4)
    assert counts.waits == 2


@pytest.mark.parametrize(("call", "answer", "message"), [("map", None, "no memory"), ("wait", 0x911D, "lost")])
def test_a_driver_that_fails_is_named(context, monkeypatch, call, answer, message):
    failing = replace(staging._functions(), **{call: lambda *_: answer})
    monkeypatch.setattr(staging, "_functions", lambda: failing)
    device = Device(context, is_mapped=True)
    with pytest.raises(DeviceError, match=message):
        device.read(device.give("d", SMALL), SMALL.nbytes)
    device.release()
