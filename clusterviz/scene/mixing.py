"""What several volumes in one scene cannot be asked for, and what a projection cannot."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from clusterviz.scene.checks import UnusableError

PROJECTED = "their values have no scale in common, of which a ray could show one"
QUALITIES = {
    "leaping": "the last frame's samples are kept of one",
    "borders": "what each brick needs of a volume is cut out of it already",
    "filter": "the texture unit samples one volume a brick",
    "adaptive": "there is no bound on the error of mixtures",
}
"""What is not done, and why."""
MIXED = ("composite", "isosurface", "overlap", "exact")
MOST_SURFACES = 32
"""In all volumes: those in a slab are kept in a list until they are in order."""


def check_mixed(volumes: Sequence[Any], quality: Any) -> None:
    """Refuse what is not done with a mixture.

    Parameters
    ----------
    volumes, quality : sections of a scene
    """
    if len(volumes) < 2:
        return
    keys = [(f"volumes[{n}].blending", volume.blending, PROJECTED) for n, volume in enumerate(volumes)]
    keys += [(f"quality.{name}", getattr(quality, name), why) for name, why in QUALITIES.items()]
    for key, found, why in keys:
        if found and found not in MIXED:
            raise UnusableError(f"not for several volumes: {why}", "one volume with it", key=key, found=found)
    surfaces = sum(len(volume.isosurfaces) for volume in volumes)
    if surfaces > MOST_SURFACES:
        told = f"{MOST_SURFACES} isosurfaces in all volumes"
        raise UnusableError("too many", told, key="volumes: isosurfaces", found=surfaces)


def check_pixel(volumes: Sequence[Any], pixel: str) -> None:
    """Refuse to round what is no colour: the scalars and sums of which projections are made."""
    for number, volume in enumerate(volumes):
        if pixel != "float32" and volume.blending not in MIXED:
            found = f"blending: {volume.blending} in volumes[{number}]"
            raise UnusableError(f"{pixel} holds colours only", "float32 with it", key="quality.pixel", found=found)
