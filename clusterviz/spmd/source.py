"""Assembled shaders: the bindings of their blocks by name, and what drivers say about them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

# Mesa writes "0:12(3): error: …", NVIDIA "0(12) : error …", others "ERROR: 0:12: …".
PLACE = re.compile(
    r"^(?P<lead>(?:ERROR: |WARNING: )?)(?P<source>\d+)(?::(?P<mesa>\d+)|\((?P<nvidia>\d+)\))", re.MULTILINE
)
MACRO = re.compile(r"#(?:define (?P<name>\w+) (?P<word>\w+)$|undef (?P<end>\w+))")
LAYOUT = re.compile(
    r"layout\((?:std\d+, )?binding = (?P<number>\w+)\) (?:\w+ )?"
    r"(?:(?P<kind>buffer|uniform) (?P<block>\w+)Block|uniform sampler\w+ (?P<texture>\w+))"
)


@dataclass(frozen=True)
class Binding:
    """What a shader reads or writes: the kind of a block or texture, and its number among those of this kind."""

    kind: Literal["buffer", "uniform", "texture"]
    number: int


@dataclass(frozen=True)
class ShaderSource:
    """An assembled shader: its text, and the file name of each source number in its `#line` directives."""

    text: str
    names: tuple[str, ...]

    @cached_property
    def blocks(self) -> dict[str, Binding]:
        """Bindings by name: of a block in lower case, without "Block"; of a texture that of its sampler.

        A declaration begins its line; of macros in it only those count that stand for a word.
        """
        found, macros = dict[str, Binding](), dict[str, str]()
        for line in self.text.splitlines():
            if macro := MACRO.match(line):
                macros.pop(macro["name"] or macro["end"], None)
                if macro["name"]:
                    macros[macro["name"]] = macro["word"]
            elif declared := LAYOUT.match(line):
                number = int(macros.get(declared["number"], declared["number"]))
                if texture := declared["texture"]:
                    found[macros.get(texture, texture)] = Binding("texture", number)
                else:
                    kind: Literal["buffer", "uniform"] = "buffer" if declared["kind"] == "buffer" else "uniform"
                    found[declared["block"].lower()] = Binding(kind, number)
        return found

    def explain(self, complaint: str) -> str:
        """Return the driver's error message with file names instead of source numbers."""

        def name(match: re.Match[str]) -> str:
            source, line = int(match["source"]), match["mesa"] or match["nvidia"]
            return f"{match['lead']}{self.names[source] if source < len(self.names) else source}:{line}"

        return PLACE.sub(name, complaint)
