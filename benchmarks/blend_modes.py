"""What each look costs beside plain compositing: `python benchmarks/blend_modes.py [DATA] [--size N] [--json F]`.

One rank, one picture, bricks in GPU memory already, the looks in turn so that a busy machine slows all alike; the
median of each look's times over that of compositing. Looks differ in how many slabs they must sample (an average takes
those that compositing skips over), so the ratio for each sample is printed beside the one for the picture.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from clusterviz.cli.arguments import parse_device
from clusterviz.content.complete import complete_scene
from clusterviz.data import open_source
from clusterviz.data.bricks import BrickLayout, read_bricks
from clusterviz.data.samples import fetch_sample
from clusterviz.data.source import Source
from clusterviz.data.summary import VolumeSummary, summarise
from clusterviz.gl.context import open_context
from clusterviz.partition import Piece, build_tree, leaf_pieces
from clusterviz.plan.blend_mode import margin_of
from clusterviz.plan.content import KnownVolume
from clusterviz.plan.plan import Plan, make_plan
from clusterviz.render.choice import Device, egl_device, prefers_cpu
from clusterviz.render.cpu.caster import VectorCaster
from clusterviz.render.raycast import Raycaster
from clusterviz.scene import Scene, VolumeInfo
from clusterviz.scene.values import ImageSettings, Volume

LIGHT: dict[str, Any] = {"position": (1.0, 2.0, 3.0)}
SURFACES = ((0.5, 1.0), (0.3, 0.3), (0.7, 0.5))
"""Shares of the range of values, and opacities."""
FADING = ((0.0, 0.2), (2.0, 0.6), (10.0, 1.0))
LOOKS: dict[str, dict[str, Any]] = {
    "composite": {},
    "maximum": {"volume": {"blending": "maximum"}},
    "minimum": {"volume": {"blending": "minimum"}},
    "local-maximum": {"volume": {"blending": "local-maximum"}},
    "average": {"volume": {"blending": "average"}},
    "additive": {"volume": {"blending": "additive"}},
    "pre-integrated": {"scene": {"quality": {"classification": "pre-integrated"}}},
    "pre-integrated, split": {"scene": {"quality": {"classification": "pre-integrated", "borders": "split"}}},
    "jitter": {"scene": {"quality": {"jitter": True}}},
    "slices": {"scene": {"quality": {"renderer": "slices"}}},
    "shade": {"volume": {"shade": True}},
    "shade, 3 lights": {"volume": {"shade": True}, "scene": {"lights": (LIGHT, LIGHT, LIGHT)}},
    "shade, light in a place": {"volume": {"shade": True}, "scene": {"lights": ({**LIGHT, "positional": True},)}},
    "shade, smooth gradient": {"volume": {"shade": True, "gradient": "smooth"}},
    "gradient opacity": {"volume": {"gradient_opacity": FADING}},
    "gradient opacity, shade": {"volume": {"gradient_opacity": FADING, "shade": True}},
    "nearest": {"volume": {"interpolation": "nearest"}},
    "cubic": {"volume": {"interpolation": "cubic"}},
    "cubic, texture unit": {"volume": {"interpolation": "cubic"}, "scene": {"quality": {"filter": "hardware"}}},
    "texture unit": {"scene": {"quality": {"filter": "hardware"}}},
    "cubic, shade": {"volume": {"interpolation": "cubic", "shade": True}},
    "isosurface": {"volume": {"blending": "isosurface", "isosurfaces": SURFACES[:1]}},
    "isosurface, shade": {"volume": {"blending": "isosurface", "isosurfaces": SURFACES[:1], "shade": True}},
    "3 isosurfaces, shade": {"volume": {"blending": "isosurface", "isosurfaces": SURFACES, "shade": True}},
    "composite, isosurface": {"volume": {"isosurfaces": SURFACES[1:2]}},
    "clip": {"scene": {"clip": {"planes": [[[0.0, 0.0, 0.0], [1.0, 0.5, 0.2]]]}}},
}


def planned(
    path: str, source: Source, value_range: tuple[float, float], size: int, look: dict[str, Any]
) -> tuple[Plan, dict[Any, Any]]:
    """The plan of a look, and its bricks."""
    keys = {"path": path} | look.get("volume", {})
    if "isosurfaces" in keys:
        low, high = value_range
        keys["isosurfaces"] = [(low + share * (high - low), opacity) for share, opacity in keys["isosurfaces"]]
    volume = Volume.model_validate(keys)
    scene = Scene.model_validate(
        {"volumes": (volume,), "image": ImageSettings(size=(size, size)), **look.get("scene", {})}
    )
    margin = margin_of(volume, scene.quality.classification, scene.quality.borders)
    layout = BrickLayout(source.grid.shape_zyx, scene.cluster.brick, margin)
    bricks = dict(read_bricks(source, layout, np.ndindex(*layout.counts_zyx)))
    summary = summarise(source.dtype, layout, lambda: iter(bricks.items()), lambda value: [value])
    completed = complete_scene(scene, facts_of(source, summary))
    return make_plan(completed, [KnownVolume(source.grid, source.dtype, layout, summary)]), bricks


def facts_of(source: Source, summary: VolumeSummary) -> VolumeInfo:
    """What completing a scene needs."""
    grid, (low, high) = source.grid, summary.value_range
    ends = summary.percentile(1.0), summary.percentile(99.0)
    return VolumeInfo(grid.shape_zyx, grid.spacing, grid.corners, low, high, *ends)


def whole_pieces(plan: Plan) -> tuple[Piece, ...]:
    """All bricks as one piece."""
    return leaf_pieces(build_tree(plan.cost, 1), plan.cost, None, plan.view.forward)


def measure(path: str, size: int, frames: int, names: list[str], device: Device) -> list[dict[str, Any]]:
    """Time all looks, in turn; those that the CPU cannot draw are left to OpenGL."""
    source, context = open_source(path, None), open_context(device=egl_device(device))
    voxels = source.read((0, 0, 0), source.grid.shape_zyx)
    value_range = float(voxels.min()), float(voxels.max())
    casters: dict[str, tuple[Raycaster | VectorCaster, Plan]] = {}
    for name in names:
        plan, bricks = planned(path, source, value_range, size, LOOKS[name])
        casters[name] = VectorCaster(plan) if prefers_cpu(device) else Raycaster(context, plan), plan
        casters[name][0].load(plan, bricks)
    seconds: dict[str, list[float]] = {name: [] for name in names}
    samples: dict[str, int] = {}
    for _ in range(frames + 1):
        for name, (caster, plan) in casters.items():
            (drawn,) = caster.draw(plan, whole_pieces(plan))
            seconds[name].append(drawn.seconds_render)
            samples[name] = drawn.samples
    return [
        {"look": name, "median_s": median(times[1:]), "min_s": min(times[1:]), "samples": samples[name]}
        for name, times in seconds.items()
    ]


def main() -> None:
    """Print the table, and write it as JSON on request."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", nargs="?", help="a data file; default: the sample mni152")
    parser.add_argument("--size", type=int, default=384)
    parser.add_argument("--device", type=parse_device, help="an EGL device by its index, or cpu; default: the best")
    parser.add_argument("--frames", type=int, default=5)
    parser.add_argument("--looks", nargs="+", choices=list(LOOKS), default=list(LOOKS))
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    path = options.data or str(fetch_sample("mni152"))
    rows = measure(path, options.size, options.frames, options.looks, options.device)
    plain = rows[0]
    print(f"{path}, {options.size} × {options.size}; ratios to {plain['look']}")
    print(f"{'look':24} {'median':>9} {'ratio':>6} {'samples':>12} {'ratio a sample':>15}")
    for row in rows:
        ratio, share = row["median_s"] / plain["median_s"], row["samples"] / plain["samples"]
        print(
            f"{row['look']:24} {1e3 * row['median_s']:6.0f} ms {ratio:6.2f} {row['samples']:12,} {ratio / share:15.2f}"
        )
    if options.json:
        report = {"data": path, "size": options.size, "frames": options.frames, "rows": rows}
        options.json.write_text(json.dumps(report, indent=2) + "\n")


if __name__ == "__main__":
    main()
