"""Names and types: makes the typed program of what the parser reads, or says what is wrong with it."""

from __future__ import annotations

import operator
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from clusterviz.errors import InputError
from clusterviz.spmd import ir
from clusterviz.spmd.tokens import WORDS, Places, Token
from clusterviz.spmd.types import (
    BOOL,
    BUILT_IN,
    INT,
    MAT3,
    NAMED,
    NUMBERS,
    SAMPLERS,
    UINT,
    VOID,
    Type,
    array_of,
    built_in,
    common,
    converts,
    whole,
)

MOST_PARTS = 1 << 16  # of a value
SHOWN = 16  # names in a message
COORDINATES = ("xyzw", "rgba", "stpq")
SYSTEM = {
    "gl_LocalInvocationIndex": UINT,
    "gl_LocalInvocationID": NUMBERS["u", 3],
    "gl_WorkGroupID": NUMBERS["u", 3],
    "gl_NumWorkGroups": NUMBERS["u", 3],
    "gl_GlobalInvocationID": NUMBERS["u", 3],
}


def _quotient(a: Any, b: Any) -> Any:
    """Return the quotient of integers, rounded towards 0."""
    return abs(a) // abs(b) * (1 - 2 * ((a < 0) != (b < 0)))


OPERATORS: dict[str, Callable[[Any, Any], Any]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "&": operator.and_,
    "|": operator.or_,
    "^": operator.xor,
    "/": _quotient,
    "%": lambda a, b: a - b * _quotient(a, b),
    "<<": lambda a, b: a << (b & 31),
    ">>": lambda a, b: a >> (b & 31),
    "<": operator.lt,
    ">": operator.gt,
    "<=": operator.le,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
}
"""Operators of integers, numbers or arrays, before the result is cut to its bits."""


class Checker:
    """Scopes of names, and the typed expressions of operators, calls and members."""

    def __init__(self, places: Places) -> None:
        self.error = places.error
        self.types: dict[str, Type] = dict(NAMED)
        self.functions: dict[str, list[ir.Function]] = {}
        self.scopes: list[ir.Names] = [{name: ir.Variable(name, kind, "system", 0) for name, kind in SYSTEM.items()}]
        self.function: ir.Function | None = None
        self.only_reads = False  # no assignments; what is declared may be named in messages

    def open(self) -> None:
        """Begin a scope."""
        self.scopes.append({})

    def close(self) -> None:
        """End the innermost scope."""
        self.scopes.pop()

    def declare(self, name: str, at: int, meaning: ir.Variable | ir.Memory) -> None:
        """Give a name its meaning in the innermost scope."""
        self.check_name(name, at)
        if name in self.scopes[-1] or (len(self.scopes) == 1 and name in self.functions):
            raise self.error(f"{name} is declared twice", at)
        self.scopes[-1][name] = meaning

    def check_name(self, name: str, at: int) -> None:
        """Refuse to declare a name that is a word of GLSL, or a type's."""
        if name in WORDS or name.startswith("gl_"):
            raise self.error("this word is GLSL's own", at, name)
        if name in self.types:
            raise self.error(f"{name} is declared twice", at)

    def function_of(self, name: str, result: Type, parameters: list[ir.Variable], at: int) -> ir.Function:
        """Return the function with these parameters, which may have been declared before."""
        self.check_name(name, at)
        kinds = [one.type for one in parameters]
        for known in self.functions.get(name, []):
            if [one.type for one in known.parameters] == kinds:
                same_ways = [one.kind for one in known.parameters] == [one.kind for one in parameters]
                if known.result is not result or not same_ways:
                    raise self.error(f"{name} was declared with another result, or other directions of parameters", at)
                return known
        function = ir.Function(name, result, parameters, at)
        self.functions.setdefault(name, []).append(function)
        return function

    def value_of(self, token: Token) -> ir.Expression:
        """Return what a name stands for."""
        for scope in reversed(self.scopes):
            if (found := scope.get(token.text)) is not None:
                if isinstance(found, ir.Memory):
                    return replace(found, at=token.at)
                if found.constant is not None:
                    return ir.Constant(found.type, token.at, found.constant)
                return ir.Name(found.type, token.at, found)
        known = [name for scope in self.scopes for name in reversed(scope)]
        shown = ", ".join(known[:SHOWN]) + ", …" * (len(known) > SHOWN)
        raise self.error(f"{token.text} is not declared", token.at, None, shown if self.only_reads else None)

    def converted(self, value: ir.Expression, kind: Type, at: int, what: str = "the value") -> ir.Expression:
        """Return a value as one of another type, where GLSL converts without being told."""
        if value.type is kind:
            return value
        if not converts(value.type, kind):
            raise self.error(f"{what} has another type", at, value.type.name, kind.name)
        if isinstance(value, ir.Constant):
            return ir.Constant(kind, value.at, float(value.value) if kind.element in "fd" else value.value)
        return ir.Construct(kind, value.at, (value,))

    def unary(self, operator: str, value: ir.Expression, at: int) -> ir.Expression:
        """Return `-x`, `+x`, `!x` or `~x`."""
        element = value.type.element
        allowed = {"!": "b", "~": "iu"}.get(operator, "iufd")
        if value.type.element not in tuple(allowed) or value.type.of or (operator == "!" and not value.type.is_scalar):
            raise self.error(f"operator {operator} has no such operand", at, value.type.name)
        if operator == "+":
            return value
        if isinstance(value, ir.Constant) and operator == "-":
            negative = -value.value
            return ir.Constant(value.type, at, negative if isinstance(negative, float) else whole(element, negative))
        if isinstance(value, ir.Constant) and operator != "-":
            return ir.Constant(
                value.type, at, not value.value if operator == "!" else whole(element, ~int(value.value))
            )
        return ir.Operation(value.type, at, {"-": "neg"}.get(operator, operator), (value,))

    def binary(self, operator: str, a: ir.Expression, b: ir.Expression, at: int) -> ir.Expression:
        """Return an operator's value."""
        found = self._binary(operator, a, b, at)
        if found is None:
            raise self.error(f"operator {operator} has no such operands", at, f"{a.type.name} and {b.type.name}")
        return found

    def _binary(self, operator: str, a: ir.Expression, b: ir.Expression, at: int) -> ir.Expression | None:
        if operator in ("&&", "||"):
            return ir.Either(BOOL, at, operator, a, b) if a.type is BOOL is b.type else None
        if operator == "^^":
            return ir.Operation(BOOL, at, "!=", (a, b)) if a.type is BOOL is b.type else None
        if operator == "*" and a.type is MAT3 and b.type is NUMBERS["f", 3]:
            return ir.Operation(b.type, at, "transform", (a, b))
        if operator in ("<<", ">>"):
            whole = a.type.element in ("i", "u") and b.type.element in ("i", "u") and b.type.size in (1, a.type.size)
            kind = NUMBERS[a.type.element, b.type.size] if whole else None
            result = a.type
        else:
            kind = common(a.type, b.type)
            result = kind or a.type
            if operator in ("==", "!=") and a.type is b.type and a.type.parts and not a.type.is_array:
                return self._operation(operator, BOOL, a, b, at)
        if kind is None or (kind.element == "b") or (operator in ("%", "&", "|", "^") and kind.element not in "iu"):
            return None
        if operator in ("<", ">", "<=", ">=", "==", "!="):
            if not kind.is_scalar and (operator not in ("==", "!=") or a.type.size != b.type.size):
                return None
            result = BOOL
        a = a if operator in ("<<", ">>") else self.converted(a, NUMBERS[kind.element, a.type.size], at)
        b = b if operator in ("<<", ">>") else self.converted(b, NUMBERS[kind.element, b.type.size], at)
        return self._operation(operator, result, a, b, at)

    def _operation(self, operator: str, result: Type, a: ir.Expression, b: ir.Expression, at: int) -> ir.Expression:
        if operator in ("/", "%") and isinstance(b, ir.Constant) and b.type.element in "iu" and not b.value:
            raise self.error("division of an integer by 0", at)
        if (
            isinstance(a, ir.Constant)
            and isinstance(b, ir.Constant)
            and a.type.element in "iub"
            and operator in OPERATORS
        ):
            found: ir.Number = OPERATORS[operator](int(a.value), int(b.value))
            if result.element != "b":
                found = whole(result.element, found)
            return ir.Constant(result, at, bool(found) if result is BOOL else found)
        return ir.Operation(result, at, operator, (a, b))

    def choice(self, condition: ir.Expression, a: ir.Expression, b: ir.Expression, at: int) -> ir.Expression:
        """Return `condition ? a : b`."""
        condition = self.converted(condition, BOOL, at, "the condition")
        if a.type is not b.type:
            wanted = b.type if converts(a.type, b.type) else a.type
            a, b = self.converted(a, wanted, at), self.converted(b, wanted, at)
        if isinstance(condition, ir.Constant):
            return a if condition.value else b
        return ir.Either(a.type, at, "?", condition, a, b)

    def member(self, base: ir.Expression, name: Token) -> ir.Expression:
        """Return a member of a struct or block, or a swizzle."""
        kind = base.type
        if kind.fields:
            begin = 0
            for field, of in kind.fields:
                if field == name.text:
                    if isinstance(base, ir.Memory):
                        offset = base.offset + kind.offset(field, base.block.kind == "uniform")
                        return replace(base, type=of, at=name.at, offset=offset)
                    return ir.Pick(of, name.at, base, tuple(range(begin, begin + of.parts)))
                begin += of.parts
            raise self.error(
                f"{kind.name} has no member {name.text}", name.at, None, ", ".join(n for n, _ in kind.fields)
            )
        letters = next((all_ for all_ in COORDINATES if set(name.text) <= set(all_[: kind.size])), "")
        if not (kind.is_scalar or kind.is_vector) or not letters or len(name.text) > 4:
            raise self.error(f"{kind.name} has no component {name.text}", name.at)
        numbers = tuple(letters.index(letter) for letter in name.text)
        return ir.Pick(NUMBERS[kind.element, len(numbers)], name.at, base, numbers)

    def element(self, base: ir.Expression, index: ir.Expression, at: int) -> ir.Expression:
        """Return an element of an array, vector or matrix."""
        kind = base.type
        of = kind.of or (NUMBERS[kind.element, 1] if kind.is_vector else None)
        if of is None or index.type not in (INT, UINT):
            raise self.error("no such index", at, f"{kind.name}[{index.type.name}]")
        if isinstance(index, ir.Constant) and not 0 <= index.value < (kind.size or 1 << 31):
            raise self.error("an index outside of the array", at, index.value, f"0 to {kind.size - 1}")
        if kind.is_array and not isinstance(base, ir.Memory | ir.Name):
            raise self.error("an array inside of another value is outside of the subset", at)
        if isinstance(base, ir.Memory):
            stride = of.stride(base.block.kind == "uniform") if kind.of else NUMBERS[kind.element, 1].parts * 4
            if isinstance(index, ir.Constant):
                return replace(base, type=of, at=at, offset=base.offset + int(index.value) * stride)
            of_vector = None if kind.is_array else kind
            return replace(base, type=of, at=at, terms=(*base.terms, (index, stride)), component_of=of_vector)
        if isinstance(index, ir.Constant) and not kind.is_array:
            begin = int(index.value) * of.parts
            return ir.Pick(of, at, base, tuple(range(begin, begin + of.parts)))
        return ir.Element(of, at, base, index)

    def length(self, base: ir.Expression, at: int) -> ir.Constant:
        """Return the number of an array's elements, or of a vector's components."""
        if (not base.type.is_array and not base.type.is_vector) or not base.type.size:
            raise self.error("the length of this is not known", at, base.type.name)
        return ir.Constant(INT, at, base.type.size)

    def construct(self, kind: Type, arguments: list[ir.Expression], at: int) -> ir.Expression:
        """Return the value of a constructor."""
        if kind.fields:
            if len(arguments) != len(kind.fields):
                raise self.error(f"{kind.name} has {len(kind.fields)} members", at, len(arguments))
            given = [self.converted(a, of, at, name) for a, (name, of) in zip(arguments, kind.fields, strict=True)]
            return ir.Construct(kind, at, tuple(given))
        parts = [one.type.parts for one in arguments]
        known = kind.element and all(one.type.element for one in arguments)
        splat = parts == [1] and not kind.of
        if not known or not arguments or not (splat or sum(parts[:-1]) < kind.parts <= sum(parts)):
            raise self.error(f"no such constructor of {kind.name}", at, ", ".join(one.type.name for one in arguments))
        (first, *others) = arguments
        if isinstance(first, ir.Constant) and not others and kind.is_scalar:
            value, element = first.value, kind.element
            made = whole(element, value) if element in "iu" else bool(value) if element == "b" else float(value)
            return ir.Constant(kind, at, made)
        return first if not others and first.type is kind else ir.Construct(kind, at, tuple(arguments))

    def call(self, name: Token, arguments: list[ir.Expression]) -> ir.Expression:
        """Return the call of a function, a built-in function, or a constructor."""
        if (kind := self.types.get(name.text)) is not None:
            return self.construct(kind, arguments, name.at)
        given = [one.type for one in arguments]
        if any(name.text in scope for scope in self.scopes):
            raise self.error(f"{name.text} is a variable, and hides the function", name.at)
        if name.text in self.functions:
            return self._call(name, arguments, given)
        if name.text in BUILT_IN or name.text == "unpackDouble2x32":
            if (found := built_in(name.text, given)) is not None:
                result, kinds = found
                taken = [self.converted(a, k, name.at) for a, k in zip(arguments, kinds, strict=True)]
                return ir.BuiltIn(result, name.at, name.text, tuple(taken))
        elif name.text in ("texture", "texelFetch", "textureSize"):
            if (texel := self._texture(name.text, given)) is not None:
                return ir.BuiltIn(texel, name.at, name.text, tuple(arguments))
        elif name.text in ("barrier", "clock2x32ARB") and not given:
            return ir.BuiltIn(VOID if name.text == "barrier" else NUMBERS["u", 2], name.at, name.text, ())
        elif name.text in ("atomicAdd", "atomicMin"):
            if len(given) == 2 and given[0] is given[1] and given[0] in (INT, UINT):
                self.target(arguments[0])
                return ir.BuiltIn(given[0], name.at, name.text, tuple(arguments))
        else:
            raise self.error(f"{name.text} is not declared, or outside of the subset", name.at)
        raise self.error(f"{name.text} has no such parameters", name.at, ", ".join(kind.name for kind in given))

    def _texture(self, name: str, given: list[Type]) -> Type | None:
        size = next((n for n, kind in SAMPLERS.items() if given[:1] == [kind]), 0)
        lod = [INT] if name != "texture" else []
        at = {"texture": NUMBERS.get(("f", size)), "texelFetch": NUMBERS.get(("i", size))}.get(name)
        if not size or given[1:] != [*([at] if at else []), *lod]:
            return None
        return NUMBERS["i", size] if name == "textureSize" else NUMBERS["f", 4]

    def _call(self, name: Token, arguments: list[ir.Expression], given: list[Type]) -> ir.Expression:
        def fits(function: ir.Function) -> bool:
            same = zip(given, function.parameters, strict=True)
            return all(kind is p.type if p.kind != "in" else converts(kind, p.type) for kind, p in same)

        known = [f for f in self.functions[name.text] if len(f.parameters) == len(given)]
        exact = [f for f in known if [p.type for p in f.parameters] == given]
        for function in exact or [f for f in known if fits(f)]:
            for argument, parameter in zip(arguments, function.parameters, strict=True):
                if parameter.kind != "in":
                    self.target(argument)
            taken = [
                self.converted(a, p.type, name.at) if p.kind == "in" else a
                for a, p in zip(arguments, function.parameters, strict=True)
            ]
            if self.function:
                self.function.calls.append((function, name.at))
            return ir.Call(function.result, name.at, function, tuple(taken))
        raise self.error(f"{name.text} has no such parameters", name.at, ", ".join(kind.name for kind in given))

    def target(self, value: ir.Expression) -> None:
        """Note that a variable is assigned, or say that it cannot be."""
        if self.only_reads:
            raise self.error("an assignment", value.at)
        root = value
        while isinstance(root, ir.Pick | ir.Element):
            if isinstance(root, ir.Pick) and len(set(root.numbers)) < len(root.numbers):
                raise self.error("a component is assigned twice", value.at)
            if isinstance(root, ir.Element) and not root.base.type.is_array:
                raise self.component(value, root.base.type)
            root = root.base
        if isinstance(root, ir.Memory) and root.component_of is not None:
            raise self.component(value, root.component_of)
        variable = root.variable if isinstance(root, ir.Name) else root.block if isinstance(root, ir.Memory) else None
        if variable is None or variable.kind in ("const", "uniform", "sampler", "system") or variable.is_read_only:
            raise self.error("this cannot be assigned", value.at, variable.name if variable else "an expression")
        variable.is_assigned = True

    def component(self, value: ir.Expression, of: Type) -> InputError:
        """Return the error of an assignment for which some drivers do not link a program."""
        return self.error("a component is assigned by an index that is not constant", value.at, of.name)

    def assign(
        self, target: ir.Expression, operator: str, value: ir.Expression, at: int, gives_old: bool = False
    ) -> ir.Assign:
        """Return `target = value` or `target op= value`."""
        self.target(target)
        if target.type.is_array:
            raise self.error("an array as a whole cannot be assigned", at)
        if operator != "=":
            value = self.binary(operator[:-1], target, value, at)
        return ir.Assign(target.type, at, target, self.converted(value, target.type, at), gives_old)

    def array(self, kind: Type, size: ir.Expression, at: int) -> Type:
        """Return the type of an array whose size is a constant."""
        if not isinstance(size, ir.Constant) or size.type not in (INT, UINT) or size.value < 1:
            raise self.error("the size of an array is not a positive constant", at)
        return self.limited(array_of(kind, int(size.value)), at)

    def limited(self, kind: Type, at: int) -> Type:
        """Return a type unless it is too large."""
        if kind.parts > MOST_PARTS:
            raise self.error("a type of too many numbers", at, kind.parts, f"up to {MOST_PARTS}")
        return kind
