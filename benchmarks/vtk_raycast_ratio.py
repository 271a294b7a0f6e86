"""Time and error against VTK's ray casters, on the GPU's interface and on the CPU.

    python benchmarks/vtk_raycast_ratio.py --python PYTHON_WITH_VTK [--pictures FOLDER] [--json F]

Runs of `vtk_peer.py` and of `clusterviz bench raycast` alternate, on the same volume, camera, transfer function and
step. VTK's Python may also be given by CLUSTERVIZ_PEER_PYTHON. `--device` is that of `clusterviz bench raycast`. VTK's
GPU caster ends a ray at an opacity of 1 − 1/255 and cannot be told otherwise; `--early-termination 0.0039` does the
same here. With `--our-step` we take another step than the peer: for comparing at equal error instead of equal step.

Errors are those from the converged picture: ours at a sixteenth of the peer's step, which the tests hold to the float64
reference within 1e-5.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from measuring import CLUSTERVIZ, PEER_PYTHON, Row, answer_of, beside, opened, options, output_of, sample, write

from clusterviz.image import compare, read_image
from clusterviz.image.compare import Difference
from clusterviz.scene import Scene, Volume
from clusterviz.scene.cluster import Cluster
from clusterviz.scene.values import Camera, ImageSettings, Quality

CASTERS = ("gpu", "cpu")


def equivalent_scene(
    volume: Path, shape_zyx: tuple[int, ...], width: int, step: float, early_termination: float = 0.0, brick: int = 64
) -> Scene:
    """What both draw, seen from (1.3, 0.9, 1.6) · the longest side."""
    centre = (np.array(shape_zyx[::-1], float) - 1) / 2
    eye = centre + np.array([1.3, 0.9, 1.6]) * max(shape_zyx)
    look = Volume(
        path=str(volume),
        cmap=((0.0, 0.1, 0.2, 0.6), (255.0, 1.0, 0.9, 0.4)),
        clim=(0.0, 255.0),
        opacity=((0.0, 0.0), (60.0, 0.0), (120.0, 0.05), (255.0, 0.3)),
        opacity_unit_distance=1.0,
    )
    lens = {"view_up": (0.0, 1.0, 0.0), "view_angle": 30.0}
    return Scene(
        volumes=(look,),
        camera=Camera(position=tuple(eye.tolist()), focal_point=tuple(centre.tolist()), **lens),  # type: ignore[arg-type]
        image=ImageSettings(size=(width, width), background="black"),
        quality=Quality(step=step, early_termination=early_termination),
        cluster=Cluster(brick=brick),
    )


def write_peer_scene(path: Path, scene: Scene, voxels: Any, step: float) -> None:
    """Write what `vtk_peer.py` reads: a complete scene of one volume with unit spacing."""
    volume, camera = scene.volumes[0], scene.camera
    cmap: Any = volume.cmap
    opacity: Any = volume.opacity
    np.savez(
        path,
        voxels=voxels,
        spacing=np.ones(3),
        origin=np.zeros(3),
        step=step,
        shade=volume.shade,
        value=[point[0] for point in opacity],
        opacity=[point[1] for point in opacity],
        colour_value=[point[0] for point in cmap],
        rgb=[point[1:] for point in cmap],
        **{name: getattr(camera, name) for name in ("position", "focal_point", "view_up", "view_angle")},
        unit=volume.opacity_unit_distance,
    )


def peer(python: str, scene: Path, kind: str, size: tuple[int, int], frames: int, out: Path, *more: str) -> Row:
    """Draw by VTK."""
    return answer_of([python, beside("vtk_peer.py"), scene, kind, f"{size[0]}x{size[1]}", frames, out, *more])


def synthetic(size: int) -> Any:
    """uint8 (size, size, size): a ball of waves, about half of it visible."""
    axis, found = np.linspace(-1, 1, size, dtype=np.float32), np.empty((size,) * 3, np.uint8)
    y, x = axis[:, None], axis[None, :]
    for slice_, z in zip(found, axis, strict=True):
        r = np.sqrt(x * x + y * y + z * z)
        field = (0.55 + 0.45 * np.cos(9 * np.pi * r) * np.cos(5 * x) * np.cos(4 * y - z)) * np.exp(-((r / 0.9) ** 4))
        slice_[:] = np.rint(255 * field)
    return found


def volumes_of(given: list[Path], folder: Path, *names: str) -> dict[str, Path]:
    """The volumes that are named, or else a ball of waves and samples, as .npy files."""
    if given:
        return {path.stem: path for path in given}
    found = {name: folder / f"{name}.npy" for name in ("synthetic", *names)}
    np.save(found["synthetic"], synthetic(256))
    for name in names:
        np.save(found[name], opened(sample(name=name))[1])
    return found


def alternate(volume: Path, folder: Path, asked: argparse.Namespace) -> tuple[list[Row], list[Row], Row]:
    """Seconds of VTK's casters and our reports, round by round; pictures, float (h, w, 3)."""
    voxels, device = np.load(volume, mmap_mode="r"), ["--device", asked.device] if asked.device else []
    scene, report, picture = folder / "scene.json", folder / "report.json", folder / "picture.npy"
    step = asked.our_step or asked.step
    one = equivalent_scene(volume, voxels.shape, asked.width, step, asked.early_termination, asked.brick)
    scene.write_text(one.model_dump_json())
    write_peer_scene(folder / "scene.npz", one, voxels, asked.step)
    peers, ours, size = [], [], (asked.width, asked.width)
    for _ in range(asked.rounds):
        arguments = (asked.python, folder / "scene.npz")
        peers.append({c: peer(*arguments, c, size, asked.frames, folder / f"{c}.npy")["median_s"] for c in CASTERS})
        output_of([*CLUSTERVIZ, "bench", "raycast", scene, "--frames", asked.frames, "--json", report, *device])
        ours.append(json.loads(report.read_text()))
    pictures = {name: np.load(folder / f"{name}.npy") for name in CASTERS}
    fine = ["-D", f"quality.step={asked.step / 16}", "-D", "quality.early_termination=0"]
    for name, settings in (("clusterviz", device), ("converged", fine)):
        output_of([*CLUSTERVIZ, "render", scene, "-o", picture, *settings])
        pictures[name] = np.asarray(read_image(picture), np.float64)[..., :3]  # premultiplied: this is over black
    return peers, ours, pictures


def report_on(name: str, volume: Path, asked: argparse.Namespace) -> Row:
    """Measure one volume, print two lines, save the pictures side by side (VTK's GPU caster on the left)."""
    with tempfile.TemporaryDirectory() as folder:
        peers, ours, pictures = alternate(volume, Path(folder), asked)
    our_s = statistics.median(row["median_s"] for row in ours)
    errors = {caster: compare(found, pictures["converged"]) for caster, found in pictures.items()}
    rate = ours[0]["samples"] / our_s / len(os.sched_getaffinity(0))
    result: Row = {"volume": name, "median_s": our_s, "renderer": ours[0]["renderer"], "samples": ours[0]["samples"]}
    result |= {"samples_per_second_and_core": rate, "load": os.getloadavg()[0], "peer_s": {}, "times_faster": {}}
    result |= {f"{kind}_from_converged": {c: getattr(e, kind) for c, e in errors.items()} for kind in ("rms", "max")}
    print(f"{name:10} {result['renderer']}: {1e3 * our_s:.1f} ms, {_in_words(errors['clusterviz'])}, ", end="")
    print(f"{rate / 1e6:.0f} million samples a second and core")
    for caster in CASTERS:
        ratios = [row[caster] / own["median_s"] for own, row in zip(ours, peers, strict=True)]
        seconds = result["peer_s"][caster] = statistics.median(row[caster] for row in peers)
        faster = result["times_faster"][caster] = statistics.median(ratios)
        print(
            f"{'':10} VTK, {caster}: {1e3 * seconds:.1f} ms, {_in_words(errors[caster])}; ours is {faster:.2f} times "
            f"faster ({min(ratios):.2f} … {max(ratios):.2f})",
            flush=True,
        )
    if asked.pictures:
        from PIL import Image

        both = np.concatenate([pictures["gpu"], pictures["clusterviz"]], axis=1)
        Image.fromarray(np.rint(255 * np.clip(both, 0, 1)).astype(np.uint8)).save(asked.pictures / f"{name}.png")
    return result


def _in_words(error: Difference) -> str:
    return f"rms {error.rms:.2e}, max {255 * error.max:.1f} of 255"


def main() -> None:
    """Measure a synthetic volume and the sample mni152, or the volumes that are named."""
    asked = options(
        __doc__,
        volumes={"names": ["volumes"], "nargs": "*", "type": Path, "help": ".npy files of uint8 (z, y, x)"},
        python=PEER_PYTHON,
        width=512,
        device={"help": "as of clusterviz bench raycast; default: what is best"},
        step={"type": float, "default": 1.0, "help": "in voxels, of both"},
        our_step={"type": float, "help": "ours, where it is another"},
        early_termination={"type": float, "default": 0.0, "help": "VTK's own is 1/255; ours: 0, never"},
        brick={"type": int, "default": 64, "help": "voxels along the side of ours; one rank needs only one"},
        rounds=3,
        frames=5,
        pictures={"type": Path, "help": "a folder for the pictures, side by side"},
    )
    with tempfile.TemporaryDirectory() as folder:
        volumes = volumes_of(asked.volumes, Path(folder), "mni152")
        write(asked, rows=[report_on(name, path, asked) for name, path in volumes.items()])


if __name__ == "__main__":
    main()
