"""Animation paths: one scene a frame, from an orbit, key frames of camera and transfer function, and time steps.

An orbit rotates the eye about view_up through the focal point. Between key frames positions follow centripetal
Catmull-Rom curves, directions are interpolated and normalised, and numbers follow monotone cubics. Values that a key
frame leaves out are the scene's.

Reference: F. N. Fritsch, J. Butland: A method for constructing local monotone piecewise cubic interpolants, SIAM
Journal on Scientific and Statistical Computing 5(2), 1984. C. Yuksel, S. Schaefer, J. Keyser: On the parameterization
of Catmull-Rom curves, SPM 2009: centripetal knots give segments without cusps and loops. P. Barry, R. Goldman: A
recursive evaluation algorithm for a class of Catmull-Rom splines, SIGGRAPH 1988.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Annotated, Any, TypeVar

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import AfterValidator, BeforeValidator, Field, ValidationError

from clusterviz.errors import SceneError, guard
from clusterviz.scene.checks import InvalidValueError, to_builtin
from clusterviz.scene.field_types import Clim, Cmap, Number, Opacity, Positive, Section, Vector
from clusterviz.scene.validation_messages import format_key, format_value, scene_error, unknown_key
from clusterviz.scene.values import Camera, Scene, Volume
from clusterviz.scene.yaml_text import parse_yaml, read_text, yaml_problem

Floats = NDArray[np.float64]


def monotone(times: Floats, values: Floats, time: float) -> Floats:
    """Interpolate numbers, monotonically between two key frames and with a continuous derivative.

    `times`: float64 (n,), strictly ascending; `values`: float64 (n, k); `time`: the curve is constant before the first
    and after the last key frame.

    Returns
    -------
    float64 (k,)
    """
    if len(times) == 1 or time <= times[0]:
        return np.array(values[0])
    if time >= times[-1]:
        return np.array(values[-1])
    steps = np.diff(times)
    rates = np.diff(values, axis=0) / steps[:, None]
    i = int(np.searchsorted(times, time, side="right")) - 1
    low, high = _slope(rates, steps, i), _slope(rates, steps, i + 1)
    u = (time - times[i]) / steps[i]
    along = values[i] + (values[i + 1] - values[i]) * (u * u * (3 - 2 * u))
    curve: Floats = along + steps[i] * (u * (1 - u)) * ((1 - u) * low - u * high)
    # Rounding must not leave the range of the two key frames.
    return np.clip(curve, np.minimum(values[i], values[i + 1]), np.maximum(values[i], values[i + 1]))


def _slope(rates: Floats, steps: Floats, key: int) -> Floats:
    """Return the derivative at a key frame: a weighted harmonic mean of both slopes, 0 if their signs differ."""
    if key in (0, len(rates)):
        return np.array(rates[min(key, len(rates) - 1)])
    before, after, short, long = rates[key - 1], rates[key], steps[key - 1], steps[key]
    first, second = 2 * long + short, long + 2 * short
    same = before * after > 0
    safe_before, safe_after = np.where(same, before, 1.0), np.where(same, after, 1.0)
    return np.where(same, (first + second) / (first / safe_before + second / safe_after), 0.0)


def centripetal(times: Floats, points: Floats, time: float) -> Floats:
    """Interpolate positions along a centripetal Catmull-Rom curve with continuous speed.

    `times`: float64 (n,), strictly ascending. `points`: float64 (n, 3); the curve is constant between equal consecutive
    points. `time`: the curve is constant before the first and after the last key frame.

    Returns
    -------
    float64 (3,)
    """
    scale = float(np.abs(points).max()) or 1.0
    knots = np.concatenate([[0.0], np.cumsum(np.sqrt(np.linalg.norm(np.diff(points / scale, axis=0), axis=1)))])
    knot = float(monotone(times, knots[:, None], time)[0])
    i = int(np.clip(np.searchsorted(times, time, side="right") - 1, 0, max(0, len(times) - 2)))
    if len(times) == 1 or knots[i + 1] == knots[i]:
        return np.array(points[i])
    before, b, c, after = i - 1, points[i], points[i + 1], i + 2
    length = knots[i + 1] - knots[i]
    # Beyond the ends, and beside a constant part, a neighbour is mirrored.
    has_before = before >= 0 and knots[before] < knots[i]
    has_after = after < len(times) and knots[after] > knots[i + 1]
    a, t0 = (points[before], knots[before]) if has_before else (2 * b - c, knots[i] - length)
    d, t3 = (points[after], knots[after]) if has_after else (2 * c - b, knots[i + 1] + length)
    return _barry_goldman((a, b, c, d), (t0, knots[i], knots[i + 1], t3), knot)


def _barry_goldman(points: tuple[Floats, ...], knots: tuple[float, ...], t: float) -> Floats:
    level = list(points)
    for width, spans in ((1, 3), (2, 2)):
        level = [
            _lerp(level[k], level[k + 1], knots[k], knots[k + width], t)
            for k in range(spans)
        ]  # fmt: skip
    return _lerp(level[0], level[1], knots[1], knots[2], t)


def _lerp(a: Floats, b: Floats, begin: float, end: float, t: float) -> Floats:
    share = (t - begin) / (end - begin)
    return (1 - share) * a + share * b


KeyFrameT = TypeVar("KeyFrameT", bound="KeyFrame")
TURN = 360.0
POSITION_KEYS = ("position", "focal_point")
MAX_FRAMES = 1_000_000


class KeyFrame(Section):
    """Base class of key frames; times are in seconds."""

    time: Number


class CameraKeyFrame(KeyFrame):
    """Camera at a time; values left out are the scene's."""

    position: Vector | None = None
    focal_point: Vector | None = None
    view_up: Vector | None = None
    view_angle: Annotated[float, Field(strict=True, gt=0, lt=180), BeforeValidator(to_builtin)] | None = None
    parallel_scale: Positive | None = None


class TransferKeyFrame(KeyFrame):
    """Transfer function at a time; values left out are the scene's."""

    cmap: Cmap | None = None
    clim: Clim | None = None
    opacity: Opacity | None = None


def _ascending(keys: tuple[KeyFrameT, ...]) -> tuple[KeyFrameT, ...]:
    for before, after in pairwise(keys):
        if after.time <= before.time:
            raise InvalidValueError(f"keys out of order: time {after.time:g} after {before.time:g}", "ascending times")
    return keys


class KeyFrames(Section):
    """Key frames of camera and transfer function."""

    camera: Annotated[tuple[CameraKeyFrame, ...], AfterValidator(_ascending)] = ()
    transfer: Annotated[tuple[TransferKeyFrame, ...], AfterValidator(_ascending)] = ()

    @property
    def times(self) -> tuple[float, float]:
        """Times of the first and last key frame, seconds; (0, 0) without key frames."""
        times = [key.time for key in (*self.camera, *self.transfer)]
        return min(times, default=0.0), max(times, default=0.0)

    def frames(self, frames_per_second: float, where: str = "path") -> int:
        """Return the number of frames from the first to the last key frame, both included.

        Raises SceneError: there are more than `MAX_FRAMES`.
        """
        begin, end = self.times
        count = (end - begin) * frames_per_second
        if not count < MAX_FRAMES:
            found = f"{end - begin:g} s at {frames_per_second:g} frames a second"
            raise SceneError("too many frames", where=where, found=found, allowed=f"at most {MAX_FRAMES}")
        return round(count) + 1


KEY_FRAME_TYPES: dict[str, type[KeyFrame]] = {"camera": CameraKeyFrame, "transfer": TransferKeyFrame}


def load_path(path: str | os.PathLike[str]) -> KeyFrames:
    """Read key frames from a YAML or JSON file.

    Raises SceneError: the file cannot be read, or holds an unknown key or an invalid value.
    """
    where = os.fspath(path)
    with guard(SceneError, where):
        return _keys(read_text(where, SceneError), where)


def _keys(text: str, where: str) -> KeyFrames:
    try:
        data = parse_yaml(text)
    except yaml.YAMLError as error:
        raise SceneError(f"not YAML: {yaml_problem(error)}", where=where) from None
    if not isinstance(data, dict) or not any(data.values()):
        allowed = "keys under camera or transfer"
        raise SceneError("no key frames", where=where, found=format_value(data), allowed=allowed)
    try:
        return KeyFrames.model_validate({name: value for name, value in data.items() if value is not None})
    except ValidationError as error:
        for details in error.errors():
            if details["type"] == "extra_forbidden":
                key = details["loc"]
                section: type[Section] = KEY_FRAME_TYPES[str(key[0])] if len(key) > 1 else KeyFrames
                raise unknown_key(f"{where}: {format_key(key)}", key[-1], section) from None
        raise scene_error(error, where) from None


def orbit(camera: Camera, degrees: float, frames: int) -> list[Camera]:
    """Return cameras on an orbit about view_up through the focal point, counter-clockwise seen from above.

    `camera`: the completed camera of the first frame. `degrees`: total angle; full turns end one step before the first
    camera, so that they can be repeated. `frames`: number of cameras.
    """
    steps = frames if math.remainder(degrees, TURN) == 0 else max(1, frames - 1)
    position, centre, up = (np.array(v, float) for v in (camera.position, camera.focal_point, camera.view_up))
    axis = up / np.abs(up).max()
    axis /= np.linalg.norm(axis)
    arm = position - centre
    cameras = []
    for number in range(frames):
        angle = math.radians(math.fmod(degrees * number / steps, TURN))
        # Rodrigues' formula.
        turned = arm * math.cos(angle) + np.cross(axis, arm) * math.sin(angle)
        turned += axis * (axis @ arm) * (1 - math.cos(angle))
        cameras.append(camera if number == 0 else camera.model_copy(update={"position": _vector(centre + turned)}))
    return cameras


def scenes_along(
    scene: Scene,
    frames: int,
    degrees: float | None = None,
    keys: KeyFrames | None = None,
    where: str = "path",
    time_steps: Mapping[str, int] | None = None,
) -> list[Scene]:
    """Return the scenes of all frames, at equal time steps from the first to the last key frame.

    Raises SceneError: key frames are incompatible, or an interpolated camera is degenerate.

    Parameters
    ----------
    scene : a completed scene
    frames : number of frames
    degrees : total angle of an orbit; None for no orbit
    keys : key frames; without camera key frames if there is an orbit
    where : the file named in errors
    time_steps : number of time steps of each volume that shows all of them, by its key; they last equally long

    Raises
    ------
    SceneError
        Key frames are incompatible, or an interpolated camera is degenerate.
    """
    keys = keys or KeyFrames()
    if keys.camera and degrees is not None:
        raise SceneError("camera keys and an orbit", where=where, allowed="one of them")
    cameras = orbit(scene.camera, degrees or 0.0, frames)
    begin, end = keys.times
    scenes, sampled = [], scene.drawn_as("samples")
    for number, camera in enumerate(cameras):
        time = begin + (end - begin) * number / max(1, frames - 1)
        update: dict[str, Any] = {"camera": camera}
        if keys.camera:
            update["camera"] = _camera_at(scene.camera, keys.camera, time, f"{where}: frame {number}")
        changes: dict[str, dict[str, Any]] = {
            key: {"time": number * steps // frames} for key, steps in (time_steps or {}).items()
        }
        if keys.transfer and sampled:
            first, volume = next(iter(sampled.items()))
            changes[first] = changes.get(first, {}) | _transfer_at(volume, keys.transfer, time, where)
        changed = {key: sampled[key].model_copy(update=each) for key, each in changes.items()}
        scenes.append(scene.model_copy(update=update).with_entries(changed))
    return scenes


def _camera_at(base: Camera, keys: Sequence[CameraKeyFrame], time: float, where: str) -> Camera:
    times = np.array([key.time for key in keys])
    names = [name for name in CameraKeyFrame.model_fields if name != "time"]
    each = {name: [getattr(key, name) or getattr(base, name) for key in keys] for name in names}
    found: dict[str, Any] = {name: _vector(centripetal(times, _rows(each[name]), time)) for name in POSITION_KEYS}
    ups = _rows(each["view_up"])
    ups = ups / np.abs(ups).max(axis=1, keepdims=True)
    up = monotone(times, ups / np.linalg.norm(ups, axis=1, keepdims=True), time)
    length = float(np.linalg.norm(up))
    if length < 1e-6:
        raise SceneError("view_up passes through zero between opposite keys", where=where, allowed="a key between them")
    found["view_up"] = _vector(up / length)
    found["view_angle"] = float(monotone(times, _rows(each["view_angle"]), time)[0])
    scales = each["parallel_scale"]
    if None in scales and any(scales):
        raise SceneError("keys in perspective and in parallel projection", where=where, allowed="one of them")
    found["parallel_scale"] = None if None in scales else float(monotone(times, _rows(scales), time)[0])
    try:
        return Camera.model_validate(found)
    except ValidationError as error:
        raise scene_error(error, where) from None


def _transfer_at(volume: Volume, keys: Sequence[TransferKeyFrame], time: float, where: str) -> dict[str, Any]:
    """Return the keys of the transfer function at a time; control points are interpolated one to one."""
    times = np.array([key.time for key in keys])
    found: dict[str, Any] = {}
    for name in ("cmap", "clim", "opacity"):
        given = [getattr(key, name) for key in keys]
        if any(value is not None for value in given):
            each = [getattr(volume, name) if value is None else value for value in given]
            found[name] = _between(times, each, time, f"{where}: transfer: {name}")
    return found


def _between(times: Floats, each: Sequence[Any], time: float, where: str) -> Any:
    if all(value == each[0] for value in each):
        return each[0]
    shapes = {np.shape(value) if not isinstance(value, str) else value for value in each}
    if len(shapes) > 1 or any(isinstance(value, str) for value in each):
        allowed = "one name in all keys, or numbers, or lists of as many points in each"
        raise SceneError("nothing lies between these keys", where=where, found=format_value(each), allowed=allowed)
    table = np.array(each, np.float64)
    flat = monotone(times, table.reshape(len(each), -1), time)
    if table.ndim == 3:
        rows = flat.reshape(table.shape[1:])
        if table.shape[2:] != (3,):  # the values of control points must stay sorted; plain colours have none
            rows[:, 0] = np.maximum.accumulate(rows[:, 0])
        return tuple(tuple(float(value) for value in row) for row in rows)
    return tuple(float(value) for value in flat) if table.ndim == 2 else float(flat[0])


def _rows(values: Sequence[Any]) -> Floats:
    return np.array(values, np.float64).reshape(len(values), -1)


def _vector(values: Floats) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in values)
    return x, y, z
