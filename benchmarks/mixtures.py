"""What several volumes in one picture cost: `python benchmarks/mixtures.py [DATA] [--size N] [--frames K] [--json F]`.

One rank, bricks in memory already, the CPU ray caster and OpenGL in turn so that a busy machine slows both alike;
of each the least CPU time of some frames, over that of the first volume alone. Volumes beside the data are made
by formula: a ball of waves, and the same turned and finer.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from blend_modes import whole_pieces

from clusterviz.comm import LoopbackChannel
from clusterviz.data import open_source
from clusterviz.data.memory import ArraySource
from clusterviz.data.samples import fetch_sample
from clusterviz.data.source import Grid, Source
from clusterviz.frame import Options, Run, prepare
from clusterviz.gl.context import open_context
from clusterviz.plan.plan import Plan
from clusterviz.render.cpu.caster import VectorCaster
from clusterviz.render.raycast import Raycaster
from clusterviz.scene.values import ImageSettings, Quality, Scene, Volume

WAVES = {"path": "waves", "cmap": "viridis", "clim": (20, 230), "opacity": ((20, 0.0), (120, 0.0), (230, 0.2))}
INTEGRATED = {"classification": "pre-integrated"}
SCENES: dict[str, tuple[int, dict[str, Any], dict[str, Any]]] = {
    "one": (1, {}, {}),
    "two": (2, {}, {}),
    "two, lit": (2, {"shade": True}, {}),
    "two, pre-integrated": (2, {}, INTEGRATED),
    "three": (3, {}, {}),
}
"""How many volumes, what is said of each beside its colours, and of quality."""


def sources(path: str) -> list[Source]:
    """The data, and what lies in the same place."""
    data = open_source(path, None)
    low, high = data.grid.corners.min(axis=0), data.grid.corners.max(axis=0)
    z, y, x = np.indices((128, 128, 128)) / 64 - 1
    waves = np.clip(128 + 127 * np.sin(12 * np.sqrt(x * x + y * y + z * z)), 0, 255).astype(np.uint8)
    cosine, sine = np.cos(0.6), np.sin(0.6)
    turned = ((cosine, -sine, 0.0), (sine, cosine, 0.0), (0.0, 0.0, 1.0))
    grids = []
    for share, direction in ((0.7, np.eye(3)), (0.5, np.array(turned))):
        spacing = share * float((high - low).min()) / 127
        origin = (low + high) / 2 - direction @ np.full(3, 63.5 * spacing)
        rows = tuple(tuple(row) for row in direction.tolist())
        grids.append(Grid(waves.shape, (spacing,) * 3, tuple(origin.tolist()), rows))
    return [data, *(ArraySource(waves, grid) for grid in grids)]


def prepared(path: str, every: Sequence[Source], size: int, name: str) -> tuple[Plan, dict[Any, Any]]:
    """The plan of a scene, and its bricks."""
    count, keys, quality = SCENES[name]
    each = every[:count]
    volumes = [Volume.model_validate(keys | told) for told in ({"path": path}, WAVES, WAVES)[:count]]
    scene = Scene(volumes=tuple(volumes), image=ImageSettings(size=(size, size)), quality=Quality(**quality))
    share, bricks = prepare(Run(LoopbackChannel(), Options()), scene, each)
    assert share.plan is not None, "there is something to show"
    return share.plan, bricks


def measure(path: str, size: int, frames: int) -> list[dict[str, Any]]:
    """Time all scenes on both casters, in turn."""
    context, every = open_context(), sources(path)
    casters: dict[tuple[str, str], tuple[Raycaster | VectorCaster, Plan]] = {}
    for name in SCENES:
        for kind in ("processor", "OpenGL"):
            plan, bricks = prepared(path, every, size, name)
            caster = VectorCaster(plan) if kind == "processor" else Raycaster(context, plan)
            caster.load(plan, bricks)
            casters[name, kind] = caster, plan
    least: dict[tuple[str, str], float] = {}
    samples: dict[tuple[str, str], int] = {}
    for _ in range(frames + 1):
        for key, (caster, plan) in casters.items():
            begin = process_time()
            (drawn,) = caster.draw(plan, whole_pieces(plan))
            least[key] = min(least.get(key, np.inf), process_time() - begin)
            samples[key] = drawn.samples
    return [
        {"volumes": name, "caster": kind, "least_s": seconds, "samples": samples[name, kind]}
        for (name, kind), seconds in least.items()
    ]


def main() -> None:
    """Print the table, and write it as JSON on request."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", nargs="?", help="a data file; default: the sample mni152")
    parser.add_argument("--size", type=int, default=384)
    parser.add_argument("--frames", type=int, default=4)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    path = options.data or str(fetch_sample("mni152"))
    rows = measure(path, options.size, options.frames)
    print(f"{path}, {options.size} × {options.size}; processor time of a frame")
    for here, there in zip(rows[::2], rows[1::2], strict=True):
        own, other = here["least_s"], there["least_s"]
        print(
            f"{here['volumes']:20} {1e3 * own:6.0f} ms {here['samples']:12,} samples, "
            f"{own / rows[0]['least_s']:5.2f} times one; OpenGL {1e3 * other:6.0f} ms {there['samples']:12,}: "
            f"{other / own:5.2f} times as long"
        )
    if options.json:
        options.json.write_text(json.dumps({"data": path, "size": options.size, "rows": rows}, indent=2) + "\n")


if __name__ == "__main__":
    main()
