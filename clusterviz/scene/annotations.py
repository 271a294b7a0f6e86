"""Keys of annotations: scalar bars, outline, axes grid, orientation marker, text, time stamp, scale bar and legend.

The words are those of VTK and ParaView. Each is off by default, and on with its defaults where it is true.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, TypeVar

from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag

from clusterviz.scene.background import background_rgb
from clusterviz.scene.checks import InvalidValueError, to_builtin
from clusterviz.scene.field_types import FINITE, Background, Flag, Number, Section


def _check_switch(value: Any) -> Any:
    """Refuse what is neither a switch nor a section; null is off."""
    value = to_builtin(value)
    if value is None:
        return False
    if isinstance(value, bool) or hasattr(value, "keys") or hasattr(value, "model_fields_set"):
        return value
    raise InvalidValueError("neither a switch nor a section", "true, false, or keys with values")


def _as_lines(value: Any) -> Any:
    return value.splitlines() if isinstance(value, str) else to_builtin(value)


def _check_format(text: str) -> str:
    try:
        text.format(time=1.5)
    except (ValueError, KeyError, IndexError, AttributeError, TypeError):
        raise InvalidValueError("not a format", "a text with {time}, as in t = {time:.2f} s") from None
    if text.format(time=1.5) == text.format(time=2.5):
        raise InvalidValueError("does not depend on the time", "a text with {time}, as in t = {time:.2f} s")
    return text


def _check_color(value: Any) -> Any:
    if value is not None and background_rgb(value) is None:
        raise InvalidValueError("not a colour", "a CSS colour name, #rrggbb, or [r, g, b] in 0..1")
    return value


Lines = Annotated[
    tuple[str, ...], BeforeValidator(_as_lines, json_schema_input_type=str | tuple[str, ...]), Field(max_length=64)
]
Kind = TypeVar("Kind", bound=Section)
Switch = Annotated[
    Annotated[bool, Tag("<switch>")] | Annotated[Kind, Tag("<section>")],
    Discriminator(lambda value: "<switch>" if isinstance(value, bool) else "<section>"),
    BeforeValidator(_check_switch),
]


class ScalarBar(Section):
    """Scalar bar: the colours of the scalars, with their opacity beside them where it varies."""

    title: Lines = Field(
        default=(),
        examples=[["temperature, K"]],
        description="Title, or a list with one for each bar, in the order of volumes, meshes, lines, points and grids; "
        "default: the array's name, or the file's.",
    )
    ticks: Annotated[int, Field(strict=True, ge=2, le=20), BeforeValidator(to_builtin)] = Field(
        default=6, description="Largest number of ticks of a bar."
    )
    opacity: Flag = Field(default=True, description="Draw the opacity beside the colours where it varies.")
    position: Literal["right", "left"] = Field(default="right", description="Side of the picture.")


class AxesGrid(Section):
    """Axes grid: ticks along the axes of the box around the data, and lines across the faces behind them."""

    titles: Annotated[tuple[str, str, str], BeforeValidator(to_builtin)] = Field(
        default=("x", "y", "z"), examples=[["x", "y", "depth"]], description="Titles of the axes x, y and z."
    )
    grid: Flag = Field(default=True, description="Draw lines at the ticks across the faces behind the data.")


class TimeStamp(Section):
    """Time stamp: the time step that is shown."""

    format: Annotated[str, AfterValidator(_check_format)] = Field(
        default="time step {time:g}",
        examples=["t = {time:.2f} s"],
        description="Text with {time}, which may have a format as in Python.",
    )
    first: Number = Field(default=0.0, description="Time of step 0.")
    interval: Number = Field(default=1.0, description="Time between two steps.")


class Legend(Section):
    """Legend: what is shown, with its colours."""

    labels: Lines = Field(
        default=(),
        examples=[["grey matter", "white matter"]],
        description="Names of volumes, meshes, lines, points and grids, in this order; default: the array's names, or "
        "the files'.",
    )


class Annotations(Section):
    """Annotations: text and lines that explain the picture; without a value, a key draws nothing."""

    scalar_bar: Switch[ScalarBar] = Field(
        default=False, examples=[{"title": "temperature, K"}], description="Scalar bar of each transfer function."
    )
    outline: Flag = Field(
        default=False, description="The edges of the box around the data: those behind the data are drawn behind it."
    )
    axes: Switch[AxesGrid] = Field(
        default=False,
        examples=[{"titles": ["x", "y", "depth"]}],
        description="Axes grid with ticks in world units. A camera that is chosen leaves a margin for it.",
    )
    orientation: Flag = Field(
        default=False,
        description="Orientation marker: the directions of x, y and z, with the letters of the body's directions (R, "
        "L, A, P, S, I) if the file has an orientation.",
    )
    title: Lines = Field(default=(), examples=[["Head, T1"]], description="Title, above the picture's middle.")
    text: Lines = Field(default=(), examples=[["patient 7"]], description="Text in the upper left corner.")
    time: Switch[TimeStamp] = Field(
        default=False,
        examples=[{"format": "t = {time:.2f} s", "interval": 0.5}],
        description="Time stamp, for data with time steps.",
    )
    scale_bar: Flag = Field(
        default=False, description="Scale bar in world units; in perspective, at the depth of the focal point."
    )
    legend: Switch[Legend] = Field(
        default=False, examples=[{"labels": ["bone", "vessels"]}], description="Legend of the contents."
    )
    unit: str = Field(default="", examples=["mm"], description="Name of the world unit, for axes and scale bar.")
    color: Annotated[Background, AfterValidator(_check_color)] | None = Field(
        default=None, description="Colour of text and lines; default: black or white, by the background."
    )
    font_size: Annotated[float, FINITE, Field(gt=0, le=0.2), BeforeValidator(to_builtin)] = Field(
        default=0.026, description="Height of text as a share of the picture's smaller side; everything grows with it."
    )

    @property
    def is_empty(self) -> bool:
        """Whether nothing is drawn."""
        return not any(getattr(self, name) for name in DRAWN)


DRAWN = ("scalar_bar", "outline", "axes", "orientation", "title", "text", "time", "scale_bar", "legend")
"""Keys that draw something."""


def section_of(value: bool | Kind, kind: type[Kind]) -> Kind | None:
    """Return the section of a key that may be a switch; None if it is off."""
    return kind() if value is True else value or None
