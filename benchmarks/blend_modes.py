"""What each look costs beside plain compositing: `python benchmarks/blend_modes.py [DATA] [--looks NAME …] [--json F]`.

One rank, bricks in memory already, the looks in turn so that a busy machine slows all alike; the least CPU time of
some frames. Looks differ in how many slabs they sample, so the ratio a sample stands beside that of the picture.
"Several volumes" are the data with balls of waves in the same place; with "all groups" no group of cells is skipped.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from typing import Any
from unittest.mock import patch

import numpy as np
from measuring import Row, alternate, loaded, opened, options, positional, prepared, sample, show, whole_pieces, write

from clusterviz.cli.arguments import parse_device
from clusterviz.data.bricks import read_bricks
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid
from clusterviz.plan.content import brick_cost, bricks_of_volume
from clusterviz.render import brick_atlas
from clusterviz.render.cpu import device as vectors
from clusterviz.scene import Scene

LIGHT: dict[str, Any] = {"position": (1.0, 2.0, 3.0)}
SURFACES = ((0.5, 1.0), (0.3, 0.3), (0.7, 0.5))
"""Shares of the range of values, and opacities."""
FADING = ((0.0, 0.2), (2.0, 0.6), (10.0, 1.0))
WAVES = {"path": "waves", "cmap": "viridis", "clim": (20, 230), "opacity": ((20, 0.0), (120, 0.0), (230, 0.2))}
LOOKS: dict[str, dict[str, dict[str, Any]]] = {
    "composite": {},
    "all groups": {},
    **{name: {"volume": {"blending": name}} for name in ("maximum", "minimum", "local-maximum", "average", "additive")},
    "pre-integrated": {"quality": {"classification": "pre-integrated"}},
    "pre-integrated, split": {"quality": {"classification": "pre-integrated", "borders": "split"}},
    "jitter": {"quality": {"jitter": True}},
    "slices": {"quality": {"renderer": "slices"}},
    "texture unit": {"quality": {"filter": "hardware"}},
    "nearest": {"volume": {"interpolation": "nearest"}},
    "cubic": {"volume": {"interpolation": "cubic"}},
    "cubic, texture unit": {"volume": {"interpolation": "cubic"}, "quality": {"filter": "hardware"}},
    "cubic, shade": {"volume": {"interpolation": "cubic", "shade": True}},
    "shade": {"volume": {"shade": True}},
    "shade, 3 lights": {"volume": {"shade": True}, "scene": {"lights": (LIGHT, LIGHT, LIGHT)}},
    "shade, light in a place": {"volume": {"shade": True}, "scene": {"lights": ({**LIGHT, "positional": True},)}},
    "shade, smooth gradient": {"volume": {"shade": True, "gradient": "smooth"}},
    "gradient opacity": {"volume": {"gradient_opacity": FADING}},
    "gradient opacity, shade": {"volume": {"gradient_opacity": FADING, "shade": True}},
    "isosurface": {"volume": {"blending": "isosurface", "isosurfaces": SURFACES[:1]}},
    "isosurface, shade": {"volume": {"blending": "isosurface", "isosurfaces": SURFACES[:1], "shade": True}},
    "3 isosurfaces, shade": {"volume": {"blending": "isosurface", "isosurfaces": SURFACES, "shade": True}},
    "composite, isosurface": {"volume": {"isosurfaces": SURFACES[1:2]}},
    "clip": {"scene": {"clip": {"planes": [[[0.0, 0.0, 0.0], [1.0, 0.5, 0.2]]]}}},
    "2 volumes": {},
    "2 volumes, shade": {"volume": {"shade": True}},
    "2 volumes, pre-integrated": {"quality": {"classification": "pre-integrated"}},
    "3 volumes": {},
}


def count_of(look: str) -> int:
    return int(look[0]) if "volumes" in look else 1


def scene_of(path: str, look: str, value_range: tuple[float, float], size: int) -> Scene:
    """A data file with a look."""
    low, high = value_range
    own = LOOKS[look].get("volume", {})
    if "isosurfaces" in own:
        own = own | {"isosurfaces": [(low + share * (high - low), opacity) for share, opacity in own["isosurfaces"]]}
    volumes = [own | one for one in ({"path": path}, WAVES, WAVES)[: count_of(look)]]
    keys = {"volumes": volumes, "image": {"size": (size, size)}, "quality": LOOKS[look].get("quality", {})}
    return Scene.model_validate(keys | LOOKS[look].get("scene", {}))


def waves_within(grid: Grid) -> list[ArraySource]:
    """A ball of waves in the middle of a grid, and the same turned and finer."""
    low, high = grid.corners.min(axis=0), grid.corners.max(axis=0)
    z, y, x = np.indices((128, 128, 128)) / 64 - 1
    waves = np.clip(128 + 127 * np.sin(12 * np.sqrt(x * x + y * y + z * z)), 0, 255).astype(np.uint8)
    cosine, sine = np.cos(0.6), np.sin(0.6)
    turned, found = np.array(((cosine, -sine, 0.0), (sine, cosine, 0.0), (0.0, 0.0, 1.0))), []
    for share, direction in ((0.7, np.eye(3)), (0.5, turned)):
        spacing = share * float((high - low).min()) / 127
        origin = (low + high) / 2 - direction @ np.full(3, 63.5 * spacing)
        rows = tuple(tuple(row) for row in direction.tolist())
        found.append(ArraySource(waves, Grid(waves.shape, (spacing,) * 3, tuple(origin.tolist()), rows)))
    return found


def nothing_skipped(stack: ExitStack) -> None:
    """Call every group of cells visible."""
    bits = lambda ranges, plan, slot: np.full((len(ranges[0]), slot.visibility_words), 0xFFFFFFFF, np.uint32)  # noqa: E731
    every = lambda ranges, plan: np.ones((len(ranges[0]), *ranges[0].shape[2:]), bool)  # noqa: E731
    stack.enter_context(patch.object(brick_atlas, "visibility_bits", bits))
    stack.enter_context(patch.object(vectors, "visible_groups", every))


def way_of(scene: Scene, sources: list[Any], device: Any, every_group: bool) -> Any:
    """What draws a frame."""
    plan, bricks = prepared(scene, sources)
    with ExitStack() as stack:
        if every_group:
            nothing_skipped(stack)
            layout = plan.layout
            bricks = bricks_of_volume(layout, read_bricks(sources[0], layout, np.ndindex(*layout.counts_zyx)))
            plan = replace(plan, cost=brick_cost(layout, np.zeros(layout.counts_zyx, bool)))
        caster = loaded(plan, bricks, device)
        caster.draw(plan, whole_pieces(plan))
    return lambda: caster.draw(plan, whole_pieces(plan))[0]


def measured(path: str, asked: Any) -> Iterator[Row]:
    """Time all looks, in turn."""
    source, voxels = opened(path)
    value_range, sources = (float(voxels.min()), float(voxels.max())), [source, *waves_within(source.grid)]
    ways = {
        look: way_of(
            scene_of(path, look, value_range, asked.size),
            sources[: count_of(look)],
            asked.device,
            every_group=look == "all groups",
        )
        for look in asked.looks
    }
    plain: tuple[float, int] | None = None
    for look, runs in alternate(ways, asked.frames).items():
        seconds, samples = min(run.cpu for run in runs), runs[0].value.samples
        plain = plain or (seconds, samples)
        ratio = seconds / plain[0]
        yield {"look": look, "s": seconds, "samples": samples, "ratio": ratio, "each": ratio * plain[1] / samples}


def main() -> None:
    data = positional("data", help="a data file; default: the sample mni152")
    device = {"type": parse_device, "help": "an EGL device by its index, or cpu; default: the best"}
    looks = {"nargs": "+", "choices": list(LOOKS), "default": list(LOOKS)}
    asked = options(__doc__, data=data, size=384, device=device, frames=5, looks=looks)
    path = sample(asked.data)
    cells = "{look} | {s!m:.0f} | {ratio:.2f} | {samples:,} | {each:.2f}"
    title = f"{path}, {asked.size} × {asked.size}, CPU time; ratios to the first"
    write(asked, rows=show("look | ms | ratio | samples | ratio a sample", cells, measured(path, asked), title))


if __name__ == "__main__":
    main()
