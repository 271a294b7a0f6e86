"""What frame coherence and early discarding save between frames, and their errors.

    python benchmarks/frame_coherence.py [DATA] [--size N] [--device D]
    python benchmarks/frame_coherence.py --early-discarding [--margins M …]

An orbit of a few frames on one rank, drawn twice frame by frame in turn: as ever, and by what the last frame's rays
found: samples begin just before it, or fragments well behind it are not stored. Samples or fragments, CPU time (medians
of the frames), the largest difference of a pixel, pixels that differ by more than 1/255, and what is told of both; the
first frame, which has no last one, is not counted.
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
from clusterviz.data.geometry import Geometry, Mesh
from clusterviz.report.counts import FrameCoherence, all_counts
from clusterviz.scene import Scene, scene_of_data
from clusterviz.scene.overrides import with_settings

FRAMES, LAYERS = 8, 64
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


def layers() -> Geometry:
    """Waves above one another, of 64 × 64 squares."""
    side = np.linspace(-1.0, 1.0, 65)
    x, y, z = np.meshgrid(side, side, np.linspace(-0.5, 0.5, LAYERS), indexing="ij")
    z = z + 0.1 * np.sin(3 * x) * np.cos(2 * y)
    number = np.arange(x.size).reshape(x.shape)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    triangles = np.concatenate([np.stack(each, axis=-1).reshape(-1, 3) for each in ((a, b, c), (a, c, d))])
    return Geometry(mesh=Mesh("layers", np.stack([x, y, z], axis=-1).reshape(-1, 3).astype(np.float32), triangles))


def volumes_of(head: str, folder: str) -> dict[str, tuple[list[dict[str, Any]], dict[str, Any]]]:
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


def meshes_of() -> dict[str, tuple[dict[str, Any], Any, float]]:
    """Sections of a scene, what is given for them, and a unit of the margin, by name."""
    fibres = {"path": sample(name="fibres"), "radius": 0.4, "color_by": "direction"}
    pial = [{"path": sample(name=f"pial-{side}"), "opacity": 0.5} for side in ("left", "right")]
    head = [{"path": sample(name=f"cranium-{of}"), "opacity": 0.5} for of in ("skin", "bone")]
    found: dict[str, tuple[dict[str, Any], Any, float]] = {
        "fibres, opacity 0.5": ({"lines": [fibres | {"opacity": 0.5}]}, None, 1.0),
        "fibres within the cortex": ({"meshes": pial, "lines": [fibres | {"opacity": 0.5}]}, None, 1.0),
        "fibres, opacity 0.05": ({"lines": [fibres | {"opacity": 0.05}]}, None, 1.0),
        "skull and skin": ({"meshes": head}, None, 1.0),
    }
    for opacity in (0.5, 0.1):
        wave = {"path": "layers", "opacity": opacity}
        found[f"{LAYERS} layers, opacity {opacity}"] = ({"meshes": [wave]}, layers(), 0.01)
    return found


def of_rays(found: Any) -> Row:
    """One frame, and the CPU time of drawing it."""
    (rank,) = found.statistics.per_rank
    return {"image": found.image, "count": rank.samples, "s": rank.cpu_seconds, "told": rank.frame_coherence}


def of_fragments(found: Any) -> Row:
    (rank,) = found.statistics.per_rank
    fragments = sum(int(one.sum()) for one in found.drawn.fragments)
    return {"image": found.image, "count": fragments, "s": rank.cpu_seconds, "told": rank.early_discarding}


def row_of(frames: list[tuple[Row, ...]]) -> Row:
    """What both ways have in common."""
    apart = [np.abs(plain["image"] - own["image"]).max(axis=2) for plain, own in frames]
    count, fewer = (median(each[n]["count"] for each in frames) for n in (0, 1))
    return {
        "count": count,
        "fewer": fewer,
        "share": fewer / count,
        "s": median(plain["s"] for plain, _ in frames),
        "ratio": median(own["s"] / plain["s"] for plain, own in frames),
        "max": max(float(one.max()) for one in apart),
        "wrong": sum(int((one > 1 / 255).sum()) for one in apart),
    }


def coherent(head: str, folder: str, asked: Any) -> Iterator[Row]:
    for (name, (volumes, quality)), degrees in product(volumes_of(head, folder).items(), asked.degrees):
        if asked.only not in name:
            continue
        data = scene_of_data(volumes[0]["path"]).model_dump(exclude_unset=True)
        data |= {"volumes": volumes, "image": {"size": (asked.size, asked.size)}, "quality": quality}
        ways = [with_settings(Scene.model_validate(data), {"frame_coherence": one}) for one in (False, True)]
        frames = list(beside_orbit(ways, None, degrees, FRAMES, of_rays, device=asked.device))
        told = all_counts(own["told"] for _, own in frames) or FrameCoherence()
        yield {"scene": name, "degrees": degrees, **row_of(frames), "told": told.error, "most": told.wrong_at_most}


def discarding(asked: Any) -> Iterator[Row]:
    for (name, (sections, given, unit)), margin, degrees in product(meshes_of().items(), asked.margins, asked.degrees):
        if asked.only not in name:
            continue
        scene = Scene.model_validate(sections | {"image": {"size": (asked.size, asked.size)}, "quality": ENDS})
        ways = [with_settings(scene, {"early_discarding": one}) for one in (None, margin * unit)]
        how = {"device": asked.device, "keep_drawn": True}
        frames = list(beside_orbit(ways, given, degrees, FRAMES, of_fragments, **how))
        pixels, again = (median(getattr(own["told"], key) for _, own in frames) for key in ("pixels", "redrawn"))
        yield {"scene": f"{name}, margin {margin * unit:g}", "degrees": degrees, **row_of(frames)} | {
            "pixels": pixels,
            "again": again,
        }


def main() -> None:
    asked = options(
        __doc__,
        data=positional("data", help="a head like that of the sample mni152, which is the default"),
        size=512,
        degrees=[0.5, 2.0],
        device={"type": parse_device, "default": "cpu", "help": "cpu, or the index of an EGL device"},
        only="",
        early_discarding=False,
        margins={"type": float, "nargs": "*", "default": [2.0], "help": "millimetres, or 1/100 of the layers"},
    )
    head = "scene | degrees | samples or fragments | fewer | share | time | max | wrong"
    cells = "{scene} | {degrees:g} | {count:,.0f} | {fewer:,.0f} | {share:.3f} | {ratio:.2f} | {max:.1e} | {wrong}"
    if asked.early_discarding:
        head, cells = f"{head} | pixels | again", cells + " | {pixels:,.0f} | {again:,.0f}"
        write(asked, rows=show(head, cells, discarding(asked)))
        return
    with TemporaryDirectory() as folder:
        rows = coherent(sample(asked.data), folder, asked)
        head, cells = f"{head} | told max | told wrong", cells + " | {told:.1e} | {most}"
        write(asked, rows=show(head, cells, rows))


if __name__ == "__main__":
    main()
