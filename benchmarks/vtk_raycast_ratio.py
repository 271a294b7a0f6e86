"""Time and picture against VTK's GPU ray caster.

    python benchmarks/vtk_raycast_ratio.py --peer vtk_raycast.py --python PYTHON_WITH_VTK [--pictures FOLDER] [--json F]

The peer is a script `PEER VOLUME.npy WIDTH OUT_PREFIX STEP` that prints one JSON line a ray caster (peer, median_s) and
writes `OUT_PREFIX_gpu.npy`: bytes (h, w, 3), over black, row 0 on top. Its runs and those of `clusterviz bench raycast`
alternate, on the same volume, camera, transfer function and step. The two may also be given by the environment, as
CLUSTERVIZ_PEER and CLUSTERVIZ_PEER_PYTHON. VTK ends a ray at an opacity of 1 − 1/255 and cannot be told otherwise;
`--early-termination 0.0039` does the same here.
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
from clusterviz.scene import Scene, Volume
from clusterviz.scene.values import Camera, ImageSettings, Quality

Bytes = np.ndarray


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
        quality=Quality(step=options.step, early_termination=options.early_termination),
    )


def synthetic(size: int) -> Bytes:
    """uint8 (size, size, size): a ball of waves, about half of it visible."""
    x = np.linspace(-1, 1, size, dtype=np.float32)
    z, y, x = np.meshgrid(x, x, x, indexing="ij", sparse=True)
    r = np.sqrt(x * x + y * y + z * z)
    field = (0.55 + 0.45 * np.cos(9 * np.pi * r) * np.cos(5 * x) * np.cos(4 * y - z)) * np.exp(-((r / 0.9) ** 4))
    return np.rint(255 * field).astype(np.uint8)


def alternate(
    volume: Path, folder: Path, options: argparse.Namespace
) -> tuple[list[dict[str, Any]], list[dict[str, Any]], Bytes, Bytes]:
    """Reports of the peer's GPU caster and of ours, round by round, and both pictures: float (h, w, 3) over black."""
    shape = np.load(volume, mmap_mode="r").shape
    scene_file, report, picture = folder / "scene.json", folder / "report.json", folder / "picture.npy"
    scene_file.write_text(equivalent_scene(volume, shape, options).model_dump_json())
    command = [sys.executable, "-m", "clusterviz"]
    peers, ours = [], []
    for _ in range(options.rounds):
        arguments = [options.python, options.peer, volume, options.width, folder / "peer", options.step]
        printed = subprocess.run(list(map(str, arguments)), check=True, capture_output=True, text=True).stdout
        rows = [json.loads(line) for line in printed.splitlines() if line.startswith("{")]
        peers.append(next(row for row in rows if "gpu" in row["peer"]))
        arguments = [*command, "bench", "raycast", scene_file, "--frames", options.frames, "--json", report]
        subprocess.run(list(map(str, arguments)), check=True, capture_output=True)
        ours.append(json.loads(report.read_text()))
    subprocess.run(list(map(str, [*command, "render", scene_file, "-o", picture])), check=True, capture_output=True)
    found = np.asarray(read_image(picture), np.float64)[..., :3]  # premultiplied, so this is over black
    return peers, ours, np.load(folder / "peer_gpu.npy")[..., :3] / 255, found


def report_on(name: str, volume: Path, options: argparse.Namespace) -> dict[str, Any]:
    """Measure one volume, print a line, save the pictures side by side (the peer's on the left)."""
    with tempfile.TemporaryDirectory() as folder:
        peers, ours, theirs, mine = alternate(volume, Path(folder), options)
    difference = compare(theirs, mine)
    peer_s, our_s = (statistics.median(row["median_s"] for row in rows) for rows in (peers, ours))
    ratios = [own["median_s"] / peer["median_s"] for own, peer in zip(ours, peers, strict=True)]
    result = {
        "volume": name,
        "width": options.width,
        "step_voxels": options.step,
        "early_termination": options.early_termination,
        "peer_s": peer_s,
        "median_s": our_s,
        "ratio": statistics.median(ratios),
        "ratios": ratios,
        "rms": difference.rms,
        "max": difference.max,
        "renderer": ours[0]["renderer"],
        "samples": ours[0]["samples"],
        "load": os.getloadavg()[0],
    }
    print(
        f"{name:10} peer {1e3 * peer_s:8.1f} ms  clusterviz {1e3 * our_s:8.1f} ms  ratio {result['ratio']:.3f} "
        f"({min(ratios):.3f} … {max(ratios):.3f})  rms {difference.rms:.2e}  max {difference.max:.2e}",
        flush=True,
    )
    if options.pictures:
        from PIL import Image

        both = np.rint(255 * np.clip(np.concatenate([theirs, mine], axis=1), 0, 1)).astype(np.uint8)
        Image.fromarray(both).save(options.pictures / f"{name}.png")
    return result


def main() -> None:
    """Measure a synthetic volume and the sample mni152, or the volumes that are named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("volumes", nargs="*", type=Path, help=".npy files of uint8 (z, y, x)")
    parser.add_argument("--peer", default=os.environ.get("CLUSTERVIZ_PEER"), help="the peer's script")
    parser.add_argument("--python", default=os.environ.get("CLUSTERVIZ_PEER_PYTHON", sys.executable))
    parser.add_argument("--width", type=int, default=512)
    parser.add_argument("--step", type=float, default=1.0)
    parser.add_argument("--early-termination", type=float, default=0.0, help="VTK's own is 1/255; ours: 0, never")
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
