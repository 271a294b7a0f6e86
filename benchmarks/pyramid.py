"""Pyramid filters: `python benchmarks/pyramid.py [--json F]`: times, and accuracy beside other programs.

Blurs of float32 RGBA images, 512², 1024² and 2048², and other libraries' Gaussian filters, where these are installed.
Error of scattered values against the function that they sample, beside SciPy's interpolation. Zoom: SSIM of pictures
of the documentation after reduction by 2 and 4 and magnification, beside Pillow's filters. Least times of three runs.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from importlib import import_module
from typing import Any

import numpy as np
from measuring import ROOT, Row, least, options, show, write
from numpy.typing import NDArray
from PIL import Image, ImageFilter

from clusterviz.data.scattered import scattered
from clusterviz.image.pyramid import blur, zoom
from clusterviz.image.pyramid.executor import Fetches
from clusterviz.jobs.device import current_device
from clusterviz.pages.tradeoff.rating import luminance, ssim

Floats = NDArray[np.float32]
SIDES, SIGMAS = (512, 1024, 2048), (0.5, 1.0, 1.8, 3.0, 8.0, 32.0, 128.0)
PICTURES = ("head", "bones", "skin_and_brain", "orbital", "flow", "shells", "tissues", "annotated", "surface_flow")


def optional(name: str) -> Any:
    try:
        return import_module(name)
    except ImportError:
        return None


def seconds(work: Callable[[], object]) -> float:
    """The least time of some runs, after the first one."""
    work()
    return least(work)


def gaussians(image: Floats, sigma: float) -> dict[str, Callable[[], object]]:
    ndimage, cv2 = optional("scipy.ndimage"), optional("cv2")
    picture = Image.fromarray((255 * image).astype(np.uint8), "RGBA")
    found: dict[str, Callable[[], object]] = {"Pillow, 8 bit": lambda: picture.filter(ImageFilter.GaussianBlur(sigma))}
    if ndimage:
        found["SciPy"] = lambda: ndimage.gaussian_filter(image, (sigma, sigma, 0))
    if cv2:
        found["OpenCV"] = lambda: cv2.GaussianBlur(image, (0, 0), sigma)
    return found


def blurs() -> Iterator[Row]:
    random = np.random.default_rng(0)
    images = {side: random.random((side, side, 4), dtype=np.float32) for side in SIDES}
    for sigma in SIGMAS:
        counted = Fetches()
        blur(images[1024], sigma, counted)
        own = {f"{side}²": seconds(lambda side=side, s=sigma: blur(images[side], s)) for side in SIDES}
        others = {name: seconds(work) for name, work in gaussians(images[1024], sigma).items()}
        yield {"sigma": sigma, "fetches": counted.count / 1024**2} | own | others


def wave(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.sin(2 * np.pi * x) * np.cos(3 * np.pi * y) + x)


def gridding() -> Iterator[Row]:
    """Scattered data on 256 × 256 samples."""
    library = optional("scipy.interpolate")
    y, x = np.mgrid[0:1:256j, 0:1:256j]
    for count in (100, 1000, 10_000):
        points = np.random.default_rng(count).random((count, 2))
        values = wave(*points.T)
        methods: dict[str, Callable[[], Any]] = {
            "pull-push": lambda p=points, v=values: scattered(p, v, (256, 256), (0, 1, 0, 1)).voxels[0]
        }
        if library:
            methods["griddata, linear"] = lambda p=points, v=values: library.griddata(p, v, (x, y), "linear")
            methods["griddata, nearest"] = lambda p=points, v=values: library.griddata(p, v, (x, y), "nearest")
            methods["RBF, 30 neighbours"] = lambda p=points, v=values: library.RBFInterpolator(p, v, neighbors=30)(
                np.stack([x.ravel(), y.ravel()], axis=1)
            ).reshape(x.shape)
        for name, work in methods.items():
            error = float(np.sqrt(np.nanmean((work() - wave(x, y)) ** 2)))
            yield {"points": count, "method": name, "rms": error, "s": seconds(work)}


def pillow(small: Floats, size: tuple[int, int], method: Any) -> Floats:
    planes = (Image.fromarray(np.ascontiguousarray(small[..., n])) for n in range(small.shape[2]))
    return np.stack([np.asarray(plane.resize(size[::-1], method)) for plane in planes], axis=-1)


MAGNIFIED: dict[str, Callable[[Floats, tuple[int, int]], Floats]] = {
    "edge-directed": zoom,
    "Doo-Sabin": lambda small, size: zoom(small, size, edges=False),
    **{
        name: lambda small, size, name=name: pillow(small, size, Image.Resampling[name.upper()])  # type: ignore[misc]
        for name in ("bilinear", "bicubic", "lanczos")
    },
}


def zooms() -> Iterator[Row]:
    for factor in (2, 4):
        rated: dict[str, list[tuple[float, float]]] = {}
        for name in PICTURES:
            whole = np.asarray(Image.open(ROOT / f"docs/pictures/{name}.png").convert("RGB"), np.float32) / 255
            height, width = (side // factor * factor for side in whole.shape[:2])
            truth = whole[:height, :width]
            small = truth.reshape(height // factor, factor, width // factor, factor, 3).mean(axis=(1, 3))
            for method, work in MAGNIFIED.items():
                made = np.clip(work(np.ascontiguousarray(small, np.float32), (height, width)), 0, 1)
                alike = ssim(luminance(made), luminance(truth))
                rated.setdefault(method, []).append((alike, float(np.sqrt(np.square(made - truth).mean()))))
        for method, each in rated.items():
            alike, error = np.mean(each, axis=0).tolist()
            yield {"factor": factor, "method": method, "ssim": alike, "rms": error}


def main() -> None:
    asked = options(__doc__)
    print(f"{current_device()}, load {os.getloadavg()[0]:.1f}")
    sides, others = [f"{side}²" for side in SIDES], ["Pillow, 8 bit", "SciPy", "OpenCV"]
    head = " | ".join(["sigma", "fetches a pixel", *(f"{side}, ms" for side in sides), *others])
    cells = " | ".join(["{sigma} | {fetches:.1f}", *(f"{{{name}!m:.1f}}" for name in [*sides, *others])])
    write(
        asked,
        blurs=show(head, cells, blurs(), "blurs; other libraries at 1024²"),
        gridding=show(
            "points | method | rms error | ms", "{points} | {method} | {rms:.4f} | {s!m:.1f}", gridding(), "gridding"
        ),
        zooms=show(
            "factor | method | SSIM, mean | rms of 255",
            "{factor} | {method} | {ssim:.4f} | {rms!l:.2f}",
            zooms(),
            "zooms",
        ),
    )


if __name__ == "__main__":
    main()
