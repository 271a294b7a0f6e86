"""Arguments and options shared by several commands, and their parsers."""

from __future__ import annotations

import re
from typing import Annotated

import typer

from clusterviz.errors import InputError
from clusterviz.gl.devices import Device

SceneArgument = Annotated[
    str,
    typer.Argument(metavar="SCENE", help="A scene file (.yaml, .json), or a data file, which gets automatic settings."),
]
Define = Annotated[
    list[str] | None,
    typer.Option("-D", metavar="KEY=VALUE", help="Set any key of the scene: -D quality.step=0.5 (may be repeated)."),
]
Size = Annotated[str | None, typer.Option("--size", metavar="WxH", help="Width and height of the picture in pixels.")]
Frames = Annotated[int, typer.Option(min=1, help="Number of timed frames, after one warm-up frame.")]
PresetOption = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="Preset of the volumes: tissue, bone, mip, …, see `clusterviz presets`."),
]
DeviceOption = Annotated[
    str | None,
    typer.Option("--device", metavar="N|cpu", help="EGL device of every rank, or the CPU; default: in turn."),
]
LayersOption = Annotated[
    str | None,
    typer.Option(
        metavar="L,L,…", help="Layers beside the colours, into .exr or .npz: depth, normal, opacity, object, or all."
    ),
]
AnnotateOption = Annotated[
    bool,
    typer.Option(
        "--annotate", help="Draw scalar bars, axes grid, orientation marker and time stamp, unless the scene says no."
    ),
]


def overrides_of(define: list[str] | None, size: str | None, layers: str | None = None) -> list[str]:
    """Return options as overrides of the scene; size and layers take precedence."""
    overrides = [*(define or []), *([f"image.size={list(parse_size(size))}"] if size else [])]
    if layers is not None:
        from clusterviz.image.files import CHANNELS

        names = list(CHANNELS) if layers == "all" else parse_names(layers, [*CHANNELS], "--layers")
        overrides.append(f"image.layers=[{', '.join(names)}]")
    return overrides


def parse_size(text: str) -> tuple[int, int]:
    """Parse a size such as 800x600 into (width, height).

    Raises InputError: the text has another form, or a side is 0 or too large.
    """
    from clusterviz.scene.field_types import LARGEST_SIDE

    found = re.fullmatch(r"(\d{1,20})[xX×](\d{1,20})", text.strip())
    if not found:
        raise InputError("not a size", where="--size", found=text, allowed="WIDTHxHEIGHT in pixels, as in 800x600")
    width, height = (int(side) for side in found.groups())
    if not (1 <= width <= LARGEST_SIDE and 1 <= height <= LARGEST_SIDE):
        what = "too small" if not width or not height else "too large"
        raise InputError(what, where="--size", found=text, allowed=f"1 to {LARGEST_SIDE} pixels a side")
    return width, height


def parse_device(text: str | None) -> Device:
    """Parse `--device`: the index of an EGL device, "cpu", or None. Raises InputError: the text is something else."""
    if text is None or text == "cpu":
        return text  # type: ignore[return-value]
    if not text.isdecimal():
        raise InputError("not a device", where="--device", found=text, allowed="cpu, or the index of an EGL device")
    return int(text)


def parse_names(text: str, known: list[str], where: str) -> list[str]:
    """Parse a list of names such as "serial,tree". Raises InputError: a name is unknown, or the list is empty."""
    names = [name.strip() for name in text.split(",")]
    unknown = [name for name in names if name not in known]
    if unknown:
        raise InputError("unknown name", where=where, found=unknown[0] or "nothing", allowed=", ".join(known))
    return list(dict.fromkeys(names))


def parse_counts(text: str, least: int, where: str) -> list[int]:
    """Parse a list of whole numbers such as "1,2,4".

    Raises InputError: an item is not a whole number, or is too small.
    """
    numbers = [number.strip() for number in text.split(",")]
    wrong = [number for number in numbers if not number.isdecimal() or int(number) < least]
    if wrong:
        raise InputError(
            "not a count", where=where, found=wrong[0] or "nothing", allowed=f"whole numbers from {least} on: 1,2,4"
        )
    return list(dict.fromkeys(int(number) for number in numbers))
