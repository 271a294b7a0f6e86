"""What is cut away from the volumes of a scene."""

from __future__ import annotations

from typing import Annotated

from pydantic import BeforeValidator, Field

from clusterviz.scene.checks import plain
from clusterviz.scene.kinds import Box, Normal, Section, Vector


class Clip(Section):
    """What is cut away from all volumes; what is left is what every plane and the box keep."""

    planes: tuple[Annotated[tuple[Vector, Normal], BeforeValidator(plain)], ...] = Field(
        default=(),
        examples=[[[[0, 0, 0], [1, 0, 0]]]],
        description="[[[x, y, z], [nx, ny, nz]], …]: a point of each plane, and the way to what is kept.",
    )
    box: Annotated[Box, BeforeValidator(plain)] | None = Field(
        default=None, description="[xmin, xmax, ymin, ymax, zmin, zmax] of what is kept, in world units."
    )
    cap: Annotated[bool, Field(strict=True), BeforeValidator(plain)] = Field(
        default=True,
        description="Light what lies next to cut faces of shaded volumes by the normals of the faces, not by gradients "
        "alone, which even tissue does not have.",
    )
