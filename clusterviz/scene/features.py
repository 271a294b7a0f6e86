"""Features of the renderer that a driver may draw wrong, one row each.

`clusterviz doctor --gl` draws a picture of each row, and a run asks which rows its scene uses. So a new feature is one
line here, and its picture is made by `python -m clusterviz.self_test`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from clusterviz.scene.values import Scene

Content = Literal[
    "volume",
    "bytes",
    "invalid",
    "table",
    "optics",
    "volumes",
    "meshes",
    "mixture",
    "lines",
    "points",
    "grid",
    "lic",
    "filter",
]
"""What a picture shows; the data are those of `self_test.contents`."""
SECTION: dict[Content, str] = {
    "volumes": "volumes.1",
    "meshes": "meshes.0",
    "mixture": "meshes.0",
    "lines": "lines.0",
    "points": "points.0",
    "grid": "grids.0",
    "lic": "flows.0",
    "filter": "",
}
"""Section that a scene has which uses such content; others have a volume. "": no scene uses OpenGL for it."""


@dataclass(frozen=True)
class Feature:
    name: str  # for users
    content: Content = "volume"  # of the picture
    # by their full paths without numbers; a scene uses the feature if it has the same in any section of the name, or,
    # of what is neither a text nor a flag, anything at all; `...` is a key that the content sets
    keys: Mapping[str, Any] = field(default_factory=dict)
    bound: float = 1e-5  # largest error of the picture that is right
    more: Mapping[str, Any] = field(default_factory=dict)  # keys of the picture alone

    def is_used(self, scene: Scene, has_invalid: bool) -> bool:
        """Return whether a completed scene uses the feature; `has_invalid`: some of its voxels are not finite."""
        section = SECTION.get(self.content, "volumes.0")
        if not section or (self.content == "invalid" and not has_invalid):
            return False
        wanted = {section: ..., **self.keys}
        return all(
            any(_is_same(found, value) for found in _values(scene, path.split("."))) for path, value in wanted.items()
        )


def _volume(key: str, value: Any) -> dict[str, Any]:
    return {f"volumes.{key}": value}


LIGHT = {"shade": True, "ambient": 0.2, "diffuse": 0.8, "specular": 0.4, "specular_power": 12.0}
HARDWARE = {"quality.filter": "hardware"}
PREINTEGRATED = {"quality.classification": "pre-integrated"}
CUBIC = _volume("interpolation", "cubic")
FADING = ((0.02, 0.0), (0.3, 1.0))
PLANE = (((6.0, 5.0, 4.0), (1.0, 0.5, -0.3)),)
FEATURES = (
    Feature("samples of integers", "bytes"),
    Feature("samples of floats", "volume"),
    Feature("invalid voxels", "invalid"),
    Feature("nearest voxels", "bytes", _volume("interpolation", "nearest")),
    Feature("cubic interpolation", "volume", CUBIC),
    Feature("texture unit", "bytes", HARDWARE, 0.03),
    Feature("cubic interpolation by the texture unit", "bytes", HARDWARE | CUBIC, 0.03),
    Feature("light", "volume", _volume("shade", True), 4e-5, LIGHT),
    Feature("ambient occlusion", "volume", _volume("ambient_occlusion", {"radius": 3.0}), 4e-5, LIGHT),
    Feature("gradient opacity", "volume", _volume("gradient_opacity", FADING)),
    Feature("transfer function of two dimensions", "table", _volume("transfer_2d", ...), 4e-5),
    Feature("pre-integration", "volume", PREINTEGRATED),
    Feature("split bricks", "volume", PREINTEGRATED | {"quality.borders": "split"}),
    Feature("clipping", "volume", {"clip.planes": PLANE}),
    Feature("jitter", "volume", {"quality.jitter": True}),
    Feature("adaptive step", "volume", {"quality.adaptive": 0.5}, 0.02, {"step": 0.3}),
    Feature("slices", "volume", {"quality.renderer": "slices"}),
    Feature(
        "isosurfaces", "volume", _volume("isosurfaces", ((0.55, 0.4), (0.7, 1.0))), 1e-4, {"blending": "isosurface"}
    ),
    *(
        Feature(f"blend mode {name}", "volume", _volume("blending", name))
        for name in ("maximum", "minimum", "average", "additive")
    ),
    Feature("blend mode local-maximum", "volume", _volume("blending", "local-maximum"), more={"threshold": 0.3}),
    Feature("blend mode first-hit", "volume", _volume("blending", "first-hit"), more={"threshold": 0.35}),
    Feature("spectral volumes", "optics", _volume("optics", ...)),
    Feature(
        "refraction",
        "optics",
        _volume("optics.refraction", True),
        1e-4,
        {"volumes.0.optics.refractive_index": ((0.0, 1.0), (1.0, 1.3))},
    ),
    Feature("several volumes", "volumes"),
    Feature("meshes", "meshes", {}, 2e-5),
    Feature("meshes in a volume", "mixture", _volume("blending", "composite"), 2e-5),
    Feature("lines", "lines", {}, 2e-5),
    Feature("points", "points", {}, 2e-5),
    Feature("unstructured grids", "grid", {"grids.visibility": "exact"}, 2e-5),
    Feature("k-buffer", "grid", {"grids.visibility.k": 8}, 2e-5),
    Feature("line integral convolution", "lic", {"flows.show": "lic"}, 1e-4),
    Feature("pyramid filters", "filter"),
)


def features_of(scene: Scene, has_invalid: bool) -> list[str]:
    """Return the names of the features that a completed scene uses; see `Feature.is_used`."""
    return [each.name for each in FEATURES if each.is_used(scene, has_invalid)]


def _values(value: Any, path: Sequence[str]) -> Iterator[Any]:
    if isinstance(value, tuple) and path and not path[0].isdecimal():
        for item in value:
            yield from _values(item, path)
    elif not path:
        yield value
    elif isinstance(value, tuple):
        yield from _values(value[int(path[0])], path[1:]) if int(path[0]) < len(value) else ()
    elif hasattr(value, path[0]):
        yield from _values(getattr(value, path[0]), path[1:])


def _is_same(found: Any, wanted: Any) -> bool:
    if isinstance(wanted, str | bool):
        return bool(found == wanted)
    return bool(found)
