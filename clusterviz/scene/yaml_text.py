"""YAML in and out, with what scenes need and YAML 1.1 lacks: no key twice, 1e-3 is a number, bounds on its size."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from clusterviz.errors import InputError

FLOAT = re.compile(
    r"""^(?:[-+]?(?:[0-9][0-9_]*\.[0-9_]*|\.[0-9][0-9_]*)(?:[eE][-+]?[0-9]+)?
    |[-+]?[0-9][0-9_]*[eE][-+]?[0-9]+
    |[-+]?\.(?:inf|Inf|INF)
    |\.(?:nan|NaN|NAN))$""",
    re.VERBOSE,
)
BREAKS = re.compile("[\x85\u2028\u2029]")
MOST_BYTES = 1 << 20
MOST_NODES, DEEPEST = 100_000, 50


class SceneLoader(yaml.SafeLoader):
    """The safe loader, for which a key that occurs twice is an error, and so is a text that stands for too much."""

    def __init__(self, stream: Any) -> None:
        super().__init__(stream)
        self._depth = self._nodes = 0
        self._sizes: dict[int, int] = {}

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """A node; an alias counts as all that it stands for."""
        before, alias = self._nodes, self.check_event(yaml.AliasEvent)
        mark = self.peek_event().start_mark  # type: ignore[no-untyped-call]
        self._depth += 1
        if self._depth > DEEPEST:
            raise yaml.composer.ComposerError(None, None, f"nested more than {DEEPEST} deep", mark)
        node = super().compose_node(parent, index)
        self._depth -= 1
        self._nodes += self._sizes.get(id(node), MOST_NODES) if alias else 1  # one that holds itself has no end
        if self._nodes > MOST_NODES:
            raise yaml.composer.ComposerError(None, None, f"more than {MOST_NODES} values", mark)
        if not alias:
            self._sizes[id(node)] = self._nodes - before
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """A mapping, whose keys differ."""
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
    """The safe dumper, which quotes every text that `SceneLoader` would take for a number.

    It escapes the rarer line breaks of Unicode, too: unescaped, a reader may fold them.
    """

    def represent_text(self, text: str) -> yaml.ScalarNode:
        """A text; in double quotes, which escape, where it holds such a break."""
        return self.represent_scalar("tag:yaml.org,2002:str", text, '"' if BREAKS.search(text) else None)


SceneDumper.add_representer(str, SceneDumper.represent_text)


for _kind in (SceneLoader, SceneDumper):
    _kind.add_implicit_resolver("tag:yaml.org,2002:float", FLOAT, list("-+0123456789."))


def parse_yaml(text: str) -> Any:
    """The value that a YAML text stands for.

    Raises
    ------
    yaml.YAMLError
        The text is not YAML, holds what its tag does not allow, stands for too much, or a key occurs twice.
    """
    try:
        return yaml.load(text, SceneLoader)
    except (ValueError, LookupError, AttributeError, TypeError) as error:  # what PyYAML makes of 2001-99-99, or !!int x
        raise yaml.YAMLError(f"{type(error).__name__}: {error}") from error


def read_text(path: str | Path, kind: type[InputError], where: str = "") -> str:
    """The text of a small file.

    Parameters
    ----------
    kind : of the error
    where : what the error names; the file where it is not given

    Raises
    ------
    InputError
        The file cannot be read, is too long, or is not UTF-8.
    """
    where = where or str(path)
    try:
        with open(path, "rb") as file:
            content = file.read(MOST_BYTES + 1)
        if len(content) > MOST_BYTES:
            raise kind("too long", where=where, allowed=f"at most {MOST_BYTES} bytes of YAML or JSON")
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise kind(f"not UTF-8 text, at byte {error.start}", where=where, allowed="a YAML or JSON file") from None
    except (OSError, ValueError) as error:
        raise kind(f"cannot be read: {getattr(error, 'strerror', None) or error}", where=where) from None


def yaml_problem(error: yaml.YAMLError) -> str:
    """A YAML error on one line: what, and at which line and column."""
    problem = getattr(error, "problem", None) or str(error).splitlines()[0]
    mark = getattr(error, "problem_mark", None)
    return f"{problem} (line {mark.line + 1}, column {mark.column + 1})" if mark else str(problem)


def write_yaml(value: Any) -> str:
    """Any tree of dicts, lists, texts and numbers as YAML; `parse_yaml` gives back the same tree, exactly."""
    return yaml.dump(value, Dumper=SceneDumper, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120)
