"""Probes: values of expressions at a place in a shader, for every invocation at its n-th visit.

The interpreter evaluates them when it comes by. For a compiler, OpenGL's or that of `spmd`, the shader gets a call that
writes them to a buffer. The rest of the text stays as it is, so side effects are kept.

Reference: M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section
7.1.4.
"""

from __future__ import annotations

import re
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import prod
from pathlib import PurePath

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import InputError
from clusterviz.spmd.interpreter import DTYPES, Array, Interpreter, Mask, Value
from clusterviz.spmd.ir import Block, Declare, Expression, Function, If, Loop, Names, Statement
from clusterviz.spmd.parser import parse, parse_expression
from clusterviz.spmd.source import ShaderSource
from clusterviz.spmd.tokens import closing, tokens_of
from clusterviz.spmd.types import BOOL, FLOAT, Type

SCALAR = re.compile(r"(?<![\w.])(?:\w+\.)*s(?![\w.(])")
"""The field's scalars in the shaders, `s` and `front.s`, in units of clim: 0 at its low end and 1 at its high one."""
NEAREST = 4
"""Lines that a message offers in place of one without a statement."""


@dataclass(frozen=True, eq=False)
class Place:
    """Statement, before which a probe looks."""

    statement: Statement
    function: Function
    names: Names  # the variables in scope
    is_body: bool  # it is the body of a branch or loop without braces
    anchor: Statement  # statement in front of which a call can be written: the loop for what a `for` declares


class Shader:
    """Shader that is debugged: its program, and the places of its statements.

    `source`: assembled. `clim`: the data's values at which the field's scalars are 0 and 1; None if there is not one
    volume.
    """

    def __init__(self, source: ShaderSource, clim: tuple[float, float] | None = None) -> None:
        self.source, self.program, self.clim = source, parse(source), clim
        self._tokens, self._positions = tokens_of(source)

    @cached_property
    def places(self) -> dict[Statement, Place]:
        """All statements of the functions, in the order of the text."""
        functions = [each for named in self.program.functions.values() for each in named if each.body]
        found = [place for each in functions for place in self._places_in(each)]
        return {place.statement: place for place in sorted(found, key=lambda place: place.statement.at)}

    def where(self, at: int) -> tuple[str, int]:
        """Return the file and the line of a position in the assembled text."""
        number, line = self._positions.line_of(at)
        return self._positions.name_of(number), line

    def places_at(self, text: str) -> list[Place]:
        """Return the first statement of a line, in every part of the shader that is of the file.

        `text`: FILE:LINE, where folders of the file are of no account. Raises InputError: the shader has no such file,
        or the line has no statement.
        """
        file, _, line = text.rpartition(":")
        if not file or not line.isdecimal():
            allowed = "FILE:LINE, as in march.glsl:140"
            raise InputError("not a place in a shader", where="--break", found=text, allowed=allowed)
        name, lines = PurePath(file).name, dict[int, dict[int, Place]]()
        for statement, place in self.places.items():
            number, found = self._positions.line_of(statement.at)
            if self._positions.name_of(number) == name:
                lines.setdefault(found, {}).setdefault(number, place)
        if not lines:
            allowed = ", ".join(sorted({self.where(statement.at)[0] for statement in self.places}))
            raise InputError("no code of this scene's shader", where="--break", found=file, allowed=allowed)
        if int(line) not in lines:
            near = sorted(sorted(lines, key=lambda number: abs(number - int(line)))[:NEAREST])
            allowed = f"{', '.join(map(str, near))}, the nearest ones"
            raise InputError("no statement begins in this line", where=f"--break {name}", found=line, allowed=allowed)
        return list(lines[int(line)].values())

    def expression(self, place: Place, text: str, option: str) -> Expression:
        """Return an expression of the variables in scope at a place; raises as `parse_expression`."""
        return parse_expression(text, option, self.program, place.names)

    def probe(self, where: str, watches: tuple[str, ...], condition: str = "", visit: int = 1) -> Probe:
        """Return a probe.

        Raises InputError: an option is wrong.

        Parameters
        ----------
        where : FILE:LINE
        watches : expressions of the variables in scope there, without calls of the shader's functions
        condition : counts visits where it holds, with the field's scalars in units of the data; "": all
        visit : that is looked at, from 1
        """
        return self.probe_at(self.places_at(where), watches, condition, visit)

    def probe_at(self, places: Sequence[Place], watches: tuple[str, ...], condition: str = "", visit: int = 1) -> Probe:
        """Return a probe of statements; see `probe`."""
        condition = self._in_data(condition, places[0].names)
        points = []
        for place in places:
            held = self.expression(place, condition, "--if") if condition else None
            if held is not None and held.type is not BOOL:
                raise InputError("the condition has another type", where="--if", found=held.type.name, allowed="bool")
            points.append(Point(place, held, tuple(self.expression(place, each, "--watch") for each in watches)))
            if _elements(points[0]) != _elements(points[-1]):
                raise InputError("the watches have other types in another part of the file", where="--watch")
        return Probe(tuple(points), condition, watches, visit)

    def _in_data(self, text: str, names: Names) -> str:
        """Return an expression in which the field's scalars are values of the data."""
        if self.clim is None or ("s" in names and names["s"].type is not FLOAT):
            return text
        low, high = map(float, self.clim)
        return SCALAR.sub(lambda found: f"({low!r} + {high - low!r} * {found[0]})", text)

    def _places_in(self, function: Function) -> Iterator[Place]:
        at = function.body.at if function.body else 0
        known: Names = {name: each for name, each in self.program.names.items() if each.at < at}
        known |= {each.name: each for each in function.parameters}

        def visit(node: Statement, names: Names, is_body: bool = False) -> Iterator[Place]:
            if isinstance(node, Block):
                # Variables that are declared together are not a scope of their own.
                together = all(isinstance(each, Declare) for each in node.statements)
                inner = names if together else dict(names)
                for number, each in enumerate(node.statements):
                    if not (together and number):
                        yield from visit(each, inner)
                    if isinstance(each, Declare):
                        inner[each.variable.name] = each.variable
                return
            inner = dict(names)
            if isinstance(node, Loop):
                for begin in visit(node.begin, inner) if node.begin else ():
                    yield replace(begin, is_body=is_body, anchor=node)
                for declare in node.begin.statements if isinstance(node.begin, Block) else [node.begin]:
                    if isinstance(declare, Declare):
                        inner[declare.variable.name] = declare.variable
            yield Place(node, function, dict(inner), is_body, node)
            if isinstance(node, If):
                for branch in filter(None, (node.then, node.otherwise)):
                    yield from visit(branch, inner, not isinstance(branch, Block))
            if isinstance(node, Loop):
                yield from visit(node.body, inner, not isinstance(node.body, Block))

        if function.body:
            yield from visit(function.body, known)

    def instrumented(self, probes: Sequence[Probe], binding: int) -> ShaderSource:
        """Return the shader with calls before the places of probes, which write to a storage buffer.

        `binding`: of the buffer, of `probe_bytes` for each invocation, in the order of `Interpreter`.
        """
        pieces = [
            piece
            for number, probe in enumerate(probes)
            for point in probe.points
            for piece in self._pieces(point, probe.call(number))
        ]
        text, begin, found = self.source.text, 0, list[str]()
        for at, piece in sorted(pieces, key=lambda piece: piece[0]):
            found += [text[begin:at], piece]
            begin = at
        whole = "".join([*found, text[begin:]])
        head, _, rest = whole.partition("\n") if whole.startswith("#version") else ("", "", whole)
        names, line = (*self.source.names, "<probe>"), 2 if head else 1
        functions = _functions(probes, binding, prod(self.program.local_size))
        return ShaderSource(f"{head}\n#line 1 {len(names) - 1}\n{functions}#line {line} 0\n{rest}", names)

    def _pieces(self, point: Point, call: str) -> Iterator[tuple[int, str]]:
        """The insertions, with their positions, of a call in front of a statement."""
        statement = point.place.anchor
        first = self._token_at(statement)
        if isinstance(statement, Loop) and point.place.statement is statement:
            begin, end = first + 1, closing(self._tokens, first + 1)
            if self._tokens[first].text == "for":
                begin = self._end(begin + 1)
                end = self._end(begin + 1)
            if begin + 1 < end:  # a condition
                yield self._tokens[begin].at + 1, f" {call} && ("
                yield self._tokens[end].at, ")"
            else:
                yield self._tokens[end].at, f" {call}"
        elif point.place.is_body:
            yield statement.at, f"{{ {call}; "
            yield self._after(statement), " }"
        else:
            yield statement.at, f"{call}; "

    def _token_at(self, statement: Statement) -> int:
        return bisect_left(self._tokens, statement.at, key=lambda token: token.at)

    def _after(self, statement: Statement) -> int:
        first = self._token_at(statement)
        if isinstance(statement, Block):
            return self._tokens[closing(self._tokens, first)].at + 1
        if isinstance(statement, If):
            return self._after(statement.otherwise or statement.then)
        return self._after(statement.body) if isinstance(statement, Loop) else self._tokens[self._end(first)].at + 1

    def _end(self, number: int) -> int:
        while self._tokens[number].text != ";":
            number = closing(self._tokens, number) + 1
        return number


@dataclass(frozen=True, eq=False)
class Point:
    """Place of a probe, with the typed condition and watches, which name variables of this place."""

    place: Place
    condition: Expression | None
    watches: tuple[Expression, ...]


@dataclass(frozen=True, eq=False)
class Probe:
    """What is looked at, where and when; see `Shader.probe`."""

    points: tuple[Point, ...]
    condition: str
    watches: tuple[str, ...]
    visit: int

    @property
    def scalars(self) -> list[tuple[str, str]]:
        """GLSL text, and element, of each scalar of the watches."""
        typed = zip(self.watches, self.points[0].watches, strict=True)
        return [(f"({text}){part}", element) for text, each in typed for part, element in scalars_of(each.type)]

    @property
    def words(self) -> int:
        """Words that an invocation writes: whether it came to the visit, and its scalars."""
        return 1 + sum(2 if element == "d" else 1 for _, element in self.scalars)

    def call(self, number: int) -> str:
        """GLSL expression, always true, that looks; `number` is that of its function."""
        call = f"probe_look_{number}({', '.join(text for text, _ in self.scalars)})"
        return f"(({self.condition}) ? {call} : true)" if self.condition else call


def _elements(point: Point) -> list[list[tuple[str, str]]]:
    return [list(scalars_of(each.type)) for each in point.watches]


def probe_bytes(probes: Sequence[Probe]) -> int:
    """Return the bytes that probes write for an invocation."""
    return 4 * sum(probe.words for probe in probes)


GLSL = {"f": "float", "d": "double", "i": "int", "u": "uint", "b": "bool"}
AS_WORDS = {"f": "floatBitsToUint({})", "d": "unpackDouble2x32({})", "i": "uint({})", "u": "{}", "b": "uint({})"}


def _functions(probes: Sequence[Probe], binding: int, lanes: int) -> str:
    """GLSL of the probes' buffer, and of a function for each, in work groups of so many lanes."""
    group = "(gl_WorkGroupID.z * gl_NumWorkGroups.y + gl_WorkGroupID.y) * gl_NumWorkGroups.x + gl_WorkGroupID.x"
    lane = f"(({group}) * {lanes}u + gl_LocalInvocationIndex)"
    lines, at = [f"layout(std430, binding = {binding}) buffer ProbeBlock {{ uint probe_words[]; }};"], 0
    for number, probe in enumerate(probes):
        elements = [element for _, element in probe.scalars]
        given = ", ".join(f"{GLSL[element]} given_{n}" for n, element in enumerate(elements))
        lines += [f"int probe_visits_{number} = 0;", f"bool probe_look_{number}({given}) {{"]
        lines += [f"++probe_visits_{number};", f"if (probe_visits_{number} != {probe.visit}) return true;"]
        lines += [f"uint at = {lane} * {probe_bytes(probes) // 4}u + {at}u;", "probe_words[at] = 1u;"]
        at, word = at + probe.words, 1
        for n, element in enumerate(elements):
            words = AS_WORDS[element].format(f"given_{n}")
            for part in (".x", ".y") if element == "d" else ("",):
                lines += [f"probe_words[at + {word}u] = {words}{part};"]
                word += 1
        lines += ["return true;", "}"]
    return "\n".join([*lines, ""])


@dataclass(frozen=True)
class Taken:
    """What a probe has found."""

    reached: Mask  # bool (lanes,): the lane has come to the visit
    values: Value  # for each scalar of the watches an array (lanes,), 0 where it has not


def taken_of_words(words: NDArray[np.uint8], probes: Sequence[Probe]) -> list[Taken]:
    """Return what the calls of an instrumented shader have written to the buffer."""
    rows, at, found = words.view(np.uint32).reshape(-1, probe_bytes(probes) // 4), 0, list[Taken]()
    for probe in probes:
        reached, values = rows[:, at] != 0, list[Array]()
        at += 1
        for _, element in probe.scalars:
            column = np.ascontiguousarray(rows[:, at : at + (2 if element == "d" else 1)])
            values.append(column[:, 0] != 0 if element == "b" else column.view(DTYPES[element])[:, 0])
            at += column.shape[1]
        found.append(Taken(reached, values))
    return found


def taken_by(interpreter: Interpreter, probes: Sequence[Probe], wanted: Mask | None = None) -> list[Taken]:
    """Execute a shader until all wanted lanes have come to the visit of every probe, or to its end."""
    lanes, points = interpreter.lanes, dict[Statement, list[int]]()
    found = [Taken(np.zeros(lanes, bool), [np.zeros(lanes, DTYPES[e]) for _, e in probe.scalars]) for probe in probes]
    visits = np.zeros((len(probes), lanes), np.int64)
    for number, probe in enumerate(probes):
        for point in probe.points:
            points.setdefault(point.place.statement, []).append(number)
    while (statement := interpreter.advance()) is not None:
        for number in points.get(statement, ()):
            probe, mask = probes[number], interpreter.mask
            point = next(each for each in probe.points if each.place.statement is statement)
            if point.condition is not None:
                mask = mask & interpreter.value(point.condition)[0]
            visits[number] += mask
            now = mask & (visits[number] == probe.visit)
            if not now.any():
                continue
            parts = [part for watch in point.watches for part in interpreter.value(watch, now)]
            for value, part in zip(found[number].values, parts, strict=True):
                value[now] = part[now]
            found[number].reached[now] = True
            if wanted is not None and all(each.reached[wanted].all() for each in found):
                return found
    return found


def scalars_of(kind: Type) -> Iterator[tuple[str, str]]:
    """Yield for each scalar of a type what is written behind a value, and the element."""
    if kind.fields:
        yield from ((f".{name}{part}", element) for name, of in kind.fields for part, element in scalars_of(of))
    elif kind.of:
        yield from ((f"[{n}]{part}", element) for n in range(kind.size) for part, element in scalars_of(kind.of))
    elif kind.size > 1:
        yield from ((f".{name}", kind.element) for name in "xyzw"[: kind.size])
    else:
        yield "", kind.element
