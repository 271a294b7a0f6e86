"""`clusterviz replay`: render a picture again from the scene that it holds, and say what differs."""

from __future__ import annotations

import json as json_text
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from clusterviz.cli.arguments import Define, DeviceOption, parse_device
from clusterviz.cli.console import Verbosity, print_document, show_progress, verbosity
from clusterviz.cli.instrumentation import start
from clusterviz.comm import agree
from clusterviz.data import FILE_AND_DATASET
from clusterviz.data.remote import is_url
from clusterviz.data.series import files_of_pattern
from clusterviz.errors import ClustervizError, InputError
from clusterviz.frame import STEPS, Options, render_frame
from clusterviz.frame.picture_file import read_record, record_of, write_picture
from clusterviz.image import compare, read_image
from clusterviz.image.compare import Difference
from clusterviz.image.files import check_writable, image_size, read_text
from clusterviz.image.finish import as_shown
from clusterviz.report.provenance import Provenance
from clusterviz.scene import Scene, background_rgb
from clusterviz.scene.files import data_paths, load_picture_scene

LEVEL = 1 / 255
TOLERANCE = {True: LEVEL * (1 + 1e-3), False: 2 * LEVEL}
"""Largest difference of two bytes that were rounded: over a background, and of colour and opacity without one."""


def command(
    context: typer.Context,
    picture: Annotated[Path, typer.Argument(metavar="PICTURE.png", help="A .png that render, animate or view wrote.")],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="OUT", help="Write the new picture, as `render` does.")
    ] = None,
    define: Define = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    device: DeviceOption = None,
) -> None:
    """Render a picture again from the scene in it, and compare: software, ranks, driver, data and pixels.

    Exit status 0 if all pixels agree to the rounding of bytes, 1 if not. Under mpirun, on all ranks.
    """
    channel, _ = start()
    with agree(channel, 0, "picture"):
        record = read_record(picture)
        scene = load_picture_scene(picture, read_text(picture), define or ())
        _check_data(picture, scene, record)
        if (found := image_size(picture)) != scene.image.size:
            raise InputError("not of its scene's size", where=str(picture), found=found, allowed=scene.image.size)
        before, device_choice = read_image(picture), parse_device(device)
        if output and channel.rank == 0:
            check_writable(output)
    made: list[Provenance] = []
    with show_progress(STEPS if channel.rank == 0 else (), per_step=True) as progress:
        keep = lambda image, scene, provenance: made.append(provenance)  # noqa: E731
        options = Options(device_choice, debug=context.obj["debug"], progress=progress, write=keep, annotate=True)
        rendered = render_frame(scene, channel, options=options)
    with agree(channel, 0, "compare"):
        if rendered.image is None:
            return
        if output:
            write_picture(output, rendered.image, rendered.scene, made[0])
        background = background_rgb(scene.image.background)
        difference = compare(as_shown(rendered.image, background), before, TOLERANCE[background is not None])
        now = record_of(rendered.scene, made[0])
        changes = changes_of(record, now)
        if json:
            report = {"equal": not difference.count, "pixels": asdict(difference), "then": record, "now": now}
            print_document(json_text.dumps(report | {"changes": changes}, indent=2, ensure_ascii=False) + "\n")
        elif verbosity() is not Verbosity.QUIET:
            _print(changes, record, difference)
        if difference.count:
            raise ClustervizError(f"the pictures differ: {difference}")


def changes_of(then: Mapping[str, Any], now: Mapping[str, Any]) -> dict[str, tuple[str, str]]:
    """Return what differs between two records: name -> texts of then and now. Errors are not compared."""
    pairs = {name: (then.get(name), now.get(name)) for name in ("ranks", "renderer", "driver")}
    for part in ("versions", "data"):
        before, after = then.get(part) or {}, now.get(part) or {}
        pairs |= {name: (before.get(name), after.get(name)) for name in dict.fromkeys((*before, *after))}
    return {name: (_text(old), _text(new)) for name, (old, new) in pairs.items() if old != new}


def _text(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {each}" for key, each in value.items())
    return "none" if value in (None, "") else str(value)


def _check_data(picture: Path, scene: Scene, record: Mapping[str, Any]) -> None:
    """Refuse a scene whose data are not there."""
    for key, path in data_paths(scene).items():
        dataset = FILE_AND_DATASET.fullmatch(path)
        file = dataset[1] if dataset else path
        if is_url(file) or file.startswith("field:") or Path(file).exists():
            continue
        if (record.get("data") or {}).get(key) is None:
            raise InputError(
                "shows data in memory, which cannot be rendered again from a file",
                where=f"{picture}: {key}",
                found=Path(file).name,
                allowed=f"a picture of files, or -D {key}=FILE with the same data",
            )
        if files_of_pattern(file) != [file]:
            continue
        raise InputError(
            "the data are not there",
            where=f"{picture}: {key}",
            found=path,
            allowed=f"-D {key}=FILE, where they are now",
        )


def _print(changes: Mapping[str, tuple[str, str]], record: Mapping[str, Any], difference: Difference) -> None:
    rows = [("", "then", "now"), *((name, *pair) for name, pair in changes.items())]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows if changes else ():
        print("  ".join(f"{text:{width}}" for text, width in zip(row, widths, strict=True)).rstrip())
    if not changes:
        print("software, ranks, driver and data are the same")
    error = record.get("error") or {}
    if error.get("estimated") is not None:
        print(f"error      about {error['estimated']:.2g} at most (asked for {error['asked_for']:.3g})")
    print(f"pixels     {difference}")
