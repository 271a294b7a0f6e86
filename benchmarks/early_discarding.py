"""Fragments and time that early discarding saves, and its errors.

    python benchmarks/early_discarding.py [--size N] [--device D] [--margins M ...]

An orbit of a few frames on one rank, drawn twice frame by frame in turn: all fragments are stored, or only those that
are not well behind the depths at which the last frame's rays ended. Fragments stored, pixels drawn again, CPU time
(medians of the frames) and the largest difference of a pixel; the first frame, which has no last one, is not counted.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from statistics import median
from typing import Any

import numpy as np
from measuring import Row, beside_orbit, options, sample, show, write

from clusterviz.cli.arguments import parse_device
from clusterviz.data.geometry import Geometry, Mesh
from clusterviz.scene import Scene
from clusterviz.scene.overrides import with_settings

FRAMES, LAYERS = 6, 64


def layers() -> Geometry:
    """Waves above one another, of 64 × 64 squares."""
    side = np.linspace(-1.0, 1.0, 65)
    x, y, z = np.meshgrid(side, side, np.linspace(-0.5, 0.5, LAYERS), indexing="ij")
    z = z + 0.1 * np.sin(3 * x) * np.cos(2 * y)
    number = np.arange(x.size).reshape(x.shape)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    triangles = np.concatenate([np.stack(each, axis=-1).reshape(-1, 3) for each in ((a, b, c), (a, c, d))])
    points = np.stack([x, y, z], axis=-1).reshape(-1, 3).astype(np.float32)
    return Geometry(mesh=Mesh("layers", points, triangles))


def scenes_of() -> dict[str, tuple[dict[str, Any], Any, float]]:
    """Sections of a scene, what is given for them, and a unit of the margin, by name."""
    fibres = {"path": sample(name="fibres"), "radius": 0.4, "color_by": "direction"}
    pial = [{"path": sample(name=f"pial-{side}"), "opacity": 0.5} for side in ("left", "right")]
    head = [{"path": sample(name=f"cranium-{of}"), "opacity": 0.5} for of in ("skin", "bone")]
    found: dict[str, tuple[dict[str, Any], Any, float]] = {
        "fibres, opacity 0.5": ({"lines": [fibres | {"opacity": 0.5}]}, None, 1.0),
        "fibres within the cortex": ({"meshes": pial, "lines": [fibres | {"opacity": 0.5}]}, None, 1.0),
        "fibres, opacity 0.05": ({"lines": [fibres | {"opacity": 0.05}]}, None, 1.0),
        "skull and skin": ({"meshes": head}, None, 1.0),
    }
    for opacity in (0.5, 0.1):
        wave = {"path": "layers", "opacity": opacity}
        found[f"{LAYERS} layers, opacity {opacity}"] = ({"meshes": [wave]}, layers(), 0.01)
    return found


def noted(found: Any) -> Row:
    """One frame, its fragments, and the CPU time of drawing it."""
    (rank,) = found.statistics.per_rank
    fragments = sum(int(one.sum()) for one in found.drawn.fragments)
    return {"image": found.image, "fragments": fragments, "s": rank.cpu_seconds, "told": rank.early_discarding}


def measured(asked: Any) -> Iterator[Row]:
    """A row for each scene, margin and angle."""
    for name, (sections, given, unit) in scenes_of().items():
        if asked.only not in name:
            continue
        data = {"image": {"size": (asked.size, asked.size)}, "quality": {"early_termination": 1 / 255}}
        scene = Scene.model_validate(sections | data)
        for margin, degrees in product(asked.margins, asked.degrees):
            ways = [with_settings(scene, {"early_discarding": one}) for one in (None, margin * unit)]
            frames = list(beside_orbit(ways, given, degrees, FRAMES, noted, device=asked.device, keep_drawn=True))
            fragments, stored = (median(each[n]["fragments"] for each in frames) for n in (0, 1))
            yield {
                "scene": name,
                "margin": margin * unit,
                "degrees": degrees,
                "fragments": fragments,
                "stored": stored,
                "share": stored / fragments,
                "pixels": median(own["told"].pixels for _, own in frames),
                "again": median(own["told"].redrawn for _, own in frames),
                "s": median(plain["s"] for plain, _ in frames),
                "ratio": median(own["s"] / plain["s"] for plain, own in frames),
                "max": max(float(np.abs(plain["image"] - own["image"]).max()) for plain, own in frames),
            }


def main() -> None:
    """Print the table."""
    margins = {"type": float, "nargs": "*", "default": [2.0], "help": "millimetres, or 1/100 of the layers"}
    device = {"type": parse_device, "default": "cpu", "help": "cpu, or the index of an EGL device"}
    asked = options(__doc__, size=512, degrees=[0.5, 2.0], margins=margins, only="", device=device)
    head = "scene | margin | degrees | fragments | stored | share | pixels | again | s | time | max"
    cells = "{scene} | {margin:.2f} | {degrees:g} | {fragments:,.0f} | {stored:,.0f} | {share:.3f} | {pixels:,.0f} | "
    rows = show(head, cells + "{again:,.0f} | {s:.2f} | {ratio:.2f} | {max:.1e}", measured(asked))
    write(asked, rows=rows)


if __name__ == "__main__":
    main()
