"""`clusterviz bench codec`: compression ratio and speed of each codec, and the links on which it pays.

One thread encodes one message a picture. A codec pays if encoding, sending and decoding take less time than sending the
raw bytes: on links slower than 8 · (1 − ratio) / (encode + decode) bits a second, with both times in seconds per raw
byte. Decoding is the time to open the message, since runs and boxes are blended without unpacking. The time of
unpacking is printed too, and the JSON holds the time of a checksum (`crc_s`, on each side).
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from clusterviz.cli.arguments import Frames, parse_size
from clusterviz.cli.bench.composite import read_rgba
from clusterviz.cli.bench.report import JsonOption, one_core, write_json
from clusterviz.codec import CODECS, Rows, open_message, pack, prepare_codecs, unpack
from clusterviz.errors import DataError
from clusterviz.input_files import require_regular_file

PIXELS = (np.uint8, np.float16, np.float32)


def command(
    images: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder with img_<rank>.rgba or rendered .npy; default: synthetic pictures."),
    ] = None,
    size: Annotated[str, typer.Option(metavar="WxH", help="Width and height, but for .npy.")] = "1024x1024",
    frames: Frames = 10,
    json: JsonOption = None,
) -> None:
    """Measure every codec: bytes left, speed, and the links on which it pays."""
    shape = parse_size(size)
    results = measure(images_in(images, shape) if images else synthetic_images(shape), frames)
    options = {"images": str(images) if images else None, "size": list(shape), "frames": frames}
    if json:
        write_json(json, {**options, "results": results})
    print(f"{'picture':16} {'codec':28} {'bytes left':>10} {'encode':>8} {'open':>8} {'unpack':>8}  GB/s    pays below")
    for row in results:
        speeds = " ".join(f"{row['bytes_raw'] / row[key] / 1e9:8.2f}" for key in ("encode_s", "open_s", "unpack_s"))
        pays = f"{row['pays_below_gbit_s']:8.2f} Gb/s" if row["pays_below_gbit_s"] else f"{'never':>8}"
        print(f"{row['picture']:16} {row['codec']:28} {100 * row['ratio']:9.2f}% {speeds}        {pays}")


def images_in(folder: Path, size: tuple[int, int]) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the pictures of a folder: raw RGBA8 as they are, .npy as uint8, float16 and float32.

    Raises DataError: there is no picture, or one has the wrong size.
    """
    paths = sorted([*folder.glob("img_*.rgba"), *folder.glob("*.npy")])
    if not paths:
        raise DataError("no pictures", where=str(folder), allowed="img_<rank>.rgba or .npy")
    for path in paths:
        if path.suffix == ".npy":
            yield from _as_all_types(path.stem, _read_npy(path))
        else:
            yield path.stem, read_rgba(path, size)


def _read_npy(path: Path) -> NDArray[Any]:
    """Read a picture of `clusterviz render`: float32 (h, w, 4), premultiplied."""
    require_regular_file(path, DataError)
    try:
        picture: NDArray[Any] = np.load(path, allow_pickle=False)
    except (OSError, ValueError) as error:
        raise DataError(f"cannot be read: {error}", where=str(path)) from None
    if picture.ndim != 3 or picture.shape[2] != 4 or picture.dtype.kind != "f":
        found = f"{picture.dtype} {picture.shape}"
        raise DataError("not a picture", where=str(path), found=found, allowed="floats (h, w, 4)")
    return picture


def _as_all_types(name: str, picture: NDArray[Any]) -> Iterator[tuple[str, NDArray[Any]]]:
    for kind in PIXELS:
        scaled = np.rint(255 * picture.clip(0, 1)) if kind is np.uint8 else picture
        yield f"{name} {np.dtype(kind).name}", scaled.astype(kind)


def synthetic_images(size: tuple[int, int]) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield a shaded ball on a transparent background, a smooth opaque picture and noise, in all pixel formats."""
    y, x = np.mgrid[-1 : 1 : size[1] * 1j, -1 : 1 : size[0] * 1j].astype(np.float32)
    depth = np.sqrt(np.maximum(0.15 - x * x - y * y, 0))[..., None]
    shade = np.array([0.9, 0.6, 0.4, 1.0], np.float32)
    waves = (0.5 + 0.25 * np.cos(9 * x * y) + 0.2 * np.sin(5 * x + 3 * y))[..., None]
    noise = np.random.default_rng(0).random((size[1], size[0], 4), np.float32)
    for name, picture in {"sparse": 2.5 * depth * shade, "dense": waves * shade, "noise": noise}.items():
        yield from _as_all_types(name, picture)


def measure(pictures: Iterator[tuple[str, NDArray[Any]]], frames: int) -> list[dict[str, Any]]:
    """Return one row for each picture and codec, measured on one core if the system supports affinity."""
    with one_core():
        return [
            {"picture": name, "pixel": pixels.dtype.name, "codec": codec, **_measure(pixels, codec, frames)}
            for name, pixels in pictures
            for codec in CODECS
            if codec != "raw"
        ]


def _measure(picture: NDArray[Any], codec: str, frames: int) -> dict[str, float | None]:
    """Measure one codec on one picture; the minimum over repetitions is the least disturbed."""
    prepare_codecs()
    pixels, rows = picture.reshape(-1, 4), Rows(0, max(picture.shape[1], 1))
    count, kind = len(pixels), pixels.dtype
    out, back = np.empty(pixels.nbytes, np.uint8), np.empty_like(pixels)
    message = pack(pixels, codec, rows).copy()
    row: dict[str, float | None] = {"bytes_raw": pixels.nbytes, "bytes": message.nbytes}
    row["ratio"] = ratio = message.nbytes / max(pixels.nbytes, 1)
    calls: dict[str, Callable[[], object]] = {
        "encode": lambda: pack(pixels, codec, rows, out),
        "open": lambda: open_message(message, count, kind, rows),
        "unpack": lambda: unpack(message, count, kind, rows, back),
        "crc": lambda: zlib.crc32(message.data),
    }
    least = 0.0
    for name, call in calls.items():
        seconds = [_seconds(call) for _ in range(frames + 1)][1:]
        row[f"{name}_s"], row[f"{name}_median_s"] = min(seconds), median(seconds)
        least += min(seconds) if name in ("encode", "open") else 0
    saved_bits = 8 * (1 - ratio) * pixels.nbytes
    row["pays_below_gbit_s"] = saved_bits / least / 1e9 if saved_bits > 0 else None
    return row


def _seconds(call: Callable[[], object]) -> float:
    started = perf_counter()
    call()
    return perf_counter() - started
