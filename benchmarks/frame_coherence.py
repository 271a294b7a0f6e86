"""Samples and time that frame coherence saves, and its errors.

    python benchmarks/frame_coherence.py [DATA] [--size N] [--device D]

An orbit of a few frames on one rank, drawn twice frame by frame in turn: every ray from where it enters the volume, and
each just before what the last frame's rays found there. Samples, CPU time, the largest difference of a pixel,
pixels that differ by more than 1/255, and what is told of both, by degrees from frame to frame; the first frame, which
has no last one, is not counted.
"""

from __future__ import annotations

import argparse
import json
from contextlib import ExitStack
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from clusterviz.comm.open import open_channel
from clusterviz.data.samples import fetch_sample
from clusterviz.frame import FrameLoop
from clusterviz.frame.run import Options
from clusterviz.render.choice import Device
from clusterviz.report.frame_coherence import FrameCoherence, together
from clusterviz.scene import Scene, scene_of_data
from clusterviz.scene.animation import orbit

FRAMES = 8
DEGREES = (0.5, 2.0)
STEEP = {"clim": (40.0, 220.0), "opacity": ((60.0, 0.0), (100.0, 0.04), (140.0, 0.25), (220.0, 0.7))}
SPARSE = {"clim": (0.0, 1.0), "opacity": ((0.0, 0.0), (0.6, 0.0), (0.7, 0.5), (1.0, 0.9))}
SURFACE = {"clim": (40.0, 220.0), "blending": "isosurface", "isosurfaces": ((140.0, 1.0),), "shade": True}
SURFACES = {"clim": (40.0, 220.0), "blending": "isosurface", "isosurfaces": ((100.0, 0.4), (160.0, 0.6))}
WIRES = {"clim": (0.0, 1.0), "opacity": ((0.0, 0.0), (0.5, 0.0), (0.6, 0.5), (1.0, 0.9))}
THIN = {"blending": "isosurface", "isosurfaces": ((0.6, 1.0),)}
ENDS = {"early_termination": 1 / 255}


def scene_with(volumes: list[dict[str, Any]], size: int, quality: dict[str, Any]) -> Scene:
    """A scene without frame coherence."""
    data = scene_of_data(volumes[0]["path"]).model_dump(exclude_unset=True)
    data |= {"volumes": volumes, "image": {"size": (size, size)}, "quality": quality}
    return Scene.model_validate(data)


def stent(folder: str, size: int = 128) -> str:
    """A file of twelve helices that cross: wires of a third of a voxel, of which voxels hold beads."""
    volume, turn = np.zeros((size, size, size), np.float32), np.linspace(0.0, 1.0, 24 * size)
    near = np.stack(np.meshgrid(*[np.arange(-1, 3)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    for strand in range(6):
        for way in (-1, 1):
            angle = 2 * np.pi * (2 * way * turn + strand / 6)
            ring = [0.5 + 0.33 * wave(angle) for wave in (np.sin, np.cos)]
            places = size * np.stack([0.08 + 0.84 * turn, *ring], axis=1)
            voxels = np.floor(places).astype(int)[:, None] + near
            apart = ((voxels - places[:, None]) ** 2).sum(axis=2)
            np.maximum.at(volume, tuple(voxels.reshape(-1, 3).T), np.exp(-apart / (2 * 0.35**2)).ravel())
    np.save(path := f"{folder}/stent.npy", volume)
    return path


def measure(scene: Scene, degrees: float, device: Device) -> dict[str, float]:
    """Both ways along an orbit."""
    frames: list[tuple[dict[str, Any], ...]] = []
    with ExitStack() as stack:
        loops = []
        for frame_coherence in (False, True):
            quality = scene.quality.model_copy(update={"frame_coherence": frame_coherence})
            one = scene.model_copy(update={"quality": quality})
            loops.append(stack.enter_context(FrameLoop(one, open_channel(), options=Options(device=device))))
        first = [loop.frame().scene for loop in loops]
        for number, camera in enumerate(orbit(first[0].camera, degrees * FRAMES, FRAMES + 1)[1:], 1):
            turned = [one.model_copy(update={"camera": camera}) for one in first]
            frames.append(tuple(drawn(loop, one, number) for loop, one in zip(loops, turned, strict=True)))
    apart = [np.abs(plain["image"] - frame_coherence["image"]).max(axis=2) for plain, frame_coherence in frames]
    told = together(frame_coherence["told"] for _, frame_coherence in frames) or FrameCoherence()
    return {
        "samples": median(plain["samples"] for plain, _ in frames),
        "samples_leaping": median(frame_coherence["samples"] for _, frame_coherence in frames),
        "seconds": median(plain["seconds"] for plain, _ in frames),
        "seconds_leaping": median(frame_coherence["seconds"] for _, frame_coherence in frames),
        "seconds_ratio": median(frame_coherence["seconds"] / plain["seconds"] for plain, frame_coherence in frames),
        "max": max(float(one.max()) for one in apart),
        "wrong": sum(int((one > 1 / 255).sum()) for one in apart),
        "told_max": told.error,
        "told_wrong_at_most": told.wrong_at_most,
    }


def drawn(loop: FrameLoop, scene: Scene, number: int) -> dict[str, Any]:
    """One frame, and the CPU time of drawing it."""
    found = loop.frame(scene, number)
    (rank,) = found.statistics.per_rank
    return {"image": found.image, "samples": rank.samples, "seconds": rank.cpu_seconds, "told": rank.frame_coherence}


def scenes_of(head: str, folder: str) -> dict[str, tuple[list[dict[str, Any]], dict[str, Any]]]:
    """Volumes and quality by name."""
    cortex, orbital = {"path": head, **STEEP}, {"path": "field:hydrogen:192", **SPARSE}
    beside = {"spacing": (0.8,) * 3, "origin": (-120.0, -120.0, -70.0)}
    return {
        "head, cortex": ([cortex], {}),
        "head, cortex, rays end": ([cortex], ENDS),
        "head, pre-integrated": ([cortex], {"classification": "pre-integrated"}),
        "head, surface": ([{"path": head, **SURFACE}], ENDS),
        "head, two surfaces": ([{"path": head, **SURFACES}], {}),
        "hydrogen, 192³": ([orbital], {}),
        "head and hydrogen": ([cortex, orbital | beside], ENDS),
        "stent, 128³": ([{"path": stent(folder), **WIRES}], {}),
        "stent, surface": ([{"path": f"{folder}/stent.npy", **WIRES, **THIN}], {}),
    }


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
    columns = f"{'degrees':>7} {'samples':>11} {'frame_coherence':>11} {'share':>6} {'time':>6} {'max':>8} {'wrong':>6}"
    print(f"{'scene':24} {columns} {'told max':>8} {'wrong':>6}")
    rows = []
    with TemporaryDirectory() as folder:
        for name, (volumes, quality) in scenes_of(head, folder).items():
            scene = scene_with(volumes, options.size, quality)
            for degrees in options.degrees:
                row = measure(scene, degrees, device)
                rows.append({"scene": name, "degrees": degrees, **row})
                share = row["samples_leaping"] / row["samples"]
                counted = f"{row['samples']:11,.0f} {row['samples_leaping']:11,.0f} {share:6.3f}"
                errors = f"{row['max']:8.1e} {row['wrong']:6} {row['told_max']:8.1e} {row['told_wrong_at_most']:6}"
                print(f"{name:24} {degrees:7.2f} {counted} {row['seconds_ratio']:6.2f} {errors}", flush=True)
    if options.json:
        options.json.write_text(json.dumps({"data": head, "size": options.size, "rows": rows}, indent=2) + "\n")


if __name__ == "__main__":
    main()
