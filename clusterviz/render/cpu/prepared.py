"""Variants of the shaders that most scenes need, to be compiled before anyone waits for them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from clusterviz.data.bricks import BrickLayout, read_bricks
from clusterviz.data.memory import ArraySource
from clusterviz.data.summary import summarise
from clusterviz.plan.blend_mode import margin_of
from clusterviz.plan.content import KnownVolume
from clusterviz.plan.plan import make_plan
from clusterviz.render.cpu.device import variant_for
from clusterviz.render.cpu.pieces import CAPACITIES, MOST
from clusterviz.render.variant import USUAL_BRICK, Lanes, Variant
from clusterviz.scene.values import Camera, Scene, Volume

SHADED = {"shade": True}
LOOKS: tuple[dict[str, Any], ...] = (
    {},
    SHADED,
    {"blending": "maximum"},
    {"blending": "isosurface", "isosurfaces": (3.0,)} | SHADED,
)
CAMERA = Camera(position=(9.0, 9.0, 9.0), focal_point=(1.0, 1.0, 1.0), view_up=(0.0, 0.0, 1.0))


def common_variants(lanes: int) -> list[Variant]:
    """Return variants of one volume with linear interpolation: composite, shaded or not, maximum, and isosurface."""
    found: list[Variant] = []
    for dtype in ("uint8", "uint16", "float32"):
        for look in LOOKS:
            variant = _variant_of(dtype, look, lanes)
            found.append(variant)
            if lanes == MOST and variant.blending == "composite":
                found += [replace(variant, cpu=Lanes(lanes, capacity, True)) for capacity in CAPACITIES]
    return found


def first_variants(lanes: int) -> list[Variant]:
    """Return the variants of `launch/demo`, and of an 8-bit data file without a scene."""
    held = Lanes(lanes, CAPACITIES[1], True) if lanes == MOST else Lanes(lanes)
    return [replace(_variant_of("uint8", look, lanes), cpu=held) for look in ({}, SHADED)]


def _variant_of(dtype: str, look: dict[str, Any], lanes: int) -> Variant:
    """Return the variant of a volume that fills a brick along every axis."""
    source = ArraySource(np.zeros((USUAL_BRICK + 1,) * 3, dtype))
    volume = Volume(
        path="-",
        cmap=((0.0, 0.0, 0.0, 0.0), (7.0, 1.0, 1.0, 1.0)),
        clim=(0.0, 7.0),
        opacity=((0.0, 0.0), (7.0, 0.5)),
        opacity_unit_distance=1.0,
        **look,
    )
    scene = Scene(volumes=(volume,), camera=CAMERA)
    margin = margin_of(volume, scene.quality.classification, scene.quality.borders)
    layout = BrickLayout(source.grid.shape_zyx, USUAL_BRICK, margin)
    bricks = dict(read_bricks(source, layout, [(0, 0, 0)]))
    summary = summarise(source.dtype, layout, lambda: iter(bricks.items()), lambda value: [value])
    return variant_for(make_plan(scene, [KnownVolume(source, layout, summary)]), lanes, [None])
