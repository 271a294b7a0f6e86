"""What `clusterviz doctor --gl` has found of each driver, kept in the user's cache: which features it draws wrong.

A file for each driver, named by device and version, so that ranks need no lock. A file is of use as long as the shaders
are those that were tested; one that cannot be read is as none.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Collection, Iterator, Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

from clusterviz.gl.shader import shader_folder
from clusterviz.image.replace import replacing

LARGEST_BYTES = 1 << 20
"""Larger files are no records."""


def driver_of(info: Mapping[str, Any]) -> str:
    """Return the name of device and driver, with its version, of the facts on a context."""
    return f"{info['GL_RENDERER']}, OpenGL {info['GL_VERSION']}"


def record_folder() -> Path:
    """Return the folder of the records: `drivers` in CLUSTERVIZ_CACHE, or else in clusterviz/ of the user's cache."""
    own, home = os.environ.get("CLUSTERVIZ_CACHE"), os.environ.get("XDG_CACHE_HOME")
    return (Path(own) if own else Path(home or Path.home() / ".cache") / "clusterviz") / "drivers"


def keep_record(driver: str, wrong: Mapping[str, str]) -> None:
    """Keep the features that a driver draws wrong, by their names, each with what is wrong.

    Raises
    ------
    OutputError, OSError
        The file cannot be written.
    """
    record_folder().mkdir(parents=True, exist_ok=True)
    record = {"driver": driver, "shaders": _shaders(), "wrong": dict(wrong)}
    with replacing(_file_of(driver)) as temporary:
        temporary.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")


def forget_record(driver: str) -> None:
    """Forget what was found of a driver."""
    _file_of(driver).unlink(missing_ok=True)


def known_wrong(features: Collection[str], driver: Callable[[], str]) -> tuple[str, dict[str, str]]:
    """Return a driver's name, and those of some features that it is known to draw wrong, with what is wrong.

    Parameters
    ----------
    features : by name
    driver : asked only if some driver is known to draw one of them wrong, since that takes a context
    """
    suspects = [each for each in _records() if each["wrong"].keys() & set(features)]
    if not suspects or all(each["shaders"] != _shaders() for each in suspects):
        return "", {}
    name, shaders = driver(), _shaders()
    mine = [each["wrong"] for each in suspects if (each["driver"], each["shaders"]) == (name, shaders)]
    return name, {feature: text for wrong in mine[:1] for feature, text in wrong.items() if feature in features}


def _records() -> Iterator[dict[str, Any]]:
    try:
        files = sorted(record_folder().glob("*.json"))
    except OSError:
        return
    for path in files:
        try:
            record = json.loads(path.read_bytes()[:LARGEST_BYTES])
        except (OSError, ValueError, RecursionError):
            continue
        if _is_record(record):
            yield record


def _is_record(record: Any) -> bool:
    if not isinstance(record, dict) or not isinstance(record.get("wrong"), dict):
        return False
    return all(
        isinstance(each, str) for each in (record.get("driver"), record.get("shaders"), *record["wrong"].values())
    )


def _file_of(driver: str) -> Path:
    return record_folder() / f"{sha256(driver.encode()).hexdigest()[:16]}.json"


def _shaders() -> str:
    """Return the fingerprint of all shader files."""
    found = sha256()
    for path in sorted(shader_folder().rglob("*.glsl")):
        found.update(path.name.encode() + b"\0" + path.read_bytes())
    return found.hexdigest()[:16]
