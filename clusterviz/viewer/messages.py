"""Messages of the viewer's clients, checked, and the binary form of pictures and files.

A client sends JSON objects with a `type`; each type is a class here. Unknown types and keys, wrong types, numbers that
are not finite and values out of range are refused. The server sends JSON objects too, and binary messages: a
little-endian uint32 with the length of the header, the header as JSON, and the file.
"""

from __future__ import annotations

import struct
from json import dumps
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    JsonValue,
    TypeAdapter,
    ValidationError,
    field_validator,
    model_validator,
)
from pydantic_core import from_json, to_json

from clusterviz.errors import InputError
from clusterviz.scene.camera import check_camera
from clusterviz.scene.checks import InvalidValueError
from clusterviz.scene.validation_messages import scene_error

PROTOCOL = 1
"""Version of the protocol; it rises with each incompatible change."""
MAX_TEXT_BYTES = 256 << 10
MAX_CHANGES, MAX_KEY_FRAMES = 256, 1000
MIN_SIDE, MAX_SIDE, MAX_SAVED_SIDE = 16, 4096, 16384
"""Sides of pictures in pixels: of the window, which are clamped, and of saved ones."""
MAX_NUMBER = 2**53
"""Largest whole number that JavaScript counts exactly."""


def _clamp(pixels: int) -> int:
    return min(max(pixels, MIN_SIDE), MAX_SIDE)


Counter = Annotated[int, Field(ge=0, le=MAX_NUMBER)]
Vector = Annotated[tuple[float, float, float], Field(examples=[[0, 0, 1]])]
WindowSide = Annotated[int, Field(ge=0, le=MAX_NUMBER), AfterValidator(_clamp)]
SavedSide = Annotated[int, Field(ge=1, le=MAX_SAVED_SIDE)]
ShareOfPicture = Annotated[float, Field(ge=0, le=1)]
ShortText = Annotated[str, Field(min_length=1, max_length=200)]


class Part(BaseModel):
    """Base class of messages and their parts."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class Pose(Part):
    """Camera: where the eye is and what it sees."""

    position: Vector = Field(description="The eye, world.")
    focal_point: Vector = Field(description="The point in the middle of the picture, world.")
    view_up: Vector = Field(description="The direction that points up in the picture.")
    view_angle: float = Field(default=30.0, gt=0, lt=180, description="Vertical angle of view, degrees.")
    parallel_scale: Annotated[float, Field(gt=0)] | None = Field(
        default=None, description="Half the height of the picture in world units, for a parallel projection."
    )

    @model_validator(mode="after")
    def _check(self) -> Pose:
        check_camera(self.position, self.focal_point, self.view_up)
        return self


class View(Part):
    """The camera is there now."""

    type: Literal["view"] = "view"
    camera: Pose
    moving: bool = Field(description="Whether the camera moves on, so that pictures may be coarse.")
    input: Counter = Field(description="Rises with each view and edit; pictures name the newest that they show.")


class Edit(Part):
    """Change keys of the scene."""

    type: Literal["edit"] = "edit"
    changes: Annotated[dict[ShortText, JsonValue], Field(min_length=1, max_length=MAX_CHANGES)] = Field(
        description="Values by full key, as in volumes.0.opacity; null stands for the default."
    )
    moving: bool = Field(description="Whether changes follow at once, as while a point is dragged.")
    input: Counter = Field(description="As in view.")
    merge: ShortText | None = Field(
        default=None, description="Consecutive edits with the same text are one step of undo."
    )

    @field_validator("changes")
    @classmethod
    def _check(cls, changes: dict[str, Any]) -> dict[str, Any]:
        try:
            dumps(changes, allow_nan=False)
        except ValueError:
            raise InvalidValueError("a value is not finite", "finite numbers") from None
        return changes


class Undo(Part):
    """Take back the last edit."""

    type: Literal["undo"] = "undo"


class Redo(Part):
    """Apply the edit again that was taken back last."""

    type: Literal["redo"] = "redo"


class Reset(Part):
    """Return to the scene as it was opened."""

    type: Literal["reset"] = "reset"


class Size(Part):
    """The window has this size."""

    type: Literal["size"] = "size"
    width: WindowSide = Field(description=f"Device pixels; clamped to {MIN_SIDE}…{MAX_SIDE}.")
    height: WindowSide = Field(description="As width.")


class Preset(Part):
    """Give a volume the transfer function of a preset."""

    type: Literal["preset"] = "preset"
    volume: Annotated[int, Field(ge=0, le=1000)] = Field(description="Index of the volume.")
    name: ShortText = Field(description="One of the presets of hello.")


class Pick(Part):
    """Ask for the position and the value at a pixel."""

    type: Literal["pick"] = "pick"
    x: ShareOfPicture = Field(description="From the left edge, as a share of the picture.")
    y: ShareOfPicture = Field(description="From the top edge, as a share of the picture.")
    pick: Counter = Field(description="Number that the answer repeats.")


class Steer(Part):
    """Ask for, give or take part in who steers."""

    type: Literal["steer"] = "steer"
    action: Literal["ask", "grant", "refuse", "release"]
    client: Counter | None = Field(default=None, description="The client that asked, for grant and refuse.")

    @model_validator(mode="after")
    def _check(self) -> Steer:
        if self.action in ("grant", "refuse") and self.client is None:
            raise InvalidValueError("missing", "the number of the client that asked", key="client")
        return self


class KeyPose(Part):
    """Key frame of a camera path."""

    time: Annotated[float, Field(ge=0, le=1e6)] = Field(description="Seconds.")
    camera: Pose


class Save(Part):
    """Ask for a file."""

    type: Literal["save"] = "save"
    what: Literal["scene", "picture", "path", "command"]
    format: Literal["png", "npz"] = Field(default="png", description="Of a picture.")
    width: SavedSide | None = Field(default=None, description="Of a picture, pixels.")
    height: SavedSide | None = Field(default=None, description="Of a picture, pixels.")
    keys: Annotated[tuple[KeyPose, ...], Field(max_length=MAX_KEY_FRAMES)] = Field(
        default=(), description="Key frames of a path."
    )
    save: Counter = Field(description="Number that the answer repeats.")


class Ack(Part):
    """A picture is shown, and all earlier ones are done with."""

    type: Literal["ack"] = "ack"
    picture: Counter


class Ping(Part):
    """Ask for a pong."""

    type: Literal["ping"] = "ping"
    time: float = Field(description="Any number; the pong repeats it.")


Message = View | Edit | Undo | Redo | Reset | Size | Preset | Pick | Steer | Save | Ack | Ping
MESSAGES: dict[str, type[Part]] = {each.model_fields["type"].default: each for each in Message.__args__}
"""The classes of messages by type."""
_ADAPTER: TypeAdapter[Message] = TypeAdapter(Annotated[Message, Field(discriminator="type")])


def parse(text: str) -> Message:
    """Return a client's message.

    Raises InputError: the text is too long, no JSON object, of an unknown type, or a value in it is not allowed.
    """
    data = text.encode("utf-8", "replace")
    if len(data) > MAX_TEXT_BYTES:
        raise InputError("too long", where="message", found=f"{len(data)} bytes", allowed=MAX_TEXT_BYTES)
    try:
        return _ADAPTER.validate_json(data)
    except ValidationError:
        raise _reason(data) from None


def _reason(text: bytes) -> InputError:
    try:
        data = from_json(text, allow_inf_nan=False)
    except ValueError as error:
        return InputError(f"not JSON: {error}", where="message")
    if not isinstance(data, dict):
        return InputError("not an object", where="message", found=type(data).__name__, allowed='{"type": …}')
    kind = data.get("type")
    if not isinstance(kind, str) or kind not in MESSAGES:
        return InputError("unknown type", where="message", found=kind, allowed=", ".join(MESSAGES))
    try:
        MESSAGES[kind].model_validate_json(text)
    except ValidationError as error:
        return scene_error(error, kind, root=MESSAGES[kind])
    return InputError("not allowed", where=kind)


def pack(header: dict[str, Any], payload: bytes) -> bytes:
    """Return a binary message of the server: a header, and the file that it describes."""
    text = to_json(header, inf_nan_mode="null")
    return b"".join((struct.pack("<I", len(text)), text, payload))


def unpack(message: bytes) -> tuple[dict[str, Any], bytes]:
    """Return the header and the file of a binary message.

    Raises InputError: the message is cut off, or its header is not JSON.
    """
    start = 4 + int.from_bytes(message[:4], "little")
    try:
        if not 4 <= start <= len(message):
            raise ValueError(f"{len(message)} bytes")
        return from_json(message[4:start]), message[start:]
    except ValueError as error:
        raise InputError("not a header and a file", where="binary message", found=error) from None
