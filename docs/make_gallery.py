"""Writes docs/pictures: the examples as small pictures, rendered from the scene files as they are.

    python docs/make_gallery.py [NAME...]

Each scene of `SCENES` names the samples that fill its volumes; they are fetched on first use.
"""

from __future__ import annotations

import sys
from pathlib import Path

from PIL import Image

import clusterviz
from clusterviz.data.samples import fetch_sample

ROOT = Path(__file__).parents[1]
SIZE = (480, 360)
COLOURS = 128  # of a picture's palette: a tenth of the bytes, and no difference that the eye sees
SCENES: dict[str, tuple[str, ...]] = {
    "skin_and_brain": ("ch2",),
    "bones": ("cranium",),
    "labels": ("frog",),
    "tissues": ("mni152-gm", "mni152-wm"),
    "two_volumes": (),
    "shells": (),
    "orbital": (),
}


def draw(name: str, samples: tuple[str, ...]) -> Path:
    """Render one example, and write its picture."""
    paths = [f"volumes.{number}.path={fetch_sample(sample)}" for number, sample in enumerate(samples)]
    scene = clusterviz.load_scene(ROOT / "examples" / f"{name}.yaml", [*paths, f"image.size={list(SIZE)}"])
    path = ROOT / "docs" / "pictures" / f"{name}.png"
    path.parent.mkdir(exist_ok=True)
    clusterviz.render(scene).save(path)
    Image.open(path).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)
    return path


if __name__ == "__main__":
    for wanted in sys.argv[1:] or SCENES:
        print(draw(wanted, SCENES[wanted]))
