"""What skipping empty groups of cells saves: `python benchmarks/skipping.py [DATA] [--size N] [--json F]`.

The same scenes drawn twice on one rank: as always, and with every group of cells of every brick called visible, so that
each ray samples all of its slabs. The pictures' largest difference is printed beside the samples: what is skipped
has no opacity at all, and places and sums are those of batches, wherever runs begin, so there is none.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from blend_modes import planned, whole_pieces
from numpy.typing import NDArray

from clusterviz.cli.arguments import parse_device
from clusterviz.data import open_source
from clusterviz.data.samples import fetch_sample
from clusterviz.gl.context import open_context
from clusterviz.image import compare
from clusterviz.plan.content import brick_cost
from clusterviz.plan.plan import Plan
from clusterviz.render import brick_atlas
from clusterviz.render.choice import Device, egl_device, prefers_cpu
from clusterviz.render.cpu import caster as vectors
from clusterviz.render.cpu.caster import VectorCaster
from clusterviz.render.raycast import Raycaster
from clusterviz.render.render_result import RenderResult
from clusterviz.render.storage import Slot

CORTEX = [(40.0, 0.0), (60.0, 0.0), (100.0, 0.04), (140.0, 0.25), (220.0, 0.7)]
SPARSE = [(0.0, 0.0), (0.6, 0.0), (0.7, 0.5), (1.0, 0.9)]


def all_visible(ranges: Any, plan: Plan, slot: Slot) -> NDArray[np.uint32]:
    """In place of `visibility_bits`: nothing is empty."""
    return np.full((len(ranges[0]), slot.visibility_words), 0xFFFFFFFF, np.uint32)


def every_group(ranges: Any, plan: Plan) -> NDArray[np.bool_]:
    """The same, in place of `visible_groups`."""
    return np.ones(ranges[0].shape, bool)


def drawn(plan: Plan, bricks: dict[Any, Any], device: Device) -> RenderResult:
    """One picture."""
    by_cpu = prefers_cpu(device)
    caster = VectorCaster(plan) if by_cpu else Raycaster(open_context(device=egl_device(device)), plan)
    caster.load(plan, dict(bricks))
    (found,) = caster.draw(plan, whole_pieces(plan))
    return found


def measure(path: str, volume: dict[str, Any], size: int, device: Device) -> dict[str, Any]:
    """One scene with and without skipping."""
    source = open_source(path, None)
    plan, bricks = planned(path, source, (0.0, 1.0), size, {"volume": volume})
    skipping = drawn(plan, bricks, device)
    every = replace(plan, cost=brick_cost(plan.layout, np.zeros(plan.layout.counts_zyx, bool)))
    with (
        patch.object(brick_atlas, "visibility_bits", all_visible),
        patch.object(vectors, "visible_groups", every_group),
    ):
        whole = drawn(every, bricks, device)
    pictures = [np.zeros((size, size, 4), np.float32) for _ in range(2)]
    for picture, each in zip(pictures, (skipping, whole), strict=True):
        rect = each.partial.rect
        picture[rect.y_begin : rect.y_end, rect.x_begin : rect.x_end] = each.partial.rgba
    samples = {"samples": skipping.samples, "samples_without": whole.samples, "share": skipping.samples / whole.samples}
    return samples | {"bricks": skipping.bricks, "bricks_without": whole.bricks, "max": compare(*pictures).max}


def main() -> None:
    """Print the table, and write it as JSON on request."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", nargs="?", help="a head like that of the sample mni152, which is the default")
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--device", type=parse_device, help="an EGL device by its index, or cpu; default: the best")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    head = options.data or str(fetch_sample("mni152"))
    scenes: dict[str, tuple[str, dict[str, Any]]] = {
        "head, default": (head, {}),
        "head, cortex": (head, {"clim": (40.0, 220.0), "opacity": CORTEX}),
        "hydrogen, 192³": ("field:hydrogen:192", {"clim": (0.0, 1.0), "opacity": SPARSE}),
    }
    rows = {name: measure(path, volume, options.size, options.device) for name, (path, volume) in scenes.items()}
    print(f"{'scene':16} {'samples':>12} {'without':>12} {'share':>6} {'bricks':>9} {'max':>9}")
    for name, row in rows.items():
        bricks = f"{row['bricks']}/{row['bricks_without']}"
        counts = f"{row['samples']:12,} {row['samples_without']:12,} {row['share']:6.3f}"
        print(f"{name:16} {counts} {bricks:>9} {row['max']:9.1e}")
    if options.json:
        options.json.write_text(json.dumps({"data": head, "size": options.size, "rows": rows}, indent=2) + "\n")


if __name__ == "__main__":
    main()
