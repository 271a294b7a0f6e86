"""Writes pictures of flows to docs/pictures: lic_noise.png and noise_spectra.png.

    python docs/make_flow_pictures.py

lic_noise.png: line integral convolution of the ABC flow. Rows: white noise, Halton noise; columns: kernel box of length
20, Hann of length 20, Hann of length 60.
noise_spectra.png: power of both noises by frequency.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

import clusterviz
from clusterviz.flow.noise import Noise, power_spectrum
from clusterviz.scene.values import Scene

FOLDER = Path(__file__).parent / "pictures"
PIXELS, COLOURS = 240, 128
KERNELS = (("box", 20.0), ("hann", 20.0), ("hann", 60.0))
OPACITY = ((0.0, 0.0), (0.6, 0.0), (0.9, 0.9), (1.0, 0.95))
SPECTRA = {
    "white": Noise("white"),
    "Halton, points": Noise("halton", blur=0.0),
    "Halton, spots of 1.5 voxels": Noise("halton"),
}
SIDE = 96


def convolved(noise: str, kernel: str, length: float) -> np.ndarray:
    """Return the picture of a flow, uint8 (h, w, 3)."""
    lic = {"noise": noise, "kernel": kernel, "length": length}
    flow = {"path": "field:abc:80", "show": "lic", "lic": lic, "opacity": OPACITY}
    picture = clusterviz.render(Scene.model_validate({"flows": [flow], "image": {"size": [PIXELS, PIXELS]}}))
    with tempfile.TemporaryDirectory() as folder:
        picture.save(path := Path(folder) / "lic.png")
        return np.asarray(Image.open(path).convert("RGB"))


def draw_noises() -> Path:
    """Write pictures side by side."""
    rows = [[convolved(noise, *kernel) for kernel in KERNELS] for noise in ("white", "halton")]
    whole = Image.fromarray(np.concatenate([np.concatenate(row, axis=1) for row in rows]))
    path = FOLDER / "lic_noise.png"
    whole.quantize(COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)
    return path


def draw_spectra() -> Path:
    """Write the plot of the spectra."""
    import matplotlib

    matplotlib.use("Agg")
    matplotlib.rcParams.update({"font.size": 9})
    from matplotlib import pyplot as plt

    figure, axis = plt.subplots(figsize=(6, 3.2))
    for (name, noise), style in zip(SPECTRA.items(), ("-", "--", "-."), strict=True):
        axis.semilogy(
            *power_spectrum(noise.read((SIDE,) * 3, (0, 0, 0), (SIDE,) * 3)), style, label=name, linewidth=1.2
        )
    axis.set(xlabel="frequency, cycles per voxel", ylabel="power / variance", xlim=(0, 0.5), ylim=(1e-3, 1e2))
    axis.grid(color="#dddddd", linewidth=0.6)
    axis.legend(frameon=False)
    figure.tight_layout()
    path = FOLDER / "noise_spectra.png"
    figure.savefig(path, dpi=110, metadata={"Software": None})
    plt.close(figure)
    with Image.open(path) as picture:
        found = picture.convert("RGB")
    found.quantize(32, dither=Image.Dither.NONE).save(path, optimize=True)
    return path


if __name__ == "__main__":
    print(draw_spectra())
    print(draw_noises())
