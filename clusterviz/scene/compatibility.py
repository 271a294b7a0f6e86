"""Checks of scene keys that exclude or require each other.

Each check raises an `InvalidValueError` that names the key, the value found and the values allowed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from clusterviz.scene.checks import InvalidValueError

NO_COMMON_SCALE = "their values have no scale in common, of which a ray could show one"
SINGLE_VOLUME_QUALITY = {
    "borders": "what each brick needs of a volume is cut out of it already",
    "filter": "the texture unit samples one volume a brick",
    "adaptive": "there is no bound on the error of mixtures",
}
"""Keys of `quality` that must keep their default with several volumes, and the reason."""
ALLOWED_WITH_SEVERAL = ("composite", "isosurface", "overlap", "exact")
MAX_SURFACES = 32
"""Isosurfaces in all volumes of a scene; the surfaces of one slab are sorted in a list of this length."""


def check_surfaces(blending: str, isosurfaces: tuple[object, ...]) -> None:
    """Require isosurfaces for `blending: isosurface`, and refuse them with projections."""
    if blending == "isosurface" and not isosurfaces:
        raise InvalidValueError("missing", "one data value or more, for blending: isosurface", key="isosurfaces")
    if isosurfaces and blending not in ("composite", "isosurface"):
        allowed = "this key with blending: composite or isosurface"
        raise InvalidValueError(f"not for blending: {blending}", allowed, key="isosurfaces")


def check_gradient(kernel: str, interpolation: str) -> None:
    """Refuse spline gradients with nearest-neighbour interpolation."""
    if kernel == "smooth" and interpolation == "nearest":
        raise InvalidValueError("not for interpolation: nearest", "central", key="gradient", found=kernel)


def check_gradient_opacity(blending: str, has_gradient_opacity: bool, has_table: bool, has_opacity: bool) -> None:
    """Allow gradient-dependent opacity for composited volumes only, and opacity in one key only."""
    for key, found in (("gradient_opacity", has_gradient_opacity), ("transfer_2d", has_table)):
        if found and blending != "composite":
            raise InvalidValueError(f"not for blending: {blending}", "this key with blending: composite", key=key)
    if has_table and (has_opacity or has_gradient_opacity):
        other = "opacity" if has_opacity else "gradient_opacity"
        raise InvalidValueError("opacity is in transfer_2d already", "one of the two keys", key=other)


def check_several_volumes(volumes: Sequence[Any], quality: Any, cluster: Any) -> None:
    """Refuse projections and settings that support a single volume only.

    Parameters
    ----------
    volumes, quality, cluster : sections of a scene
    """
    if len(volumes) < 2:
        return
    keys = [(f"volumes[{n}].blending", volume.blending, NO_COMMON_SCALE) for n, volume in enumerate(volumes)]
    keys += [(f"quality.{name}", getattr(quality, name), why) for name, why in SINGLE_VOLUME_QUALITY.items()]
    keys.append(("cluster.largest_brick", cluster.largest_brick, "bricks of their domain are of one size"))
    for key, found, why in keys:
        if found and found not in ALLOWED_WITH_SEVERAL:
            raise InvalidValueError(f"not for several volumes: {why}", "one volume with it", key=key, found=found)
    surfaces = sum(len(volume.isosurfaces) for volume in volumes)
    if surfaces > MAX_SURFACES:
        allowed = f"{MAX_SURFACES} isosurfaces in all volumes"
        raise InvalidValueError("too many", allowed, key="volumes: isosurfaces", found=surfaces)


def check_pixel_format(volumes: Sequence[Any], pixel: str) -> None:
    """Refuse rounded pixels with projections, whose partial images hold scalars and sums instead of colours."""
    for number, volume in enumerate(volumes):
        if pixel != "float32" and volume.blending not in ALLOWED_WITH_SEVERAL:
            found = f"blending: {volume.blending} in volumes[{number}]"
            raise InvalidValueError(f"{pixel} holds colours only", "float32 with it", key="quality.pixel", found=found)


def check_brick_sizes(brick: int, largest: int | None) -> None:
    """Require that larger bricks consist of whole smallest ones, and these of whole groups of cells."""
    if largest is None:
        return
    if brick % 8:
        allowed = "a multiple of 8, or largest_brick: null"
        raise InvalidValueError("bricks of several sizes are made of groups of 8", allowed, key="brick", found=brick)
    if largest % brick:
        raise InvalidValueError(
            "not made of whole bricks", f"a multiple of {brick}", key="largest_brick", found=largest
        )


def check_groups(mode: str, groups: int | None) -> None:
    """Refuse a number of groups where the mode fixes it: one for sort-last, one a rank for sort-first."""
    if mode == "sort-last" and groups not in (None, 1):
        raise InvalidValueError("sort-last has one group", "1, or mode: hybrid", key="groups", found=groups)
    if mode == "sort-first" and groups is not None:
        raise InvalidValueError("sort-first has a group a rank", "null, or mode: hybrid", key="groups", found=groups)


def check_mode(mode: str, tiling: str, distribution: str, compositing: str, transport: str) -> None:
    """Refuse tilings without a shared screen, and distributions, compositing and transports without shared data."""
    if mode == "sort-last" and tiling != "auto":
        allowed = "auto, or mode: sort-first or hybrid"
        raise InvalidValueError("sort-last does not share the screen", allowed, key="tiling", found=tiling)
    if mode in ("sort-first", "hybrid") and distribution != "auto":
        allowed = "auto, or mode: sort-last"
        text = "where the screen is shared, bricks are assigned by trees"
        raise InvalidValueError(text, allowed, key="distribution", found=distribution)
    if mode == "sort-first" and compositing != "auto":
        allowed = "auto, or mode: sort-last or hybrid"
        raise InvalidValueError("sort-first blends nothing", allowed, key="compositing", found=compositing)
    if mode == "sort-first" and transport not in ("auto", "messages"):
        allowed = "messages, auto, or mode: sort-last or hybrid"
        raise InvalidValueError("sort-first sends tiles straight to rank 0", allowed, key="transport", found=transport)
