"""`clusterviz illuminate`: show a spectral picture under a light."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from clusterviz.cli.console import print_info
from clusterviz.cli.jobs import refuse_launcher
from clusterviz.errors import InputError
from clusterviz.image.files import LINEAR, check_writable, write_image
from clusterviz.image.spectral import illuminate, light_of, read_spectral, reflectance_of
from clusterviz.scene.background import background_rgb
from clusterviz.scene.checks import InvalidValueError


def command(
    picture: Annotated[
        Path, typer.Argument(metavar="PICTURE.spectral.npz", help="A spectral picture that render wrote.")
    ],
    output: Annotated[
        Path,
        typer.Option("-o", "--output", metavar="OUT", help="The picture: .png, .jpg, .gif; .exr, .npy, .npz: linear."),
    ],
    light: Annotated[
        str,
        typer.Option(
            metavar="LIGHT", help="D65, A, F11, E (equal energy), laser:NM, laser:NM:WIDTH, or a table of nm, power."
        ),
    ] = "D65",
    background: Annotated[
        str, typer.Option(metavar="COLOUR", help="Colour of the opaque background in daylight, as of image.background.")
    ] = "white",
    adapt: Annotated[
        bool, typer.Option("--adapt", help="Show white things white under this light, as an eye does after a while.")
    ] = False,
) -> None:
    """Show a spectral picture under a light. Lights other than daylight keep their colour unless --adapt is given."""
    refuse_launcher("illuminate", "works in one process")
    check_writable(output)
    shining = light_of(light)
    try:
        rgb = background_rgb(background)
    except InvalidValueError:
        rgb = None
    if rgb is None:
        allowed = "a CSS colour name or #rrggbb"
        raise InputError("not an opaque colour", where="--background", found=background, allowed=allowed)
    spectral = read_spectral(picture)
    linear = output.suffix.lower() in LINEAR
    behind = reflectance_of(rgb, spectral.wavelengths)
    rgba = illuminate(spectral, shining, behind, adapt=adapt, linear=linear)
    write_image(output, rgba, (0.0, 0.0, 0.0), {"clusterviz light": shining.name})
    at = spectral.wavelengths
    print_info(f"lit        {len(at)} wavelengths from {at[0]:g} to {at[-1]:g} nm by {shining.name}")
    print_info(f"\nthe picture is {output}")
