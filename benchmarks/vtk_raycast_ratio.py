"""Time and error against VTK's ray casters, on the GPU's interface and on the CPU.

    python benchmarks/vtk_raycast_ratio.py --peer vtk_raycast.py --python PYTHON_WITH_VTK [--pictures FOLDER] [--json F]

The peer is a script `PEER VOLUME.npy WIDTH OUT_PREFIX STEP` that prints one JSON line a ray caster (peer: vtk-gpu or
vtk-cpu, median_s) and writes `OUT_PREFIX_gpu.npy` and `OUT_PREFIX_cpu.npy`: bytes (h, w, 3), over black, row 0 on top.
Its runs and those of `clusterviz bench raycast` alternate, on the same volume, camera, transfer function and step. The
two may also be given by the environment, as CLUSTERVIZ_PEER and CLUSTERVIZ_PEER_PYTHON. `--device` is that of
`clusterviz bench raycast`. VTK's GPU caster ends a ray at an opacity of 1 − 1/255 and cannot be told otherwise;
`--early-termination 0.0039` does the same here. With `--our-step` we take another step than the peer: for comparing at
equal error instead of equal step.

Errors are those from the converged picture: ours at a sixteenth of the peer's step, which the tests hold to the float64
reference within 1e-5.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from clusterviz.data import open_source
from clusterviz.data.samples import fetch_sample
from clusterviz.image import compare, read_image
from clusterviz.image.compare import Difference
from clusterviz.scene import Scene, Volume
from clusterviz.scene.cluster import Cluster
from clusterviz.scene.values import Camera, ImageSettings, Quality

Bytes = np.ndarray
Rows = list[dict[str, Any]]
CLUSTERVIZ = [sys.executable, "-m", "clusterviz"]


def equivalent_scene(volume: Path, shape_zyx: tuple[int, ...], options: argparse.Namespace) -> Scene:
    """What the peer draws: its transfer function, and its camera from (1.3, 0.9, 1.6) · the longest side."""
    last = np.array(shape_zyx[::-1], float) - 1
    centre = last / 2
    eye = centre + np.array([1.3, 0.9, 1.6]) * max(shape_zyx)
    return Scene(
        volumes=(
            Volume(
                path=str(volume),
                cmap=((0.0, 0.1, 0.2, 0.6), (255.0, 1.0, 0.9, 0.4)),
                clim=(0.0, 255.0),
                opacity=((0.0, 0.0), (60.0, 0.0), (120.0, 0.05), (255.0, 0.3)),
                opacity_unit_distance=1.0,
            ),
        ),
        camera=Camera(
            position=tuple(eye.tolist()), focal_point=tuple(centre.tolist()), view_up=(0.0, 1.0, 0.0), view_angle=30.0
        ),
        image=ImageSettings(size=(options.width, options.width), background="black"),
        quality=Quality(step=options.our_step or options.step, early_termination=options.early_termination),
        cluster=Cluster(brick=options.brick),
    )


def synthetic(size: int) -> Bytes:
    """uint8 (size, size, size): a ball of waves, about half of it visible."""
    axis, found = np.linspace(-1, 1, size, dtype=np.float32), np.empty((size,) * 3, np.uint8)
    y, x = axis[:, None], axis[None, :]
    for slice_, z in zip(found, axis, strict=True):
        r = np.sqrt(x * x + y * y + z * z)
        field = (0.55 + 0.45 * np.cos(9 * np.pi * r) * np.cos(5 * x) * np.cos(4 * y - z)) * np.exp(-((r / 0.9) ** 4))
        slice_[:] = np.rint(255 * field)
    return found


def alternate(volume: Path, folder: Path, options: argparse.Namespace) -> tuple[Rows, Rows, dict[str, Bytes]]:
    """Reports of the peer's casters (a dict by caster) and of ours, round by round; pictures, float (h, w, 3)."""
    shape, device = np.load(volume, mmap_mode="r").shape, ["--device", options.device] if options.device else []
    scene_file, report, picture = folder / "scene.json", folder / "report.json", folder / "picture.npy"
    scene_file.write_text(equivalent_scene(volume, shape, options).model_dump_json())
    peers, ours = [], []
    for _ in range(options.rounds):
        arguments = [options.python, options.peer, volume, options.width, folder / "peer", options.step]
        printed = _output_of(arguments)
        rows = [json.loads(line) for line in printed.splitlines() if line.startswith("{")]
        peers.append({row["peer"].removeprefix("vtk-"): row["median_s"] for row in rows})
        _output_of([*CLUSTERVIZ, "bench", "raycast", scene_file, "--frames", options.frames, "--json", report, *device])
        ours.append(json.loads(report.read_text()))
    pictures = {name: np.load(folder / f"peer_{name}.npy")[..., :3] / 255 for name in peers[0]}
    fine = ["-D", f"quality.step={options.step / 16}", "-D", "quality.early_termination=0"]
    for name, settings in (("clusterviz", device), ("converged", fine)):
        _output_of([*CLUSTERVIZ, "render", scene_file, "-o", picture, *settings])
        # Premultiplied, so this is over black.
        pictures[name] = np.asarray(read_image(picture), np.float64)[..., :3]
    return peers, ours, pictures


def _output_of(arguments: list[Any]) -> str:
    return subprocess.run(list(map(str, arguments)), check=True, capture_output=True, text=True).stdout


def report_on(name: str, volume: Path, options: argparse.Namespace) -> dict[str, Any]:
    """Measure one volume, print two lines, save the pictures side by side (VTK's GPU caster on the left)."""
    with tempfile.TemporaryDirectory() as folder:
        peers, ours, pictures = alternate(volume, Path(folder), options)
    our_s = statistics.median(row["median_s"] for row in ours)
    errors = {caster: compare(found, pictures["converged"]) for caster, found in pictures.items()}
    ratios = {
        caster: [peer[caster] / own["median_s"] for own, peer in zip(ours, peers, strict=True)] for caster in peers[0]
    }
    cores = len(os.sched_getaffinity(0))
    result = {
        "volume": name,
        "width": options.width,
        "step_voxels": options.our_step or options.step,
        "peer_step_voxels": options.step,
        "early_termination": options.early_termination,
        "brick": options.brick,
        "peer_s": {caster: statistics.median(peer[caster] for peer in peers) for caster in ratios},
        "median_s": our_s,
        "times_faster": {caster: statistics.median(found) for caster, found in ratios.items()},
        "rounds": ratios,
        "rms_from_converged": {caster: error.rms for caster, error in errors.items()},
        "max_from_converged": {caster: error.max for caster, error in errors.items()},
        "rms_from_vtk_gpu": compare(pictures["gpu"], pictures["clusterviz"]).rms,
        "renderer": ours[0]["renderer"],
        "samples": ours[0]["samples"],
        "samples_per_second_and_core": ours[0]["samples"] / our_s / cores,
        "load": os.getloadavg()[0],
    }
    print(
        f"{name:10} {result['renderer']}: {1e3 * our_s:.1f} ms, {_in_words(errors['clusterviz'])}, "
        f"{result['samples_per_second_and_core'] / 1e6:.0f} million samples a second and core"
    )
    for caster, found in ratios.items():
        print(
            f"{'':10} VTK, {caster}: {1e3 * result['peer_s'][caster]:.1f} ms, {_in_words(errors[caster])}; ours is "
            f"{result['times_faster'][caster]:.2f} times faster ({min(found):.2f} … {max(found):.2f})",
            flush=True,
        )
    if options.pictures:
        from PIL import Image

        both = np.concatenate([pictures["gpu"], pictures["clusterviz"]], axis=1)
        Image.fromarray(np.rint(255 * np.clip(both, 0, 1)).astype(np.uint8)).save(options.pictures / f"{name}.png")
    return result


def _in_words(error: Difference) -> str:
    return f"rms {error.rms:.2e}, max {255 * error.max:.1f} of 255"


def main() -> None:
    """Measure a synthetic volume and the sample mni152, or the volumes that are named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("volumes", nargs="*", type=Path, help=".npy files of uint8 (z, y, x)")
    parser.add_argument("--peer", default=os.environ.get("CLUSTERVIZ_PEER"), help="the peer's script")
    parser.add_argument("--python", default=os.environ.get("CLUSTERVIZ_PEER_PYTHON", sys.executable))
    parser.add_argument("--width", type=int, default=512)
    parser.add_argument("--device", help="as of clusterviz bench raycast; default: what is best")
    parser.add_argument("--step", type=float, default=1.0, help="in voxels, of both")
    parser.add_argument("--our-step", type=float, help="ours, where it is another")
    parser.add_argument("--early-termination", type=float, default=0.0, help="VTK's own is 1/255; ours: 0, never")
    parser.add_argument("--brick", type=int, default=64, help="voxels along the side of ours; one rank needs only one")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--frames", type=int, default=5)
    parser.add_argument("--pictures", type=Path, help="a folder for the pictures, side by side")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    if not options.peer:
        parser.error("no peer: give --peer or CLUSTERVIZ_PEER")
    with tempfile.TemporaryDirectory() as folder:
        volumes = {path.stem: path for path in options.volumes}
        if not volumes:
            volumes = {name: Path(folder) / f"{name}.npy" for name in ("synthetic", "mni152")}
            np.save(volumes["synthetic"], synthetic(256))
            source = open_source(str(fetch_sample("mni152")), None)
            np.save(volumes["mni152"], source.read((0, 0, 0), source.grid.shape_zyx))
        rows = [report_on(name, path, options) for name, path in volumes.items()]
    if options.json:
        options.json.write_text(json.dumps(rows, indent=2) + "\n")


if __name__ == "__main__":
    main()
