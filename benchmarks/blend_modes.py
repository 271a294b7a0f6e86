"""What each look costs beside plain compositing: `python benchmarks/blend_modes.py [DATA] [--size N] [--json F]`.

One rank, one picture, bricks in GPU memory already, the looks in turn so that a busy machine slows all alike; the
median of each look's times over that of compositing. Looks differ in how many slabs they must sample (an average takes
those that compositing skips over), so the ratio for each sample is printed beside the one for the picture.
"""

from __future__ import annotations

from collections.abc import Iterator
from statistics import median
from typing import Any

from measuring import Row, alternate, loaded, opened, options, positional, prepared, sample, show, whole_pieces, write

from clusterviz.cli.arguments import parse_device
from clusterviz.scene import Scene

LIGHT: dict[str, Any] = {"position": (1.0, 2.0, 3.0)}
SURFACES = ((0.5, 1.0), (0.3, 0.3), (0.7, 0.5))
"""Shares of the range of values, and opacities."""
FADING = ((0.0, 0.2), (2.0, 0.6), (10.0, 1.0))
QUALITY: dict[str, dict[str, Any]] = {
    "pre-integrated": {"classification": "pre-integrated"},
    "pre-integrated, split": {"classification": "pre-integrated", "borders": "split"},
    "jitter": {"jitter": True},
    "slices": {"renderer": "slices"},
    "cubic, texture unit": {"filter": "hardware"},
    "texture unit": {"filter": "hardware"},
}
VOLUME: dict[str, dict[str, Any]] = {
    "composite": {},
    **{name: {"blending": name} for name in ("maximum", "minimum", "local-maximum", "average", "additive")},
    **{name: {} for name in QUALITY},
    "shade": {"shade": True},
    "shade, 3 lights": {"shade": True},
    "shade, light in a place": {"shade": True},
    "shade, smooth gradient": {"shade": True, "gradient": "smooth"},
    "gradient opacity": {"gradient_opacity": FADING},
    "gradient opacity, shade": {"gradient_opacity": FADING, "shade": True},
    "nearest": {"interpolation": "nearest"},
    "cubic": {"interpolation": "cubic"},
    "cubic, texture unit": {"interpolation": "cubic"},
    "cubic, shade": {"interpolation": "cubic", "shade": True},
    "isosurface": {"blending": "isosurface", "isosurfaces": SURFACES[:1]},
    "isosurface, shade": {"blending": "isosurface", "isosurfaces": SURFACES[:1], "shade": True},
    "3 isosurfaces, shade": {"blending": "isosurface", "isosurfaces": SURFACES, "shade": True},
    "composite, isosurface": {"isosurfaces": SURFACES[1:2]},
    "clip": {},
}
SCENE: dict[str, dict[str, Any]] = {
    "shade, 3 lights": {"lights": (LIGHT, LIGHT, LIGHT)},
    "shade, light in a place": {"lights": ({**LIGHT, "positional": True},)},
    "clip": {"clip": {"planes": [[[0.0, 0.0, 0.0], [1.0, 0.5, 0.2]]]}},
}


def scene_of(path: str, name: str, value_range: tuple[float, float], size: int) -> Scene:
    """A data file with a look."""
    low, high = value_range
    volume = {"path": path} | VOLUME[name]
    if "isosurfaces" in volume:
        volume["isosurfaces"] = [(low + share * (high - low), opacity) for share, opacity in volume["isosurfaces"]]
    keys = {"volumes": [volume], "image": {"size": (size, size)}, "quality": QUALITY.get(name, {})}
    return Scene.model_validate(keys | SCENE.get(name, {}))


def measured(path: str, asked: Any) -> Iterator[Row]:
    """Time all looks, in turn."""
    source, voxels = opened(path)
    ways = {}
    for name in asked.looks:
        value_range = float(voxels.min()), float(voxels.max())
        plan, bricks = prepared(scene_of(path, name, value_range, asked.size), [source])
        caster = loaded(plan, bricks, asked.device)
        ways[name] = lambda caster=caster, plan=plan: caster.draw(plan, whole_pieces(plan))[0]
    plain: tuple[float, int] | None = None
    for name, runs in alternate(ways, asked.frames).items():
        seconds, samples = median(run.value.seconds_render for run in runs), runs[0].value.samples
        plain = plain or (seconds, samples)
        ratio = seconds / plain[0]
        yield {"look": name, "s": seconds, "samples": samples, "ratio": ratio, "each": ratio * plain[1] / samples}


def main() -> None:
    """Print the table."""
    data = positional("data", help="a data file; default: the sample mni152")
    device = {"type": parse_device, "help": "an EGL device by its index, or cpu; default: the best"}
    looks = {"nargs": "+", "choices": list(VOLUME), "default": list(VOLUME)}
    asked = options(__doc__, data=data, size=384, device=device, frames=5, looks=looks)
    path = sample(asked.data)
    cells = "{look} | {s!m:.0f} | {ratio:.2f} | {samples:,} | {each:.2f}"
    title = f"{path}, {asked.size} × {asked.size}; ratios to the first"
    write(asked, rows=show("look | ms | ratio | samples | ratio a sample", cells, measured(path, asked), title))


if __name__ == "__main__":
    main()
