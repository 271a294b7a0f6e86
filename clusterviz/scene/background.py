"""Background colours: CSS names, #rrggbb or [r, g, b]."""

from __future__ import annotations

from typing import Any

from clusterviz.scene.checks import InvalidValueError, to_builtin

RGB = tuple[float, float, float]
ALLOWED = "a CSS colour name, #rrggbb, [r, g, b] in 0..1, or transparent"


def background_rgb(background: str | RGB) -> RGB | None:
    """Return the RGB components of a background colour.

    `background`: `ImageSettings.background`. Returns components in [0, 1]; None for transparent. Raises
    InvalidValueError: the colour is unknown or half transparent.
    """
    if not isinstance(background, str):
        return background
    if background.strip().lower() == "transparent":
        return None
    from PIL import ImageColor

    try:
        found = ImageColor.getrgb(background.strip())
    except ValueError:
        raise InvalidValueError("unknown colour", ALLOWED) from None
    if len(found) != 3:
        raise InvalidValueError("a half transparent background", ALLOWED)
    red, green, blue = (channel / 255 for channel in found)
    return red, green, blue


def check_background(value: Any) -> Any:
    """Validate a background colour; the numbers of [r, g, b] are checked by their field type."""
    value = to_builtin(value)
    if isinstance(value, str) and value not in ("white", "black", "transparent"):
        background_rgb(value)
    if not isinstance(value, (str, list, tuple)):
        raise InvalidValueError("not a colour", ALLOWED)
    return value
