"""A volume of 3.7 GiB, its store, and its first picture: `python benchmarks/large_volume.py FOLDER [--errors 0,1,2,4]`.

The volume has the size of the Visible Human, 2048 × 1024 × 1878 samples of 8 bits: the sample `ch2better`, interpolated
by Catmull-Rom splines, with noise of a fixed seed where it is not empty. It is written plane by plane as `large.raw`
with the header `large.mhd`, once; `clusterviz store` makes `errorE.ome.zarr` of it for each error E.

Printed are the time of each conversion, the peak memory of the largest rank, the sizes of the stores, and of some of
their bricks the decoding speed and what zstd and blosc2 make of the same bytes; then the time from the start of a
process until its picture is written, and its peak memory, here and of pvbatch on the raw file with the same transfer
function and camera. It needs the extra `store`; the parts of blosc2, pvbatch and xvfb-run are omitted without them.
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
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from measuring import CLUSTERVIZ, beside, commas, options, write

SIZE = (2048, 1024, 1878)
BRICKS = 200
"""Bricks that are compressed by other programs, spread evenly over the volume."""
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


def compare_bricks(folder: Path, wanted: int) -> dict[str, Any]:
    """Return the shares of the bytes of some bricks that remain, and the speed of decoding, in MB/s of CPU time."""
    import zstandard

    from clusterviz.data.store.shards import BrickCodec, open_array

    found: dict[str, Any] = {}
    for store in sorted(folder.glob("error*.ome.zarr")):
        warm, array = open_array(store / "0"), open_array(store / "0")
        assert warm is not None
        assert array is not None
        bricks = [brick for shard in array.shards for brick in array.bricks_of(shard)]
        bricks = bricks[:: max(1, len(bricks) // wanted)]
        warm.brick(bricks[0])
        began = time.thread_time()
        samples = [array.brick(brick) for brick in bricks]
        seconds = time.thread_time() - began
        size = sum(each.nbytes for each in samples)
        found[f"decode {store.name}, MB/s"] = size / seconds / 1e6
        if array.codec.error:
            continue
        programs: dict[str, Callable[[Any], bytes]] = {
            f"clusterviz, effort {n}": BrickCodec("wavelet", 0.0, n).encode for n in (1, 19)
        }
        programs |= {f"zstd {n}": zstandard.ZstdCompressor(n).compress for n in (1, 19, 22)}
        with suppress(ImportError):
            import blosc2  # type: ignore[import-not-found, import-untyped, unused-ignore]

            options = {"codec": blosc2.Codec.ZSTD, "clevel": 9, "typesize": 1}
            programs |= {
                f"blosc2 zstd 9 {each.name.lower()}": partial(blosc2.compress2, filters=[each], **options)
                for each in (blosc2.Filter.NOFILTER, blosc2.Filter.BITSHUFFLE)
            }
        for name, program in programs.items():
            found[name] = sum(len(program(each)) for each in samples) / size
        found["bricks"] = len(bricks)
    return found


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
    """Return the start of a command for some ranks, and its environment."""
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
    """Return seconds to the first picture and MiB of the largest process, of each store, the raw file, and pvbatch."""
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
    size, found = math.prod(asked.size), dict[str, Any]()
    print(f"made in {measured([*here, '--part', 'make'])[0]:.0f} s, if it was missing; load {os.getloadavg()[0]:.1f}")
    start, environment = ranks_of(asked.ranks)
    stores = [folder / f"error{error:g}.ome.zarr" for error in asked.errors]
    for error, store in zip(asked.errors, stores, strict=True):
        shutil.rmtree(store, ignore_errors=True)
        command = [*CLUSTERVIZ, "--quiet", "store", str(folder / "large.mhd"), str(store)]
        seconds, cpu, memory = measured([*start, *command, "--error", str(error)], **environment)
        levels = [
            sum(file.stat().st_size for file in (store / name / "c").rglob("*") if file.is_file())
            for name in sorted(each.name for each in store.iterdir() if each.name.isdigit())
        ]
        found[store.name] = {"seconds": seconds, "cpu": cpu, "memory_mib": memory, "levels": levels}
        print(
            f"{store.name}: {seconds:.0f} s on {asked.ranks} ranks, {size / cpu / 1e6:.0f} MB/s a core, "
            f"{memory:.0f} MiB at most a rank; the finest level {100 * levels[0] / size:.2f} % of its samples, "
            f"all {100 * sum(levels) / size:.2f} %",
            flush=True,
        )
    measured([*here, "--part", "bricks", "--bricks", str(asked.bricks)])
    found["bricks"] = json.loads((folder / "bricks.json").read_text())
    for name, value in found["bricks"].items():
        print(f"{name}: {value:.0f}" if value > 1 else f"{name}: {100 * value:.2f} % of the bytes of these bricks")
    found["first picture"] = first_pictures(folder, stores, asked.ranks, asked.width, asked.keys)
    for name, (seconds, cpu, memory) in found["first picture"].items():
        print(f"first picture of {name}: {seconds:.1f} s ({cpu:.1f} s of CPU time), {memory:.0f} MiB at most a process")
    if "pvbatch" in found["first picture"]:
        from clusterviz.image import compare, read_image

        theirs, ours = (read_image(folder / f"{name}.png")[..., :3] for name in ("pvbatch", "large.mhd"))
        found["away"] = 255 * compare(theirs, ours).rms
        print(f"pvbatch's picture is {found['away']:.1f} of 255 away from that of large.mhd (rms)")
    write(asked, **found)


def main() -> None:
    """Measure, or do a part of it."""
    asked = options(
        __doc__,
        folder={"names": ["folder"], "type": Path, "help": "where volume and stores are kept, and made if missing"},
        errors={"type": commas(float), "default": [0.0]},
        size={"type": commas(int), "default": SIZE},
        ranks=1,
        width=512,
        bricks={"type": int, "default": BRICKS, "help": "that other programs compress"},
        keys={"names": ["-D"], "dest": "keys", "action": "append", "default": ["cluster.memory_limit=536870912"]},
        part={"choices": ("make", "bricks"), "help": argparse.SUPPRESS},
    )
    if asked.part == "make":
        make(asked.folder, asked.size)
    elif asked.part == "bricks":
        (asked.folder / "bricks.json").write_text(json.dumps(compare_bricks(asked.folder, asked.bricks)))
    else:
        measure(asked)


if __name__ == "__main__":
    main()
