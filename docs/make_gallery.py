"""Writes docs/pictures: the examples as small pictures, rendered from the scene files as they are.

    python docs/make_gallery.py [NAME...]

Each scene of `SCENES` names the samples that fill its volumes, or other keys; they are fetched on first use.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import clusterviz
from clusterviz.data.samples import fetch_sample
from clusterviz.image.spectral import SpectralPicture, illuminate, light_of

ROOT = Path(__file__).parents[1]
SIZE = (480, 360)
SIZES = {
    "spectral": (320, 240),
    "annotated": (800, 600),
    "flow": (640, 480),
    "reactor_flow": (640, 480),
}  # text and lines
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
    "slices": (),
    "wells": (),
    "layers": (),
    "folds": ("mni152",),
    "depth_of_field": ("cranium",),
    "annotated": ("mni152",),
    "spectral": ("cranium",),
    "flow": (),
    "surface_flow": (),
    "reactor_flow": ("flows.0.path=disk-out", "grids.0.path=disk-out"),
}
GYRE = {"path": "field:double-gyre:48", "radius": 0.012}
ROW = {"kind": "line", "begin": [-0.9, -0.4, 0], "end": [0.9, -0.4, 0]}
FLOWS: dict[str, dict[str, Any]] = {
    "pathlines": GYRE | {"show": "pathlines", "seeds": ROW | {"count": 16}},
    "streaklines": GYRE | {"show": "streaklines", "seeds": ROW | {"count": 7}, "trace": {"release": 0.05}},
    "glyphs": {
        "path": "field:abc:48",
        "show": "glyphs",
        "seeds": {"kind": "plane", "center": [0, 0, 0.2], "normal": [0, 0, 1], "radius": 1, "count": 260},
        "length": 0.22,
        "radius": 0.008,
    },
}
"""Flows of `docs/how-to/show-flow.md`, seen from above."""


def as_colours(layers: Mapping[str, np.ndarray]) -> list[np.ndarray]:
    """Return depth, normal and object as pictures, uint8 (h, w, 3), white where there is none."""
    depth, there = layers["depth"], layers["object"] >= 0
    grey = 1 - 0.8 * (depth - depth[there].min()) / np.ptp(depth[there])
    colours = [grey[..., None].repeat(3, axis=2), 0.5 + 0.5 * layers["normal"], OBJECTS[layers["object"]]]
    return [np.round(255 * np.where(there[..., None], one, 1)).astype(np.uint8) for one in colours]


def under_lights(picture: clusterviz.Image) -> np.ndarray:
    """Return a spectral picture under four lights before black, uint8 (2 h, 2 w, 3)."""
    spectral = SpectralPicture.of_layers(picture.layers)
    shown = [illuminate(spectral, light_of(name), 0.0)[..., :3] for name in ("D65", "A", "F11", "laser:650")]
    return np.round(255 * np.vstack([np.hstack(shown[:2]), np.hstack(shown[2:])])).astype(np.uint8)


def draw(name: str, samples: tuple[str, ...]) -> Path:
    """Render one example, and write its picture."""
    pairs = [each.partition("=")[::2] for each in samples]
    paths = [
        f"{key}={fetch_sample(sample)}" if sample else f"volumes.{number}.path={fetch_sample(key)}"
        for number, (key, sample) in enumerate(pairs)
    ]
    scene = clusterviz.load_scene(
        ROOT / "examples" / f"{name}.yaml", [*paths, f"image.size={list(SIZES.get(name, SIZE))}"]
    )
    path = ROOT / "docs" / "pictures" / f"{name}.png"
    path.parent.mkdir(exist_ok=True)
    picture = clusterviz.render(scene)
    picture.save(path)
    if "T" in picture.layers:
        Image.fromarray(under_lights(picture)).save(path)
    elif picture.layers:
        Image.fromarray(np.concatenate([np.asarray(Image.open(path)), *as_colours(picture.layers)], axis=1)).save(path)
    found = Image.open(path).convert("RGB")
    # Normals and scalar bars have more colours than a palette.
    (found if picture.layers or name in SIZES else found.quantize(COLOURS, dither=Image.Dither.NONE)).save(
        path, optimize=True
    )
    return path


def draw_flow(name: str) -> Path:
    """Render one of `FLOWS`, and write its picture."""
    path = ROOT / "docs" / "pictures" / f"{name}.png"
    camera = {"position": (0, -0.9, 4.3), "focal_point": (0, 0, 0), "view_up": (0, 1, 0)}
    scene = clusterviz.Scene(flows=[FLOWS[name]], camera=camera, image={"size": SIZE, "background": "#0b1020"})
    clusterviz.render(scene).save(path)
    found = Image.open(path).convert("RGB")
    found.quantize(COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)
    return path


if __name__ == "__main__":
    for wanted in sys.argv[1:] or (*SCENES, *FLOWS):
        print(draw_flow(wanted) if wanted in FLOWS else draw(wanted, SCENES[wanted]))
