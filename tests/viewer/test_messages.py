"""A client's message is understood, or refused with one clear error that names the key."""

from __future__ import annotations

import json
from random import Random
from typing import Any

import pytest
from fuzz.mutate import mutated

from clusterviz.errors import InputError
from clusterviz.viewer.messages import (
    MAX_TEXT_BYTES,
    MESSAGES,
    Edit,
    Message,
    Pose,
    Save,
    Size,
    View,
    pack,
    parse,
    unpack,
)

CAMERA = {"position": [0, 0, 5.5], "focal_point": [0, 0, 0], "view_up": [0, 1, 0], "view_angle": 30}
VALID: list[dict[str, Any]] = [
    {"type": "view", "camera": {**CAMERA, "parallel_scale": None}, "moving": True, "input": 1},
    {"type": "edit", "changes": {"volumes.0.opacity": [[0, 0.5]], "clip": None}, "moving": False, "input": 2},
    {"type": "edit", "changes": {"quality.step": 1}, "moving": True, "input": 2**53, "merge": "step"},
    {"type": "undo"},
    {"type": "redo"},
    {"type": "reset"},
    {"type": "size", "width": 800, "height": 600},
    {"type": "preset", "volume": 0, "name": "bone"},
    {"type": "pick", "x": 0, "y": 1.0, "pick": 1},
    {"type": "steer", "action": "ask"},
    {"type": "steer", "action": "grant", "client": 2},
    {"type": "save", "what": "path", "keys": [{"time": 0, "camera": CAMERA}], "save": 1},
    {"type": "save", "what": "picture", "width": 4096, "height": 4096, "save": 2},
    {"type": "ack", "picture": 1},
    {"type": "ping", "time": 1.5},
]
VIEW, EDIT = json.dumps(VALID[0]), json.dumps(VALID[1])
REFUSED: dict[str, tuple[str, str]] = {
    "empty": ("", "message: not JSON"),
    "half": ('{"type":', "message: not JSON"),
    "list": ("[]", "message: not an object"),
    "no-type": ("{}", "message: unknown type"),
    "type-list": ('{"type": ["view"]}', "message: unknown type"),
    "unknown-type": ('{"type": "shell"}', "found shell; allowed view, edit"),
    "missing": ('{"type": "pick", "x": 0, "y": 0}', "pick: pick: missing"),
    "unknown-key": (VIEW.replace("moving", "movin"), "view: movin: unknown key, did you mean moving?"),
    "unknown-key-of-camera": (VIEW.replace("view_up", "up"), "view: camera.up: unknown key"),
    "text-for-number": (VIEW.replace("5.5", '"5.5"'), "view: camera.position[2]: not a number"),
    "nan": (VIEW.replace("5.5", "NaN"), "not JSON"),
    "infinite": (VIEW.replace("5.5", "1e999"), "view: camera.position[2]: not finite"),
    "two-numbers": (VIEW.replace("[0, 1, 0]", "[0, 1]"), "view: camera.view_up: too few values"),
    "no-direction": (VIEW.replace("5.5", "0"), "view: camera.focal_point: the same as position"),
    "wide": (VIEW.replace("30", "180"), "view: camera.view_angle: too large"),
    "negative": (VIEW.replace('"input": 1', '"input": -1'), "view: input: too small"),
    "fraction": ('{"type": "size", "width": 1.5, "height": 1}', "size: width: not a whole number"),
    "switch": ('{"type": "size", "width": true, "height": 1}', "size: width: not a whole number"),
    "negative-size": ('{"type": "size", "width": -1, "height": 1}', "size: width: too small"),
    "outside": ('{"type": "pick", "x": 1.1, "y": 0, "pick": 1}', "pick: x: too large"),
    "grant-nobody": ('{"type": "steer", "action": "grant"}', "steer: client: missing"),
    "no-changes": (EDIT.replace(json.dumps(VALID[1]["changes"]), "{}"), "edit: changes: too few"),
    "edit-nan": (EDIT.replace("0.5", "NaN"), "message: not JSON"),
    "edit-infinite": (EDIT.replace("0.5", "-1e999"), "edit: changes: a value is not finite"),
    "long-key": (EDIT.replace("clip", "c" * 201), "edit: changes"),
    "deep": (EDIT.replace("0.5", "[" * 5000 + "]" * 5000), "message: not JSON: recursion limit"),
    "huge-picture": ('{"type": "save", "what": "picture", "width": 16385, "save": 1}', "save: width: too large"),
    "long": (EDIT.replace("clip", "c" * MAX_TEXT_BYTES), "message: too long"),
    "half-a-character": ('{"type": "\ud800"}', "unknown type"),
}


@pytest.mark.parametrize("message", VALID, ids=lambda message: message["type"])
def test_is_read_as_it_was_written(message: dict[str, Any]) -> None:
    found = parse(json.dumps(message))
    written = json.loads(found.model_dump_json(exclude_unset=True))
    assert written == message
    assert type(found) is MESSAGES[message["type"]]


def test_all_types_are_here() -> None:
    assert {message["type"] for message in VALID} == MESSAGES.keys()


@pytest.mark.parametrize("name", REFUSED)
def test_is_refused(name: str) -> None:
    text, reason = REFUSED[name]
    with pytest.raises(InputError) as error:
        parse(text)
    assert reason in str(error.value)
    assert len(str(error.value)) < 4000


@pytest.mark.parametrize(("side", "clamped"), [(0, 16), (15, 16), (16, 16), (4096, 4096), (4097, 4096), (10**9, 4096)])
def test_sizes_of_windows_are_clamped(side: int, clamped: int) -> None:
    assert parse(json.dumps({"type": "size", "width": side, "height": 99})) == Size(width=clamped, height=99)


def test_values_have_the_types_of_their_keys() -> None:
    view, edit, save = parse(VIEW), parse(EDIT), parse(json.dumps(VALID[11]))
    assert isinstance(view, View)
    assert isinstance(edit, Edit)
    assert isinstance(save, Save)
    assert view.camera == save.keys[0].camera == Pose(position=(0, 0, 5.5), focal_point=(0, 0, 0), view_up=(0, 1, 0))
    assert edit.changes == {"volumes.0.opacity": [[0, 0.5]], "clip": None}


def test_damaged_messages_are_read_or_refused() -> None:
    random, outcomes = Random(18), {"read": 0, "refused": 0}
    for number in range(3000):
        text = mutated(json.dumps(VALID[number % len(VALID)]).encode(), random).decode("utf-8", "surrogateescape")
        try:
            assert isinstance(parse(text), Message)
            outcomes["read"] += 1
        except InputError:
            outcomes["refused"] += 1
    assert min(outcomes.values()) > 100


def test_files_are_packed_with_a_header() -> None:
    header, content = {"kind": "file", "save": 1, "name": "é.yaml", "seconds": float("nan")}, bytes(range(256))
    assert unpack(pack(header, content)) == ({**header, "seconds": None}, content)


@pytest.mark.parametrize("message", [b"", b"\0\0", b"\2\0\0\0{", b"\2\0\0\0{]", b"\xff\xff\xff\xff{}"])
def test_cut_off_files_are_refused(message: bytes) -> None:
    with pytest.raises(InputError, match="binary message"):
        unpack(message)
