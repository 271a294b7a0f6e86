"""`clusterviz bench raycast`: time of ray casting one frame on one rank, without reading, upload and compositing."""

from __future__ import annotations

from statistics import median
from typing import Any

from clusterviz.cli.arguments import Define, DeviceOption, Frames, SceneArgument, Size, overrides_of, parse_device
from clusterviz.cli.bench.report import JsonOption, write_json
from clusterviz.comm import LoopbackChannel
from clusterviz.data import open_scene
from clusterviz.errors import SceneError
from clusterviz.frame import Options, Run, prepare
from clusterviz.gl.devices import Device
from clusterviz.render.choice import make_caster
from clusterviz.scene import Scene
from clusterviz.scene.files import public_data


def command(
    scene: SceneArgument,
    frames: Frames = 10,
    define: Define = None,
    size: Size = None,
    device: DeviceOption = None,
    json: JsonOption = None,
) -> None:
    """Measure ray casting on one rank, with the bricks already loaded."""
    # Automatic settings would change the measured scene.
    opened = open_scene(scene, overrides_of(define, size)).model_copy(update={"automatic": False})
    report = measure(opened, frames, parse_device(device))
    if json:
        write_json(json, report)
    width, height = report["size"]
    print(f"{report['renderer']}, {width} × {height}, step {report['step_voxels']:g} voxels, {frames} frames")
    print(f"median {1e3 * report['median_s']:.2f} ms, min {1e3 * report['min_s']:.2f} ms", end=", ")
    print(f"readback {1e3 * report['readback_median_s']:.2f} ms, {report['samples']:,} samples a frame")


def measure(scene: Scene, frames: int, device: Device = None) -> dict[str, Any]:
    """Draw a scene several times.

    `frames`: number of timed frames, after one warm-up frame. Returns median_s and min_s of drawing, readback_median_s,
    samples of one frame, and the options.
    """
    share, bricks = prepare(Run(LoopbackChannel(), Options()), scene)
    if share.plan is None:
        raise SceneError("nothing to draw", where="volumes", allowed="one volume")
    caster = make_caster(share.plan, device)
    caster.load(share.plan, bricks)
    drawn = [drawn for _ in range(frames + 1) for drawn in caster.draw(share.plan, share.pieces)][1:]
    seconds = [frame.seconds_render for frame in drawn]
    return {
        "median_s": median(seconds),
        "min_s": min(seconds),
        "readback_median_s": median(frame.seconds_readback for frame in drawn),
        "samples": drawn[-1].samples,
        "bricks": drawn[-1].bricks,
        "voxel_bytes": caster.pool.bytes,
        "step_voxels": share.scene.quality.step,
        "renderer": caster.device.renderer,
        "size": list(share.scene.image.size),
        "frames": frames,
        "scene": public_data(share.scene),
    }
