"""What several volumes in one picture cost: `python benchmarks/mixtures.py [DATA] [--size N] [--frames K] [--json F]`.

One rank, bricks in memory already, the CPU ray caster and OpenGL in turn so that a busy machine slows both alike;
of each the least CPU time of some frames, over that of the first volume alone. Volumes beside the data are made
by formula: a ball of waves, and the same turned and finer.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from measuring import Row, alternate, loaded, opened, options, positional, prepared, sample, show, whole_pieces, write

from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid
from clusterviz.scene import Scene

WAVES = {"path": "waves", "cmap": "viridis", "clim": (20, 230), "opacity": ((20, 0.0), (120, 0.0), (230, 0.2))}
SCENES: dict[str, tuple[int, dict[str, Any], dict[str, Any]]] = {
    "one": (1, {}, {}),
    "two": (2, {}, {}),
    "two, lit": (2, {"shade": True}, {}),
    "two, pre-integrated": (2, {}, {"classification": "pre-integrated"}),
    "three": (3, {}, {}),
}
"""How many volumes, what is said of each beside its colours, and of quality."""


def sources(path: str) -> list[Any]:
    """The data, and what lies in the same place."""
    data, _ = opened(path)
    low, high = data.grid.corners.min(axis=0), data.grid.corners.max(axis=0)
    z, y, x = np.indices((128, 128, 128)) / 64 - 1
    waves = np.clip(128 + 127 * np.sin(12 * np.sqrt(x * x + y * y + z * z)), 0, 255).astype(np.uint8)
    cosine, sine = np.cos(0.6), np.sin(0.6)
    turned, found = np.array(((cosine, -sine, 0.0), (sine, cosine, 0.0), (0.0, 0.0, 1.0))), [data]
    for share, direction in ((0.7, np.eye(3)), (0.5, turned)):
        spacing = share * float((high - low).min()) / 127
        origin = (low + high) / 2 - direction @ np.full(3, 63.5 * spacing)
        rows = tuple(tuple(row) for row in direction.tolist())
        found.append(ArraySource(waves, Grid(waves.shape, (spacing,) * 3, tuple(origin.tolist()), rows)))
    return found


def measured(path: str, size: int, frames: int) -> Iterator[Row]:
    """Time all scenes on both casters, in turn."""
    every, ways = sources(path), {}
    for name, (count, keys, quality) in SCENES.items():
        volumes = [keys | told for told in ({"path": path}, WAVES, WAVES)[:count]]
        scene = Scene.model_validate({"volumes": volumes, "image": {"size": (size, size)}, "quality": quality})
        for device in ("cpu", 0):
            plan, bricks = prepared(scene, every[:count])
            caster = loaded(plan, bricks, device)
            ways[name, device] = lambda caster=caster, plan=plan: caster.draw(plan, whole_pieces(plan))[0]
    runs = alternate(ways, frames)
    least = {key: min(run.cpu for run in each) for key, each in runs.items()}
    for name in SCENES:
        cpu, gl = least[name, "cpu"], least[name, 0]
        row = {"volumes": name, "cpu": cpu, "gl": gl, "times": cpu / least["one", "cpu"], "ratio": gl / cpu}
        yield row | {"samples": runs[name, "cpu"][0].value.samples}


def main() -> None:
    """Print the table."""
    asked = options(__doc__, data=positional("data", help="default: the sample mni152"), size=384, frames=4)
    path = sample(asked.data)
    head = "volumes | CPU, ms | times one | samples | OpenGL, ms | times CPU"
    cells = "{volumes} | {cpu!m:.0f} | {times:.2f} | {samples:,} | {gl!m:.0f} | {ratio:.2f}"
    write(asked, rows=show(head, cells, measured(path, asked.size, asked.frames), f"{path}, {asked.size}², CPU time"))


if __name__ == "__main__":
    main()
