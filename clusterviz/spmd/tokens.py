"""Tokens of an assembled shader: macros are expanded, and every token knows its file, line and column."""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Sequence
from typing import NamedTuple

from clusterviz.errors import InputError
from clusterviz.spmd.source import ShaderSource

WORD = re.compile(
    r"(?P<directive>^[ \t]*\#[^\n]*)|(?P<space>\s+|//[^\n]*|/\*.*?\*/)"
    r"|(?P<number>0[xX][0-9a-fA-F]+u?|(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?(?:LF|lf|[fFuU])?)|(?P<name>[A-Za-z_]\w*)"
    r"|(?P<sign><<=|>>=|\+\+|--|<<|>>|<=|>=|==|!=|&&|\|\||\^\^|[-+*/%&|^]=|[-+*/%&|^~!?:;,.<>=(){}\[\]])|(?P<bad>.)",
    re.MULTILINE | re.DOTALL,
)
_OUTSIDE = """
switch case default do discard goto subroutine precision highp mediump lowp invariant centroid flat smooth sample patch
attribute varying coherent volatile restrict asm class union enum typedef template this resource inline noinline public
static extern external interface long short half fixed unsigned superp input output hvec2 hvec3 hvec4 fvec2 fvec3 fvec4
filter sizeof cast namespace using common partition active
"""
OUTSIDE = frozenset(_OUTSIDE.split())
"""Words of GLSL that the subset does not have, and those that GLSL keeps for later."""
_WORDS = """
if else for while return break continue true false struct layout uniform buffer shared const in out inout precise
readonly writeonly
"""
WORDS = frozenset(_WORDS.split())
DEFINE = re.compile(r"\s*#\s*define\s+(\w+)(\([^)]*\))?(.*)")


class Token(NamedTuple):
    kind: str  # "name", "number", "sign" or "end"
    text: str  # its characters
    at: int  # position in the assembled text


class Macro(NamedTuple):
    """Tokens that replace a name; with parameters, the name and its arguments are removed."""

    tokens: tuple[Token, ...]
    has_parameters: bool


class Places:
    """Files, lines and columns of positions in an assembled shader."""

    def __init__(self, source: ShaderSource) -> None:
        self._text, self._names = source.text, source.names
        self._begins, self._lines = [0], [(0, 1)]

    def go_on(self, at: int, line: int, number: int) -> None:
        """Note that the text from a position on begins with this line of the file with this number."""
        self._begins.append(at)
        self._lines.append((number, line))

    def line_of(self, at: int) -> tuple[int, int]:
        """Return the number of the file, as several parts of a shader may be of one file, and the line."""
        part = bisect_right(self._begins, at) - 1
        number, line = self._lines[part]
        return number, line + self._text.count("\n", self._begins[part], at)

    def name_of(self, number: int) -> str:
        """Return the name of a file."""
        return self._names[number] if number < len(self._names) else str(number)

    def where(self, at: int) -> str:
        """Return "file:line:column"."""
        number, line = self.line_of(at)
        return f"{self.name_of(number)}:{line}:{at - self._text.rfind(chr(10), 0, at)}"

    def error(self, what: str, at: int, found: object = None, allowed: object = None) -> InputError:
        """Return the error of a position."""
        return InputError(what, where=self.where(at), found=found, allowed=allowed)


def tokens_of(source: ShaderSource) -> tuple[list[Token], Places]:
    """Return the tokens of a shader, the last one of kind "end", and the places of their positions.

    Raises InputError: a character or a preprocessor directive that the subset does not have.
    """
    places, found, macros = Places(source), list[Token](), dict[str, Macro]()
    skip_call = False
    for match in WORD.finditer(source.text):
        kind, text, at = str(match.lastgroup), match[0], match.start()
        if kind == "space":
            continue
        if kind == "directive":
            _direct(text, at, places, macros)
        elif kind == "bad":
            raise places.error("this character has no meaning", at, text)
        elif kind == "name" and text in macros:
            macro = macros[text]
            found += _expanded(macro, at, macros, {text})
            skip_call = macro.has_parameters
            depth = 0
        elif skip_call:
            depth += (text == "(") - (text == ")")
            skip_call = depth > 0
        else:
            if text in OUTSIDE:
                raise places.error("this word of GLSL is outside of the subset", at, text)
            found.append(Token(kind, text, at))
    found.append(Token("end", "the end", len(source.text)))
    return found, places


def closing(tokens: Sequence[Token], begin: int) -> int:
    """Return the number of the token that closes the bracket with a number."""
    depth = 0
    for n in range(begin, len(tokens)):
        depth += (tokens[n].text in "([{") - (tokens[n].text in ")]}")
        if not depth:
            return n
    raise AssertionError("a bracket that the parser has not missed")


def _expanded(macro: Macro, at: int, macros: dict[str, Macro], hidden: set[str]) -> list[Token]:
    found: list[Token] = []
    for kind, text, _ in macro.tokens:
        inner = macros.get(text) if kind == "name" and text not in hidden else None
        found += _expanded(inner, at, macros, hidden | {text}) if inner else [Token(kind, text, at)]
    return found


def _direct(line: str, at: int, places: Places, macros: dict[str, Macro]) -> None:
    words = line.replace("#", " ").split()
    if words[0] in ("version", "extension"):
        return
    if words[0] == "line" and len(words) == 3:
        places.go_on(at + len(line) + 1, int(words[1]), int(words[2]))
    elif words[0] == "undef" and len(words) == 2:
        macros.pop(words[1], None)
    elif words[0] == "define" and (match := DEFINE.match(line)):
        body = tuple(Token(str(m.lastgroup), m[0], at) for m in WORD.finditer(match[3]) if m.lastgroup != "space")
        if match[2] and body:
            raise places.error("a macro with parameters that is not empty", at, match[1])
        macros[match[1]] = Macro(body, bool(match[2]))
    else:
        raise places.error(
            "a preprocessor directive outside of the subset", at, words[0], "define, extension, undef, line, version"
        )
