"""Arguments that several commands share, so that they look and behave the same in each."""

from __future__ import annotations

import re
from typing import Annotated

import typer

from clusterviz.errors import InputError
from clusterviz.render.choice import Device

SceneArgument = Annotated[
    str,
    typer.Argument(
        metavar="SCENE", help="A scene file (.yaml, .json), or a data file: it is shown as it is best seen."
    ),
]
Define = Annotated[
    list[str] | None,
    typer.Option("-D", metavar="KEY=VALUE", help="Set any key of the scene: -D quality.step=0.5 (may be repeated)."),
]
Size = Annotated[str | None, typer.Option("--size", metavar="WxH", help="Width and height of the picture in pixels.")]

DeviceOption = Annotated[
    str | None,
    typer.Option("--device", metavar="N|cpu", help="EGL device of every rank, or the processor; default: in turn."),
]


def overrides_of(define: list[str] | None, size: str | None) -> list[str]:
    """Both options as overrides of the scene; the size comes last and so holds."""
    return [*(define or []), *([f"image.size={list(parse_size(size))}"] if size else [])]


def parse_size(text: str) -> tuple[int, int]:
    """(width, height) of a text like 800x600.

    Raises
    ------
    InputError
        It is not of that form, or a side is none, or longer than a picture's can be.
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
    """What `--device` names: an EGL device's index, "cpu", or nothing.

    Raises
    ------
    InputError
        It is neither.
    """
    if text is None or text == "cpu":
        return text  # type: ignore[return-value]
    if not text.isdecimal():
        raise InputError("not a device", where="--device", found=text, allowed="cpu, or the index of an EGL device")
    return int(text)


def parse_names(text: str, known: list[str], where: str) -> list[str]:
    """The names in a list like "serial,tree".

    Raises
    ------
    InputError
        One of them is not known, or there is none.
    """
    names = [name.strip() for name in text.split(",")]
    unknown = [name for name in names if name not in known]
    if unknown:
        raise InputError("unknown name", where=where, found=unknown[0] or "nothing", allowed=", ".join(known))
    return list(dict.fromkeys(names))


def parse_counts(text: str, least: int, where: str) -> list[int]:
    """The numbers in a list like "1,2,4".

    Raises
    ------
    InputError
        One of them is not a whole number, or too small.
    """
    numbers = [number.strip() for number in text.split(",")]
    wrong = [number for number in numbers if not number.isdecimal() or int(number) < least]
    if wrong:
        raise InputError(
            "not a count", where=where, found=wrong[0] or "nothing", allowed=f"whole numbers from {least} on: 1,2,4"
        )
    return list(dict.fromkeys(int(number) for number in numbers))
