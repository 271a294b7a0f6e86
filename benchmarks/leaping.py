"""What starting rays by the last frame saves, and errs: `python benchmarks/leaping.py [DATA] [--size N] [--device D]`.

An orbit of a few frames on one rank, drawn twice frame by frame in turn: every ray from where it enters the volume, and
each just before what the last frame's rays found there. Samples, processor time and the largest difference of a pixel,
by degrees from frame to frame; the first frame, which has no last one, is not counted.
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
from clusterviz.data.samples import fetch_sample
from clusterviz.frame import FrameLoop
from clusterviz.frame.run import Options
from clusterviz.render.choice import Device
from clusterviz.scene import Scene, scene_of_data
from clusterviz.scene.animation import orbit

FRAMES = 8
DEGREES = (0.5, 2.0)
STEEP = {"clim": (40.0, 220.0), "opacity": ((60.0, 0.0), (100.0, 0.04), (140.0, 0.25), (220.0, 0.7))}
SPARSE = {"clim": (0.0, 1.0), "opacity": ((0.0, 0.0), (0.6, 0.0), (0.7, 0.5), (1.0, 0.9))}


def scene_with(path: str, size: int, volume: dict[str, Any], quality: dict[str, Any]) -> Scene:
    """A scene without leaping."""
    data = scene_of_data(path).model_dump(exclude_unset=True)
    data["volumes"] = [{"path": path, **volume}]
    data |= {"image": {"size": (size, size)}, "quality": quality}
    return Scene.model_validate(data)


def measure(scene: Scene, degrees: float, device: Device) -> dict[str, float]:
    """Both ways along an orbit."""
    frames: list[tuple[dict[str, Any], ...]] = []
    with ExitStack() as stack:
        loops = []
        for leaping in (False, True):
            quality = scene.quality.model_copy(update={"leaping": leaping})
            one = scene.model_copy(update={"quality": quality})
            loops.append(stack.enter_context(FrameLoop(one, open_channel(), options=Options(device=device))))
        first = [loop.frame().scene for loop in loops]
        for number, camera in enumerate(orbit(first[0].camera, degrees * FRAMES, FRAMES + 1)[1:], 1):
            turned = [one.model_copy(update={"camera": camera}) for one in first]
            frames.append(tuple(drawn(loop, one, number) for loop, one in zip(loops, turned, strict=True)))
    apart = [np.abs(plain["image"] - leaping["image"]).max(axis=2) for plain, leaping in frames]
    return {
        "samples": median(plain["samples"] for plain, _ in frames),
        "samples_leaping": median(leaping["samples"] for _, leaping in frames),
        "seconds": median(plain["seconds"] for plain, _ in frames),
        "seconds_leaping": median(leaping["seconds"] for _, leaping in frames),
        "seconds_ratio": median(leaping["seconds"] / plain["seconds"] for plain, leaping in frames),
        "max": max(float(one.max()) for one in apart),
        "pixels_wrong": max(float((one > 1 / 255).mean()) for one in apart),
    }


def drawn(loop: FrameLoop, scene: Scene, number: int) -> dict[str, Any]:
    """One frame, and the processor time of drawing it."""
    found = loop.frame(scene, number)
    (rank,) = found.statistics.per_rank
    return {"image": found.image, "samples": rank.samples, "seconds": rank.cpu_seconds}


def main() -> None:
    """Print the table, and write it as JSON on request."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", nargs="?", help="a head like that of the sample mni152, which is the default")
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--degrees", type=float, nargs="*", default=DEGREES, help="from frame to frame")
    parser.add_argument("--device", default="cpu", help="cpu, or the index of an EGL device, which OpenGL draws on")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    device: Device = "cpu" if options.device == "cpu" else int(options.device)
    head = options.data or str(fetch_sample("mni152"))
    scenes: dict[str, tuple[str, dict[str, Any], dict[str, Any]]] = {
        "head, cortex": (head, STEEP, {}),
        "head, cortex, rays end": (head, STEEP, {"early_termination": 1 / 255}),
        "head, pre-integrated": (head, STEEP, {"classification": "pre-integrated"}),
        "hydrogen, 192³": ("field:hydrogen:192", SPARSE, {}),
    }
    columns = f"{'degrees':>7} {'samples':>11} {'leaping':>11} {'share':>6} {'time':>6} {'max':>8} {'pixels':>8}"
    print(f"{'scene':24} {columns}")
    rows = []
    for name, (path, volume, quality) in scenes.items():
        scene = scene_with(path, options.size, volume, quality)
        for degrees in options.degrees:
            row = measure(scene, degrees, device)
            rows.append({"scene": name, "degrees": degrees, **row})
            share = row["samples_leaping"] / row["samples"]
            counted = f"{row['samples']:11,.0f} {row['samples_leaping']:11,.0f} {share:6.3f}"
            errors = f"{row['max']:8.1e} {row['pixels_wrong']:8.1e}"
            print(f"{name:24} {degrees:7.2f} {counted} {row['seconds_ratio']:6.2f} {errors}", flush=True)
    if options.json:
        options.json.write_text(json.dumps({"data": head, "size": options.size, "rows": rows}, indent=2) + "\n")


if __name__ == "__main__":
    main()
