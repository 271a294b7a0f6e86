"""Shader assembler: joins shader files by includes; error messages name the original file and line.

A top-level shader may contain `#include "name.glsl"`; included files may not include others, so that one file shows the
order of the parts. `#include <NAME>` is replaced by a text or a file that the caller chooses by variant. Every part is
preceded by a `#line` with a source number, which is translated back to a file name in the driver's messages.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from pathlib import Path

from clusterviz.errors import DeviceError
from clusterviz.spmd.source import ShaderSource

INCLUDE = re.compile(r'^\s*#include\s+(?:"(?P<file>[^"]+)"|<(?P<slot>\w+)>)\s*$')

FUNCTION = re.compile(r"(?:\w+ )+(?P<name>\w+)\(.*\) \{|struct (?P<struct>\w+)")
VARIABLES = re.compile(r"(?:const )?\w+ (?P<names>\w+(?:\[.*\])?(?:,| =|;).*)")
NESTED = re.compile(r"\([^()]*\)|\[[^\[\]]*\]")


@cache
def shader_folder() -> Path:
    """Return the folder of the .glsl files: inside the installed package, or beside it in a checkout."""
    package = Path(__file__).resolve().parent.parent
    for folder in (package / "shaders", package.parent / "shaders"):
        if folder.is_dir():
            return folder
    raise DeviceError(
        f"the shader files are missing: neither {package / 'shaders'} nor {package.parent / 'shaders'} exists"
    )


def assemble(name: str, slots: Mapping[str, str | tuple[str, ...]] | None = None) -> ShaderSource:
    """Assemble a top-level shader.

    Parameters
    ----------
    name : file name of the top-level shader in the shader folder; its first line is `#version`
    slots : for each `#include <NAME>`, the name of a file, or GLSL text if it contains a line break; or several of them

    Raises
    ------
    DeviceError
        A file or a slot is missing, or an included file includes another.
    """
    names, lines = [name], []
    for number, line in enumerate(_read(name, "").splitlines(), start=1):
        match = INCLUDE.match(line)
        if not match:
            lines.append(line)
            continue
        for part, text in _parts(match, slots or {}, f"{name}:{number}"):
            lines += [f"#line 1 {len(names)}", text.rstrip("\n")]
            names.append(part)
        lines.append(f"#line {number + 1} 0")
    return ShaderSource("\n".join(lines) + "\n", tuple(names))


def _parts(match: re.Match[str], slots: Mapping[str, str | tuple[str, ...]], where: str) -> list[tuple[str, str]]:
    """Return the names and the texts that replace an include line."""
    if match["slot"] and match["slot"] not in slots:
        raise DeviceError(f"{where}: nothing given for #include <{match['slot']}>; given {sorted(slots)}")
    given = slots[match["slot"]] if match["slot"] else match["file"]
    return [_part(part, match["slot"], where) for part in ((given,) if isinstance(given, str) else given)]


def _part(part: str, slot: str, where: str) -> tuple[str, str]:
    if "\n" in part:
        return f"<{slot}>", part
    text = _read(part, where)
    for number, line in enumerate(text.splitlines(), start=1):
        if INCLUDE.match(line):
            raise DeviceError(f"{part}:{number}: only a top-level shader may include; included by {where}")
    return part, text


@cache
def _files(folder: Path) -> dict[str, Path]:
    """Return the paths of shader files by name, looked for once, as a variant has dozens."""
    return {path.name: path for path in folder.rglob("*.glsl")}


def shader_file(name: str) -> Path:
    """Return the path of a shader file, in whichever folder of `shader_folder` it lies; names are unique."""
    folder = shader_folder()
    return _files(folder).get(name, folder / name)


@cache
def defined_names(*files: str) -> tuple[str, ...]:
    """Return the names that shader files define outside of functions: functions with a body, structs and variables.

    A definition begins a line; what is only declared, and blocks, do not count.
    """
    found = dict[str, None]()
    for line in (line for name in files for line in _read(name, "").splitlines()):
        text = line.partition("//")[0].rstrip(" ;")
        if match := FUNCTION.match(text):
            found[match["name"] or match["struct"]] = None
        elif match := VARIABLES.match(f"{text};"):
            declared = match["names"].rstrip(";")
            while NESTED.search(declared):  # values and sizes, in which there may be commas
                declared = NESTED.sub("", declared)
            found |= {part.split("=")[0].strip(): None for part in declared.split(",")}
    return tuple(found)


def _read(name: str, where: str) -> str:
    path = shader_file(name)
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise DeviceError(f"{where or path}: the shader file {name} cannot be read: {error.strerror}") from None
