"""OpenGL that fails: in any of its calls, for want of memory, or because other code has another context current."""

from __future__ import annotations

import threading
from traceback import extract_stack
from typing import Any

import moderngl
import numpy as np
import pytest
from render.scenes import SHAPE, camera_at, noise, prepare, scene_of

from clusterviz.comm import LoopbackChannel, run_loopback
from clusterviz.data.source import Grid
from clusterviz.errors import DeviceError, RankError
from clusterviz.frame import FrameLoop, Options
from clusterviz.gl import compute
from clusterviz.gl.context import _egl, open_context
from clusterviz.render.brick_atlas import BrickPool
from clusterviz.render.content_bricks import store_as
from clusterviz.render.storage import slot_of
from clusterviz.scene import Scene, scene_of_data
from clusterviz.scene.overrides import with_settings

pytestmark = pytest.mark.gl
CALLS: dict[type, str] = {
    moderngl.Context: "buffer texture texture3d compute_shader memory_barrier copy_buffer",
    moderngl.Buffer: "write read clear bind_to_uniform_block bind_to_storage_buffer",
    moderngl.Texture: "write read use",
    moderngl.ComputeShader: "run",
}
LOSING, RANKS = 1, 3


class LossyDevice:
    """OpenGL whose device is lost on one rank, from its n-th call on; 0: never.

    `places` of calls have the number of the last call there.
    """

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.lost_at, self.calls, self._own = 0, 0, threading.local()
        self.places = dict[tuple[Any, ...], int]()
        for owner, names in CALLS.items():
            for name in names.split():
                patch.setattr(owner, name, self._counted(getattr(owner, name)))
        use, dispatch, finish = map(self._counted, compute._functions())
        patch.setattr(compute, "_functions", lambda: (use, dispatch, finish))

    def _counted(self, call: Any) -> Any:
        def counted(*args: Any, **keys: Any) -> Any:
            if getattr(self._own, "rank", None) == LOSING:
                self.calls += 1
                self.places[tuple((frame.filename, frame.lineno) for frame in extract_stack(limit=4))] = self.calls
                if 0 < self.lost_at <= self.calls:
                    raise moderngl.Error("device lost")
            return call(*args, **keys)

        return counted

    def draw(self, scene: Scene, lost_at: int = 0) -> list[Any]:
        """Return what each rank has: the picture, None, or the error."""
        self.lost_at, self.calls = lost_at, 0

        def rank(channel: LoopbackChannel) -> Any:
            self._own.rank = channel.rank
            device: Any = 0 if lost_at == 0 or channel.rank == LOSING else "cpu"  # which starts sooner
            try:
                with FrameLoop(scene, channel, None, Options(device=device, overlap=False)) as loop:
                    return loop.frame(scene, 0).image
            except Exception as error:
                return error

        return run_loopback(RANKS, rank)


def test_device_that_is_lost_in_any_call_ends_all_ranks_with_one_message(monkeypatch: pytest.MonkeyPatch) -> None:
    """At first the ranks share a device, each with a context of its own."""
    scene = scene_of_data("field:gaussian:16", ["automatic=false"])
    scene = with_settings(scene, {"clim": (0.0, 1.0), "opacity": 0.2, "size": (8, 8), "brick": 8})
    scene = with_settings(scene, {"early_termination": 0.0})
    device = LossyDevice(monkeypatch)
    picture, *others = device.draw(scene)
    assert picture.max() > 0.1
    assert others == [None] * (RANKS - 1)
    stages = set()
    for call in sorted(device.places.values()):
        errors = device.draw(scene, call)
        assert {type(error) for error in errors} == {RankError}, call
        (message,) = {str(error) for error in errors}
        assert message.startswith(f"rank {LOSING}, frame 0, "), call
        assert message.endswith("device lost"), call
        assert {error.exit_status for error in errors} == {1}
        stages.add(message.split(", ")[2].split(":")[0])
    assert stages == {"shaders", "upload", "render"}


class Card:
    """A context on a card of so many bytes."""

    def __init__(self, context: moderngl.Context, size: int) -> None:
        self._context, self._size, self._held, self._is_full = context, size, list[moderngl.Buffer](), False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._context, name)

    def buffer(self, *args: Any, **keys: Any) -> moderngl.Buffer:
        made = self._context.buffer(*args, **keys)
        self._held = [one for one in self._held if not isinstance(one.mglo, moderngl.InvalidObject)] + [made]
        self._is_full = sum(one.size for one in self._held) > self._size
        return made

    @property
    def error(self) -> str:
        """What glGetError gives, once."""
        was_full, self._is_full = self._is_full, False
        return "GL_OUT_OF_MEMORY" if was_full else "GL_NO_ERROR"


def test_bricks_that_do_not_fit_twice_are_drawn_in_parts_and_then_refused(context: moderngl.Context) -> None:
    voxels = noise()
    prepared = prepare(scene_of(voxels, camera_at("outside", Grid(SHAPE))), voxels, brick=8)
    slot, bricks = slot_of(prepared.plan), sorted(prepared.shown)
    card: Any = Card(context, int(2.2 * len(bricks) / 3 * slot.bytes))
    pool = BrickPool(card, slot, len(bricks))

    def put(some: list[Any]) -> None:
        pool.put({index: prepared.bricks[index] for index in some}, store_as(prepared.plan, slot))

    third = len(bricks) // 3
    put(bricks[:third])
    put(bricks[third : 2 * third])
    parts = list(pool.parts(prepared.plan, np.array(bricks[: 2 * third])))
    assert len(parts) > 1, "to grow would have taken three thirds"
    assert sorted(tuple(index) for _, part in parts for index in part.tolist()) == bricks[: 2 * third]
    with pytest.raises(DeviceError, match=r"no memory for \d+ more bricks; needed \d+ bytes.*cluster.memory_limit"):
        put(bricks[2 * third :])
    pool.release()


def test_context_that_other_code_makes_current_is_kept_and_changes_nothing() -> None:
    scene = with_settings(scene_of_data("field:gaussian:16", ["automatic=false"]), {"size": (12, 10), "brick": 8})
    scene = with_settings(scene, {"clim": (0.0, 1.0), "opacity": 0.2})
    with FrameLoop(scene, LoopbackChannel(), None, Options(device=0)) as loop:
        expected = loop.frame(scene, 0).image
    with open_context() as other:
        theirs = _egl().eglGetCurrentContext()
        mark = other.buffer(b"theirs")
        with FrameLoop(scene, LoopbackChannel(), None, Options(device=0)) as loop:
            for number in range(2):
                found = loop.frame(scene, number).image
                assert _egl().eglGetCurrentContext() == theirs
                assert np.array_equal(found, expected)
                assert mark.read() == b"theirs"
        assert _egl().eglGetCurrentContext() == theirs
        assert mark.read() == b"theirs"
