"""Write the keys of scenes for readers and for type checkers: docs/reference/scene.md, clusterviz/scene/settings.pyi.

Run `python docs/make_scene_keys.py` after changing a key of a scene; a test compares both files with the scene.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

from reference_pages import scene  # noqa: E402

from clusterviz.content.flow import section as flow  # noqa: E402
from clusterviz.content.sections import LISTED_SECTIONS  # noqa: E402
from clusterviz.content.volume import presets  # noqa: E402
from clusterviz.content.volume import section as volume  # noqa: E402
from clusterviz.scene import (  # noqa: E402
    blend_modes,
    camera,
    cluster,
    scene_schema,
    values,
)
from clusterviz.scene.field_types import Section  # noqa: E402
from clusterviz.scene.transfer_2d import Transfer2d  # noqa: E402
from clusterviz.scene.validation_messages import SECTIONS  # noqa: E402
from clusterviz.scene.values import Light, Scene  # noqa: E402

PAGE = HERE / "reference" / "scene.md"
MODULE = HERE.parent / "clusterviz" / "scene" / "settings.pyi"
HEAD = '''"""Scene keys as keyword arguments, for type checkers; `python docs/make_scene_keys.py` writes this file."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, TypedDict

from numpy.typing import NDArray

{imports}

Numbers = Sequence[float] | NDArray[Any]
Rows = Sequence[Sequence[Any]] | NDArray[Any]

class Settings(TypedDict, total=False):
    """Keyword arguments of `clusterviz.render`: keys of scenes by their last names."""

'''
SPECIAL: dict[str, list[str]] = {
    "cmap": ["str", "Rows", "Callable[..., Any]", "None"],  # matplotlib's are called
    "isosurfaces": ["Sequence[float | Sequence[float]]", "NDArray[Any]"],
    **{name: ["Any"] for name in LISTED_SECTIONS},  # sections, or objects in memory
}
"""Types of keys that take more than scene files have."""
HOMES = (blend_modes, camera, cluster, flow, presets, values, volume)
ALIASES: dict[Any, str] = {
    kind: name for home in HOMES for name, kind in vars(home).items() if get_origin(kind) is Literal
}
"""Names of choices, by their types."""


def page_text() -> str:
    """Return the page."""
    text = "\n".join([*scene(scene_schema()), "`python docs/make_scene_keys.py` writes this page."])
    return re.sub(r"\n{3,}", "\n\n", text) + "\n"


def settings_text() -> str:
    """Return the module: each key with all types that it has in any section."""
    types: dict[str, list[str]] = {}
    sections: list[type[Section]] = [*(section for _, section in SECTIONS), *LISTED_SECTIONS.values()]
    sections += [Light, Transfer2d, Scene]
    used = set[type[Section]]()
    for section in sections:
        for name, kind in get_type_hints(section, include_extras=True).items():
            if name in section.model_fields:
                types.setdefault(name, []).extend(SPECIAL[name] if name in SPECIAL else _words(kind, used))
    lines = [
        f"    {name}: {' | '.join(sorted(dict.fromkeys(words), key=lambda word: word == 'None'))}\n"
        for name, words in types.items()
    ]
    modules: dict[str, list[str]] = {}
    for section in sorted(used, key=lambda each: each.__name__):
        modules.setdefault(section.__module__, []).append(section.__name__)
    named = set(re.findall(r"\b[A-Z]\w+\b", "".join(lines)))
    for home in HOMES:
        for kind, name in ALIASES.items():
            if name in named and vars(home).get(name) == kind:
                modules.setdefault(home.__name__, []).append(name)
                named.discard(name)
    imports = [f"from {module} import {', '.join(names)}" for module, names in sorted(modules.items())]
    text = HEAD.replace("{imports}", "\n".join(imports)) + "".join(lines)
    for command in (("check", "--select", "I", "--fix-only", "--quiet"), ("format",)):
        words = [sys.executable, "-m", "ruff", *command, "--stdin-filename", str(MODULE), "-"]
        text = subprocess.run(words, input=text, capture_output=True, text=True, check=True).stdout
    return text


def _words(kind: Any, used: set[type[Section]]) -> list[str]:
    """Return the types that a key takes, as text; sequences for tuples, mappings for sections, which are collected."""
    origin, parts = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return _words(parts[0], used)
    if origin in (Union, UnionType):
        return [word for part in parts for word in _words(part, used)]
    if origin is Literal:
        return [ALIASES.get(kind) or f"Literal[{', '.join(map(repr, parts))}]"]
    if origin is tuple:
        inner = dict.fromkeys(word for part in parts if part is not ... for word in _words(part, used))
        if {"Numbers", "Rows"} & inner.keys():
            return ["Rows"]
        return ["Numbers"] if inner.keys() <= {"float", "int"} else [f"Sequence[{' | '.join(inner)}]"]
    if isinstance(kind, type) and issubclass(kind, Section):
        used.add(kind)
        return [kind.__name__, "Mapping[str, Any]"]
    return ["None" if kind is type(None) else kind.__name__]


if __name__ == "__main__":
    PAGE.write_text(page_text(), encoding="utf-8")
    MODULE.write_text(settings_text(), encoding="utf-8")
