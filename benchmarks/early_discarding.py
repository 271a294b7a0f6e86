"""Fragments and time that early discarding saves, and its errors.

    python benchmarks/early_discarding.py [--size N] [--device D] [--margins M ...]

An orbit of a few frames on one rank, drawn twice frame by frame in turn: all fragments are stored, or only those that
are not well behind the depths at which the last frame's rays ended. Fragments stored, pixels drawn again, CPU time
(medians of the frames) and the largest difference of a pixel; the first frame, which has no last one, is not counted.
"""

from __future__ import annotations

import argparse
import json
from contextlib import ExitStack
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from clusterviz.comm.open import open_channel
from clusterviz.data.geometry import Geometry, Mesh
from clusterviz.data.samples import fetch_sample
from clusterviz.frame import FrameLoop
from clusterviz.frame.run import Options
from clusterviz.render.choice import Device
from clusterviz.scene import Scene
from clusterviz.scene.animation import orbit

FRAMES = 6
LAYERS = 64
FIBRES = {"path": str(fetch_sample("fibres")), "radius": 0.4, "color_by": "direction"}


def layers() -> Mesh:
    """Waves above one another, of 64 × 64 squares."""
    side = np.linspace(-1.0, 1.0, 65)
    x, y, z = np.meshgrid(side, side, np.linspace(-0.5, 0.5, LAYERS), indexing="ij")
    z = z + 0.1 * np.sin(3 * x) * np.cos(2 * y)
    number = np.arange(x.size).reshape(x.shape)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    triangles = [np.stack(each, axis=-1).reshape(-1, 3) for each in ((a, b, c), (a, c, d))]
    return Mesh("layers", np.stack([x, y, z], axis=-1).reshape(-1, 3).astype(np.float32), np.concatenate(triangles))


def scenes_of() -> dict[str, tuple[dict[str, Any], Any, float]]:
    """Sections of a scene, what is given for them, and a unit of the margin, by name."""
    pial = [{"path": str(fetch_sample(f"pial-{side}")), "opacity": 0.5} for side in ("left", "right")]
    head = [{"path": str(fetch_sample(f"cranium-{of}")), "opacity": 0.5} for of in ("skin", "bone")]
    wave = [{"path": "layers", "opacity": 0.5}]
    return {
        "fibres, opacity 0.5": ({"lines": [FIBRES | {"opacity": 0.5}]}, None, 1.0),
        "fibres within the cortex": ({"meshes": pial, "lines": [FIBRES | {"opacity": 0.5}]}, None, 1.0),
        "fibres, opacity 0.05": ({"lines": [FIBRES | {"opacity": 0.05}]}, None, 1.0),
        "skull and skin": ({"meshes": head}, None, 1.0),
        f"{LAYERS} layers, opacity 0.5": ({"meshes": wave}, Geometry(mesh=layers()), 0.01),
        f"{LAYERS} layers, opacity 0.1": ({"meshes": [wave[0] | {"opacity": 0.1}]}, Geometry(mesh=layers()), 0.01),
    }


def measure(scene: Scene, given: Any, margin: float, degrees: float, device: Device) -> dict[str, float]:
    """Both ways along an orbit."""
    frames = []
    with ExitStack() as stack:
        loops = []
        for one in (None, margin):
            quality = scene.quality.model_copy(update={"early_discarding": one})
            shown = scene.model_copy(update={"quality": quality})
            loops.append(
                stack.enter_context(FrameLoop(shown, open_channel(), given, Options(device=device, keep_drawn=True)))
            )
        first = [loop.frame().scene for loop in loops]
        for number, camera in enumerate(orbit(first[0].camera, degrees * FRAMES, FRAMES + 1)[1:], 1):
            turned = [one.model_copy(update={"camera": camera}) for one in first]
            frames.append(tuple(drawn(loop, one, number) for loop, one in zip(loops, turned, strict=True)))
    return {
        "fragments": median(plain["fragments"] for plain, _ in frames),
        "stored": median(own["fragments"] for _, own in frames),
        "pixels": median(own["told"].pixels for _, own in frames),
        "redrawn": median(own["told"].redrawn for _, own in frames),
        "seconds": median(plain["seconds"] for plain, _ in frames),
        "seconds_ratio": median(own["seconds"] / plain["seconds"] for plain, own in frames),
        "max": max(float(np.abs(plain["image"] - own["image"]).max()) for plain, own in frames),
    }


def drawn(loop: FrameLoop, scene: Scene, number: int) -> dict[str, Any]:
    """One frame, its fragments, and the CPU time of drawing it."""
    found = loop.frame(scene, number)
    (rank,) = found.statistics.per_rank
    assert found.drawn, "the loop keeps it"
    fragments = sum(int(one.sum()) for one in found.drawn.fragments)
    return {
        "image": found.image,
        "fragments": fragments,
        "seconds": rank.cpu_seconds,
        "told": rank.early_discarding,
    }


def main() -> None:
    """Print the table, and write it as JSON on request."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--degrees", type=float, nargs="*", default=(0.5, 2.0), help="from frame to frame")
    parser.add_argument("--margins", type=float, nargs="*", default=(2.0,), help="millimetres, or 1/100 of the layers")
    parser.add_argument("--only", default="", help="part of the names of the scenes")
    parser.add_argument("--device", default="cpu", help="cpu, or the index of an EGL device, which OpenGL draws on")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    device: Device = "cpu" if options.device == "cpu" else int(options.device)
    columns = (
        f"{'fragments':>11} {'stored':>11} {'share':>6} {'pixels':>7} {'again':>6} {'s':>6} {'time':>6} {'max':>8}"
    )
    print(f"{'scene':26} {'margin':>6} {'degrees':>7} {columns}")
    rows = []
    for name, (sections, given, unit) in scenes_of().items():
        if options.only not in name:
            continue
        data = {"image": {"size": (options.size, options.size)}, "quality": {"early_termination": 1 / 255}}
        scene = Scene.model_validate(sections | data)
        for margin in options.margins:
            for degrees in options.degrees:
                row = measure(scene, given, margin * unit, degrees, device)
                rows.append({"scene": name, "margin": margin * unit, "degrees": degrees, **row})
                counted = f"{row['fragments']:11,.0f} {row['stored']:11,.0f} {row['stored'] / row['fragments']:6.3f}"
                again = (
                    f"{row['pixels']:7,.0f} {row['redrawn']:6,.0f} {row['seconds']:6.2f} {row['seconds_ratio']:6.2f}"
                )
                print(f"{name:26} {margin * unit:6.2f} {degrees:7.2f} {counted} {again} {row['max']:8.1e}", flush=True)
    if options.json:
        options.json.write_text(json.dumps({"size": options.size, "rows": rows}, indent=2) + "\n")


if __name__ == "__main__":
    main()
