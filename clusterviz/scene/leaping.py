"""What coherence leaping can be asked for: one composited volume, whose bricks are drawn whole."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from clusterviz.scene.checks import InvalidValueError


def check_leaping(volumes: Sequence[Any], quality: Any, cluster: Any) -> None:
    """Refuse what cannot be done with the hits of the last frame.

    Several volumes are refused by `check_mixed`.

    Parameters
    ----------
    volumes, quality, cluster : sections of a scene
    """
    if not quality.leaping:
        return
    groups = cluster.groups is not None and cluster.groups > 1
    problems = {
        "settings chosen for quality.max_error": quality.max_error is not None,
        "quality.adaptive": bool(quality.adaptive),
        f"cluster.mode: {cluster.mode}": cluster.mode in ("sort-first", "hybrid"),
        "cluster.groups: ranks do not know what other tiles hit": groups,
        **{f"blending: {volume.blending}": volume.blending != "composite" for volume in volumes},
        "isosurfaces": any(volume.isosurfaces for volume in volumes),
    }
    for name, is_one in problems.items():
        if is_one:
            raise InvalidValueError(f"not with {name}", "false", key="quality.leaping", found=True)
