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
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from measuring import Row, answer_of, beside, commas, options, show, timed, write

from clusterviz.cli.jobs import OVERSUBSCRIBE, find_mpirun
from clusterviz.image import compare, read_image, write_image
from clusterviz.scene import Scene, Volume
from clusterviz.scene.overrides import with_settings
from clusterviz.scene.values import Camera, ImageSettings

LOW, HIGH = 37.35, 276.83
COOL_TO_WARM = ((LOW, 0.231, 0.298, 0.753), ((LOW + HIGH) / 2, 0.865, 0.865, 0.865), (HIGH, 0.706, 0.016, 0.15))
PEER = ("xvfb-run", "-a", "mpirun.openmpi", "--oversubscribe", "--mca", "mpi_yield_when_idle", "1", "-n")


def order_of(samples: Path, size: int, width: int, frames: int) -> dict[str, Any]:
    """What both draw: the scene here begins at the origin, ParaView's in the middle."""
    look: dict[str, Any] = {"opacity": ((LOW, 0.0), (HIGH, 1.0)), "opacity_unit_distance": 20.0}
    volume = Volume(path=str(samples), cmap=COOL_TO_WARM, clim=(LOW, HIGH), **look)
    lens: dict[str, Any] = {"focal_point": (0.0, 0.0, 0.0), "view_up": (0.0, 1.0, 0.0), "view_angle": 30.0}
    camera = Camera(position=(1.2 * size, 1.0 * size, 1.6 * size), **lens)
    scene = Scene(volumes=(volume,), camera=camera, image=ImageSettings(size=(width, width), background="black"))
    positions = [(1.2 * size + 2 * frame, 1.0 * size, 1.6 * size) for frame in range(1 + frames)]
    return {"size": size, "scene": scene.model_dump(mode="json"), "frames": positions, "samples": False}


def at(scene: Scene, position: tuple[float, ...], size: int) -> Scene:
    """The scene from another place; ParaView's sample (0, 0, 0) is at −size / 2."""
    shift = size / 2
    camera = {"position": tuple(x + shift for x in position), "focal_point": (shift, shift, shift)}
    return with_settings(scene, camera)


def draw_frames(order_file: Path, output: Path) -> None:
    from clusterviz.comm import limit_threads, open_channel
    from clusterviz.frame import FrameLoop

    order, channel = json.loads(order_file.read_text()), open_channel()
    limit_threads(channel.placement())
    scene, seconds = Scene.model_validate(order["scene"]), []
    views = [at(scene, position, order["size"]) for position in order["frames"]]
    with FrameLoop(views[0], channel) as loop:
        for number, view in enumerate(views):
            channel.barrier()
            run = timed(lambda view=view, number=number: loop.frame(view, number=number))
            drawn = run.value
            seconds.append(run.wall)
    if drawn.image is not None:
        write_image(output, drawn.image, None)
        found = drawn.statistics
        shared = found.sharing.mode if found.sharing else ""
        print(json.dumps({"seconds": seconds, "mode": shared, "samples": max(rank.samples for rank in found.per_rank)}))


def later(told: dict[str, Any]) -> float:
    return statistics.median(told["seconds"][1:])


def run_peer(ranks: int, order: Path, prefix: Path) -> dict[str, Any]:
    program = ["pvbatch", "--force-offscreen-rendering", str(beside("pvbatch_pictures.py")), str(order), str(prefix)]
    root = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
    system = os.pathsep.join(part for part in os.environ["PATH"].split(os.pathsep) if "venv" not in part)
    return answer_of([*PEER, str(ranks), *program], PATH=system, PYTHONPATH="", **root)


def run_ours(ranks: int, order: Path, picture: Path) -> dict[str, Any]:
    program = [sys.executable, __file__, "--order", str(order), "--picture", str(picture)]
    return answer_of([find_mpirun(), "-n", str(ranks), *program], **OVERSUBSCRIBE)


def ratios(asked: argparse.Namespace, folder: Path) -> Iterator[Row]:
    """All rank counts, several times in turn."""
    order_file, samples = folder / "order.json", folder / "wavelet.npy"
    order = order_of(samples, asked.size, asked.width, asked.frames)
    order_file.write_text(json.dumps(order | {"samples": True, "frames": order["frames"][:1]}))
    run_peer(1, order_file, folder / "wavelet")
    how = {"step": asked.step, "early_termination": asked.early_termination}
    scene = with_settings(Scene.model_validate(order["scene"]), how)
    fine = with_settings(scene, {"step": 1 / 8, "early_termination": 0.0}).model_dump(mode="json")
    order_file.write_text(json.dumps(order | {"scene": fine, "frames": order["frames"][-1:]}))
    run_ours(1, order_file, folder / "fine.npy")
    exact = read_image(folder / "fine.npy").astype(np.float64)[..., :3]
    order_file.write_text(json.dumps(order | {"scene": scene.model_dump(mode="json")}))
    for ranks in asked.ranks:
        theirs, mine, told = list[float](), list[float](), Row()
        for _ in range(asked.rounds):
            theirs.append(later(run_peer(ranks, order_file, folder / "peer")))
            told = run_ours(ranks, order_file, folder / "ours.npy")
            mine.append(later(told))
        peer, ours = (
            compare(read_image(folder / name).astype(np.float64)[..., :3], exact) for name in ("peer.png", "ours.npy")
        )
        row = {"ranks": ranks, "peer_s": statistics.median(theirs), "median_s": statistics.median(mine)}
        row |= {"ratio": statistics.median(a / b for a, b in zip(theirs, mine, strict=True)), "mode": told["mode"]}
        row |= {"peer_rms": peer.rms, "peer_max": peer.max, "rms": ours.rms, "max": ours.max}
        yield row | {"samples": told["samples"], "load": os.getloadavg()[0]}


def main() -> None:
    asked = options(
        __doc__,
        ranks={"type": commas(int), "default": [1, 2, 4]},
        size=256,
        width=512,
        step=1.0,
        early_termination=1 / 255,
        frames=3,
        rounds=1,
        order={"type": Path, "help": argparse.SUPPRESS},
        picture={"type": Path, "help": argparse.SUPPRESS},
    )
    if asked.order:
        draw_frames(asked.order, asked.picture)
        return
    head = "ranks | pvbatch, s | clusterviz, s | times faster | pvbatch off by | clusterviz | mode | most samples, M"
    cells = "{ranks} | {peer_s:.3f} | {median_s:.3f} | {ratio:.1f} | {peer_rms!l:.2f} ({peer_max!l:.1f}) | "
    cells += "{rms!l:.3f} ({max!l:.2f}) | {mode} | {samples!M:.1f}"
    title = f"Wavelet, {asked.size}³, {asked.width}²; errors of 255"
    with tempfile.TemporaryDirectory() as folder:
        write(asked, rows=show(head, cells, ratios(asked, Path(folder)), title))


if __name__ == "__main__":
    main()
