"""Depth of field: `python benchmarks/depth_of_field.py [--size WxH] [--eye-points N] [--json F]`.

For a head and for opaque surfaces, at several apertures: time of a frame on one rank and error, of sub-images and of
few eye points, against many eye points. `pinhole` is the picture without a lens; `independent` are the sub-images of
the second row, each blurred by itself and blended over the others, as in the thesis, without continuation.

References
----------
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 4.2.4.
"""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from typing import Any

import numpy as np
from measuring import ROOT, Row, options, sample, show, timed, write
from numpy.typing import NDArray

from clusterviz.cli.arguments import parse_size
from clusterviz.comm import LoopbackChannel
from clusterviz.content.geometry.section import MeshSection
from clusterviz.data import open_scene
from clusterviz.data.geometry import Geometry, Mesh
from clusterviz.frame import FrameLoop, Options
from clusterviz.image import compare
from clusterviz.image.merge import over
from clusterviz.image.pyramid.blur import blur
from clusterviz.pages.tradeoff.rating import luminance, ssim
from clusterviz.plan.lens import Lens
from clusterviz.scene import Scene
from clusterviz.scene.overrides import with_settings
from clusterviz.scene.values import Camera, ImageSettings

LENS = import_module("clusterviz.render.lens")
METHODS: dict[str, dict[str, Any]] = {
    "pinhole": {"aperture": 0.0},
    "sub-images 8": {"lens": {"sub_images": 8}},
    "sub-images 16": {"lens": {"sub_images": 16}},
    "sub-images 32": {"lens": {"sub_images": 32}},
    "independent": {"lens": {"sub_images": 16}},
    "eye points 4": {"lens": {"eye_points": 4}},
    "eye points 16": {"lens": {"eye_points": 16}},
}
APERTURES = {"head": (5.0, 10.0, 22.0), "surfaces": (0.08, 0.15, 0.4)}
COLOURS = ((0.8, 0.2, 0.2), (0.3, 0.7, 0.3), (0.2, 0.4, 0.8), (0.9, 0.7, 0.2), (0.6, 0.3, 0.7))
PLACES = ((-2.0, 3.0), (1.2, 8.0), (-1.5, 14.0), (2.5, 20.0), (-3.0, 26.0))
Picture = NDArray[np.float32]


def head() -> tuple[Scene, Any]:
    """Return the example's head."""
    return open_scene(ROOT / "examples/depth_of_field.yaml", [f"volumes.0.path={sample(name='cranium')}"]), None


def surfaces() -> tuple[Scene, Any]:
    """Return a chequered floor that recedes, with blocks on it: opaque, and at all depths."""
    parts: dict[tuple[float, float, float], list[NDArray[np.float64]]] = {}

    def add(colour: tuple[float, float, float], *corners: tuple[float, float, float]) -> None:
        parts.setdefault(colour, []).append(np.array(corners))

    for x, y in np.ndindex(12, 30):
        left, colour = float(x - 6), (0.9, 0.9, 0.85) if (x + y) % 2 else (0.25, 0.3, 0.4)
        add(colour, (left, y, 0), (left + 1, y, 0), (left + 1, y + 1, 0), (left, y + 1, 0))
    for (x, y), colour in zip(PLACES, COLOURS, strict=True):
        ring = [(x - 0.5, y - 0.5), (x + 0.5, y - 0.5), (x + 0.5, y + 0.5), (x - 0.5, y + 0.5)]
        for (ax, ay), (bx, by) in zip(ring, ring[1:] + ring[:1], strict=True):
            add(colour, (ax, ay, 0), (bx, by, 0), (bx, by, 2.4), (ax, ay, 2.4))
        add(colour, *((px, py, 2.4) for px, py in ring))
    sections, given = [], []
    for colour, quads in parts.items():
        points = np.concatenate(quads).astype(np.float32)
        first = 4 * np.arange(len(quads))[:, None]
        faces = np.concatenate([first + np.array(corners) for corners in ([0, 1, 2], [0, 2, 3])])
        given.append(Geometry(mesh=Mesh("m", points, faces)))
        sections.append(MeshSection(path="in memory", color=colour))
    camera = Camera(position=(0, -4, 3), focal_point=(0, 10, 0.5), view_up=(0, 0, 1), view_angle=40)
    return Scene(meshes=tuple(sections), camera=camera, image=ImageSettings(background="white")), given


SCENES = {"head": head, "surfaces": surfaces}


def independent(tall: Picture, lens: Lens) -> Picture:
    """Return the picture of sub-images that are blurred each for itself."""
    picture = np.zeros((len(tall) // lens.count, tall.shape[1], 4), np.float32)
    for number in range(lens.count - 1, -1, -1):
        own = np.ascontiguousarray(tall[number :: lens.count])
        picture = over(blur(own, abs(float(lens.radii[number])) / 2), picture)
    rows, columns = (slice(lens.margin, lens.margin + side) for side in lens.size[::-1])
    return picture[rows, columns]


def drawn(scene: Scene, given: Any, frames: int = 2) -> tuple[Picture, float]:
    """Return the picture, and the least time of some frames."""
    with FrameLoop(scene, LoopbackChannel(), given, Options()) as loop:
        runs = [timed(lambda number=number: loop.frame(number=number).image) for number in range(frames)]
    return np.asarray(runs[-1].value), min(run.wall for run in runs)


def measured(name: str, aperture: float, asked: Any) -> Iterator[Row]:
    """Return the time and the error of all methods, one scene at one aperture."""
    scene, given = SCENES[name]()
    scene = with_settings(scene, {"size": asked.size, "aperture": aperture})
    about = {"scene": name, "aperture": aperture}
    truth, seconds = drawn(with_settings(scene, {"lens": {"eye_points": asked.eye_points}}), given, frames=1)
    yield {**about, "method": f"eye points {asked.eye_points}", "seconds": seconds}
    for method, keys in METHODS.items():
        kept = LENS.depth_of_field
        if method == "independent":
            LENS.depth_of_field = independent
        image, seconds = drawn(with_settings(scene, keys), given)
        LENS.depth_of_field = kept
        error = compare(image.astype(np.float64), truth.astype(np.float64))
        alike = ssim(*(luminance(over_grey(one)) for one in (image, truth)))
        yield {**about, "method": method, "seconds": seconds, "max": error.max, "rms": error.rms, "ssim": alike}


def over_grey(rgba: Picture) -> NDArray[np.float32]:
    """Return a picture over a background on which dark and light parts are visible."""
    return np.clip(rgba[..., :3] + 0.5 * (1 - rgba[..., 3:]), 0, 1)


def main() -> None:
    """Print a table of all scenes and apertures."""
    asked = options(__doc__, size={"type": parse_size, "default": (320, 240), "metavar": "WxH"}, eye_points=128)
    cases = ((name, aperture) for name, apertures in APERTURES.items() for aperture in apertures)
    head = "scene | aperture | method | s | max | rms | ssim"
    cells = "{scene} | {aperture:g} | {method} | {seconds:.2f} | {max:.3f} | {rms:.4f} | {ssim:.4f}"
    write(asked, rows=show(head, cells, (row for case in cases for row in measured(*case, asked))))


if __name__ == "__main__":
    main()
