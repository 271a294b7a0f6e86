"""Frame coherence: the same pictures on any number of ranks, and no reuse of hits that no longer hold.

The bound is that of pictures on other numbers of ranks, 1e-5: nothing in these scenes is thinner than a pixel.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from frame.views import DEVICES, check_same, move_at_random, moving, on_ranks, pixels, so_far, turning

from clusterviz.frame import Rendered
from clusterviz.gl.devices import Device
from clusterviz.image import compare
from clusterviz.render import frame_coherence
from clusterviz.scene import Scene, scene_of_data
from clusterviz.scene.overrides import with_settings

BOUND = 1e-5
CLEAR = ((0.0, 0.0), (0.4, 0.0), (0.7, 0.3), (1.0, 0.9))


def scene_of(frame_coherence: bool = True, **keys: Any) -> Scene:
    scene = scene_of_data("field:gaussian:33", ["volumes.0.clim=[0,1]", "image.size=[60,50]", "camera.view_angle=30"])
    scene = with_settings(scene, {"opacity": CLEAR, "step": 0.5, "brick": 9, "position": (5.0, 3.0, 2.0)})
    return with_settings(
        scene, {"focal_point": (0.0, 0.0, 0.0), "view_up": (0.0, 0.0, 1.0), "frame_coherence": frame_coherence, **keys}
    )


@pytest.fixture(params=DEVICES)
def device(request: pytest.FixtureRequest) -> Device:
    found: Device = request.param
    return found


def draw(scenes: Sequence[Scene], device: Device = "cpu", ranks: int = 1) -> list[Rendered]:
    return on_ranks(ranks, scenes, device=device)


def without(scenes: Sequence[Scene], device: Device = "cpu") -> list[Rendered]:
    """The same frames, all rays from where they enter the volume, on one rank."""
    return draw([with_settings(scene, {"frame_coherence": False}) for scene in scenes], device)


def rays(frame: Rendered, name: str) -> int:
    return sum(getattr(rank.frame_coherence, name) for rank in frame.statistics.per_rank if rank.frame_coherence)


def samples(frame: Rendered) -> int:
    return sum(rank.samples for rank in frame.statistics.per_rank)


def check(frames: Sequence[Rendered], expected: Sequence[Rendered], bound: float = BOUND) -> None:
    assert all(pixels(plain).max() > 0.3 for plain in expected)
    check_same(frames, expected, bound)


def wires(tmp_path: Path, **keys: Any) -> dict[str, Any]:
    """A volume of helices that cross, as those of a stent: beads thinner than a voxel, and than a pixel."""
    size = 48
    volume = np.zeros((size, size, size), np.float32)
    turn = np.linspace(0.0, 1.0, 2 * size)
    for strand in range(4):
        for way in (-1, 1):
            angle = 2 * np.pi * (2 * way * turn + strand / 4)
            places = [0.1 + 0.8 * turn, 0.5 + 0.3 * np.sin(angle), 0.5 + 0.3 * np.cos(angle)]
            volume[tuple((size * at).astype(int) for at in places)] = 1.0
    np.save(tmp_path / "wires.npy", volume)
    spacing = 2.0 / (size - 1)
    thin = {"opacity": ((0.0, 0.0), (0.8, 0.0), (0.9, 0.6), (1.0, 0.9)), **keys}
    return {"path": str(tmp_path / "wires.npy"), "spacing": (spacing,) * 3, "origin": (-1.0,) * 3} | thin


LOOKS: dict[str, dict[str, Any]] = {
    "samples": {},
    "pre-integrated, jittered, lit": {"classification": "pre-integrated", "jitter": True, "shade": True},
    "a surface": {"blending": "isosurface", "isosurfaces": ((0.5, 1.0),), "shade": True},
    "translucent surfaces": {"blending": "isosurface", "isosurfaces": ((0.5, 0.4), (0.8, 0.6))},
    "surfaces in a volume": {"isosurfaces": ((0.5, 0.4),)},
    "two volumes": {},
}
OPENGL_LOOKS = {look: keys for look, keys in LOOKS.items() if look != "pre-integrated, jittered, lit"} | {
    "pre-integrated, jittered": {"classification": "pre-integrated", "jitter": True},
    "slabs that are cut": {"classification": "pre-integrated", "borders": "split", "jitter": True},
    "texture unit, layers of bricks": {"filter": "hardware", "early_termination": 0.02},
    "two volumes, one with surfaces": {"isosurfaces": ((0.5, 0.4),)},
}
"""Light is that of the surface: it takes long to compile."""


@pytest.mark.cover("two volumes, one with surfaces-1-0")
@pytest.mark.parametrize(
    ("look", "ranks", "device"),
    [
        *((look, ranks, "cpu") for look in LOOKS for ranks in (1, 3, 5)),
        *(pytest.param(look, 1, 0, marks=pytest.mark.gl) for look in OPENGL_LOOKS),
        *(pytest.param("samples", ranks, 0, marks=pytest.mark.gl) for ranks in (3, 5)),
    ],
)
def test_pictures_are_those_without_on_any_number_of_ranks(look: str, ranks: int, device: Device) -> None:
    scene = with_settings(scene_of(), (LOOKS | OPENGL_LOOKS)[look])
    if look.startswith("two volumes"):
        keys = {"path": "field:marschner-lobb:20", "interpolation": "nearest"}
        other = scene.volumes[0].model_copy(update=keys | {"isosurfaces": ()})
        scene = scene.model_copy(update={"volumes": (*scene.volumes, other)})
    scenes = turning(scene)
    frames = draw(scenes, device, ranks)
    plain = without(scenes, device)
    check(frames, plain, 0.0 if ranks == 1 else BOUND)
    assert rays(frames[0], "estimated") == rays(frames[0], "left_out") == 0
    assert samples(frames[0]) == samples(plain[0])
    for found, expected in zip(frames[1:], plain[1:], strict=True):
        assert rays(found, "estimated") > 0
        assert rays(found, "left_out") > 0
        assert samples(found) < samples(expected)


def test_corners_of_voxels_between_the_pixels_are_all_that_is_missed(device: Device) -> None:
    """Voxels that stand for themselves, clipped, by rays that end: corners at the rim are thinner than a pixel."""
    planes = [((0.1, 0.0, 0.0), (-1.0, -0.3, 0.1))]
    scenes = turning(scene_of(interpolation="nearest", early_termination=1e-6, planes=planes), frames=4)
    frames = draw(scenes, device)
    for frame, scene in zip(frames[1:], scenes[1:], strict=True):
        (alone,) = draw([scene], device)
        found = compare(pixels(frame), pixels(alone), BOUND)
        assert found.count <= 2
        assert found.max < 0.02
        assert rays(frame, "estimated") > 0


def test_nothing_is_kept_that_does_not_hold(device: Device) -> None:
    """A jump, another transfer function, another step, a light, the other projection: each time rays start anew."""
    first = scene_of()
    changes: list[dict[str, Any]] = [
        {"position": (-5.0, 3.0, 2.0)},
        {"position": (-5.0, 3.0, 2.0), "opacity": ((0.0, 0.0), (0.1, 0.0), (0.4, 0.4), (1.0, 0.1))},
        {"position": (-5.0, 3.0, 2.0), "step": 0.7},
        {"position": (-5.0, 3.0, 2.0), "parallel_scale": 1.0},
        {"position": (0.1, 0.2, 0.1)},
        {},
    ]
    scenes = [first, *(with_settings(first, change) for change in changes)]
    frames = draw([one for scene in scenes for one in (scene, scene)], device)
    check(frames[::2], without(scenes, device))
    inside = 5
    for number, (frame, again) in enumerate(zip(frames[::2], frames[1::2], strict=True)):
        assert rays(frame, "estimated") == rays(frame, "left_out") == 0, number
        assert (rays(again, "estimated") > 0) == (number != inside), number


def test_without_it_frames_are_those_of_single_pictures_bit_for_bit() -> None:
    scenes = turning(scene_of(frame_coherence=False), frames=2)
    frames = draw(scenes)
    for frame, scene in zip(frames, scenes, strict=True):
        (alone,) = draw([with_settings(scene, {"frame_coherence": True})])
        assert np.array_equal(pixels(frame), pixels(alone))
        assert frame.statistics.per_rank[0].frame_coherence is None


@pytest.mark.parametrize("residual", [0.0, 0.02])
def test_rays_that_start_too_late_begin_again(monkeypatch: pytest.MonkeyPatch, device: Device, residual: float) -> None:
    """As if the last frame had found nothing before the middle; rays that start amid what shows notice.

    Where rays end early, OpenGL draws bricks in layers: rays begin again in those before.
    """
    scenes = turning(scene_of(early_termination=residual), frames=2)

    def amid(views: Any, rects: Any, box: Any, alike: float, hits: Any, starts: Any) -> None:
        starts[starts > 0.0] = np.float32(np.linalg.norm(scenes[0].camera.position))

    monkeypatch.setattr(frame_coherence, "reproject", amid)
    found, plain = draw(scenes, device)[1], without(scenes, device)[1]
    dense = pixels(plain)[..., 3] > 0.1
    assert compare(pixels(found)[dense], pixels(plain)[dense], BOUND).count == 0
    assert rays(found, "late") > dense.sum() / 2
    assert rays(found, "estimated") >= rays(found, "late")


def test_rays_that_are_checked_tell_what_the_others_miss(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, device: Device
) -> None:
    """Of thin wires some are missed. Had all rays been checked, they would have told so, and missed nothing."""
    scenes = turning(with_settings(scene_of(), wires(tmp_path)), 6.0, 2)
    plain = without(scenes, device)[1]
    drawn = []
    for check in (np.ones, np.zeros):
        monkeypatch.setattr(
            frame_coherence.LastFrame, "_drawn_at_random", lambda *a, check=check: check(a[-1], np.bool_)
        )
        drawn.append(draw(scenes, device)[1])
    checked, others = drawn
    assert rays(checked, "estimated") == rays(others, "checked") == 0
    assert rays(checked, "checked") >= rays(others, "estimated") > 0
    check_same([checked], [plain], BOUND)
    missed = compare(pixels(others), pixels(plain), 1 / 255)
    report = checked.statistics.frame_coherence
    assert report is not None
    assert 1 / 255 < missed.max <= report.error + BOUND
    assert 0 < missed.count <= report.wrong <= 2 * missed.count


@pytest.mark.parametrize(
    "look", [{}, {"blending": "isosurface", "isosurfaces": ((0.85, 1.0),)}], ids=["samples", "surface"]
)
def test_no_more_rays_err_than_what_is_told(tmp_path: Path, look: dict[str, Any]) -> None:
    """Where something was missed, rays start anew: what wires there are, and rays go by, is soon all found."""
    scenes = turning(with_settings(scene_of(), wires(tmp_path, size=(96, 80), **look)), 6.0, 6)
    frames, missed = draw(scenes), []
    for frame, plain in zip(frames, without(scenes), strict=True):
        assert frame.statistics.frame_coherence is not None
        told, apart = frame.statistics.frame_coherence, np.abs(pixels(frame) - pixels(plain)).max(axis=2)
        missed.append(int((apart > 1 / 255).sum()))
        assert missed[-1] <= told.wrong_at_most
        assert (apart > told.error + BOUND).sum() <= told.beyond_at_most
        assert told.wrong_at_most <= told.estimated + told.left_out + told.checked
    assert missed[1] > 2 * missed[-1]


def test_bricks_that_move_are_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a rank shows ends at its bricks, amid what is dense; when they arrive is a matter of time."""
    scenes = moving(turning(scene_of(), frames=12))
    move_at_random(monkeypatch)
    frames = draw(scenes, ranks=3)
    for frame, plain in zip(frames, without(turning(scene_of(), frames=12)), strict=True):
        found = compare(pixels(frame), pixels(plain), BOUND)
        assert found.count <= 1
        assert found.max < 0.01
    assert so_far(frames, "bricks_received") > 10
    assert sum(rays(frame, "estimated") for frame in frames) > 0
