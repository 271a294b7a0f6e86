"""Assembled shaders, and what drivers say about them."""

from __future__ import annotations

import re
from dataclasses import dataclass

# Mesa writes "0:12(3): error: …", NVIDIA "0(12) : error …", others "ERROR: 0:12: …".
PLACE = re.compile(
    r"^(?P<lead>(?:ERROR: |WARNING: )?)(?P<source>\d+)(?::(?P<mesa>\d+)|\((?P<nvidia>\d+)\))", re.MULTILINE
)


@dataclass(frozen=True)
class ShaderSource:
    """An assembled shader: its text, and the file name of each source number in its `#line` directives."""

    text: str
    names: tuple[str, ...]

    def explain(self, complaint: str) -> str:
        """Return the driver's error message with file names instead of source numbers."""

        def name(match: re.Match[str]) -> str:
            source, line = int(match["source"]), match["mesa"] or match["nvidia"]
            return f"{match['lead']}{self.names[source] if source < len(self.names) else source}:{line}"

        return PLACE.sub(name, complaint)
