"""Lights of a scene, as VTK has them: far away, or in a place, with or without a cone."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, model_validator

from clusterviz.scene.checks import check_attenuation, check_light, plain
from clusterviz.scene.kinds import FINITE, Fraction, Section, Vector

NotNegative = Annotated[float, FINITE, Field(ge=0), BeforeValidator(plain)]
Attenuation = Annotated[tuple[NotNegative, NotNegative, NotNegative], BeforeValidator(plain)]


class Light(Section):
    """A light: from position towards focal_point everywhere alike, or, if positional, from where it is."""

    type: Literal["headlight", "scene"] = Field(
        default="scene", description="headlight: shines from the eye; scene: stays where it is."
    )
    position: Vector | None = Field(default=None, description="From where a scene light shines, in world units.")
    focal_point: Vector = Field(default=(0.0, 0.0, 0.0), description="Towards where.")
    color: Annotated[tuple[Fraction, Fraction, Fraction], BeforeValidator(plain)] = Field(
        default=(1.0, 1.0, 1.0), examples=[[1, 0.9, 0.8]], description="[r, g, b] in 0..1."
    )
    intensity: NotNegative = Field(default=1.0, description="Times its colour.")
    positional: Annotated[bool, Field(strict=True), BeforeValidator(plain)] = Field(
        default=False, description="A scene light that shines from its position in all directions of its cone."
    )
    cone_angle: Annotated[float, FINITE, Field(gt=0, le=90), BeforeValidator(plain)] = Field(
        default=30.0,
        description="Of a positional light: degrees from the cone's axis, which goes to focal_point, to its edge; "
        "90: there is no cone, it shines everywhere.",
    )
    exponent: NotNegative = Field(
        default=1.0, description="Of a cone: the light goes by this power of the cosine of the angle from its axis."
    )
    attenuation: Attenuation = Field(
        default=(1.0, 0.0, 0.0),
        examples=[[1, 0, 0.1]],
        description="Of a positional light: [a, b, c]; at a distance d, in world units, its light is divided by "
        "a + b d + c d².",
    )

    @property
    def has_cone(self) -> bool:
        """Whether it shines in some directions only."""
        return self.positional and self.cone_angle < 90

    @model_validator(mode="after")
    def _has_direction(self) -> Light:
        check_light(self.type, self.position, self.focal_point, self.positional and not self.has_cone)
        check_attenuation(self.type, self.positional, self.attenuation)
        return self
