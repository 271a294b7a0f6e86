"""Time and error against VTK's ray casters, on the GPU's interface and on the CPU.

    python benchmarks/vtk_raycast_ratio.py --python PYTHON_WITH_VTK [VOLUME.npy …] [--functions NAME …]

Runs of `vtk_peer.py` and of `clusterviz bench raycast` alternate, on the same volume, camera, transfer function and
step. VTK's Python may also be given by CLUSTERVIZ_PEER_PYTHON. `--device` is that of `clusterviz bench raycast`. VTK's
GPU caster ends a ray at an opacity of 1 − 1/255 and cannot be told otherwise; `--early-termination 0.0039` does the
same here. With `--our-step` we take another step than the peer: for comparing at equal error instead of equal step.

Errors are of colours over black from the picture without error, in levels of 255. That is found as `clusterviz
tradeoff` finds it: the step is halved until nothing changes, and the renderer is held to the float64 reference at a
small size; `known` is what is left of its own error. "pre-integrated" are slabs between whose ends the transfer
function is integrated. VTK's pictures have 8 bits: none can be nearer than "8 bits", the exact one rounded.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import tempfile
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from measuring import CLUSTERVIZ, PEER_PYTHON, Row, opened, options, output_of, sample, show, write
from vtk_mappers_ratio import Arrays, peer, scene_of, synthetic, with_meshes

from clusterviz.comm import LoopbackChannel
from clusterviz.frame import render_frame
from clusterviz.pages.tradeoff.ground_truth import find_ground_truth
from clusterviz.scene import Scene
from clusterviz.scene.overrides import with_settings

CASTERS = ("gpu", "cpu")
Points = tuple[tuple[float, float], ...]


def smooth() -> Points:
    """A bump over the upper half of the range, by 64 control points."""
    s = np.linspace(0, 255, 64)
    return tuple(zip(s.tolist(), (0.2 * np.exp(-(((s / 255 - 0.6) / 0.15) ** 2))).tolist(), strict=True))


def peaks(width: float) -> Points:
    """Three peaks, each so wide a part of the range."""
    half, places = 127.5 * width, ((0.35, 0.3), (0.55, 0.6), (0.8, 0.9))
    rows = [(255 * place + aside, alpha) for place, top in places for aside, alpha in ((-half, 0), (0, top), (half, 0))]
    return ((0.0, 0.0), *((value, float(alpha)) for value, alpha in rows), (255.0, 0.0))


FUNCTIONS: dict[str, Points] = {
    "ramp": ((0.0, 0.0), (60.0, 0.0), (120.0, 0.05), (255.0, 0.3)),
    "smooth": smooth(),
    "peaks, 4 %": peaks(0.04),
    "peaks, 2.5 %": peaks(0.025),
}


def arrays_of(voxels: Any, points: Points) -> Arrays:
    """A volume with unit spacing, seen from (1.3, 0.9, 1.6) · the longest side."""
    centre = (np.array(voxels.shape[::-1], float) - 1) / 2
    eye = centre + np.array([1.3, 0.9, 1.6]) * max(voxels.shape)
    value, opacity = np.array(points).T
    share = value[:, None] / 255
    colours = (1 - share) * np.array([0.1, 0.2, 0.6]) + share * np.array([1.0, 0.9, 0.4])
    look = {"value": value, "opacity": opacity, "rgb": colours, "unit": 1.0}
    lattice = {"voxels": voxels, "spacing": np.ones(3), "origin": np.zeros(3)}
    return with_meshes(eye.tolist(), **look, **lattice) | {"focal_point": centre.tolist(), "view_up": [0, 1, 0]}


def volumes_of(given: list[Path], folder: Path, *names: str) -> dict[str, Path]:
    """The volumes that are named, or else a ball of waves and samples, as .npy files."""
    if given:
        return {path.stem: path for path in given}
    found = {name: folder / f"{name}.npy" for name in ("synthetic", *names)}
    np.save(found["synthetic"], synthetic(256))
    for name in names:
        np.save(found[name], opened(sample(name=name))[1])
    return found


def ours(scene: Scene, step: float) -> Any:
    """float64 (h, w, 4): drawn on one rank."""
    return np.asarray(render_frame(with_settings(scene, {"step": step}), LoopbackChannel()).image, np.float64)


def errors_of(scene: Scene, pictures: dict[str, Any], step: float, budget: float) -> Iterator[tuple[str, float, float]]:
    """What rms and largest error pictures (h, w, 3) have, and ours, and what is known of the exact one."""
    complete = render_frame(scene, LoopbackChannel()).scene
    exact = with_settings(complete, {"classification": "pre-integrated", "early_termination": 0.0})
    truth = find_ground_truth(exact, ours, budget)
    black = truth.picture[..., :3]
    for name in ("post", "pre-integrated"):
        pictures[name] = ours(with_settings(complete, {"classification": name}), step)[..., :3]
    for name, picture in (pictures | {"8 bits": np.rint(255 * black) / 255}).items():
        yield name, float(np.sqrt(np.mean((picture - black) ** 2))), float(np.abs(picture - black).max())
    yield "known", truth.rms, truth.max


def measured(volume: str, path: Path, function: str, asked: argparse.Namespace) -> Iterator[Row]:
    """A row for each program, and the errors of other pictures."""
    voxels, device = np.load(path, mmap_mode="r"), ["--device", asked.device] if asked.device else []
    step, size = asked.our_step or asked.step, (asked.width, asked.width)
    arrays = arrays_of(np.asarray(voxels), FUNCTIONS[function])
    how = {"path": str(path), "step": step, "early_termination": asked.early_termination, "brick": asked.brick}
    one = with_settings(scene_of(arrays, asked.width)[0], how)
    seconds: dict[str, list[float]] = {name: [] for name in ("post", *CASTERS)}
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        scene, report, given = folder / "scene.json", folder / "report.json", folder / "scene.npz"
        scene.write_text(one.model_dump_json())
        np.savez(given, **arrays, step=asked.step)
        for _ in range(asked.rounds):
            for caster in CASTERS:
                told = peer(asked.python, given, caster, size, asked.frames, folder / f"{caster}.npy")
                seconds[caster].append(told["median_s"])
            output_of([*CLUSTERVIZ, "bench", "raycast", scene, "--frames", asked.frames, "--json", report, *device])
            told = json.loads(report.read_text())
            seconds["post"].append(told["median_s"])
        pictures = {name: np.load(folder / f"{name}.npy") for name in CASTERS}
    for name, rms, largest in errors_of(one, pictures, step, asked.budget):
        row: Row = {"volume": volume, "function": function, "program": name, "rms": rms, "max": largest}
        if name in seconds:
            ratios = [theirs / own for own, theirs in zip(seconds["post"], seconds[name], strict=True)]
            row |= {"s": statistics.median(seconds[name]), "times": statistics.median(ratios)}
        if name == "post":
            row |= {"samples": told["samples"], "rate": told["samples"] / row["s"] / len(os.sched_getaffinity(0))}
        yield row | {"load": os.getloadavg()[0]}


def main() -> None:
    asked = options(
        __doc__,
        volumes={"names": ["volumes"], "nargs": "*", "type": Path, "help": ".npy files of uint8 (z, y, x)"},
        python=PEER_PYTHON,
        functions={"nargs": "+", "choices": FUNCTIONS, "default": ["ramp"]},
        width=512,
        device={"help": "as of clusterviz bench raycast; default: what is best"},
        step={"type": float, "default": 1.0, "help": "in voxels, of both"},
        our_step={"type": float, "help": "ours, where it is another"},
        early_termination={"type": float, "default": 0.0, "help": "VTK's own is 1/255; ours: 0, never"},
        brick={"type": int, "default": 64, "help": "voxels along the side of ours; one rank needs only one"},
        rounds=3,
        frames=5,
        budget={"type": float, "default": 40.0, "help": "seconds for each picture without error"},
    )
    head = "volume | function | program | ms | times ours | rms error | largest | million samples a second and core"
    cells = "{volume} | {function} | {program} | {s!m:.1f} | {times:.2f} | {rms!l:.3f} | {max!l:.1f} | {rate!M:.0f}"
    with tempfile.TemporaryDirectory() as folder:
        volumes = volumes_of(asked.volumes, Path(folder), "mni152")
        cases = product(volumes.items(), asked.functions)
        write(asked, rows=show(head, cells, (row for one, f in cases for row in measured(*one, f, asked))))


if __name__ == "__main__":
    main()
