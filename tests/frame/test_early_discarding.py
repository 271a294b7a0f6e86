"""Early fragment discarding: pictures are those with all fragments, bit for bit, whatever the last frame was."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from frame.views import DEVICES, on_ranks, pixels, turning

from clusterviz.data.geometry import Geometry, Lines, Mesh, Points
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid
from clusterviz.frame import Rendered
from clusterviz.gl.devices import Device
from clusterviz.plan import plan
from clusterviz.plan.content import make_content
from clusterviz.plan.plan import changed_settings
from clusterviz.render import opengl
from clusterviz.render.abuffer import discarding, fills
from clusterviz.report.counts import EarlyDiscarding
from clusterviz.scene import Scene
from clusterviz.scene.overrides import with_settings

RNG = np.random.default_rng(3)
CENTRES = RNG.random((900, 1, 3)) * 9.0
SOUP = Mesh(
    "m", (CENTRES + RNG.normal(size=(900, 3, 3))).reshape(-1, 3).astype(np.float32), np.arange(2700).reshape(-1, 3)
)
PATHS = Lines("l", RNG.random((300, 3)) * 9.0, np.arange(0, 301, 3))
CLOUD = Points("p", (RNG.random((200, 3)) * 9.0))
FOG = ArraySource(RNG.random((10, 10, 10)).astype(np.float32), Grid((10, 10, 10)))
MESH: dict[str, Any] = {"meshes": [{"path": "m", "opacity": 0.6}]}
LINES: dict[str, Any] = {"lines": [{"path": "l", "radius": 0.5, "opacity": 0.9}]}
POINTS: dict[str, Any] = {"points": [{"path": "p", "radius": 0.6, "opacity": 1.0}]}
VOLUME: dict[str, Any] = {"volumes": [{"path": "a", "clim": (0, 1), "opacity": 0.3, "opacity_unit_distance": 2.0}]}
CONTENT: dict[str, tuple[dict[str, Any], Sequence[Any]]] = {
    "mesh": (MESH, [Geometry(mesh=SOUP)]),
    "volume, mesh, lines, points": (
        VOLUME | LINES | POINTS | {"meshes": [{"path": "m", "opacity": 0.95}]},
        [FOG, Geometry(mesh=SOUP), Geometry(lines=PATHS), Geometry(points=CLOUD)],
    ),
}


def scene_of(sections: dict[str, Any], **keys: Any) -> Scene:
    data = {
        "camera": {"position": (30, 26, 22), "focal_point": (4.5, 4.5, 4.5), "view_up": (0, 0, 1), "view_angle": 22},
        "image": {"size": (50, 40)},
    }
    settings = {"early_termination": 0.02, "early_discarding": 0.5, "brick": 128, **keys}
    return with_settings(Scene.model_validate(sections | data), settings)


def check(scenes: Sequence[Scene], given: Any, device: Device, ranks: int = 1, shown: float = 0.3) -> list[Rendered]:
    """Draw frames with discarding, and compare them with those without."""
    plain = on_ranks(
        ranks, [with_settings(scene, {"early_discarding": None}) for scene in scenes], given, device=device
    )
    frames = on_ranks(ranks, scenes, given, device=device)
    for number, (frame, expected) in enumerate(zip(frames, plain, strict=True)):
        assert pixels(expected)[..., 3].max() > shown
        assert np.array_equal(pixels(frame), pixels(expected)), number
        assert expected.statistics.early_discarding is None
    return frames


def counts(frame: Rendered) -> EarlyDiscarding:
    found = frame.statistics.early_discarding
    assert found is not None
    return found


@pytest.mark.cover("volume, mesh, lines, points-1-keys7-0")
@pytest.mark.parametrize(
    ("content", "ranks", "keys", "device"),
    [
        ("mesh", 1, {}, "cpu"),
        ("mesh", 3, {"brick": 64}, "cpu"),
        ("mesh", 2, {"mode": "sort-first"}, "cpu"),
        ("volume, mesh, lines, points", 1, {}, "cpu"),
        ("volume, mesh, lines, points", 3, {"brick": 4, "distribution": "interleaved"}, "cpu"),
        ("volume, mesh, lines, points", 1, {"early_termination": 0.0}, "cpu"),
        pytest.param("mesh", 1, {"brick": 64}, 0, marks=pytest.mark.gl),
        pytest.param("volume, mesh, lines, points", 1, {}, 0, marks=pytest.mark.gl),
    ],
)
def test_pictures_are_those_with_all_fragments(content: str, ranks: int, keys: dict[str, Any], device: Device) -> None:
    sections, given = CONTENT[content]
    frames = check(turning(scene_of(sections, **keys)), given, device, ranks)
    assert counts(frames[0]).pixels == counts(frames[0]).redrawn == 0
    for frame in frames[1:]:
        assert counts(frame).pixels > counts(frame).redrawn


def test_fewer_fragments_are_stored_behind_what_is_dense() -> None:
    scene = scene_of({"meshes": [{"path": "m", "opacity": 0.9}]}, size=(120, 100))
    first, *others = check(turning(scene), CONTENT["mesh"][1], "cpu")
    for frame in others:
        assert counts(frame).stored < 0.8 * counts(first).stored


def test_nothing_is_left_out_where_no_ray_ends() -> None:
    thin = {"meshes": [{"path": "m", "opacity": 0.01}]}
    for frame in check(turning(scene_of(thin)), CONTENT["mesh"][1], "cpu", shown=0.05):
        assert (counts(frame).pixels, counts(frame).redrawn) == (0, 0)


@pytest.mark.cover("opengl")
@pytest.mark.parametrize("device", DEVICES)
def test_other_frames_may_follow(device: Device) -> None:
    """A jump to the other side, into the content, another opacity, the other projection."""
    first = scene_of(MESH)
    changes: list[dict[str, Any]] = [
        {},
        {"position": (-20, -20, 5)},
        {"position": (4.5, 4.5, 4.0), "focal_point": (0, 0, 9)},
        {"position": (4.6, 4.5, 4.0), "focal_point": (0, 0, 9)},
        {"meshes.0.opacity": 0.05},
        {"meshes.0.opacity": 1.0},
        {"parallel_scale": 9.0},
        {"parallel_scale": 8.5},
    ]
    check([with_settings(first, change) for change in changes], CONTENT["mesh"][1], device)


@pytest.mark.cover("volume, mesh, lines, points-schemes3-0", "mesh-schemes0-cpu")
@pytest.mark.parametrize(
    ("content", "schemes", "device"),
    [
        ("mesh", {"fill": "fixed", "resolve": "optimised"}, "cpu"),
        ("mesh", {"fill": "pages", "resolve": "peeling"}, "cpu"),
        ("volume, mesh, lines, points", {}, "cpu"),
        pytest.param("volume, mesh, lines, points", {}, 0, marks=pytest.mark.gl),
    ],
)
def test_wrong_depths_cost_time_only(
    monkeypatch: pytest.MonkeyPatch, content: str, schemes: dict[str, Any], device: Device
) -> None:
    """Depths at random, in rectangles that are divided as they have many fragments, and bricks in several buffers."""

    def anywhere(last: Any, shown: Any, rect: Any) -> Any:
        return np.random.default_rng(1).uniform(25, 60, (rect.height, rect.width))

    def with_schemes(*given: Any) -> Any:
        found, cost = make_content(*given)
        return replace(found, **schemes), cost

    monkeypatch.setattr(plan, "make_content", with_schemes)
    monkeypatch.setattr(discarding, "move_ends", anywhere)
    monkeypatch.setattr(fills, "MOST_BYTES", 60_000)
    monkeypatch.setattr(opengl, "capacity", lambda *given: 2)
    sections, given = CONTENT[content]
    frames = check(turning(scene_of(sections, brick=5 if "volume" in content else 128), frames=2), given, device)
    assert counts(frames[1]).redrawn > 300
    assert counts(frames[1]).pixels > 20


@pytest.mark.parametrize("device", DEVICES)
def test_rays_end_at_fragments(device: Device) -> None:
    """Of four layers of opacity 0.5, the second leaves less than a third."""
    z = np.repeat([1.0, 2.0, 3.0, 4.0], 4)
    corners = np.stack([np.tile([0, 9, 9, 0], 4), np.tile([0, 0, 9, 9], 4), z], axis=1).astype(np.float32)
    faces = np.concatenate([[[a, a + 1, a + 2], [a, a + 2, a + 3]] for a in range(0, 16, 4)])
    scene = scene_of({"meshes": [{"path": "m", "opacity": 0.5}]}, early_termination=0.3, early_discarding=None)
    (frame,) = on_ranks(1, [scene], Geometry(mesh=Mesh("m", corners, faces)), device=device)
    assert pixels(frame)[20, 25, 3] == 0.75


def test_a_scene_without_what_ends_rays_tells_so() -> None:
    grids = MESH | {"grids": [{"path": "g"}]}
    for sections, keys in (({}, {}), (MESH, {"early_termination": 0.0}), (grids, {})):
        changes = changed_settings(scene_of(sections | ({} if sections else VOLUME), **keys), 1)
        assert [change.key for change in changes if "discarding" in change.key] == ["quality.early_discarding"]
    for keys in ({}, {"early_termination": 0.0, "meshes.0.opacity": 1.0}):
        assert not [one for one in changed_settings(scene_of(MESH, **keys), 1) if "discarding" in one.key]
