"""Buffers that stay on the device from draw to draw."""

from dataclasses import replace

import numpy as np
import pytest

from clusterviz.gl.device import COMPARED_BYTES, Device

pytestmark = pytest.mark.gl
SMALL, LARGE = np.arange(8, dtype=np.uint32), np.arange(COMPARED_BYTES, dtype=np.uint32)


@pytest.fixture
def device(context):
    made = Device(context)
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
    first = _counted(device, lambda: device.give(3, data))
    again = _counted(device, lambda: device.give(3, data))
    assert (first.made, first.uploaded) == (1, data.nbytes)
    assert (again.made, again.uploaded) == (0, 0)


@pytest.mark.parametrize("data", [SMALL, LARGE], ids=["small", "large"])
def test_changed_data_are_uploaded_into_the_same_buffer(device, data):
    data = data.copy()
    device.give(3, data)
    data[5] = 77
    counts = _counted(device, lambda: device.give(3, data))
    assert (counts.made, counts.uploaded) == (0, data.nbytes)
    assert np.array_equal(np.frombuffer(device.read(device.give(3, data), data.nbytes), np.uint32), data)


def test_buffers_grow_and_shrunken_data_keep_them(device):
    device.give(3, SMALL)
    assert _counted(device, lambda: device.give(3, LARGE)).made == 1
    assert _counted(device, lambda: device.give(3, SMALL)).made == 0
    assert np.frombuffer(device.read(device.give(3, SMALL), SMALL.nbytes), np.uint32).tolist() == SMALL.tolist()


def test_what_a_shader_may_have_written_is_given_again(device):
    device.give(3, SMALL)
    device.reserve(3, SMALL.nbytes)
    assert _counted(device, lambda: device.give(3, SMALL)).uploaded == SMALL.nbytes


def test_a_table_is_uploaded_when_it_changes(device):
    texels = np.ones((2, 3, 4), np.float32)
    assert _counted(device, lambda: device.table(1, texels)).uploaded == texels.nbytes
    assert _counted(device, lambda: device.table(1, texels.copy())).uploaded == 0
    assert _counted(device, lambda: device.table(1, 2 * texels)).uploaded == texels.nbytes
    assert _counted(device, lambda: device.table(1, texels[:1])).made == 1


def test_only_the_first_read_behind_a_dispatch_waits(device, context):
    text = "#version 430\nlayout(local_size_x = 1) in;\nlayout(std430, binding = 2) buffer B { uint n[]; };\n"
    program = context.compute_shader(text + "void main() { n[gl_WorkGroupID.x] += 10u; }")
    buffer = device.begin(2, SMALL)
    device.clear(buffer, 8, 4)
    before = replace(device.counts)
    device.dispatch(program, (4,))
    device.dispatch(program, (2,))
    found = np.frombuffer(device.read(buffer, SMALL.nbytes), np.uint32)
    device.read(buffer, 8)
    assert found.tolist() == [20, 20, 10, 13, 4, 5, 6, 7]
    counts = device.counts.since(before)
    assert (counts.waits, counts.dispatches, counts.read, counts.made) == (1, 2, SMALL.nbytes + 8, 0)
    program.release()


def test_a_buffer_that_grows_keeps_its_contents_if_asked_to(device):
    device.write(device.reserve(2, SMALL.nbytes), SMALL)
    grown = device.reserve(2, 4 * SMALL.nbytes, keeps=True)
    assert np.frombuffer(device.read(grown, SMALL.nbytes), np.uint32).tolist() == SMALL.tolist()
