"""The viewer's JavaScript modules as one module, and its style sheets as one, for notebooks.

A notebook takes the text of one module, which cannot import others from beside it. Each module that it needs becomes a
function that returns the exports. The modules of `static` import each other by `import {…} from "./name.js"`, without
circles, and export declarations.
"""

from __future__ import annotations

import re
from graphlib import TopologicalSorter
from pathlib import Path

STATIC = Path(__file__).parent / "static"
PAGE_STYLE = "page.css"
"""Style sheet of the page around the viewer, which notebooks do without."""
IMPORT = re.compile(r'^import (\{[^}]*\}) from "\./([\w-]+)\.js";$', re.MULTILINE)
EXPORT = re.compile(r"^export (?=(?:async )?(?:function|class|const|let) (\w+))", re.MULTILINE)


def bundled_modules(entry: str, folder: Path = STATIC) -> str:
    """Return a module and all that it imports as the text of one module, which exports what the entry exports."""
    texts, wanted = dict[str, str](), [entry]
    while wanted:
        name = wanted.pop()
        if name not in texts:
            texts[name] = (folder / f"{name}.js").read_text(encoding="utf-8")
            wanted += _imported(texts[name])
    order = TopologicalSorter({name: _imported(text) for name, text in texts.items()}).static_order()
    return "".join(_with_constants(texts[name]) if name == entry else _as_function(name, texts[name]) for name in order)


def bundled_styles() -> str:
    """Return the style sheets of the viewer as one."""
    return "".join(path.read_text(encoding="utf-8") for path in sorted(STATIC.glob("*.css")) if path.name != PAGE_STYLE)


def _imported(text: str) -> list[str]:
    return [name for _, name in IMPORT.findall(text)]


def _with_constants(text: str) -> str:
    return IMPORT.sub(lambda found: f"const {found[1].replace(' as ', ': ')} = module_{_identifier(found[2])};", text)


def _as_function(name: str, text: str) -> str:
    exports = ", ".join(EXPORT.findall(text))
    body = EXPORT.sub("", _with_constants(text))
    return f"const module_{_identifier(name)} = (() => {{\n{body}\nreturn {{{exports}}};\n}})();\n"


def _identifier(name: str) -> str:
    return name.replace("-", "_")
