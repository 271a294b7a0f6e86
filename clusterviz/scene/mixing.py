"""What several volumes in one scene can be asked for: emission and absorption at midpoints of slabs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from clusterviz.scene.checks import UnusableError

LOOKS = ("blending", "isosurfaces")
QUALITIES = ("classification", "filter", "adaptive")
MIXED = ("composite", "post", "exact")


def check_mixed(volumes: Sequence[Any], quality: Any) -> None:
    """Refuse what is not done with a mixture.

    Parameters
    ----------
    volumes, quality : sections of a scene
    """
    if len(volumes) < 2:
        return
    keys = [(f"volumes[{n}].{name}", getattr(volume, name)) for n, volume in enumerate(volumes) for name in LOOKS]
    keys += [(f"quality.{name}", getattr(quality, name)) for name in QUALITIES]
    for key, found in keys:
        if found and found not in MIXED:
            raise UnusableError("not for several volumes", "one volume with it", key=key, found=found)
