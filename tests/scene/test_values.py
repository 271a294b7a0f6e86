"""Scene validation: every invalid value is refused with key, value found and values allowed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from clusterviz.errors import SceneError
from clusterviz.scene import Scene, Volume
from clusterviz.scene.validation_messages import scene_error

NAN, INF = float("nan"), float("inf")


def complaint(data: dict[str, Any]) -> str:
    with pytest.raises(ValidationError) as caught:
        Scene.model_validate(data)
    return str(scene_error(caught.value, "scene.yaml"))


def volume(**keys: Any) -> dict[str, Any]:
    return {"volumes": [{"path": "a.npy", **keys}]}


def mixed(**keys: object) -> dict[str, object]:
    """Two volumes, the second with further keys."""
    return {"volumes": [{"path": "a"}, {"path": "b", **keys}]}


def test_an_empty_scene_is_valid() -> None:
    scene = Scene()
    assert scene.volumes == ()
    assert scene.image.size == (1024, 768)
    assert scene == Scene.model_validate({})


def test_scenes_are_frozen_and_hashable() -> None:
    scene = Scene.model_validate(volume(opacity=[[0, 0], [1, 1]]))
    with pytest.raises(ValidationError):
        scene.quality.step = 2.0  # type: ignore[misc]
    assert hash(scene) == hash(Scene.model_validate(volume(opacity=[[0, 0], [1, 1]])))


def test_numpy_numbers_and_arrays_are_taken() -> None:
    made = Volume(path="a", clim=np.array([1, 2], np.uint8), opacity=np.float32(0.5))  # type: ignore[arg-type]
    assert made.clim == (1.0, 2.0)
    assert made.opacity == 0.5
    assert type(made.opacity) is float


def beside(mesh: dict[str, Any], **sections: Any) -> dict[str, Any]:
    """A mesh with further keys, and other sections."""
    return {"meshes": [{"path": "a.ply", **mesh}], **sections}


SQUASHED = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]]


def grid(**keys: Any) -> dict[str, Any]:
    return {"grids": [{"path": "a", **keys}]}


def flow(**keys: Any) -> dict[str, Any]:
    return {"flows": [{"path": "a", **keys}]}


def painted(flows: int = 1, **keys: Any) -> dict[str, Any]:
    """An isosurface, a mesh, and flows on both."""
    surfaces = volume(isosurfaces=[0.5]) | {"meshes": [{"path": "m"}]}
    return surfaces | {"flows": [{"path": "a", "show": "surface-lic", **keys}] * flows}


SURFACES = "not with meshes, lines or points"
COHERENT, NOT_WITH = {"quality": {"frame_coherence": True}}, "quality.frame_coherence: not with"
BAD = [
    (beside({"colour": "red"}), "meshes[0].colour: unknown key, did you mean color?", "colour", "path, color"),
    (beside({"color": "ivroy"}), "meshes[0].color", '"ivroy"', "a CSS colour name"),
    (beside({"color": "transparent"}), "meshes[0].color", '"transparent"', "a CSS colour name, #rrggbb, or [r, g, b]"),
    (beside({"opacity": 2}), "meshes[0].opacity", "2", "at most 1"),
    (beside({"opacity": "linear"}), "meshes[0].opacity: no scalars", "", "a number, or scalars beside it"),
    (beside({"shading": "round"}), "meshes[0].shading", '"round"', "smooth, flat"),
    (beside({"transform": SQUASHED}), "meshes[0].transform: not affine and invertible", "[[1", "4 rows of 4 numbers"),
    (beside({"transform": SQUASHED[:3]}), "meshes[0].transform", "[[1", "a list, such as [[1, 0, 0, 10]"),
    ({"lines": [{"path": "a", "radius": 0}]}, "lines[0].radius", "0", "more than 0"),
    ({"points": [{"path": "a", "radius": -1}]}, "points[0].radius", "-1", "more than 0"),
    ({"points": [{"path": "a", "radius": True}]}, "points[0].radius: not a size", "true", "the name of an array"),
    (
        {"points": [{"path": "a", "style": "arrows"}]},
        "points[0].direction: arrows need vectors",
        "",
        "three components",
    ),
    ({"points": [{"path": "a", "scale": 2}]}, "points[0].scale: spheres have none", "2", "null, or style: arrows"),
    ({"meshes": [{}]}, "meshes[0].path: missing", "", "a value, such as"),
    (
        beside({}, volumes=[{"path": "a", "blending": "maximum"}]),
        f"volumes[0].blending: {SURFACES}",
        "maximum",
        "alone",
    ),
    (beside({}, quality={"filter": "hardware"}), f"quality.filter: {SURFACES}", '"hardware"', "one volume alone"),
    (grid(time=-1), "grids[0].time: not a time step", "-1", "a whole number from 0 on, or its time"),
    (grid(time=NAN), "grids[0].time", "NaN", "a finite number"),
    (grid(visibility="sorted"), "grids[0].visibility: not an order", '"sorted"', "exact, or {k: 2 to 32}"),
    (grid(visibility={"k": 1}), "grids[0].visibility.k", "1", "at least 2"),
    (grid(visibility={"k": 33}), "grids[0].visibility.k", "33", "at most 32"),
    (grid(transform=SQUASHED), "grids[0].transform: not affine", "[[1", "4 rows of 4"),
    (grid(scalars="Temp"), "grids[0].scalars: unknown key", "scalars", "path, array, time"),
    ({"grids": [{"path": "a"}] * 5}, "grids: too many values", "path", "at most 4"),
    (grid() | {"quality": {"adaptive": 0.01}}, "quality.adaptive: not with unstructured grids", "0.01", "one volume"),
    (grid() | volume(blending="maximum"), "volumes[0].blending: not with unstructured grids", "max", "one volume"),
    (grid() | {"image": {"layers": ["depth"]}}, "image.layers: not with unstructured grids", '["depth"]', "no grids"),
    (flow(show="lik"), "flows[0].show: not one of the choices", '"lik"', "lic, streamlines, pathlines"),
    (flow(seeds={}), "flows[0].seeds: not for show: lic", "{}", "null, or this key with show: streamlines"),
    (flow(lic={"lenght": 3}), "flows[0].lic.lenght: unknown key, did you mean length?", "lenght", "length, step"),
    (flow(lic={"step": 0}), "flows[0].lic.step", "0", "more than 0"),
    (flow(color_by="direction"), "flows[0].color_by: not for show: lic", '"direction"', "speed, color"),
    (flow(order="xyy"), "flows[0].order", '"xyy"', "xyz, xzy"),
    (flow(show="streamlines", seeds={"kind": "plane"}), "flows[0].seeds.center: missing", "", "for kind: plane"),
    (
        flow(show="streamlines", seeds={"radius": 1}),
        "flows[0].seeds.radius: not for kind: random",
        "1",
        "plane, sphere",
    ),
    (flow(show="streamlines", trace={"release": 1}), "flows[0].trace.release: not for show: str", "1", "streaklines"),
    (flow(show="surface-lic", lic={"noise": "white"}), "flows[0].lic.noise: not for show: sur", '"white"', "halton"),
    (flow(show="surface-lic", opacity="linear"), "flows[0].opacity: the pattern has one strength", "", "a number in"),
    (flow(show="surface-lic"), "flows[0].surfaces: there is no surface", "", "a scene with meshes, or with volumes"),
    (painted(lic={"integrator": "rk45"}), "flows[0].lic.integrator: not for show: surface-lic", "rk45", "euler, rk4"),
    (painted(lic={"step": 1.5}), "flows[0].lic.step: longer than a pixel", "1.5", "at most 1"),
    (painted(lic={"length": 1e9}), "flows[0].lic.length: too long", "1000000000", "at most 10,000 steps: 5000"),
    (painted(surfaces=["meshes[1]"]), "flows[0].surfaces: not a surface", '"meshes[1]"', "volumes[0], meshes[0]"),
    (painted() | painted(2), "flows[1].surfaces: has a pattern by flows[0]", '"volumes[0]"', "another one"),
    (painted() | grid(), "flows[0].show: not with unstructured grids", "surface-lic", "no grids"),
    ({"flows": [{"path": "a"}] * 3}, "flows: too many with show: lic", "3", "at most 2"),
    (flow() | volume(blending="maximum"), "volumes[0].blending: not with flows", "maximum", "one volume alone"),
    (volume(spacing=[1, 0, 1]), "volumes[0].spacing[1]", "0", "more than 0"),
    (volume(spacing=[1, 1]), "volumes[0].spacing", "[1, 1]", "a list, such as [0.5, 0.5, 1.2]"),
    (volume(origin=[1, 1, NAN]), "volumes[0].origin[2]", "NaN", "a finite number"),
    (volume(direction=[[1, 0, 0], [0, 1, 0]]), "volumes[0].direction", "", "such as [[1, 0, 0], [0, 1, 0], [0, 0, 1]]"),
    (volume(direction=[[1, 0, 0], [0, 1, 1], [0, 0, 1]]), "volumes[0].direction", "[[1, 0, 0]", "at right angles"),
    (volume(direction=[[2, 0, 0], [0, 1, 0], [0, 0, 1]]), "volumes[0].direction", "[[2, 0, 0]", "unit vectors"),
    (volume(time=-1), "volumes[0].time: not a time step", "-1", "from 0 on, or all"),
    (volume(time=1.5), "volumes[0].time", "1.5", "whole number"),
    (volume(channel=-1), "volumes[0].channel", "-1", "a whole number from 0 on, or a name"),
    (volume(channel=True), "volumes[0].channel", "true", "a whole number from 0 on, or a name"),
    (volume(clim=[2, 1]), "volumes[0].clim", "[2, 1]", "low <= high"),
    (volume(clim=[NAN, 1]), "volumes[0].clim[0]", "NaN", "a finite number"),
    (volume(clim=[0, INF]), "volumes[0].clim[1]", "Infinity", "a finite number"),
    (volume(clim=[1]), "volumes[0].clim", "", "a list, such as [20, 200]"),
    (volume(clim=[1, 2, 3]), "volumes[0].clim", "[1, 2, 3]", "2 values"),
    (volume(clim="wide"), "volumes[0].clim", '"wide"', "a list"),
    (volume(clim=[True, 2]), "volumes[0].clim[0]", "true", "a number"),
    (volume(path=""), "volumes[0].path", '""', "a data file"),
    (volume(path="a\0b"), "volumes[0].path", "", "a data file"),
    (volume(path=3), "volumes[0].path", "3", "a text"),
    (volume(array=3), "volumes[0].array", "3", "a text"),
    ({"volumes": [{}]}, "volumes[0].path: missing", "", "a value"),
    ({"volumes": {"path": "a"}}, "volumes", "path", "a list"),
    ({"volumes": ["a.npy"]}, "volumes[0]: not a section", '"a.npy"', "path, array"),
    ({"volumes": [{"path": "a"}] * 9}, "too many volumes", "path", "at most 8"),
    (
        {"volumes": [{"path": "a", "isosurfaces": [*range(11)]}] * 3},
        "isosurfaces: too many",
        "33",
        "32 isosurfaces in all",
    ),
    (mixed(blending="maximum"), "volumes[1].blending: not for several volumes: their values", '"max', "one volume"),
    (mixed() | {"quality": {"filter": "hardware"}}, "quality.filter: not for several", "hardware", "one volume"),
    (mixed() | {"quality": {"borders": "split"}}, "quality.borders: not for several", "split", "one volume"),
    (mixed() | {"quality": {"adaptive": 0.01}}, "quality.adaptive: not for several", "0.01", "one volume"),
    (volume(blending="maximum") | COHERENT, f"{NOT_WITH} blending: maximum", "true", "false"),
    (COHERENT | {"cluster": {"mode": "sort-first"}}, f"{NOT_WITH} cluster.mode: sort-first", "", "false"),
    (COHERENT | {"cluster": {"groups": 2}}, f"{NOT_WITH} cluster.groups", "", "false"),
    (
        {"quality": {"renderer": "slices", "jitter": True}},
        "quality.renderer: not with quality.jitter",
        "slices",
        "raycast",
    ),
    ({"quality": {"frame_coherence": True, "adaptive": 0.01}}, f"{NOT_WITH} quality.adaptive", "", "false"),
    ({"quality": {"frame_coherence": True, "max_error": 0.01}}, f"{NOT_WITH} settings", "", "false"),
    (volume(opacity=1.5), "volumes[0].opacity", "1.5", "at most 1"),
    (volume(opacity=-0.5), "volumes[0].opacity", "-0.5", "at least 0"),
    (volume(opacity=NAN), "volumes[0].opacity", "NaN", "a finite number"),
    (volume(opacity=True), "volumes[0].opacity", "true", "a number in 0..1"),
    (volume(opacity="steep"), "volumes[0].opacity", '"steep"', "sigmoid"),
    (volume(opacity=[]), "volumes[0].opacity", "[]", "at least one"),
    (volume(opacity=[[1, 0], [0, 1]]), "out of order: 0.0 after 1.0", "[[1, 0], [0, 1]]", "sorted"),
    (volume(opacity=[[0, 2]]), "volumes[0].opacity[0][1]", "2", "at most 1"),
    (volume(opacity=[[0, 0, 0]]), "volumes[0].opacity[0]", "[0, 0, 0]", "2 values"),
    (volume(opacity={"a": 1}), "volumes[0].opacity", '{"a": 1}', "a number"),
    (volume(cmap=[[0, 0, 0, 1.5]]), "volumes[0].cmap[0][3]", "1.5", "at most 1"),
    (volume(gradient="smooth", interpolation="nearest"), "volumes[0].gradient: not for", '"smooth"', "central"),
    (volume(gradient_opacity=[[-1, 0]]), "volumes[0].gradient_opacity[0][0]", "-1", "at least 0"),
    (volume(gradient_opacity=[[1, 2]]), "volumes[0].gradient_opacity[0][1]", "2", "at most 1"),
    (volume(gradient_opacity=[[1, 0], [0, 1]]), "out of order: 0.0 after 1.0", "[[1, 0], [0, 1]]", "sorted"),
    (volume(gradient_opacity=[[0, 1]], blending="average"), "gradient_opacity: not for", "", "blending: composite"),
    (volume(transfer_2d={"path": "t.npy"}, opacity=1), "volumes[0].opacity: opacity is in", "", "one of the two"),
    (volume(transfer_2d={}), "volumes[0].transfer_2d.path: missing", "", "a value"),
    (volume(cmap=3), "volumes[0].cmap", "3", "a name that `clusterviz cmaps` lists"),
    (volume(cmap=""), "volumes[0].cmap", '""', "a name that `clusterviz cmaps` lists"),
    (volume(opacity_unit_distance=0), "volumes[0].opacity_unit_distance", "0", "more than 0"),
    (volume(interpolation="quintic"), "volumes[0].interpolation", '"quintic"', "linear, nearest, cubic"),
    (volume(specular_power=-1), "volumes[0].specular_power", "-1", "at least 0"),
    (volume(shade=1), "volumes[0].shade", "1", "true, false"),
    (volume(blending="sum"), "volumes[0].blending", '"sum"', "local-maximum"),
    (volume(threshold=NAN), "volumes[0].threshold", "NaN", "a finite number"),
    (volume(blending="isosurface"), "volumes[0].isosurfaces: missing", "", "one data value or more"),
    (volume(blending="average", isosurfaces=[1]), "volumes[0].isosurfaces: not for blending: average", "", "composite"),
    (volume(isosurfaces=[[1, 2]]), "volumes[0].isosurfaces[0][1]", "2", "at most 1"),
    (volume(isosurfaces=["x"]), "volumes[0].isosurfaces[0]: not a surface", "", "[value, opacity]"),
    ({"lights": [{}]}, "lights[0].position: missing", "", "[x, y, z]"),
    ({"lights": [{"position": [0, 0, 0]}]}, "lights[0].position", "[0.0, 0.0, 0.0]", "other than focal_point"),
    ({"lights": [{"type": "headlight", "positional": True}]}, "lights[0].positional", "", "type: scene"),
    ({"lights": [{"position": [1, 0, 0], "cone_angle": 91}]}, "lights[0].cone_angle", "91", "at most 90"),
    ({"lights": [{"position": [1, 0, 0], "attenuation": [0, 0, 0]}]}, "lights[0].attenuation", "[0.0", "above 0"),
    ({"lights": [{"type": "lamp"}]}, "lights[0].type", '"lamp"', "headlight"),
    ({"lights": [{"type": "headlight", "intensity": -1}]}, "lights[0].intensity", "-1", "at least 0"),
    ({"clip": {"planes": [[[0, 0, 0], [0, 0, 0]]]}}, "clip.planes[0][1]", "[0, 0, 0]", "a direction"),
    ({"clip": {"planes": [[0, 0, 0]]}}, "clip.planes[0]", "", ""),
    ({"clip": {"box": [0, 1, 5, 4, 0, 1]}}, "clip.box: ymin lies above ymax", "", "xmin, xmax"),
    ({"clip": {"box": [0, 1]}}, "clip.box: too few values", "[0, 1]", "a list"),
    ({"camera": {"view_angle": 0}}, "camera.view_angle", "0", "more than 0"),
    ({"camera": {"view_angle": 180}}, "camera.view_angle", "180", "less than 180"),
    ({"camera": {"parallel_scale": -1}}, "camera.parallel_scale", "-1", "more than 0"),
    ({"camera": {"position": [0, 0]}}, "camera.position: too few values", "[0, 0]", "a list"),
    ({"camera": {"view_up": [0, 0, 0]}}, "camera.view_up", "[0.0, 0.0, 0.0]", "a direction"),
    ({"image": {"size": [0, 5]}}, "image.size[0]", "0", "at least 1"),
    ({"image": {"size": [5, 65537]}}, "image.size[1]", "65537", "at most 65536"),
    ({"image": {"size": [5.5, 5]}}, "image.size[0]", "5.5", "a whole number"),
    ({"image": {"background": "whiteish"}}, "image.background", '"whiteish"', "a CSS colour name"),
    ({"image": {"background": "#ffffff80"}}, "image.background", '"#ffffff80"', "a CSS colour name"),
    ({"image": {"background": [0, 0, 2]}}, "image.background[2]", "2", "at most 1"),
    ({"image": {"background": None}}, "image.background", "null", "a CSS colour name"),
    ({"quality": {"step": 0}}, "quality.step", "0", "more than 0"),
    ({"quality": {"step": "1"}}, "quality.step", '"1"', "a number"),
    ({"quality": {"step": 1e10}}, "quality.step: too large", "", "at most 1e+09"),
    ({"quality": {"classification": "pre"}}, "quality.classification", '"pre"', "post, pre-integrated"),
    ({"quality": {"early_termination": 1}}, "quality.early_termination", "1", "less than 1"),
    ({"quality": {"filter": "fast"}}, "quality.filter", '"fast"', "exact, hardware"),
    ({"quality": 3}, "quality: not a section", "3", "step, classification"),
    ({"cluster": {"brick": 1}}, "cluster.brick", "1", "at least 2"),
    ({"cluster": {"brick": 1025}}, "cluster.brick", "1025", "at most 1024"),
    ({"cluster": {"brick": 12, "largest_brick": 24}}, "cluster.brick", "12", "a multiple of 8"),
    ({"cluster": {"brick": 16, "largest_brick": 24}}, "cluster.largest_brick", "24", "a multiple of 16"),
    (mixed() | {"cluster": {"largest_brick": 128}}, "cluster.largest_brick: not for several", "128", "one volume"),
    ({"cluster": {"groups": 0}}, "cluster.groups", "0", "at least 1"),
    ({"cluster": {"tile": 7}}, "cluster.tile", "7", "at least 8"),
    ({"cluster": {"repetitions": 0}}, "cluster.repetitions", "0", "at least 1"),
    ({"cluster": {"tiling": "tiles"}}, "cluster.tiling", '"tiles"', "interleaved, pattern, scheduled"),
    ({"cluster": {"mode": "sort-last", "groups": 2}}, "cluster.groups", "2", "mode: hybrid"),
    ({"cluster": {"mode": "sort-first", "groups": 2}}, "cluster.groups", "2", "mode: hybrid"),
    ({"cluster": {"mode": "sort-last", "tiling": "pattern"}}, "cluster.tiling", '"pattern"', "mode: sort-first"),
    ({"cluster": {"mode": "sort-first", "transport": "shared"}}, "cluster.transport", '"shared"', "messages"),
    (
        {"cluster": {"mode": "hybrid", "distribution": "interleaved"}},
        "cluster.distribution",
        '"inter',
        "mode: sort-last",
    ),
    ({"cluster": {"mode": "sort-first", "compositing": "tree"}}, "cluster.compositing", '"tree"', "mode: sort-last"),
]


@pytest.mark.parametrize(("data", "where", "found", "allowed"), BAD)
def test_an_impossible_value_is_refused(data: dict[str, Any], where: str, found: str, allowed: str) -> None:
    text = complaint(data)
    assert text.startswith("scene.yaml: ")
    assert where in text
    assert not found or found in text.partition("found ")[2]
    assert "allowed " in text
    assert allowed in text


@pytest.mark.parametrize(
    ("section", "name", "near"),
    [("quality", "stpe", "step"), ("camera", "viewup", "view_up"), (None, "volume", "volumes")],
)
def test_an_unknown_key_gets_the_nearest_one(section: str | None, name: str, near: str) -> None:
    text = complaint({section: {name: 1}} if section else {name: 1})
    assert f"unknown key, did you mean {near}?" in text
    assert f"found {name}" in text


def test_all_complaints_are_listed_a_line_each_and_many_are_counted() -> None:
    assert complaint({"quality": {"step": 0, "filter": "x"}}).count("\n") == 1
    lines = complaint(volume(opacity=[[0, 7 + i] for i in range(100)])).splitlines()
    assert len(lines) == 9
    assert lines[-1] == "and 92 more errors"


@pytest.mark.parametrize("scale", [1e-300, 1e-9, 1.0, 1e9, 1e300])
def test_a_degenerate_camera_is_refused_at_any_scale(scale: float) -> None:
    eye, focus = [0, 0, scale], [0, 0, -scale]
    same = {"camera": {"position": eye, "focal_point": eye}}
    assert "camera.focal_point: the same as position" in complaint(same)
    parallel = {"camera": {"position": eye, "focal_point": focus, "view_up": [0, 0, -3 * scale]}}
    assert "camera.view_up: parallel to the direction of view" in complaint(parallel)
    good = Scene.model_validate({"camera": {"position": eye, "focal_point": focus, "view_up": [0, scale, scale]}})
    assert good.camera.view_up == (0, scale, scale)


def test_equal_clim_ends_and_repeated_points_are_steps_not_errors() -> None:
    scene = Scene.model_validate(volume(clim=[3, 3], opacity=[[1, 0], [1, 1]]))
    assert scene.volumes[0].clim == (3.0, 3.0)


def test_complaints_are_scene_errors_with_status_2() -> None:
    with pytest.raises(ValidationError) as caught:
        Scene.model_validate({"quality": {"step": 0}})
    assert isinstance(scene_error(caught.value, "a"), SceneError)
    assert scene_error(caught.value, "a").exit_status == 2
