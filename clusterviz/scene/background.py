"""The background colour: names of CSS, #rrggbb and [r, g, b] become three fractions."""

from __future__ import annotations

from typing import Any

from clusterviz.scene.checks import UnusableError, plain

RGB = tuple[float, float, float]
ALLOWED = "a CSS colour name, #rrggbb, [r, g, b] in 0..1, or transparent"


def background_rgb(background: str | RGB) -> RGB | None:
    """The background of an image as three fractions.

    Parameters
    ----------
    background : `ImageSettings.background`

    Returns
    -------
    rgb : each in [0, 1]; None for transparent

    Raises
    ------
    UnusableError
        No such colour.
    """
    if not isinstance(background, str):
        return background
    if background.strip().lower() == "transparent":
        return None
    from PIL import ImageColor

    try:
        found = ImageColor.getrgb(background.strip())
    except ValueError:
        raise UnusableError("unknown colour", ALLOWED) from None
    if len(found) != 3:
        raise UnusableError("a half transparent background", ALLOWED)
    red, green, blue = (channel / 255 for channel in found)
    return red, green, blue


def check_background(value: Any) -> Any:
    """A known colour; the numbers of [r, g, b] are checked by their own type."""
    value = plain(value)
    if isinstance(value, str) and value not in ("white", "black", "transparent"):
        background_rgb(value)
    if not isinstance(value, (str, list, tuple)):
        raise UnusableError("not a colour", ALLOWED)
    return value
