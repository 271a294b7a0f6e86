"""YAML parser and writer for scenes: duplicate keys are refused, 1e-3 is a number, and size is limited."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from clusterviz.errors import InputError
from clusterviz.input_files import require_regular_file

FLOAT = re.compile(
    r"""^(?:[-+]?(?:[0-9][0-9_]*\.[0-9_]*|\.[0-9][0-9_]*)(?:[eE][-+]?[0-9]+)?
    |[-+]?[0-9][0-9_]*[eE][-+]?[0-9]+
    |[-+]?\.(?:inf|Inf|INF)
    |\.(?:nan|NaN|NAN))$""",
    re.VERBOSE,
)
BREAKS = re.compile("[\x85\u2028\u2029]")
MAX_BYTES = 1 << 20
MAX_NODES, MAX_DEPTH = 100_000, 50


class SceneLoader(yaml.SafeLoader):
    """Safe loader that refuses duplicate keys, deep nesting, and documents that expand to too many values."""

    def __init__(self, stream: Any) -> None:
        super().__init__(stream)
        self._depth = self._nodes = 0
        self._sizes: dict[int, int] = {}

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """Compose a node; an alias counts as all nodes of its target."""
        before, alias = self._nodes, self.check_event(yaml.AliasEvent)
        mark = self.peek_event().start_mark  # type: ignore[no-untyped-call]
        self._depth += 1
        if self._depth > MAX_DEPTH:
            raise yaml.composer.ComposerError(None, None, f"nested more than {MAX_DEPTH} deep", mark)
        node = super().compose_node(parent, index)
        self._depth -= 1
        self._nodes += self._sizes.get(id(node), MAX_NODES) if alias else 1  # a recursive alias
        if self._nodes > MAX_NODES:
            raise yaml.composer.ComposerError(None, None, f"more than {MAX_NODES} values", mark)
        if not alias:
            self._sizes[id(node)] = self._nodes - before
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Construct a mapping; duplicate keys are refused."""
        seen = set()
        for key_node, _ in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                raise yaml.constructor.ConstructorError(None, None, "a key is not a word", key_node.start_mark)
            if key_node.value in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"the key {key_node.value!r} occurs twice", key_node.start_mark
                )
            seen.add(key_node.value)
        return super().construct_mapping(node, deep)


class SceneDumper(yaml.SafeDumper):
    """Safe dumper that quotes text which `SceneLoader` would parse as a number.

    It also escapes Unicode line breaks, which other readers may fold.
    """

    def represent_text(self, text: str) -> yaml.ScalarNode:
        """Represent text, in double quotes if it contains a Unicode line break."""
        return self.represent_scalar("tag:yaml.org,2002:str", text, '"' if BREAKS.search(text) else None)


SceneDumper.add_representer(str, SceneDumper.represent_text)


for _kind in (SceneLoader, SceneDumper):
    _kind.add_implicit_resolver("tag:yaml.org,2002:float", FLOAT, list("-+0123456789."))


def parse_yaml(text: str) -> Any:
    """Parse YAML text.

    Raises yaml.YAMLError: the text is not YAML, a value does not match its tag, a key occurs twice, or the document is
    too large.
    """
    try:
        return yaml.load(text, SceneLoader)
    except (ValueError, LookupError, AttributeError, TypeError) as error:  # raised by PyYAML for 2001-99-99 or !!int x
        raise yaml.YAMLError(f"{type(error).__name__}: {error}") from error


def read_text(path: str | Path, kind: type[InputError], where: str = "") -> str:
    """Read a UTF-8 text file of at most `MAX_BYTES`.

    `path`: the file. `kind`: class of the error to raise. `where`: the name in errors; by default the path. Raises
    InputError: the file cannot be read, is too long, or is not UTF-8.
    """
    where = where or str(path)
    require_regular_file(path, kind, where)
    try:
        with open(path, "rb") as file:
            content = file.read(MAX_BYTES + 1)
        if len(content) > MAX_BYTES:
            raise kind("too long", where=where, allowed=f"at most {MAX_BYTES} bytes of YAML or JSON")
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise kind(f"not UTF-8 text, at byte {error.start}", where=where, allowed="a YAML or JSON file") from None
    except (OSError, ValueError) as error:
        raise kind(f"cannot be read: {getattr(error, 'strerror', None) or error}", where=where) from None


def yaml_problem(error: yaml.YAMLError) -> str:
    """Return a YAML error on one line, with line and column."""
    problem = getattr(error, "problem", None) or str(error).splitlines()[0]
    mark = getattr(error, "problem_mark", None)
    return f"{problem} (line {mark.line + 1}, column {mark.column + 1})" if mark else str(problem)


def write_yaml(value: Any) -> str:
    """Return a tree of dicts, lists, texts and numbers as YAML; `parse_yaml` restores it exactly."""
    return yaml.dump(value, Dumper=SceneDumper, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120)
