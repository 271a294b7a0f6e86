"""Keys of meshes, lines and points: colour, opacity, light and place of a surface."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field

from clusterviz.scene.background import background_rgb
from clusterviz.scene.checks import InvalidValueError, check_path, to_builtin
from clusterviz.scene.field_types import FINITE, Background, Clim, Cmap, Fraction, Number, Opacity, Positive, Section


def _check_colour(value: Any) -> Any:
    if background_rgb(value) is None:
        raise InvalidValueError("not a colour", "a CSS colour name, #rrggbb, or [r, g, b] in 0..1")
    return value


Row = tuple[Number, Number, Number, Number]
Transform = Annotated[tuple[Row, Row, Row, Row], BeforeValidator(to_builtin)]


class SurfaceSection(Section):
    """Colour, opacity, light and place that meshes, lines and points have in common."""

    path: Annotated[str, AfterValidator(check_path)] = Field(
        examples=["bone.vtp"], description="The data file, relative to the scene file."
    )
    color: Annotated[Background, AfterValidator(_check_colour)] = Field(
        default="white", description="A CSS colour name, #rrggbb, or [r, g, b] in 0..1."
    )
    scalars: str | None = Field(
        default=None,
        description="Name of an array that gives the colours: numbers through cmap, or red, green, blue (and alpha) as "
        "bytes or in 0..1. Arrays of vertices are interpolated, then classified.",
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
    shade: Annotated[bool, Field(strict=True), BeforeValidator(to_builtin)] = Field(
        default=True, description="Light the surface, on both sides."
    )
    ambient: Fraction = Field(default=0.0, description="Ambient share of the light.")
    diffuse: Fraction = Field(default=1.0, description="Diffuse share of the light.")
    specular: Fraction = Field(default=0.0, description="Specular share of the light.")
    specular_power: Annotated[float, FINITE, Field(ge=0), BeforeValidator(to_builtin)] = Field(
        default=1.0, description="Sharpness of the highlight."
    )
    transform: Transform | None = Field(
        default=None, description="World from the file's coordinates: 4 x 4, row by row, affine. Radii do not change."
    )


class MeshSection(SurfaceSection):
    """Mesh: triangles of a file."""

    shading: Literal["smooth", "flat"] = Field(
        default="smooth", description="Normals of the vertices, interpolated, or of the triangles."
    )
    culling: Literal["none", "front", "back"] = Field(
        default="none", description="The side that is not drawn; vertices are counter-clockwise seen from the front."
    )


class LinesSection(SurfaceSection):
    """Lines: polylines of a file, as tubes with round caps."""

    radius: Positive = Field(description="Of the tubes, in world units.")
    color_by: Literal["color", "scalars", "direction"] = Field(
        default="color", description="What gives the colour; direction: the absolute x, y, z of the segment as RGB."
    )


class PointsSection(SurfaceSection):
    """Points of a file, as spheres."""

    radius: Positive | str = Field(
        default="radius", description="Of the spheres in world units, or the name of an array of radii."
    )
