"""Keys of unstructured grids: tetrahedra, hexahedra, wedges and pyramids, drawn as volumes without resampling."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag

from clusterviz.content.facts import Facts
from clusterviz.content.geometry.section import Transform
from clusterviz.scene.checks import InvalidValueError, check_path, to_builtin
from clusterviz.scene.field_types import (
    Ambient,
    Clim,
    Cmap,
    ContentSection,
    Diffuse,
    DrawnAs,
    Flag,
    Opacity,
    Positive,
    Section,
    Specular,
    SpecularPower,
)

MOST_GRIDS = 4
"""Grids of a scene: a ray walks through all of them at the same time."""


Entries = Literal["sorted", "unsorted"]
"""How a k-buffer holds its entries."""


class KBuffer(Section):
    """K-buffer: entries a pixel, which bring the faces in order as far as they suffice."""

    k: Annotated[int, Field(strict=True, ge=2, le=32), BeforeValidator(to_builtin)] = Field(
        examples=[6], description="Entries a pixel, 2 to 32; pixels that need more are wrong, and counted."
    )
    entries: Entries = Field(
        default="sorted",
        description="Keep the entries in order, or search them for the nearest two; pictures are the same.",
    )
    integration: Literal["exact", "table"] = Field(
        default="exact",
        description="Integrate segments from the pieces of the transfer function, or take them from a table of 64 x 64 "
        "scalars and 32 lengths.",
    )


def _check_visibility(value: Any) -> Any:
    if value == "exact" or isinstance(value, (dict, KBuffer)):
        return value
    raise InvalidValueError("not an order of visibility", "exact, or {k: 2 to 32}")


def _check_time(value: Any) -> Any:
    value = to_builtin(value)
    if isinstance(value, float) or (type(value) is int and value >= 0):
        return value
    raise InvalidValueError("not a time step", "its number, a whole number from 0 on, or its time with a decimal point")


Time = Annotated[
    Annotated[int, Tag("<number>")] | Annotated[float, Field(strict=True, allow_inf_nan=False), Tag("<points>")],
    Discriminator(lambda value: "<points>" if isinstance(value, float) else "<number>"),
    BeforeValidator(_check_time),
]
Visibility = Annotated[
    Annotated[Literal["exact"], Tag("<name>")] | Annotated[KBuffer, Tag("<points>")],
    Discriminator(lambda value: "<name>" if isinstance(value, str) else "<points>"),
    BeforeValidator(_check_visibility),
]


class GridSection(ContentSection):
    """Grid: an unstructured grid of a file, with the scalars of one of its arrays."""

    drawn_as: ClassVar[DrawnAs] = "segments"

    path: Annotated[str, AfterValidator(check_path)] = Field(
        examples=["disk.vtu"], description="The data file, relative to the scene file."
    )
    array: str | None = Field(
        default=None, description="Name of the array of scalars, of points or cells; default: the first one."
    )
    time: Time | None = Field(
        default=None,
        description="Time step: its number, from 0, or its time with a decimal point; default: the last one.",
    )
    cmap: Cmap = Field(default="viridis", description="The colour map, as of volumes.")
    clim: Clim | None = Field(
        default=None, description="The scalars at the two ends of the colour map; default: their range."
    )
    opacity: Opacity | None = Field(
        default=None,
        description="Opacity over one opacity unit distance, as of volumes; default: 0 up to 0.3 of clim, then rising "
        "to 0.9.",
    )
    opacity_unit_distance: Positive | None = Field(
        default=None,
        description="World units over which opacity counts; default: the cube root of the cells' mean volume.",
    )
    shade: Flag = Field(
        default=False, description="Light the grid by its gradient, which is constant in a tetrahedron."
    )
    ambient: Ambient = 0.0
    diffuse: Diffuse = 1.0
    specular: Specular = 0.0
    specular_power: SpecularPower = 1.0
    visibility: Visibility = Field(
        default="exact",
        examples=[{"k": 6}],
        description="exact, or {k: 6}: a k-buffer of 6 entries a pixel, whose errors are counted.",
    )
    transform: Transform | None = Field(
        default=None,
        examples=[[[1, 0, 0, 10], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]],
        description="World from the file's coordinates: 4 x 4, row by row, affine.",
    )

    @property
    def objects(self) -> int:
        """None, since they have no surface."""
        return 0


@dataclass(frozen=True, eq=False)
class GridInfo(Facts):
    """Facts on an unstructured grid of a scene.

    Attributes
    ----------
    box : float64 (2, 3), low and high corner of the box around all tetrahedra, world; (0, 3) if there are none
    count : number of tetrahedra
    drawn : number of cells that they are parts of
    scalars : minimum and maximum of the array in them; None if there are none
    cell_size : cube root of the mean volume of a cell that is drawn, world units; 0 if there are none
    counts : cells that are not drawn, or drawn otherwise, as `Tetrahedra.counts`
    overlaps : whether two cells lie on the same side of a face; known after the first plan
    side : mean side of the box around a tetrahedron, world units
    array : name of the array of scalars
    """

    box: NDArray[np.float64]
    count: int
    drawn: int = 0
    scalars: tuple[float, float] | None = None
    cell_size: float = 0.0
    counts: Mapping[str, int] = field(default_factory=dict)
    overlaps: bool = False
    side: float = 0.0
    array: str = ""

    @property
    def left_out(self) -> int:
        """Number of cells that cannot be drawn."""
        return sum(self.counts.get(name, 0) for name in ("flat", "misplaced", "invalid"))

    def grown_box(self, _: GridSection) -> NDArray[np.float64]:
        """Return the box."""
        return self.box
