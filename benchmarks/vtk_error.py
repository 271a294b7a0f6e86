"""How far VTK's ray casters and this one are from the picture without error, at the same step.

    python benchmarks/vtk_error.py --python PYTHON_WITH_VTK [VOLUME.npy …] [--functions smooth …] [--step 1] [--json F]

Each volume is drawn with a smooth transfer function and with three narrow peaks of opacity, by VTK's GPU and CPU
casters (`vtk_pictures.py`), and here with samples classified at midpoints and between the ends of slabs. The picture
without error is found as `clusterviz tradeoff` finds it: the step is halved until nothing changes, and the renderer is
held to the float64 reference at a small size; `known` is what is left of its own error. VTK's pictures have 8 bits, so
"8 bits" is what rounding the picture without error would cost, and no picture of 8 bits can be nearer. Errors are of
colours over black, in levels of 255.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from vtk_raycast_ratio import equivalent_scene, synthetic

from clusterviz.comm import LoopbackChannel
from clusterviz.data import open_source
from clusterviz.data.samples import fetch_sample
from clusterviz.frame import render_frame
from clusterviz.report.tradeoff.ground_truth import find_ground_truth
from clusterviz.scene import Scene
from clusterviz.scene.overrides import with_settings

Picture = np.ndarray[Any, Any]
PROGRAM = Path(__file__).with_name("vtk_pictures.py")


def smooth() -> tuple[tuple[float, float], ...]:
    """A bump over the upper half of the range, by 64 control points."""
    s = np.linspace(0, 255, 64)
    return tuple(zip(s.tolist(), (0.2 * np.exp(-(((s / 255 - 0.6) / 0.15) ** 2))).tolist(), strict=True))


def peaks(width: float) -> tuple[tuple[float, float], ...]:
    """Three peaks, each so wide a part of the range."""
    half = 127.5 * width
    places = ((0.35, 0.3), (0.55, 0.6), (0.8, 0.9))
    rows = [
        (255 * place + aside, alpha * top) for place, top in places for aside, alpha in ((-half, 0), (0, 1), (half, 0))
    ]
    return ((0.0, 0.0), *((value, float(alpha)) for value, alpha in rows), (255.0, 0.0))


FUNCTIONS = {"smooth": smooth(), "peaks, 4 %": peaks(0.04), "peaks, 2.5 %": peaks(0.025)}


def ours(scene: Scene, step: float) -> Picture:
    """float64 (h, w, 4): drawn on one rank."""
    image = render_frame(with_settings(scene, {"step": step}), LoopbackChannel()).image
    assert image is not None
    return image.astype(np.float64)


def pictures(scene: Scene, folder: Path, python: str) -> Iterator[tuple[str, Picture]]:
    """Who draws, and what: float64 (h, w, 3) over black, row 0 on top."""
    file = folder / "scene.json"
    file.write_text(scene.model_dump_json())
    subprocess.run([python, str(PROGRAM), str(file), str(folder / "vtk")], check=True, capture_output=True)
    for caster in ("gpu", "cpu"):
        yield f"VTK, {caster}", np.load(folder / f"vtk_{caster}.npy") / 255
    for name in ("post", "pre-integrated"):
        yield name, ours(with_settings(scene, {"classification": name}), scene.quality.step)[..., :3]


def measure(volume: str, path: Path, function: str, options: argparse.Namespace) -> dict[str, Any]:
    """One volume and one transfer function: a line of the table."""
    scene = equivalent_scene(path, np.load(path, mmap_mode="r").shape, options)
    scene = with_settings(scene, {"opacity": FUNCTIONS[function]})
    scene = render_frame(scene, LoopbackChannel()).scene
    exact = with_settings(scene, {"classification": "pre-integrated"})
    truth = find_ground_truth(exact, ours, options.budget)
    black = truth.picture[..., :3]
    with tempfile.TemporaryDirectory() as folder:
        drawn = dict(pictures(scene, Path(folder), options.python))
    drawn["8 bits"] = np.rint(255 * black) / 255
    errors = {name: picture - black for name, picture in drawn.items()}
    found = {
        name: {"rms": 255 * float(np.sqrt(np.mean(error**2))), "max": 255 * float(np.abs(error).max())}
        for name, error in errors.items()
    }
    known = {"max": 255 * truth.max, "rms": 255 * truth.rms, "step": truth.step, "source": truth.source}
    cells = "  ".join(f"{name} {one['rms']:.3f} ({one['max']:.1f})" for name, one in found.items())
    print(f"{volume:10} {function:12}  {cells}  known {known['rms']:.3f} ({known['max']:.2f})", flush=True)
    return {"volume": volume, "function": function, "known": known, "errors": found}


def main() -> None:
    """Measure a ball of waves and two heads, or the volumes that are named."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("volumes", nargs="*", type=Path, help=".npy files of uint8 (z, y, x)")
    parser.add_argument("--python", default=sys.executable, help="a Python with VTK")
    parser.add_argument("--functions", nargs="*", choices=FUNCTIONS, default=[*FUNCTIONS], metavar="NAME")
    parser.add_argument("--width", type=int, default=256)
    parser.add_argument("--step", type=float, default=1.0)
    parser.add_argument("--budget", type=float, default=40.0, help="seconds for each picture without error")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    options.early_termination = 0.0
    print("in levels of 255: rms (max)")
    with tempfile.TemporaryDirectory() as folder:
        volumes = {path.stem: path for path in options.volumes}
        if not volumes:
            volumes = {name: Path(folder) / f"{name}.npy" for name in ("ball", "mni152", "ch2better")}
            np.save(volumes["ball"], synthetic(256))
            for name in ("mni152", "ch2better"):
                source = open_source(str(fetch_sample(name)), None)
                np.save(volumes[name], source.read((0, 0, 0), source.grid.shape_zyx))
        rows = [
            measure(name, path, function, options) for name, path in volumes.items() for function in options.functions
        ]
    if options.json:
        options.json.write_text(
            json.dumps({"width": options.width, "step": options.step, "rows": rows}, indent=2) + "\n"
        )


if __name__ == "__main__":
    main()
