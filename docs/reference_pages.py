"""Reference pages that are made from the code: commands, scene keys, blend modes, the Python API and the modules.

`conf.py` writes them before Sphinx reads the pages.
"""

from __future__ import annotations

import ast
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer.main

import clusterviz
import clusterviz.jobs
from clusterviz.cli import COMMANDS, command_line
from clusterviz.scene.blend_modes import BLEND_MODES
from clusterviz.viewer.messages import MESSAGES

Schema = dict[str, Any]


def cell(text: object) -> str:
    """One cell of a Markdown table."""
    return " ".join(str(text).split()).replace("|", "\\|")


def table(head: tuple[str, ...], rows: list[tuple[object, ...]]) -> Iterator[str]:
    """The lines of a Markdown table."""
    yield ""
    for row in (head, ("---",) * len(head), *rows):
        yield f"| {' | '.join(map(cell, row))} |"
    yield ""


def commands() -> Iterator[str]:
    """The command line: arguments, options and an example of each command."""
    yield "# Commands"
    group: Any = typer.main.get_command(command_line(list(COMMANDS)))
    for name, command in group.commands.items():
        for part, each in getattr(command, "commands", {"": command}).items():
            context = each.context_class(each)
            yield f"\n## clusterviz {' '.join(filter(None, (name, part)))}\n\n{each.help or ''}"
            rows: list[tuple[object, ...]] = []
            for parameter in each.get_params(context):
                names = (
                    parameter.opts
                    if parameter.param_type_name == "option"
                    else [parameter.metavar or parameter.name.upper()]
                )
                default = parameter.default
                shown = "" if default in (None, False, (), []) or callable(default) else f"`{default}`"
                meaning = getattr(parameter, "help", "") or ""
                rows.append(
                    (", ".join(f"`{one}`" for one in names), meaning, "required" if parameter.required else shown)
                )
            yield from table(("option", "meaning", "default"), rows)
        yield f"\n    {COMMANDS[name].example}\n"


def scene(schema: Schema) -> Iterator[str]:
    """The keys of the scene file, section by section."""
    yield "# Scene keys\n\nA scene is a YAML or JSON file. Every key may be left out, but for the `path` of a volume."
    yield "`-D section.key=value` sets a key on the command line. `clusterviz schema` prints these keys as JSON Schema."
    for key, part in schema["properties"].items():
        yield f"\n## {key}\n\n{part.get('description', '')}"
        names = list(dict.fromkeys(names_in(part)))
        for name in names:  # and sections within them
            section = schema["$defs"].get(name, {})
            names += [inner for inner in dict.fromkeys(names_in(section)) if inner not in names]
            if "properties" in section:
                yield "" if name == names[0] else f"\n### {name}"
                yield from keys(name, section)


def names_in(part: Schema) -> Iterator[str]:
    """The names of the definitions that a part of the schema refers to."""
    for key, value in part.items():
        if key == "$ref":
            yield value.rsplit("/", 1)[-1]
        for each in value if isinstance(value, list) else [value]:
            if isinstance(each, dict):
                yield from names_in(each)


def keys(name: str, section: Schema) -> Iterator[str]:
    """The keys of one section."""
    yield f"\n{section.get('description', name)}"
    rows: list[tuple[object, ...]] = []
    for key, part in section["properties"].items():
        default = part.get("default")
        shown = default if isinstance(default, str) else json.dumps(default)
        rows.append((f"`{key}`", kind(part), "" if default is None else f"`{shown}`", part.get("description", "")))
    yield from table(("key", "value", "default", "meaning"), rows)


def kind(part: Schema) -> str:
    """The values that a key takes, in a few words."""
    if "enum" in part:
        return ", ".join(f"`{one}`" for one in part["enum"])
    if "const" in part:
        return f"`{part['const']}`"
    choices = part.get("anyOf") or part.get("oneOf")
    if choices:
        return " or ".join(dict.fromkeys(filter(None, map(kind, choices))))
    if "$ref" in part:
        return part["$ref"].rsplit("/", 1)[-1]
    if part.get("type") == "array":
        items = part.get("prefixItems")
        return f"list of {len(items)}" if items else f"list of {kind(part.get('items', {})) or 'values'}"
    return {"null": "", "string": "text", "object": "mapping"}.get(part.get("type", ""), part.get("type", ""))


def blend_modes() -> Iterator[str]:
    """The table of blend modes."""
    yield "# Blend modes\n\n`volumes[].blending` says how the samples along a ray become a pixel."
    yield "Formulas and limits are in the [conventions](../conventions.md#blend-modes)."
    head = ("mode", "pixel", "partial images are merged by", "skipped samples", "isosurfaces", "light")
    rows = [
        (f"`{name}`", mode.pixel, mode.operator, mode.skip, mode.surfaces, "yes" if mode.lit else "no")
        for name, mode in BLEND_MODES.items()
    ]
    yield from table(head, list[tuple[object, ...]](rows))


def viewer_messages() -> Iterator[str]:
    """The messages of the viewer's clients."""
    yield "# Messages of the viewer's clients\n\nThe [protocol](../viewer-protocol.md) says how they are sent."
    for name, message in MESSAGES.items():
        schema = message.model_json_schema()
        yield f"\n## {name}"
        yield from keys(name, {**schema, "properties": {**schema["properties"], "type": {"const": name}}})
        for part, section in schema.get("$defs", {}).items():
            if "properties" in section:
                yield f"\n### {part}"
                yield from keys(part, section)


def api() -> Iterator[str]:
    """The names of `clusterviz` and `clusterviz.jobs`, which autodoc writes out."""
    yield "# Python API"
    for package in (clusterviz, clusterviz.jobs):
        yield f"\n## {package.__name__}\n"
        for name in package.__all__:
            found = getattr(package, name)
            home = getattr(found, "__module__", "")
            if home.startswith("clusterviz"):
                kind = "autoclass" if isinstance(found, type) else "autofunction"
                yield f"\n```{{eval-rst}}\n.. {kind}:: {home}.{name}\n```\n"


def modules() -> Iterator[str]:
    """What each module is, by package: the first lines of their docstrings."""
    yield "# Modules\n\nThe [architecture](../../concepts/architecture.md) says how the packages work together."
    root = Path(clusterviz.__file__).parent
    for package in sorted(path.parent for path in root.rglob("__init__.py")):
        rows: list[tuple[object, ...]] = []
        for path in sorted(package.glob("*.py")):
            text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
            if path.name == "__init__.py":
                yield f"\n## {'.'.join(path.parent.relative_to(root.parent).parts)}\n\n{text.partition(chr(10))[0]}"
            else:
                rows.append((f"`{path.stem}`", text.partition("\n")[0]))
        yield from table(("module", "contents"), rows)


def write_pages(folder: Path) -> None:
    """Write the pages into a folder."""
    folder.mkdir(exist_ok=True)
    pages = {"commands": commands(), "blend-modes": blend_modes(), "python": api()}
    pages |= {"viewer-messages": viewer_messages(), "modules": modules()}
    for page, lines in pages.items():
        text = "\n".join(lines) + "\n"
        path = folder / f"{page}.md"
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")
