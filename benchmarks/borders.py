"""What cutting slabs at the faces of bricks trades: `python benchmarks/borders.py [DATA] [--size N] [--json F]`.

Pre-integrated slabs with one more voxel around every brick (`quality.borders: overlap`) beside slabs that are cut where
they leave a brick (`split`), for several brick sizes: bytes of voxels, field samples, a frame's time, and how far the
picture is from that with overlap, which is the same for all bricks, and from a converged one.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from looks import planned

from clusterviz.data import open_source
from clusterviz.data.samples import fetch_sample
from clusterviz.gl.context import open_context
from clusterviz.partition import build_tree
from clusterviz.partition.pieces import Piece
from clusterviz.render.raycast import Raycaster

BRICKS = (33, 64, 128)
CONVERGED = 1 / 16


def scene(brick: int, borders: str, step: float = 1.0) -> dict[str, Any]:
    """The keys of one row."""
    quality = {"classification": "pre-integrated", "borders": borders, "step": step}
    return {"scene": {"quality": quality, "cluster": {"brick": brick}}}


def drawn(path: str, size: int, look: dict[str, Any], frames: int) -> tuple[np.ndarray, dict[str, Any]]:
    """The picture, and what it took."""
    source, context = open_source(path, None), open_context()
    plan, bricks = planned(path, source, (0.0, 1.0), size, look)
    caster = Raycaster(context, plan)
    box = build_tree(plan.cost, 1).leaves[0].trimmed
    caster.load(plan, {index: voxels for index, voxels in bricks.items() if plan.cost[index] > 0})
    found = [caster.draw(plan, [Piece(0, box, None)])[0] for _ in range(frames + 1)]
    costs = {
        "voxel_bytes": caster.voxel_bytes,
        "samples": found[0].samples,
        "seconds": median(each.seconds_render for each in found[1:]),
    }
    rgba = np.zeros((size, size, 4))
    rect = found[0].partial.rect
    rgba[rect.y_begin : rect.y_end, rect.x_begin : rect.x_end] = found[0].partial.rgba
    caster.release()
    return rgba, costs


def main() -> None:
    """Print the table, and write it as JSON on request."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", nargs="?", help="a data file; default: the sample mni152")
    parser.add_argument("--size", type=int, default=192)
    parser.add_argument("--frames", type=int, default=5)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    path = options.data or str(fetch_sample("mni152"))
    truth, _ = drawn(path, options.size, scene(64, "overlap", CONVERGED), 1)
    rows = []
    for brick in BRICKS:
        pictures = {}
        for borders in ("overlap", "split"):
            pictures[borders], costs = drawn(path, options.size, scene(brick, borders), options.frames)
            error = np.abs(pictures[borders] - truth)
            rows.append({"brick": brick, "borders": borders, **costs, "error_rms": float(np.sqrt(np.mean(error**2)))})
            rows[-1]["seam_max"] = float(np.abs(pictures[borders] - pictures["overlap"]).max())
    print(f"{path}, {options.size} × {options.size}, step 1; errors in 255ths")
    for row in rows:
        print(
            f"brick {row['brick']:4} {row['borders']:8} {row['voxel_bytes'] / 1e6:7.2f} MB {row['samples']:9,} samples "
            f"{1e3 * row['seconds']:6.1f} ms, from overlap max {255 * row['seam_max']:6.2f}, "
            f"from converged rms {255 * row['error_rms']:6.3f}"
        )
    if options.json:
        options.json.write_text(json.dumps({"data": path, "size": options.size, "rows": rows}, indent=2) + "\n")


if __name__ == "__main__":
    main()
