"""Samples and time that frame coherence saves, and its errors.

    python benchmarks/frame_coherence.py [DATA] [--size N] [--device D]

An orbit of a few frames on one rank, drawn twice frame by frame in turn: every ray from where it enters the volume, and
each just before what the last frame's rays found there. Samples, CPU time, the largest difference of a pixel,
pixels that differ by more than 1/255, and what is told of both, by degrees from frame to frame; the first frame, which
has no last one, is not counted.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from measuring import Row, beside_orbit, options, positional, sample, show, write

from clusterviz.cli.arguments import parse_device
from clusterviz.report.counts import FrameCoherence, all_counts
from clusterviz.scene import Scene, scene_of_data
from clusterviz.scene.overrides import with_settings

FRAMES = 8
STEEP = {"clim": (40.0, 220.0), "opacity": ((60.0, 0.0), (100.0, 0.04), (140.0, 0.25), (220.0, 0.7))}
SPARSE = {"clim": (0.0, 1.0), "opacity": ((0.0, 0.0), (0.6, 0.0), (0.7, 0.5), (1.0, 0.9))}
SURFACE = {"clim": (40.0, 220.0), "blending": "isosurface", "isosurfaces": ((140.0, 1.0),), "shade": True}
SURFACES = {"clim": (40.0, 220.0), "blending": "isosurface", "isosurfaces": ((100.0, 0.4), (160.0, 0.6))}
WIRES = {"clim": (0.0, 1.0), "opacity": ((0.0, 0.0), (0.5, 0.0), (0.6, 0.5), (1.0, 0.9))}
THIN = {"blending": "isosurface", "isosurfaces": ((0.6, 1.0),)}
ENDS = {"early_termination": 1 / 255}


def stent(folder: str, size: int = 128) -> str:
    """A file of twelve helices that cross: wires of a third of a voxel, of which voxels hold beads."""
    volume, turn = np.zeros((size, size, size), np.float32), np.linspace(0.0, 1.0, 24 * size)
    near = np.stack(np.meshgrid(*[np.arange(-1, 3)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    for strand, way in product(range(6), (-1, 1)):
        angle = 2 * np.pi * (2 * way * turn + strand / 6)
        ring = [0.5 + 0.33 * wave(angle) for wave in (np.sin, np.cos)]
        places = size * np.stack([0.08 + 0.84 * turn, *ring], axis=1)
        voxels = np.floor(places).astype(int)[:, None] + near
        apart = ((voxels - places[:, None]) ** 2).sum(axis=2)
        np.maximum.at(volume, tuple(voxels.reshape(-1, 3).T), np.exp(-apart / (2 * 0.35**2)).ravel())
    np.save(path := f"{folder}/stent.npy", volume)
    return path


def scenes_of(head: str, folder: str) -> dict[str, tuple[list[dict[str, Any]], dict[str, Any]]]:
    """Volumes and quality by name."""
    cortex, orbital = {"path": head, **STEEP}, {"path": "field:hydrogen:192", **SPARSE}
    beside = {"spacing": (0.8,) * 3, "origin": (-120.0, -120.0, -70.0)}
    wires = {"path": stent(folder), **WIRES}
    return {
        "head, cortex": ([cortex], {}),
        "head, cortex, rays end": ([cortex], ENDS),
        "head, pre-integrated": ([cortex], {"classification": "pre-integrated"}),
        "head, surface": ([{"path": head, **SURFACE}], ENDS),
        "head, two surfaces": ([{"path": head, **SURFACES}], {}),
        "hydrogen, 192³": ([orbital], {}),
        "head and hydrogen": ([cortex, orbital | beside], ENDS),
        "stent, 128³": ([wires], {}),
        "stent, surface": ([wires | THIN], {}),
    }


def noted(found: Any) -> Row:
    """One frame, and the CPU time of drawing it."""
    (rank,) = found.statistics.per_rank
    return {"image": found.image, "samples": rank.samples, "s": rank.cpu_seconds, "told": rank.frame_coherence}


def measured(head: str, folder: str, asked: Any) -> Iterator[Row]:
    """A row for each scene and angle."""
    for (name, (volumes, quality)), degrees in product(scenes_of(head, folder).items(), asked.degrees):
        data = scene_of_data(volumes[0]["path"]).model_dump(exclude_unset=True)
        data |= {"volumes": volumes, "image": {"size": (asked.size, asked.size)}, "quality": quality}
        ways = [with_settings(Scene.model_validate(data), {"frame_coherence": one}) for one in (False, True)]
        frames = list(beside_orbit(ways, None, degrees, FRAMES, noted, device=asked.device))
        apart = [np.abs(plain["image"] - own["image"]).max(axis=2) for plain, own in frames]
        told = all_counts(own["told"] for _, own in frames) or FrameCoherence()
        samples, fewer = (median(each[n]["samples"] for each in frames) for n in (0, 1))
        yield {
            "scene": name,
            "degrees": degrees,
            "samples": samples,
            "fewer": fewer,
            "share": fewer / samples,
            "s": median(plain["s"] for plain, _ in frames),
            "ratio": median(own["s"] / plain["s"] for plain, own in frames),
            "max": max(float(one.max()) for one in apart),
            "wrong": sum(int((one > 1 / 255).sum()) for one in apart),
            "told_max": told.error,
            "told_wrong": told.wrong_at_most,
        }


def main() -> None:
    """Print the table."""
    data = positional("data", help="a head like that of the sample mni152, which is the default")
    device = {"type": parse_device, "default": "cpu", "help": "cpu, or the index of an EGL device"}
    asked = options(__doc__, data=data, size=512, degrees=[0.5, 2.0], device=device)
    head = "scene | degrees | samples | with frame coherence | share | time | max | wrong | told max | told wrong"
    cells = "{scene} | {degrees:g} | {samples:,.0f} | {fewer:,.0f} | {share:.3f} | {ratio:.2f} | {max:.1e} | {wrong} | "
    with TemporaryDirectory() as folder:
        rows = measured(sample(asked.data), folder, asked)
        write(asked, rows=show(head, cells + "{told_max:.1e} | {told_wrong}", rows))


if __name__ == "__main__":
    main()
