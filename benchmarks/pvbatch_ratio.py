"""A frame's time and picture beside ParaView's: `python benchmarks/pvbatch_ratio.py [--ranks 1,2,4] [--json F]`.

ParaView's Wavelet, 256 samples a side, 512 × 512 pixels, the same transfer function, from a camera that moves with
every frame; pvbatch under Open MPI, and clusterviz under its own mpirun, in turn. A frame is from a barrier until the
picture is whole on rank 0; reading is not in it, and the first frame is not counted. Errors are of colours over black,
in levels of 255, against a picture of one rank here with a step of 1/8 voxel. ParaView chooses its step itself,
and ends a ray at an opacity of 1 − 1/255, as is done here unless told otherwise. It needs pvbatch, mpirun.openmpi and
xvfb-run on the path.
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
from time import perf_counter
from typing import Any

import numpy as np

from clusterviz.cli.jobs import OVERSUBSCRIBE, find_mpirun
from clusterviz.image import compare, read_image, write_image
from clusterviz.scene import Scene, Volume
from clusterviz.scene.overrides import with_settings
from clusterviz.scene.values import Camera, ImageSettings

PROGRAM = Path(__file__).with_name("pvbatch_pictures.py")
LOW, HIGH = 37.35, 276.83
COOL_TO_WARM = ((LOW, 0.231, 0.298, 0.753), ((LOW + HIGH) / 2, 0.865, 0.865, 0.865), (HIGH, 0.706, 0.016, 0.15))
PEER = ("xvfb-run", "-a", "mpirun.openmpi", "--oversubscribe", "--mca", "mpi_yield_when_idle", "1", "-n")


def order_of(samples: Path, size: int, width: int, frames: int) -> dict[str, Any]:
    """What both draw: the scene here begins at the origin, ParaView's in the middle."""
    volume = Volume(
        path=str(samples), cmap=COOL_TO_WARM, clim=(LOW, HIGH), opacity=((LOW, 0.0), (HIGH, 1.0)),
        opacity_unit_distance=20.0,
    )  # fmt: skip
    camera = Camera(
        position=(1.2 * size, 1.0 * size, 1.6 * size), focal_point=(0.0, 0.0, 0.0), view_up=(0.0, 1.0, 0.0),
        view_angle=30.0,
    )  # fmt: skip
    scene = Scene(volumes=(volume,), camera=camera, image=ImageSettings(size=(width, width), background="black"))
    positions = [(1.2 * size + 2 * frame, 1.0 * size, 1.6 * size) for frame in range(1 + frames)]
    return {"size": size, "scene": scene.model_dump(mode="json"), "frames": positions, "samples": False}


def at(scene: Scene, position: tuple[float, ...], size: int) -> Scene:
    """The scene from another place; ParaView's sample (0, 0, 0) is at −size / 2."""
    shift = size / 2
    camera = {"position": tuple(x + shift for x in position), "focal_point": (shift, shift, shift)}
    return with_settings(scene, camera)


def draw_frames(order_file: Path, output: Path) -> None:
    """What each of our ranks does."""
    from clusterviz.comm import limit_threads, open_channel
    from clusterviz.frame import FrameLoop

    order, channel = json.loads(order_file.read_text()), open_channel()
    limit_threads(channel.placement())
    scene, seconds = Scene.model_validate(order["scene"]), []
    views = [at(scene, position, order["size"]) for position in order["frames"]]
    with FrameLoop(views[0], channel) as loop:
        for number, view in enumerate(views):
            channel.barrier()
            start = perf_counter()
            drawn = loop.frame(view, number=number)
            seconds.append(perf_counter() - start)
    if drawn.image is not None:
        write_image(output, drawn.image, None)
        found = drawn.statistics
        shared = found.sharing.mode if found.sharing else ""
        print(json.dumps({"seconds": seconds, "mode": shared, "samples": max(rank.samples for rank in found.per_rank)}))


def run(command: list[str], **environment: str) -> dict[str, Any]:
    """What the last line of a program tells: the seconds of its frames, and of ours the mode and most samples."""
    variables = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | environment
    done = subprocess.run(command, capture_output=True, text=True, env=variables)
    lines = [line for line in done.stdout.splitlines() if line.startswith('{"seconds"')]
    if done.returncode or not lines:
        raise SystemExit(f"{command[0]} ended with {done.returncode}:\n{done.stdout}\n{done.stderr}")
    told: dict[str, Any] = json.loads(lines[-1])
    return told


def later(told: dict[str, Any]) -> float:
    """Seconds of a frame that is not the first: the median."""
    return statistics.median(told["seconds"][1:])


def run_peer(ranks: int, order: Path, prefix: Path) -> dict[str, Any]:
    """ParaView on some ranks."""
    program = ["pvbatch", "--force-offscreen-rendering", str(PROGRAM), str(order), str(prefix)]
    root = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
    system = os.pathsep.join(part for part in os.environ["PATH"].split(os.pathsep) if "venv" not in part)
    return run([*PEER, str(ranks), *program], PATH=system, **root)


def run_ours(ranks: int, order: Path, picture: Path) -> dict[str, Any]:
    """clusterviz on some ranks."""
    program = [sys.executable, __file__, "--order", str(order), "--picture", str(picture)]
    package = {"PYTHONPATH": os.environ.get("PYTHONPATH", "")}
    return run([find_mpirun(), "-n", str(ranks), *program], **{**OVERSUBSCRIBE, **package})


def ratios(options: argparse.Namespace, folder: Path) -> list[dict[str, Any]]:
    """All rank counts, several times in turn; a line each."""
    order_file, samples = folder / "order.json", folder / "wavelet.npy"
    order = order_of(samples, options.size, options.width, options.frames)
    order_file.write_text(json.dumps(order | {"samples": True, "frames": order["frames"][:1]}))
    run_peer(1, order_file, folder / "wavelet")
    scene = with_settings(
        Scene.model_validate(order["scene"]), {"step": options.step, "early_termination": options.early_termination}
    )
    fine = with_settings(scene, {"step": 1 / 8, "early_termination": 0.0}).model_dump(mode="json")
    order_file.write_text(json.dumps(order | {"scene": fine, "frames": order["frames"][-1:]}))
    run_ours(1, order_file, folder / "fine.npy")
    exact = read_image(folder / "fine.npy").astype(np.float64)[..., :3]
    order_file.write_text(json.dumps(order | {"scene": scene.model_dump(mode="json")}))
    rows = []
    for ranks in options.ranks:
        theirs, mine = list[float](), list[float]()
        for _ in range(options.rounds):
            theirs.append(later(run_peer(ranks, order_file, folder / "peer")))
            told = run_ours(ranks, order_file, folder / "ours.npy")
            mine.append(later(told))
        peer = compare(read_image(folder / "peer.png").astype(np.float64)[..., :3], exact)
        ours = compare(read_image(folder / "ours.npy").astype(np.float64)[..., :3], exact)
        row = {
            "ranks": ranks, "peer_s": statistics.median(theirs), "median_s": statistics.median(mine),
            "ratio": statistics.median(a / b for a, b in zip(theirs, mine, strict=True)),
            "mode": told["mode"], "most_samples": told["samples"],
            "peer_rms": 255 * peer.rms, "peer_max": 255 * peer.max, "rms": 255 * ours.rms, "max": 255 * ours.max,
            "load": os.getloadavg()[0],
        }  # fmt: skip
        print(
            f"{ranks:5}  {row['peer_s']:10.3f} {row['median_s']:12.3f} {row['ratio']:12.1f}   "
            f"{row['peer_rms']:.2f} ({row['peer_max']:.1f}) {row['rms']:14.3f} ({row['max']:.2f})   "
            f"{row['mode']}, {row['most_samples'] / 1e6:.1f} M samples",
            flush=True,
        )
        rows.append(row)
    return rows


def main() -> None:
    """Measure, and write JSON on request."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ranks", type=lambda text: [int(part) for part in text.split(",")], default=[1, 2, 4])
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--width", type=int, default=512)
    parser.add_argument("--step", type=float, default=1.0)
    parser.add_argument("--early-termination", type=float, default=1 / 255)
    parser.add_argument("--frames", type=int, default=3)
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--order", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--picture", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.order:
        draw_frames(options.order, options.picture)
        return
    print(f"Wavelet, {options.size}³, {options.width}², step {options.step:g}; load {os.getloadavg()[0]:.1f}")
    print("ranks  pvbatch, s  clusterviz, s  times faster  pvbatch off by    clusterviz off by   mode, most samples")
    with tempfile.TemporaryDirectory() as folder:
        rows = ratios(options, Path(folder))
    if options.json:
        found = {"size": options.size, "width": options.width, "step": options.step, "rows": rows}
        options.json.write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
