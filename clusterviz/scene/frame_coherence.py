"""Check of `quality.frame_coherence`: it needs composited volumes or isosurfaces, whose bricks are drawn whole."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from clusterviz.scene.checks import InvalidValueError

HIT = ("composite", "isosurface")
"""Blendings with a first visible sample on a ray; projections have none."""


def check_frame_coherence(volumes: Sequence[Any], quality: Any, cluster: Any) -> None:
    """Raise an error for settings that frame coherence does not support.

    Parameters
    ----------
    volumes, quality, cluster : sections of a scene
    """
    if not quality.frame_coherence:
        return
    groups = cluster.groups is not None and cluster.groups > 1
    problems = {
        "settings chosen for quality.max_error": quality.max_error is not None,
        "quality.adaptive": bool(quality.adaptive),
        f"cluster.mode: {cluster.mode}": cluster.mode in ("sort-first", "hybrid"),
        "cluster.groups: ranks do not know what other tiles hit": groups,
        **{f"blending: {volume.blending}": volume.blending not in HIT for volume in volumes},
    }
    for name, is_one in problems.items():
        if is_one:
            raise InvalidValueError(f"not with {name}", "false", key="quality.frame_coherence", found=True)
