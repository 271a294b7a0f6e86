"""Picture files: .npy, .npz and .exr hold float32 pixels before the background, .png, .jpg and .gif bytes over it.

.npz and .exr also hold other layers than the colours.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import InputError, OutputError
from clusterviz.image.finish import Colour, finish
from clusterviz.image.replace import check_replaceable, replacing
from clusterviz.input_files import require_regular_file

JPEG_QUALITY = 95
Pixels = NDArray[np.float32]
Layers = Mapping[str, NDArray[Any]]
"""Layers beside the colours by name, (h, w) or (h, w, 3)."""
LAYERED = (".exr", ".npz")
LINEAR = (".exr", ".npy", ".npz")
"""Files in which the colours of spectral pictures are linear."""
BYTES = {".png": "png", ".jpg": "jpeg", ".jpeg": "jpeg", ".gif": "gif"}
"""Files of bytes over the background, by Pillow's names of their formats."""
SPECTRAL_KEYS = {"R_front", "R_back", "T", "wavelengths"}
"""Names of the layers of a spectral picture."""
CHANNELS = {"depth": ("Z",), "normal": ("X", "Y", "Z"), "opacity": ("A",), "object": ("ID",)}
"""Names of a layer's channels in .exr files, behind the layer's own and a dot."""
TEXT_KEY, RECORD_KEY = "clusterviz scene", "clusterviz record"
"""Keywords of a PNG's text chunks: the scene, and how it was drawn."""


def write_image(
    path: str | os.PathLike[str],
    rgba: Pixels,
    background: Colour | None,
    text: str | Mapping[str, str] = "",
    layers: Layers | None = None,
) -> None:
    """Write a picture in the format of its extension, atomically.

    Parameters
    ----------
    path : ends in .npy, .npz, .exr (float32, premultiplied, before the background) or .png, .jpg, .gif (8 bit, over it)
    rgba : float32 (h, w, 4), premultiplied
    background : (r, g, b) in [0, 1] or None for transparent; unused by .npy, .npz and .exr
    text : description of the picture, or several by their keywords, kept in a .png for `read_text`
    layers : other layers; for .exr and .npz. Those of a spectral picture are written to .npz only, and its colours are
        linear in `LINEAR` ones, those of sRGB in others

    Raises
    ------
    OutputError
        Unknown extension, or one without layers; missing or unwritable folder, disk full. No file is left behind.
    InputError
        `rgba` is not (h, w, 4), or has no pixels.
    """
    if layers and layers.keys() >= SPECTRAL_KEYS:
        from clusterviz.image.spectral.illuminate import linear_picture

        extension = Path(path).suffix.lower()
        if extension in LINEAR:
            rgba = linear_picture(rgba, layers, background or (0.0, 0.0, 0.0))
        layers = layers if extension == ".npz" else None
    write = _WRITERS[_extension(path, bool(layers))]
    if rgba.ndim != 3 or rgba.shape[2] != 4 or rgba.size == 0:
        raise InputError("not a picture", where=str(path), found=f"shape {rgba.shape}", allowed="(h, w, 4)")
    texts = {TEXT_KEY: text} if isinstance(text, str) else text
    more = layers or {} if Path(path).suffix.lower() in LAYERED else texts
    with replacing(path) as temporary:
        write(temporary, rgba, background, more)


def check_writable(path: str | os.PathLike[str], has_layers: bool = False) -> None:
    """Check early that `write_image` can write to a path.

    Raises
    ------
    OutputError
        Unknown extension, or one without layers; missing or unwritable folder.
    """
    _extension(path, has_layers)
    check_replaceable(path)


def read_image(path: str | os.PathLike[str]) -> Pixels:
    """Read a picture that `write_image` wrote, or any PNG, JPEG or GIF.

    Returns
    -------
    rgba : float32 (h, w, 4), premultiplied. An 8-bit picture includes its background.

    Raises
    ------
    InputError
        Unknown extension, missing or damaged file, not RGBA.
    """
    extension = Path(path).suffix.lower()
    if extension not in _READERS:
        raise InputError("unknown extension", where=str(path), found=extension or "none", allowed=", ".join(_READERS))
    with _readable(path):
        rgba = _READERS[extension](Path(path))
    if rgba.ndim != 3 or rgba.shape[2] != 4:
        raise InputError("not a picture", where=str(path), found=f"shape {rgba.shape}", allowed="(h, w, 4)")
    return np.ascontiguousarray(rgba, np.float32)


def read_text(path: str | os.PathLike[str], key: str = TEXT_KEY) -> str:
    """Return the text that `write_image` kept in a PNG under a keyword.

    Raises
    ------
    InputError
        Missing or damaged file, or no such text in it.
    """
    from PIL import Image

    with _readable(path), Image.open(path) as file:
        text = file.info.get(key)
    if not text:
        what = key.rpartition(" ")[2]
        raise InputError(f"no {what} in the picture", where=str(path), allowed="a .png that `clusterviz render` wrote")
    return str(text)


def image_size(path: str | os.PathLike[str]) -> tuple[int, int]:
    """Return width and height of a PNG, JPEG or GIF, by its header alone.

    Raises
    ------
    InputError
        Missing or damaged file.
    """
    from PIL import Image

    with _readable(path), Image.open(path) as file:
        return file.size


@contextmanager
def _readable(path: str | os.PathLike[str]) -> Iterator[None]:
    """Context that turns errors of reading a picture into errors of the input."""
    require_regular_file(path)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Image size")  # Pillow warns long before it refuses
            yield
    except (OSError, ValueError, RuntimeError, KeyError, EOFError, SyntaxError, BadZipFile, MemoryError) as error:
        found = "no picture, or damaged" if "allow_pickle" in str(error) else getattr(error, "strerror", None) or error
        raise InputError("cannot be read as a picture", where=str(path), found=found) from error
    except Exception as error:
        if type(error).__name__ != "DecompressionBombError":  # Pillow is not imported without need
            raise
        raise InputError("too large a picture", where=str(path), found=error) from error


def _extension(path: str | os.PathLike[str], has_layers: bool) -> str:
    extension = Path(path).suffix.lower()
    if extension not in _WRITERS:
        raise OutputError("unknown extension", where=str(path), found=extension or "none", allowed=", ".join(_WRITERS))
    if has_layers and extension not in LAYERED:
        raise OutputError("holds no layers", where=str(path), found=extension, allowed=", ".join(LAYERED))
    return extension


def _write_npy(path: Path, rgba: Pixels, background: Colour | None, _: Mapping[str, Any]) -> None:
    pixels = np.ascontiguousarray(rgba, np.float32)
    # numpy.save writes through C's stdio, which may lose its last buffer on a full disk without an error.
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, np.lib.format.header_data_from_array_1_0(pixels))
        file.write(pixels.data)


def _write_bytes(path: Path, rgba: Pixels, background: Colour | None, text: Mapping[str, Any]) -> None:
    from PIL import Image, PngImagePlugin

    kind, chunks = BYTES[path.suffix.lower()], PngImagePlugin.PngInfo()
    if kind == "jpeg" and background is None:
        raise OSError("a JPEG cannot be transparent: give a background, or write .png")
    for key, each in text.items():
        if each:
            chunks.add_itxt(key, each, zip=True)
    settings: dict[str, dict[str, Any]] = {"png": {"pnginfo": chunks}, "jpeg": {"quality": JPEG_QUALITY}, "gif": {}}
    with path.open("wb") as file:
        Image.fromarray(finish(rgba, background)).save(file, format=kind, **settings[kind])


def _write_npz(path: Path, rgba: Pixels, background: Colour | None, layers: Layers) -> None:
    with path.open("wb") as file:
        arrays: dict[str, Any] = {"rgba": np.asarray(rgba, np.float32), **layers}
        np.savez_compressed(file, **arrays)


def _write_exr(path: Path, rgba: Pixels, background: Colour | None, layers: Layers) -> None:
    import OpenEXR

    channels = {"RGBA": np.ascontiguousarray(rgba, np.float32)}
    for name, layer in layers.items():
        for part, plane in zip(CHANNELS[name], np.moveaxis(np.atleast_3d(layer), -1, 0), strict=True):
            channels[f"{name}.{part}"] = np.ascontiguousarray(plane, np.float32)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    try:
        with OpenEXR.File(header, channels) as file:
            file.write(str(path))
        # The library reports no error if the disk is full when it closes the file, so the file is read again.
        _read_exr(path)
    except (RuntimeError, ValueError) as error:
        raise OSError(str(error)) from error


def _read_npz(path: Path) -> Pixels:
    with np.load(path, allow_pickle=False) as file:
        pixels: Pixels = file["rgba"]
    return pixels


def _read_png(path: Path) -> Pixels:
    from PIL import Image

    with Image.open(path) as file:
        rgba = np.asarray(file.convert("RGBA"), np.float32) / np.float32(255)
    rgba[..., :3] *= rgba[..., 3:]
    return rgba


def _read_exr(path: Path) -> Pixels:
    import OpenEXR

    with OpenEXR.File(str(path)) as file:
        pixels: Pixels = file.channels()["RGBA"].pixels
    return pixels


Write = Callable[[Path, Pixels, Colour | None, Mapping[str, Any]], None]
_WRITERS: dict[str, Write] = {
    ".png": _write_bytes,
    ".npy": _write_npy,
    ".exr": _write_exr,
    ".npz": _write_npz,
    ".jpg": _write_bytes,
    ".jpeg": _write_bytes,
    ".gif": _write_bytes,
}
_READERS: dict[str, Callable[[Path], Pixels]] = {
    ".png": _read_png,
    ".npy": lambda path: np.load(path, allow_pickle=False),
    ".exr": _read_exr,
    ".npz": _read_npz,
    **dict.fromkeys((".jpg", ".jpeg", ".gif"), _read_png),
}
