"""Real partial images: what each of several ranks would draw of a scene, written for compositors to be measured on.

    python benchmarks/partial_images.py head|vessels DIR [--ranks 8] [--size 1024x1024]

"head" is the MNI head of examples/head.yaml (the sample mni152); "vessels" a tree of thin tubes grown from a seed, as
sparse as an angiogram. The volume is divided as for that many ranks, and one process draws the shares one after the
other. DIR/img_<n>.rgba are bytes, premultiplied, the whole picture, numbered front to back. DIR/exact.npy is float64
(h, w, 4): the composite of these bytes, not of the floats that they were rounded from, since a compositor shall answer
for its own errors only.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from measuring import ROOT, options, picture_of, prepared, sample
from numpy.typing import NDArray

from clusterviz.cli.arguments import parse_size
from clusterviz.data import open_scene
from clusterviz.gl.context import open_context
from clusterviz.partition import build_tree, leaf_pieces
from clusterviz.reference.over import over
from clusterviz.render.opengl import opengl_caster
from clusterviz.scene import Scene, Volume
from clusterviz.scene.values import Cluster, ImageSettings

FORKS = 9  # from a trunk to its thinnest twigs
Floats = NDArray[np.float32]


def head(_folder: Path, size: tuple[int, int]) -> Scene:
    """The cortex of the MNI head."""
    # Cubes of 32 cells, so that eight ranks still get shares of about one size.
    keys = [f"volumes.0.path={sample()}", f"image.size={list(size)}", "cluster.brick=32"]
    return open_scene(str(ROOT / "examples" / "head.yaml"), keys)


def vessels(folder: Path, size: tuple[int, int], side: int = 256) -> Scene:
    """Thin tubes, written to a file in `folder`, and drawn so that what is no tube is transparent."""
    path = folder / "vessels.npy"
    np.save(path, grow_vessels(side))
    opacity = ((60.0, 0.0), (120.0, 0.3), (255.0, 0.9))
    cmap = ((0.0, 0.3, 0.0, 0.0), (255.0, 1.0, 0.75, 0.6))
    volume = Volume(path=str(path), cmap=cmap, clim=(0.0, 255.0), opacity=opacity)
    return Scene(volumes=(volume,), image=ImageSettings(size=size), cluster=Cluster(brick=32))


SCENES: dict[str, Callable[[Path, tuple[int, int]], Scene]] = {"head": head, "vessels": vessels}


def grow_vessels(side: int, seed: int = 7) -> NDArray[np.uint8]:
    """A volume (z, y, x) of `side` voxels a side: three trees of tubes, 255 at their axes and 0 outside.

    Each tube forks into two thinner ones that bend away from it, as arteries do (the cubes of the radii of both
    children add up to the parent's: Murray's law).
    """
    rng = np.random.default_rng(seed)
    voxels = np.zeros((side, side, side), np.uint8)
    for start_xyz, radius in (((0.5, 0.5, 0.04), 0.017), ((0.3, 0.35, 0.04), 0.013), ((0.7, 0.65, 0.04), 0.013)):
        tubes = [(np.array(start_xyz) * side, np.array([0.0, 0.0, 1.0]), radius * side, 0)]
        while tubes:
            begin, direction, thickness, forks = tubes.pop()
            end = begin + direction * side * rng.uniform(0.07, 0.13)
            draw_tube(voxels, begin, end, thickness)
            if forks == FORKS or end.min() < 0.03 * side or end.max() > 0.97 * side:
                continue
            share = rng.uniform(0.3, 0.7)
            for part in (share, 1 - share):
                bent = direction + rng.normal(0, 0.45, 3)
                tubes.append((end, bent / np.linalg.norm(bent), max(1.0, thickness * part ** (1 / 3)), forks + 1))
    return voxels


def draw_tube(voxels: NDArray[np.uint8], begin: NDArray[Any], end: NDArray[Any], radius: float) -> None:
    """Add a tube with round ends between two points (x, y, z); overlapping tubes keep the larger value."""
    low = np.maximum(np.floor(np.minimum(begin, end) - radius - 1), 0).astype(int)
    high = np.minimum(np.ceil(np.maximum(begin, end) + radius + 2), voxels.shape[::-1]).astype(int)
    if (low >= high).any():
        return
    z, y, x = np.mgrid[low[2] : high[2], low[1] : high[1], low[0] : high[0]]
    points = np.stack([x, y, z], axis=-1) - begin
    axis = end - begin
    along = np.clip(points @ axis / (axis @ axis), 0, 1)
    distance = np.linalg.norm(points - along[..., None] * axis, axis=-1)
    value = np.rint(255 * np.clip(1.5 - distance / radius, 0, 1)).astype(np.uint8)
    part = voxels[low[2] : high[2], low[1] : high[1], low[0] : high[0]]
    np.maximum(part, value, out=part)


def partial_images(scene: Scene, ranks: int) -> Iterator[Floats]:
    """What each rank would draw, float32 (h, w, 4), premultiplied, front to back."""
    plan, bricks = prepared(scene)
    pieces = leaf_pieces(build_tree(plan.cost, ranks), plan.cost, plan.eye_in_bricks(), plan.view.forward)
    caster = opengl_caster(open_context(), plan)
    caster.load(plan, bricks)
    for drawn in caster.draw(plan, pieces):
        yield picture_of(plan.view.size, [drawn])
    yield from np.zeros((ranks - len(pieces), *plan.view.size[::-1], 4), np.float32)


def main() -> None:
    asked = options(
        __doc__,
        scene={"names": ["scene"], "choices": sorted(SCENES)},
        folder={"names": ["folder"], "type": Path, "metavar": "DIR"},
        ranks=8,
        size={"type": parse_size, "default": (1024, 1024), "metavar": "WxH"},
    )
    asked.folder.mkdir(parents=True, exist_ok=True)
    layers = []
    with tempfile.TemporaryDirectory() as folder:
        scene = SCENES[asked.scene](Path(folder), asked.size)
        for number, picture in enumerate(partial_images(scene, asked.ranks)):
            pixels = np.rint(255 * picture).astype(np.uint8)
            pixels.tofile(asked.folder / f"img_{number}.rgba")
            layers.append(pixels / 255)
            print(f"img_{number}: {(pixels[..., 3] > 0).mean():.1%} not blank", flush=True)
    exact = over(layers)
    np.save(asked.folder / "exact.npy", exact)
    print(f"exact: {(exact[..., 3] > 0).mean():.1%} not blank")


if __name__ == "__main__":
    main()
