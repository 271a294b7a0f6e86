"""A volume of 3.7 GiB, its store, and its first picture: `python benchmarks/large_volume.py FOLDER [--errors 0,1,2,4]`.

The volume has the size of the Visible Human, 2048 × 1024 × 1878 samples of 8 bits: the sample `ch2better`, interpolated
by Catmull-Rom splines, with noise of a fixed seed where it is not empty. It is written plane by plane as `large.raw`
with the header `large.mhd`, once; `clusterviz store` makes `errorE.ome.zarr` of it for each error E.

Printed are the time of each conversion, the peak memory of the largest rank and the sizes of the stores; then the time
from the start of a process until its picture is written, and its peak memory, here and of pvbatch on the raw file with
the same transfer function and camera. It needs the extra `store`; without pvbatch and xvfb-run their part is omitted.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from measuring import CLUSTERVIZ, Row, beside, commas, options, show, write

SIZE = (2048, 1024, 1878)
CLIM, OPACITY = [20.0, 130.0], [[20.0, 0.0], [60.0, 0.0], [130.0, 0.8]]


def make(folder: Path, size: tuple[int, ...]) -> None:
    """Write the volume, unless it is there."""
    import numpy as np

    from clusterviz.data import open_source
    from clusterviz.data.samples import fetch_sample

    raw, shape = folder / "large.raw", tuple(size[::-1])
    if raw.exists() and raw.stat().st_size == math.prod(shape):
        return
    source = open_source(fetch_sample("ch2better"))
    grid = source.grid
    samples = source.read((0, 0, 0), grid.shape_zyx)

    def weights(count: int, wanted: int) -> Any:
        """Catmull-Rom splines, float32 (wanted, count): both ends are samples of both."""
        at = np.linspace(0, count - 1, wanted)
        first = np.minimum(at.astype(int), count - 2)
        t = (at - first)[:, None]
        four = np.concatenate(
            [-t + 2 * t**2 - t**3, 2 - 5 * t**2 + 3 * t**3, t + 4 * t**2 - 3 * t**3, t**3 - t**2], axis=1
        )
        found = np.zeros((wanted, count), np.float32)
        for n in range(4):
            np.add.at(found, (np.arange(wanted), np.clip(first + n - 1, 0, count - 1)), four[:, n] / 2)
        return found

    along_z, along_y, along_x = (weights(*pair) for pair in zip(grid.shape_zyx, shape, strict=True))
    planes: dict[int, Any] = {}
    with (folder / "part.raw").open("wb") as file:
        for z, row in enumerate(along_z):
            met = np.flatnonzero(row).tolist()
            planes = {n: planes[n] if n in planes else along_y @ samples[n].astype(np.float32) @ along_x.T for n in met}
            plane = sum(row[n] * planes[n] for n in met)
            # The sum of three bytes, about normal, with a standard deviation of 3 levels in the brightest tissue.
            noise = np.random.default_rng(z).integers(0, 256, (3, *plane.shape), np.uint8)
            spread = noise.sum(axis=0, dtype=np.int16).astype(np.float32) - 382.5
            plane += plane * spread * np.float32(3 / (128 * 255))
            file.write(np.clip(np.rint(plane), 0, 255).astype(np.uint8).tobytes())
    os.replace(folder / "part.raw", raw)
    steps = [s * (n - 1) / (m - 1) for s, n, m in zip(grid.spacing, grid.shape_zyx[::-1], size, strict=True)]
    lines = {
        "ObjectType": "Image", "NDims": "3", "DimSize": size, "ElementSpacing": steps, "Offset": grid.origin,
        "ElementType": "MET_UCHAR", "BinaryData": "True", "BinaryDataByteOrderMSB": "False",
        "ElementDataFile": "large.raw",
    }  # fmt: skip
    text = [f"{key} = {each if isinstance(each, str) else ' '.join(map(str, each))}\n" for key, each in lines.items()]
    (folder / "large.mhd").write_text("".join(text))


def measured(command: list[str], **environment: str) -> tuple[float, float, float]:
    """Run a program; return seconds, CPU seconds, and the peak memory of the largest of its processes in MiB."""
    began = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, env=os.environ | environment)
    _, status, used = os.wait4(process.pid, 0)
    seconds = time.perf_counter() - began
    if status:
        raise SystemExit(f"{' '.join(command)} ended with {os.waitstatus_to_exitcode(status)}")
    return seconds, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


def ranks_of(count: int) -> tuple[list[str], dict[str, str]]:
    if count == 1:
        return [], {}
    from clusterviz.cli.jobs import OVERSUBSCRIBE, find_mpirun

    return [find_mpirun(), "-n", str(count)], OVERSUBSCRIBE


def scene_of(folder: Path, path: str, width: int) -> dict[str, Any]:
    """Return the scene that both programs draw."""
    words = dict(line.split(" = ") for line in (folder / "large.mhd").read_text().splitlines())
    numbers = {key: [float(n) for n in words[key].split()] for key in ("DimSize", "ElementSpacing", "Offset")}
    sides = [(n - 1) * s for n, s in zip(numbers["DimSize"], numbers["ElementSpacing"], strict=True)]
    centre = [o + side / 2 for o, side in zip(numbers["Offset"], sides, strict=True)]
    away = 1.6 * math.hypot(*sides) / math.sqrt(3)
    camera = {"position": [c + away for c in centre], "focal_point": centre, "view_up": [0, 0, 1], "view_angle": 30.0}
    volume = {
        "path": path, "clim": CLIM, "cmap": [[CLIM[0], 0, 0, 0], [CLIM[1], 1, 1, 1]],
        "opacity": OPACITY, "opacity_unit_distance": 1.0, "shade": False,
    }  # fmt: skip
    image = {"size": [width, width], "background": "black"}
    return {"volumes": [volume], "camera": camera, "image": image, "automatic": False}


def first_pictures(folder: Path, stores: list[Path], ranks: int, width: int, keys: Sequence[str]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    start, environment = ranks_of(ranks)
    for path in (*stores, folder / "large.mhd"):
        scene, picture = folder / f"{path.name}.json", folder / f"{path.name}.png"
        scene.write_text(json.dumps(scene_of(folder, str(path), width)))
        command = [*start, *CLUSTERVIZ, "--quiet", "render", str(scene), "-o", str(picture)]
        command += [word for key in keys for word in ("-D", key)]
        found[path.name] = measured(command, **environment)
    if shutil.which("pvbatch") and shutil.which("xvfb-run"):
        content = scene_of(folder, "", width)
        order, position = folder / "order.json", content["camera"]["position"]
        order.write_text(json.dumps({"file": str(folder / "large.mhd"), "scene": content, "frames": [position]}))
        program = str(beside("pvbatch_pictures.py"))
        command = ["pvbatch", "--force-offscreen-rendering", program, str(order), str(folder / "pvbatch")]
        system = os.pathsep.join(part for part in os.environ["PATH"].split(os.pathsep) if "venv" not in part)
        # Without -noreset the server may refuse a client that comes while it resets after the one before.
        server = ["xvfb-run", "-a", "-s", "-screen 0 1280x1024x24 -noreset"]
        found["pvbatch"] = measured([*server, *command], PATH=system, PYTHONPATH="")
    return found


def measure(asked: argparse.Namespace) -> None:
    """Run all programs, each in a process of its own: it begins with the peak memory of the one that starts it."""
    folder = asked.folder
    folder.mkdir(exist_ok=True)
    here = [sys.executable, __file__, str(folder), "--size", ",".join(map(str, asked.size))]
    size = math.prod(asked.size)
    print(f"made in {measured([*here, '--part', 'make'])[0]:.0f} s, if it was missing; load {os.getloadavg()[0]:.1f}")
    start, environment = ranks_of(asked.ranks)
    stores = [folder / f"error{error:g}.ome.zarr" for error in asked.errors]

    def conversions() -> Iterator[Row]:
        for error, store in zip(asked.errors, stores, strict=True):
            shutil.rmtree(store, ignore_errors=True)
            command = [*CLUSTERVIZ, "--quiet", "store", str(folder / "large.mhd"), str(store)]
            seconds, cpu, memory = measured([*start, *command, "--error", str(error)], **environment)
            levels = [
                sum(file.stat().st_size for file in (store / name / "c").rglob("*") if file.is_file()) / size
                for name in sorted(each.name for each in store.iterdir() if each.name.isdigit())
            ]
            row = {"store": store.name, "s": seconds, "cpu": cpu, "rate": size / cpu, "mib": memory}
            yield row | {"levels": levels, "finest": levels[0], "all": sum(levels)}

    head = "store | s | B/s a core, millions | MiB at most a rank | finest level | all levels"
    cells = "{store} | {s:.0f} | {rate!M:.0f} | {mib:.0f} | {finest:.2%} | {all:.2%}"
    stored = show(head, cells, conversions(), f"on {asked.ranks} ranks; levels as shares of the samples")
    pictures = first_pictures(folder, stores, asked.ranks, asked.width, asked.keys)
    head, cells = "first picture of | s | CPU s | MiB at most a process", "{what} | {s:.1f} | {cpu:.1f} | {mib:.0f}"
    drawn = show(
        head, cells, (dict(zip(("s", "cpu", "mib"), one, strict=True), what=name) for name, one in pictures.items())
    )
    found = {"stored": stored, "drawn": drawn}
    if "pvbatch" in pictures:
        from clusterviz.image import compare, read_image

        theirs, ours = (read_image(folder / f"{name}.png")[..., :3] for name in ("pvbatch", "large.mhd"))
        found["away"] = 255 * compare(theirs, ours).rms
        print(f"pvbatch's picture is {found['away']:.1f} of 255 away from that of large.mhd (rms)")
    write(asked, **found)


def main() -> None:
    asked = options(
        __doc__,
        folder={"names": ["folder"], "type": Path, "help": "where volume and stores are kept, and made if missing"},
        errors={"type": commas(float), "default": [0.0]},
        size={"type": commas(int), "default": SIZE},
        ranks=1,
        width=512,
        keys={"names": ["-D"], "dest": "keys", "action": "append", "default": ["cluster.memory_limit=536870912"]},
        part={"choices": ("make",), "help": argparse.SUPPRESS},
    )
    if asked.part == "make":
        make(asked.folder, asked.size)
    else:
        measure(asked)


if __name__ == "__main__":
    main()
