"""Pyramid filters: `python benchmarks/pyramid.py [--json F]`: times, fetches, and accuracy beside other programs.

Times of filters and of blurs of float32 RGBA images, 512², 1024² and 2048²; of other libraries' Gaussian filters, where
these are installed. Error of scattered values against the function that they sample, beside SciPy's interpolation.
Zoom: SSIM of pictures of the documentation after reduction by 2 and 4 and magnification, beside Pillow's filters; and
what sending magnified pictures to a viewer would take. Least times of three runs.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from importlib import import_module
from typing import Any

import numpy as np
from measuring import ROOT, least, options, write
from numpy.typing import NDArray
from PIL import Image, ImageFilter

from clusterviz.data.scattered import scattered
from clusterviz.image.pyramid import apply_filter, blur, zoom
from clusterviz.image.pyramid.executor import Fetches
from clusterviz.image.pyramid.filters import ANALYSIS, BASIC, SYNTHESIS
from clusterviz.jobs.device import current_device
from clusterviz.pages.tradeoff.rating import luminance, ssim
from clusterviz.viewer.encoding import Encoding, encode

Floats = NDArray[np.float32]
SIDES, SIGMAS = (512, 1024, 2048), (0.5, 1.0, 1.8, 3.0, 8.0, 32.0, 128.0)
PICTURES = ("head", "bones", "skin_and_brain", "orbital", "flow", "shells", "tissues", "annotated", "surface_flow")


def optional(name: str) -> Any:
    """Return a module, or None where it is not installed."""
    try:
        return import_module(name)
    except ImportError:
        return None


def milliseconds(work: Callable[[], object]) -> float:
    """Return the least time of some runs, after the first one."""
    work()
    return 1e3 * least(work)


def row(*words: object) -> None:
    """Print a row of a table."""
    texts = (f"{word:.1f}" if isinstance(word, float) else str(word) for word in words)
    print("| " + " | ".join(texts) + " |", flush=True)


def images() -> dict[int, Floats]:
    """Return noise in four channels."""
    draw = np.random.default_rng(0)
    return {side: draw.random((side, side, 4), dtype=np.float32) for side in SIDES}


def filters() -> list[Any]:
    """Time all filters; the side is that of the finer image."""
    row("filter", "fetches a pixel of the result", *(f"{side}², ms" for side in SIDES))
    found = []
    for each in (*BASIC.values(), *ANALYSIS.values(), *SYNTHESIS.values()):
        halved = each.name in SYNTHESIS
        sources = [image[: n // 2, : n // 2] if halved else image for n, image in images().items()]
        times = [milliseconds(lambda each=each, image=image: apply_filter(each, image)) for image in sources]
        found.append((each.name, each.fetches(), times))
        row(each.name, each.fetches(), *times)
    return found


def gaussians(sigma: float) -> dict[str, Callable[[Floats], object]]:
    """Return the Gaussian filters of other libraries."""
    ndimage, cv2 = optional("scipy.ndimage"), optional("cv2")
    found: dict[str, Callable[[Floats], object]] = {
        "Pillow, 8 bit": lambda image: Image.fromarray((255 * image).astype(np.uint8), "RGBA").filter(
            ImageFilter.GaussianBlur(sigma)
        )
    }
    if ndimage:
        found["SciPy"] = lambda image: ndimage.gaussian_filter(image, (sigma, sigma, 0))
    if cv2:
        found["OpenCV"] = lambda image: cv2.GaussianBlur(image, (0, 0), sigma)
    return found


def blurs() -> list[Any]:
    """Time blurs of all widths, and other libraries' at 1024²."""
    others = list(gaussians(1.0))
    row("sigma", "fetches a pixel", *(f"{side}², ms" for side in SIDES), *(f"{name}, 1024²" for name in others))
    pixels, found = images(), []
    for sigma in SIGMAS:
        counted = Fetches()
        blur(pixels[1024], sigma, counted)
        times = [milliseconds(lambda image=image, sigma=sigma: blur(image, sigma)) for image in pixels.values()]
        besides = [milliseconds(lambda work=work: work(pixels[1024])) for work in gaussians(sigma).values()]
        found.append((sigma, counted.count / 1024**2, times, besides))
        row(sigma, counted.count / 1024**2, *times, *besides)
    return found


def wave(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the function that is sampled."""
    return np.asarray(np.sin(2 * np.pi * x) * np.cos(3 * np.pi * y) + x)


def gridding() -> list[Any]:
    """Time and rate scattered data on 256 × 256 samples."""
    row("points", "method", "rms error", "ms")
    found, library = [], optional("scipy.interpolate")
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
            error = np.sqrt(np.nanmean((work() - wave(x, y)) ** 2))
            found.append((count, name, float(error), milliseconds(work)))
            row(count, name, f"{error:.4f}", found[-1][-1])
    return found


def pillow(small: Floats, size: tuple[int, int], method: Any) -> Floats:
    """Return a picture that Pillow has magnified, in float32."""
    planes = (Image.fromarray(np.ascontiguousarray(small[..., n])) for n in range(small.shape[2]))
    return np.stack([np.asarray(plane.resize(size[::-1], method)) for plane in planes], axis=-1)


def zooms() -> list[Any]:
    """Rate magnified pictures."""
    methods: dict[str, Callable[[Floats, tuple[int, int]], Floats]] = {
        "edge-directed": zoom,
        "Doo-Sabin": lambda small, size: zoom(small, size, edges=False),
        "bilinear": lambda small, size: pillow(small, size, Image.Resampling.BILINEAR),
        "bicubic": lambda small, size: pillow(small, size, Image.Resampling.BICUBIC),
        "Lanczos": lambda small, size: pillow(small, size, Image.Resampling.LANCZOS),
    }
    folder, found = ROOT / "docs/pictures", []
    row("factor", "method", "SSIM, mean", "rms of 255")
    for factor in (2, 4):
        rated: dict[str, list[tuple[float, float]]] = {}
        for name in PICTURES:
            whole = np.asarray(Image.open(folder / f"{name}.png").convert("RGB"), np.float32) / 255
            height, width = (side // factor * factor for side in whole.shape[:2])
            truth = whole[:height, :width]
            small = truth.reshape(height // factor, factor, width // factor, factor, 3).mean(axis=(1, 3))
            for method, work in methods.items():
                made = np.clip(work(np.ascontiguousarray(small, np.float32), (height, width)), 0, 1)
                alike = ssim(luminance(made), luminance(truth))
                rated.setdefault(method, []).append((alike, 255 * float(np.sqrt(np.square(made - truth).mean()))))
        for method, each in rated.items():
            alike, error = np.mean(each, axis=0).tolist()
            found.append((factor, method, alike, error))
            row(factor, method, f"{alike:.4f}", f"{error:.2f}")
    return found


def previews() -> list[Any]:
    """Compare a moving picture that is sent small with one that is magnified before."""
    whole = np.asarray(Image.open(ROOT / "docs/pictures/skin_and_brain.png").convert("RGBA"))
    whole = np.asarray(Image.fromarray(whole).resize((1024, 768)), np.float32) / 255
    jpeg, found = Encoding("jpeg", 75), []
    row("sides", "zoom, ms", "JPEG of the small one, ms", "KiB", "JPEG of the large one, ms", "KiB")
    for factor in (2, 4):
        small = np.asarray(Image.fromarray((255 * whole).astype(np.uint8)).resize((1024 // factor, 768 // factor)))
        part = np.asarray(small, np.float32) / 255
        large = zoom(part, (768, 1024))
        sizes = [len(encode(each, (1, 1, 1), jpeg)) / 1024 for each in (part, large)]
        times = [milliseconds(lambda each=each: encode(each, (1, 1, 1), jpeg)) for each in (part, large)]
        magnified = milliseconds(lambda part=part: zoom(part, (768, 1024)))
        found.append((factor, magnified, times, sizes))
        row(f"1/{factor}", magnified, times[0], sizes[0], times[1], sizes[1])
    return found


def main() -> None:
    asked = options(__doc__)
    print(f"{current_device()}, load {os.getloadavg()[0]:.1f}")
    numbers = {}
    for part in (filters, blurs, gridding, zooms, previews):
        print(f"\n{part.__name__}\n")
        numbers[part.__name__] = part()
    write(asked, **numbers)


if __name__ == "__main__":
    main()
