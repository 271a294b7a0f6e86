"""Checks of users' looks, and the form in which they are compiled; see look.py."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

from clusterviz.errors import InputError
from clusterviz.spmd.analysis import Facts, children, walk
from clusterviz.spmd.codegen import Generator
from clusterviz.spmd.ir import BuiltIn, Call, Declare, Element, Function, Loop, Name, Program
from clusterviz.spmd.look import MOST_ITERATIONS, Look
from clusterviz.spmd.parser import parse
from clusterviz.spmd.source import ShaderSource
from clusterviz.spmd.tokens import WORD, Places, Token, closing, tokens_of
from clusterviz.spmd.types import FLOAT, NUMBERS, Type

SIGNATURE = "vec4 look(float value, vec3 gradient, vec3 position)"
PARAMETERS = [FLOAT, NUMBERS["f", 3], NUMBERS["f", 3]]
MOST_NUMBERS = 1024  # in arrays
MOST_OPERATIONS = 20_000  # about; a call counts as what it calls, a loop as 1000
KEPT = "look_goes_on", "look_iterations"
MAIN = "void main() { vec4 unused = users_look(0.0, vec3(0.0), vec3(0.0)); }\n"


def make_look(text: str, path: str) -> Look:
    """Return the look of a text; see `plan.look_files.read_look`."""
    text = text.replace("\r", "\n").rstrip() + "\n"
    source = ShaderSource(text, (path,))
    places = Places(source)
    directive = next((found for found in WORD.finditer(text) if found.lastgroup == "directive"), None)
    if directive:
        raise places.error("a preprocessor directive; a look has none", directive.start(), directive[0].split()[0])
    program = parse(source)
    look = _look_of(program, path)
    bodies = [function.body for named in program.functions.values() for function in named if function.body]
    nodes = list(walk(*bodies, *(one.value for one in program.globals if one.value is not None)))
    _check(program, nodes)
    facts = Facts({})
    assert look.body is not None, "a look with a body"
    if (cost := facts.cost(look.body)) > MOST_OPERATIONS:
        raise places.error("too many operations", look.at, f"about {cost}", f"up to {MOST_OPERATIONS}")
    iterations = _iterations(look.body, facts)
    is_guarded = iterations is None or iterations > MOST_ITERATIONS
    tokens = tokens_of(source)[0]
    if kept := next((token for token in tokens if token.text in KEPT), None):
        raise places.error("this name is used already", kept.at, kept.text)
    structs = (name.text for word, name in pairwise(tokens) if word.text == "struct")
    names = (*program.functions, *(d.variable.name for d in program.globals), *structs)
    uses_gradient = any(isinstance(node, Name) and node.variable is look.parameters[1] for node in nodes)
    guarded = _guarded(text, program, nodes, tokens, is_guarded)
    iterations = MOST_ITERATIONS if iterations is None else min(iterations, MOST_ITERATIONS)
    found = Look(guarded, tuple(dict.fromkeys(names)), iterations, is_guarded, uses_gradient)
    # The whole way, so that nothing is left to find when it is drawn.
    whole = ShaderSource(found.glsl() + MAIN, (path,))
    Generator(parse(whole), 4, {}).text("look")
    return found


def _look_of(program: Program, path: str) -> Function:
    for function in program.functions.get("look", []):
        if function.body is not None and [p.type for p in function.parameters] == PARAMETERS:
            if function.result is NUMBERS["f", 4] and all(p.kind == "in" for p in function.parameters):
                return function
            raise program.places.error("look has another result, or other directions", function.at, None, SIGNATURE)
    raise InputError("no function look", where=path, allowed=SIGNATURE)


def _check(program: Program, nodes: list[Any]) -> None:
    error = program.places.error
    for block in program.blocks:
        raise error("a look reads no blocks or textures", block.at, block.name)
    if "main" in program.functions:
        raise error("a look has no main", program.functions["main"][0].at)
    for one in program.globals:
        if one.variable.kind != "const":
            raise error("a variable outside of functions, which is not const", one.at, one.variable.name)
        if one.value is not None and any(isinstance(node, Call) for node in walk(one.value)):
            raise error("a constant that calls a function", one.at, one.variable.name)
    numbers = 0
    for node in nodes:
        if isinstance(node, BuiltIn) and node.name in ("barrier", "atomicAdd", "atomicMin"):
            raise error("not in a look", node.at, node.name)
        if isinstance(node, Name) and node.variable.kind == "system":
            raise error("not in a look", node.at, node.variable.name)
        if isinstance(node, Declare):
            numbers += node.variable.type.parts * node.variable.type.is_array
            if numbers > MOST_NUMBERS:
                raise error("too large arrays", node.at, f"{numbers} numbers", f"up to {MOST_NUMBERS}")


def _iterations(node: Any, facts: Facts) -> int | None:
    """Return the most iterations of all loops in a node, with what it calls; None if that is not known."""
    parts = [_iterations(child, facts) for child in children(node)]
    if isinstance(node, Call) and node.function.body is not None:
        parts.append(_iterations(node.function.body, facts))
    if None in parts:
        return None
    found = sum(part for part in parts if part is not None)
    if not isinstance(node, Loop):
        return found
    counted = facts.counted(node)
    return len(counted[1]) * (1 + found) if counted else None


def _guarded(text: str, program: Program, nodes: list[Any], tokens: list[Token], counts: bool) -> str:
    """Return the text with loops that end, indices that are inside of arrays, and variables that begin as 0."""
    number = {token.at: n for n, token in enumerate(tokens)}
    edits = {(token.at, len("out"), "inout") for token in tokens if token.text == "out"}
    for node in nodes:
        if isinstance(node, Declare) and node.value is None and not node.variable.type.is_array:
            value = _zero(node.variable.type, program, node.variable.at)
            edits.add((node.variable.at + len(node.variable.name), 0, f" = {value}"))
        elif isinstance(node, Element) and node.index.type.element in ("i", "u"):
            begin = number[node.at]
            end = closing(tokens, begin)
            edits.add((tokens[begin].at + 1, 0, "clamp(int("))
            edits.add((tokens[end].at, 0, f"), 0, {node.base.type.size - 1})"))
        elif isinstance(node, Loop) and counts:
            begin = number[node.at] + 1
            end = closing(tokens, begin)
            if tokens[begin - 1].text == "for":
                signs = [n for n in range(begin, end) if tokens[n].text == ";"]
                begin, end = signs[0], signs[1]
            empty = end == begin + 1
            edits.add((tokens[begin].at + 1, 0, "" if empty else "("))
            edits.add((tokens[end].at, 0, "look_goes_on()" if empty else ") && look_goes_on()"))
    for at, length, new in sorted(edits, reverse=True):
        text = text[:at] + new + text[at + length :]
    return text


def _zero(kind: Type, program: Program, at: int) -> str:
    if any(of.is_array for _, of in kind.fields):
        raise program.places.error("a struct with an array", at, kind.name)
    if kind.fields:
        return f"{kind.name}({', '.join(_zero(of, program, at) for _, of in kind.fields)})"
    return f"{kind.name}(0)"
