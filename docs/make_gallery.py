"""Writes docs/pictures: the examples as small pictures, rendered from the scene files as they are.

    python docs/make_gallery.py [NAME...]

Each scene of `SCENES` names the samples that fill its volumes; they are fetched on first use.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from PIL import Image

import clusterviz
from clusterviz.data.samples import fetch_sample

ROOT = Path(__file__).parents[1]
SIZE = (480, 360)
SIZES = {"annotated": (800, 600)}  # text and lines
COLOURS = 128  # of a picture's palette: a tenth of the bytes, and no difference that the eye sees
OBJECTS = np.array([(0.9, 0.6, 0.2), (0.6, 0.2, 0.6), (0.9, 0.2, 0.3), (0.3, 0.6, 0.9)])
SCENES: dict[str, tuple[str, ...]] = {
    "skin_and_brain": ("ch2",),
    "bones": ("cranium",),
    "labels": ("frog",),
    "tissues": ("mni152-gm", "mni152-wm"),
    "two_volumes": (),
    "shells": (),
    "orbital": (),
    "layers": (),
    "folds": ("mni152",),
    "annotated": ("mni152",),
}


def as_colours(layers: Mapping[str, np.ndarray]) -> list[np.ndarray]:
    """Return depth, normal and object as pictures, uint8 (h, w, 3), white where there is none."""
    depth, there = layers["depth"], layers["object"] >= 0
    grey = 1 - 0.8 * (depth - depth[there].min()) / np.ptp(depth[there])
    colours = [grey[..., None].repeat(3, axis=2), 0.5 + 0.5 * layers["normal"], OBJECTS[layers["object"]]]
    return [np.round(255 * np.where(there[..., None], one, 1)).astype(np.uint8) for one in colours]


def draw(name: str, samples: tuple[str, ...]) -> Path:
    """Render one example, and write its picture."""
    paths = [f"volumes.{number}.path={fetch_sample(sample)}" for number, sample in enumerate(samples)]
    scene = clusterviz.load_scene(
        ROOT / "examples" / f"{name}.yaml", [*paths, f"image.size={list(SIZES.get(name, SIZE))}"]
    )
    path = ROOT / "docs" / "pictures" / f"{name}.png"
    path.parent.mkdir(exist_ok=True)
    picture = clusterviz.render(scene)
    picture.save(path)
    if picture.layers:
        Image.fromarray(np.concatenate([np.asarray(Image.open(path)), *as_colours(picture.layers)], axis=1)).save(path)
    found = Image.open(path).convert("RGB")
    # Normals and scalar bars have more colours than a palette.
    (found if picture.layers or name in SIZES else found.quantize(COLOURS, dither=Image.Dither.NONE)).save(
        path, optimize=True
    )
    return path


if __name__ == "__main__":
    for wanted in sys.argv[1:] or SCENES:
        print(draw(wanted, SCENES[wanted]))
