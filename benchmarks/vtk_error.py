"""How far VTK's ray casters and this one are from the picture without error, at the same step.

    python benchmarks/vtk_error.py --python PYTHON_WITH_VTK [VOLUME.npy …] [--functions smooth …] [--step 1] [--json F]

Each volume is drawn with a smooth transfer function and with three narrow peaks of opacity, by VTK's GPU and CPU
casters (`vtk_peer.py`), and here with samples classified at midpoints and between the ends of slabs. The picture
without error is found as `clusterviz tradeoff` finds it: the step is halved until nothing changes, and the renderer is
held to the float64 reference at a small size; `known` is what is left of its own error. VTK's pictures have 8 bits, so
"8 bits" is what rounding the picture without error would cost, and no picture of 8 bits can be nearer. Errors are of
colours over black, in levels of 255.
"""

from __future__ import annotations

import argparse
import tempfile
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from measuring import PEER_PYTHON, Row, options, show, write
from vtk_raycast_ratio import CASTERS, equivalent_scene, peer, volumes_of, write_peer_scene

from clusterviz.comm import LoopbackChannel
from clusterviz.frame import render_frame
from clusterviz.pages.tradeoff.ground_truth import find_ground_truth
from clusterviz.scene import Scene
from clusterviz.scene.overrides import with_settings


def smooth() -> tuple[tuple[float, float], ...]:
    """A bump over the upper half of the range, by 64 control points."""
    s = np.linspace(0, 255, 64)
    return tuple(zip(s.tolist(), (0.2 * np.exp(-(((s / 255 - 0.6) / 0.15) ** 2))).tolist(), strict=True))


def peaks(width: float) -> tuple[tuple[float, float], ...]:
    """Three peaks, each so wide a part of the range."""
    half, places = 127.5 * width, ((0.35, 0.3), (0.55, 0.6), (0.8, 0.9))
    rows = [(255 * place + aside, alpha) for place, top in places for aside, alpha in ((-half, 0), (0, top), (half, 0))]
    return ((0.0, 0.0), *((value, float(alpha)) for value, alpha in rows), (255.0, 0.0))


FUNCTIONS = {"smooth": smooth(), "peaks, 4 %": peaks(0.04), "peaks, 2.5 %": peaks(0.025)}


def ours(scene: Scene, step: float) -> Any:
    """float64 (h, w, 4): drawn on one rank."""
    return np.asarray(render_frame(with_settings(scene, {"step": step}), LoopbackChannel()).image, np.float64)


def measure(volume: str, path: Path, function: str, asked: argparse.Namespace) -> Row:
    """One volume and one transfer function: rms and largest errors."""
    voxels = np.load(path, mmap_mode="r")
    scene = equivalent_scene(path, voxels.shape, asked.width, asked.step)
    scene = render_frame(with_settings(scene, {"opacity": FUNCTIONS[function]}), LoopbackChannel()).scene
    truth = find_ground_truth(with_settings(scene, {"classification": "pre-integrated"}), ours, asked.budget)
    black, drawn = truth.picture[..., :3], {}
    with tempfile.TemporaryDirectory() as folder:
        given, out = Path(folder) / "scene.npz", Path(folder) / "picture.npy"
        write_peer_scene(given, scene, voxels, asked.step)
        for caster in CASTERS:
            peer(asked.python, given, caster, scene.image.size, 0, out)
            drawn[caster] = np.load(out)
    for name in ("post", "pre-integrated"):
        drawn[name] = ours(with_settings(scene, {"classification": name}), asked.step)[..., :3]
    drawn["8 bits"] = np.rint(255 * black) / 255
    row: Row = {"volume": volume, "function": function, "known": truth.rms, "known_max": truth.max}
    for name, picture in drawn.items():
        key = name.replace(" ", "_").replace("-", "_")
        row |= {key: np.sqrt(np.mean((picture - black) ** 2)), f"{key}_max": np.abs(picture - black).max()}
    return row


def main() -> None:
    """Measure a ball of waves and two heads, or the volumes that are named."""
    asked = options(
        __doc__,
        volumes={"names": ["volumes"], "nargs": "*", "type": Path, "help": ".npy files of uint8 (z, y, x)"},
        python=PEER_PYTHON,
        functions={"nargs": "*", "choices": FUNCTIONS, "default": [*FUNCTIONS], "metavar": "NAME"},
        width=256,
        step=1.0,
        budget={"type": float, "default": 40.0, "help": "seconds for each picture without error"},
    )
    names = ("gpu", "cpu", "post", "pre_integrated", "8_bits", "known")
    cells = " | ".join(f"{{{name}!l:.3f}} ({{{name}_max!l:.1f}})" for name in names)
    head = "volume | function | VTK, GPU | VTK, CPU | post | pre-integrated | 8 bits | known"
    with tempfile.TemporaryDirectory() as folder:
        volumes = volumes_of(asked.volumes, Path(folder), "mni152", "ch2better")
        rows = (measure(*volume, name, asked) for volume, name in product(volumes.items(), asked.functions))
        title = "in levels of 255: rms (max)"
        write(asked, rows=show(head, "{volume} | {function} | " + cells, rows, title))


if __name__ == "__main__":
    main()
