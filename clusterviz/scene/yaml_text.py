"""YAML in and out, with the two things that scenes need and YAML 1.1 lacks: no key twice, and 1e-3 is a number."""

from __future__ import annotations

import re
from typing import Any

import yaml

FLOAT = re.compile(
    r"""^(?:[-+]?(?:[0-9][0-9_]*\.[0-9_]*|\.[0-9][0-9_]*)(?:[eE][-+]?[0-9]+)?
    |[-+]?[0-9][0-9_]*[eE][-+]?[0-9]+
    |[-+]?\.(?:inf|Inf|INF)
    |\.(?:nan|NaN|NAN))$""",
    re.VERBOSE,
)
BREAKS = re.compile("[\x85\u2028\u2029]")


class SceneLoader(yaml.SafeLoader):
    """The safe loader, for which a key that occurs twice is an error."""

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
        The text is not YAML, or a key occurs twice.
    """
    return yaml.load(text, SceneLoader)


def yaml_problem(error: yaml.YAMLError) -> str:
    """A YAML error on one line: what, and at which line and column."""
    problem = getattr(error, "problem", None) or str(error).splitlines()[0]
    mark = getattr(error, "problem_mark", None)
    return f"{problem} (line {mark.line + 1}, column {mark.column + 1})" if mark else str(problem)


def write_yaml(value: Any) -> str:
    """Any tree of dicts, lists, texts and numbers as YAML; `parse_yaml` gives back the same tree, exactly."""
    return yaml.dump(value, Dumper=SceneDumper, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120)
