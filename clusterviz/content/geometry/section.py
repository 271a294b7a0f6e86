"""Keys of meshes, lines and points: colour, opacity, light and place of a surface."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag, model_validator

from clusterviz.content.facts import Facts
from clusterviz.scene.background import background_rgb
from clusterviz.scene.checks import InvalidValueError, check_path, to_builtin, union_tag
from clusterviz.scene.field_types import (
    Ambient,
    Background,
    Clim,
    Cmap,
    ContentSection,
    Diffuse,
    DrawnAs,
    Flag,
    Fraction,
    Number,
    Opacity,
    Positive,
    Section,
    Specular,
    SpecularPower,
)


def _check_colour(value: Any) -> Any:
    if background_rgb(value) is None:
        raise InvalidValueError("not a colour", "a CSS colour name, #rrggbb, or [r, g, b] in 0..1")
    return value


def _check_transform(rows: tuple[Any, ...]) -> tuple[Any, ...]:
    matrix = np.array(rows)
    linear = matrix[:3, :3]
    scaled = linear / (np.abs(linear).max() or 1.0)
    if rows[3] != (0.0, 0.0, 0.0, 1.0) or abs(np.linalg.det(scaled)) < FLAT:
        raise InvalidValueError("not affine and invertible", "4 rows of 4 numbers, the last [0, 0, 0, 1]")
    return rows


Colour = Annotated[Background, AfterValidator(_check_colour)]
FLAT_SHARE = 1e-6
"""Share of the longest side of a box below which a side is that of a plane."""
FLAT = 1e-12
"""Determinant, of a matrix whose largest entry is 1, below which it flattens space."""
Row = Annotated[tuple[Number, Number, Number, Number], BeforeValidator(to_builtin)]
Transform = Annotated[tuple[Row, Row, Row, Row], BeforeValidator(to_builtin), AfterValidator(_check_transform)]


class GeometrySection(ContentSection):
    """Colour, opacity, light and place that meshes, lines and points have in common."""

    path: Annotated[str, AfterValidator(check_path)] = Field(
        examples=["bone.vtp"], description="The data file, relative to the scene file."
    )
    color: Colour = Field(default="white", description="A CSS colour name, #rrggbb, or [r, g, b] in 0..1.")
    scalars: str | None = Field(
        default=None,
        description="Name of an array that gives the colours: numbers through cmap, or red, green, blue (and alpha) as "
        "unsigned integers of 8 or 16 bits, or in 0..1. Arrays of vertices are interpolated, then classified. Default: "
        "the file's array RGB or RGBA, unless color is given; of a data file without a scene else its first array of "
        "numbers.",
    )
    cmap: Cmap = Field(default="viridis", description="The colour map of the scalars, as of volumes.")
    clim: Clim | None = Field(
        default=None, description="The scalars at the two ends of the colour map; default: their range."
    )
    opacity: Opacity = Field(
        default=1.0,
        description="Opacity of the surface: a number, or, of scalars, control points [[value, opacity], …] or a "
        "preset as of volumes.",
    )
    shade: Flag = Field(default=True, description="Light the surface, on both sides.")
    ambient: Ambient = 0.0
    diffuse: Diffuse = 1.0
    specular: Specular = 0.0
    specular_power: SpecularPower = 1.0
    transform: Transform | None = Field(
        default=None,
        examples=[[[1, 0, 0, 10], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]],
        description="World from the file's coordinates: 4 x 4, row by row, affine. Radii do not change.",
    )

    drawn_as: ClassVar[DrawnAs] = "fragments"

    @property
    def shown_array(self) -> str | None:
        """Name of the array of scalars that gives the colours."""
        return self.scalars if self.clim is not None else None

    @property
    def has_one_colour(self) -> bool:
        """Whether no scalars give the colours."""
        return self.scalars is None

    @property
    def may_be_opaque(self) -> bool:
        """Whether nothing may be visible behind the surface somewhere."""
        return not isinstance(self.opacity, float) or self.opacity == 1.0

    @model_validator(mode="after")
    def _has_scalars(self) -> GeometrySection:
        if not isinstance(self.opacity, float) and self.scalars is None:
            raise InvalidValueError("no scalars that it depends on", "a number, or scalars beside it", key="opacity")
        return self


class Edges(Section):
    """Edges of a mesh's triangles, painted on them."""

    color: Colour = Field(default="black", description="A CSS colour name, #rrggbb, or [r, g, b] in 0..1.")
    width: Positive | None = Field(
        default=None, description="World units; default: a 1000th of the diagonal of the mesh's box."
    )
    opacity: Fraction = Field(default=1.0, description="Opacity, whatever that of the surface is.")


class MeshSection(GeometrySection):
    """Mesh: triangles of a file."""

    shading: Literal["smooth", "flat"] = Field(
        default="smooth", description="Normals of the vertices, interpolated, or of the triangles."
    )
    culling: Literal["none", "front", "back"] = Field(
        default="none",
        description="The side that is not drawn; vertices are counter-clockwise seen from the front, in the file: a "
        "transform that mirrors keeps the sides.",
    )
    edges: Edges | None = Field(
        default=None,
        examples=[{"color": "black", "width": 0.2}],
        description="Draw the edges of the triangles; default: none.",
    )


class LinesSection(GeometrySection):
    """Lines: polylines of a file, as tubes with round caps."""

    radius: Positive | None = Field(
        default=None, description="Of the tubes, in world units; default: a 500th of the diagonal of the lines' box."
    )
    color_by: Literal["color", "scalars", "direction"] | None = Field(
        default=None,
        description="What gives the colour; direction: the absolute x, y, z of the segment as RGB; default: the "
        "scalars, if they are given.",
    )


def _check_size(value: Any) -> Any:
    value = to_builtin(value)
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        raise InvalidValueError("not a size", "a number more than 0, or the name of an array of numbers")
    return value


Size = Annotated[
    Annotated[str, Tag("<name>")] | Annotated[Positive, Tag("<number>")],
    Discriminator(union_tag),
    BeforeValidator(_check_size),
]


class PointsSection(GeometrySection):
    """Points of a file, as spheres or arrows."""

    style: Literal["spheres", "arrows"] = Field(
        default="spheres",
        description="Spheres, or arrows that begin at the points; arrows are transformed as a whole.",
    )
    radius: Size = Field(
        default="radius",
        description="Of the spheres, or of the arrows' shafts, in world units, or the name of an array of radii; "
        "default: the array radius, or of spheres a 200th of the diagonal of the points' box, of arrows 0.03 of their "
        "length.",
    )
    direction: str | None = Field(
        default=None,
        description="Name of the array of the arrows' vectors. As scalars, this array is the vectors' magnitude.",
    )
    length: Size | None = Field(
        default=None,
        description="Of all arrows, or the name of an array of lengths; default: the vectors' magnitude.",
    )
    scale: Positive | None = Field(
        default=None,
        description="Factor of the arrows' lengths; default: 1 for one length, else such that the longest arrow is a "
        "20th of the diagonal of the points' box.",
    )

    @model_validator(mode="after")
    def _has_direction(self) -> PointsSection:
        of_arrows = {"direction": self.direction, "length": self.length, "scale": self.scale}
        if self.style == "arrows" and self.direction is None:
            raise InvalidValueError("arrows need vectors", "the name of an array of three components", key="direction")
        for key, found in of_arrows.items():
            if self.style != "arrows" and found is not None:
                raise InvalidValueError("spheres have none", "null, or style: arrows", key=key, found=found)
        return self


def is_arrows(section: GeometrySection) -> bool:
    """Return whether a section shows points as arrows."""
    return isinstance(section, PointsSection) and section.style == "arrows"


GEOMETRY_SECTIONS: dict[str, type[GeometrySection]] = {
    "meshes": MeshSection,
    "lines": LinesSection,
    "points": PointsSection,
}
"""Sections of a scene with meshes, lines and points, in the order in which equal depths are composited."""


COLOUR_ARRAYS = ("RGB", "RGBA")
NOT_SHOWN = ("vtk", "stl")
"""Beginnings of the names of arrays that are no data: VTK's own, such as vtkGhostType, and STL's attribute bytes."""


def own_colours(section: GeometrySection, arrays: Arrays) -> str | None:
    """Return the file's array of colours by its name, if there is one and the scene has no colour."""
    if {"color", "scalars"} & section.model_fields_set:
        return None
    return next((name for name in COLOUR_ARRAYS if arrays.get(name, ("", 0))[1] in (3, 4)), None)


def own_scalars(section: GeometrySection, arrays: Arrays) -> str | None:
    """Return the file's array that automatic settings show, if the scene has no colour: colours, else scalars.

    These are the first array of vertices with one number each, else of primitives; radii and directions are none.
    """
    if {"color", "scalars", "color_by"} & section.model_fields_set:
        return None
    radius = getattr(section, "radius", None)
    known = [name for name, (_, width) in arrays.items() if width == 1 and name != radius]
    shown = [name for name in known if not name.startswith(NOT_SHOWN)]
    return own_colours(section, arrays) or next(
        iter(sorted(shown, key=lambda name: arrays[name][0] != "vertices")), None
    )


def as_sections(sections: Iterable[GeometrySection]) -> dict[str, tuple[GeometrySection, ...]]:
    """Return entries by the key of a scene that lists them."""
    each = tuple(sections)
    return {name: tuple(one for one in each if isinstance(one, section)) for name, section in GEOMETRY_SECTIONS.items()}


Arrays = Mapping[str, tuple[Literal["vertices", "primitives"], int]]
"""By the name of each array of a file: what it belongs to, and its number of components."""


@dataclass(frozen=True, eq=False)
class GeometryInfo(Facts):
    """Facts on an entry of meshes, lines or points.

    Attributes
    ----------
    box : float64 (2, 3), low and high corner of the box around what can be drawn, world, with radii of an array but
        not with one radius for all; (0, 3) if there is nothing
    count : primitives, or arrows, that can be drawn
    left_out : triangles, segments or points of the file that cannot: not finite, or without area, length or radius
    has_radii : radii are those of an array
    scalars : minimum and maximum of the array that the section names, or that automatic settings show; None without
        one, and for colours
    has_invalid : some of these are not finite
    arrays : of the file
    axes : directions of x, y and z by the first letters of right, left, anterior, posterior, superior and inferior, if
        the format says what is up; else empty
    other : sections that the file's geometry belongs in, if it has none for this one
    """

    box: NDArray[np.float64]
    count: int
    left_out: int = 0
    has_radii: bool = False
    scalars: tuple[float, float] | None = None
    has_invalid: bool = False
    arrays: Arrays = field(default_factory=dict)
    axes: str = ""
    other: tuple[str, ...] = ()

    @property
    def drawn(self) -> int:
        """Number of primitives, or arrows, that are drawn."""
        return self.count

    @property
    def flat_axis(self) -> int | None:
        """Axis of the world, 0 to 2, along which all lies in a plane; None if there is not exactly one."""
        sides = np.ptp(self.box, axis=0) if len(self.box) and not self.axes else np.ones(3)
        flat = np.flatnonzero(sides <= FLAT_SHARE * sides.max())
        return int(flat[0]) if len(flat) == 1 else None

    @property
    def side(self) -> None:
        """None: bricks need not be larger for its primitives."""
        return None

    def grown_box(self, section: GeometrySection) -> NDArray[np.float64]:
        """Return the box with the radius of a completed section, float64 (2, 3) or (0, 3)."""
        radius = 0.0 if is_arrows(section) else getattr(section, "radius", 0.0)
        return self.box + np.array([[-radius], [radius]])[: len(self.box)] if isinstance(radius, float) else self.box
